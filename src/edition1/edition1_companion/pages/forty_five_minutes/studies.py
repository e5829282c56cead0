"""The studies of twins of 45 minutes: robots calibrated by motion and with poses."""

from __future__ import annotations

ROBOTS = ("one_segment", "two_segments", "three_segments")
POSES = ("1", "2", "3", "places", "places_2", "straight")
"""What the names of the studies end in: robots that drift, robots with parts out of place, motion that begins straight."""
