"""The page `notebooks/recording.ipynb`."""
