"""The page `notebooks/closed_loop.ipynb`."""
