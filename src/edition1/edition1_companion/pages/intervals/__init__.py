"""The page `notebooks/intervals.ipynb`."""
