"""Wire formats and ports."""
