"""The page `notebooks/one_robot.ipynb`."""
