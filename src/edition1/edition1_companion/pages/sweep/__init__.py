"""The page `notebooks/sweep.ipynb`."""
