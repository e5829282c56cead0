"""The page `notebooks/constant_curvature_floor.ipynb`."""
