"""The page `notebooks/performance.ipynb`."""
