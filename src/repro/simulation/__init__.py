"""Synthetic recordings, called synthetic everywhere."""
