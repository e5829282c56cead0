"""Experiments of Baaij et al. 2023, simulated and on the rig."""
