"""The page `notebooks/light_bulb.ipynb`."""
