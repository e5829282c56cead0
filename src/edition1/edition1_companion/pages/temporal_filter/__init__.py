"""The page `notebooks/temporal_filter.ipynb`."""
