"""Synthetic robots, motions and readings, and what several pages do with them."""
