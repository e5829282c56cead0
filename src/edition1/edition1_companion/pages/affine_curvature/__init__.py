"""The page `notebooks/affine_curvature.ipynb`."""
