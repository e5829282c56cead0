"""Readers of the papers' files, and where these come from."""
