"""The page `notebooks/bend_tests.ipynb`."""
