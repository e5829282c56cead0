"""The page `notebooks/robustness.ipynb`."""
