"""A robot in a file: its parts, sensors, noise and limits, read and checked."""
