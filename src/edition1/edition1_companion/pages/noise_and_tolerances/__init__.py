"""The page `notebooks/noise_and_tolerances.ipynb`."""
