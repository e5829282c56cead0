"""The page `notebooks/live.ipynb`."""
