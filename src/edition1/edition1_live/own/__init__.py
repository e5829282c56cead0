"""A robot of one's own: pairs of readings and shapes, calibration and fit, also at the board."""
