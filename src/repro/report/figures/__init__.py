"""Figures of the notebooks, one module for each notebook or paper."""
