"""The page `notebooks/recorded_trial.ipynb`."""
