"""A rig whose readings are linear in its bend, and a segment that follows its commands linearly."""

from dataclasses import replace

import numpy as np

from edition1_companion.pages.closed_loop.identification import Segment
from edition1_companion.twins.rig_map import SCALE_MM, BendMap

SLOPES = np.array([[-5.0, 1.0, -4.0], [-3.0, -3.0, 1.5]])  # mV/mm
ACROSS = np.array([[2.0, 0.5, 1.4], [1.5, 1.8, 1.0]])  # mV s/mm


def linear_map(**changes) -> BendMap:
    """Readings linear in the bend."""
    factors = np.vstack([[1300.0, 1200.0, 1400.0], SCALE_MM * SLOPES])
    box = np.full(2, 9.0)
    known = BendMap(
        degree=1,
        factors=factors,
        noise_mv=np.full(3, 0.6),
        error_mv=np.full(3, 0.5),
        error_s=1.5,
        acceleration=2.0,
        rate=3.0,
        mean_mm=np.zeros(2),
        spread_mm=np.array([3.0, 4.0]),
        elongation_mm=np.array([4.5, 0.0]),
        elongation_spread_mm=1e-3,
        lower=-box,
        upper=box,
        starts=np.stack(np.meshgrid(*[np.linspace(-8.0, 8.0, 9)] * 2), axis=-1).reshape(-1, 2),
        elongation_slope=0.0,
    )
    return replace(known, **changes)


def segment(**changes) -> Segment:
    """Seven millimetres for the reference torque, linear; 0.2 s."""
    static = np.zeros((10, 2))
    static[1:3] = 7.0 * np.eye(2)
    known = Segment(
        lag_s=0.2,
        static=static,
        rest_mm=np.zeros(2),
        apart_mm=0.1,
        apart_s=0.8,
        centre=0.1,
        across=ACROSS,
        error_mv=np.full(3, 0.5),
        share=0.0,
    )
    return replace(known, **changes)
