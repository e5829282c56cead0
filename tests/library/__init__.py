"""Tests of the library; they share the robots of `robots.py`."""
