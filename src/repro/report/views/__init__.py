"""3-D views of the notebooks, for the viewer."""
