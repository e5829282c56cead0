"""Experiments of Martin et al. 2022, recorded and simulated."""
