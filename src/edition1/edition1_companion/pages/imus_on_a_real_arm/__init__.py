"""The page `notebooks/imus_on_a_real_arm.ipynb`."""
