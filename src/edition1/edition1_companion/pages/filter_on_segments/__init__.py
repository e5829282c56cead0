"""The page `notebooks/filter_on_segments.ipynb`."""
