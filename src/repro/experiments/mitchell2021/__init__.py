"""Experiments of Mitchell et al. 2021, simulated and recorded."""
