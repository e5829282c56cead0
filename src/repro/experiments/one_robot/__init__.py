"""One robot with the sensors of all three papers."""
