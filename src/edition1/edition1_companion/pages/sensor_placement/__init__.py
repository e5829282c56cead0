"""The page `notebooks/sensor_placement.ipynb`."""
