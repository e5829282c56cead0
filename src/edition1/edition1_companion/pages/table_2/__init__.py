"""The page `notebooks/table_2.ipynb`."""
