"""A robot in a file, and its calibration."""
