"""The page `notebooks/fusion.ipynb`."""
