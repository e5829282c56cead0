"""The page `notebooks/sensor_failure.ipynb`."""
