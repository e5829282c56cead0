"""The page `notebooks/forty_five_minutes.ipynb`."""
