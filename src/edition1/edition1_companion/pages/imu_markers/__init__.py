"""The page `notebooks/imu_markers.ipynb`."""
