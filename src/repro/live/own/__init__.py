"""Own recordings with motion capture: one clock, a calibration, estimates, and how far off they are."""
