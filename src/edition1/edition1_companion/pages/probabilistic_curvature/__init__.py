"""The page `notebooks/probabilistic_curvature.ipynb`."""
