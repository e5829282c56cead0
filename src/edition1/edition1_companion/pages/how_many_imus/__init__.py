"""The page `notebooks/how_many_imus.ipynb`."""
