"""The page `notebooks/digital_twin.ipynb`."""
