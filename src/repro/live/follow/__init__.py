"""From frames to estimates while they arrive."""
