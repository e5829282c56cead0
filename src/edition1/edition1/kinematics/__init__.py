"""Configuration to poses along the backbone: segments, robots, mounts."""
