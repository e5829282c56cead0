"""The page `notebooks/table_1.ipynb`."""
