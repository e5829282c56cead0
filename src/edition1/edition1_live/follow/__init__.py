"""Estimates while readings come in, and their page."""
