"""The page `notebooks/recorded_arm.ipynb`."""
