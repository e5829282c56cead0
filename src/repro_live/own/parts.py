"""The two parts of a recording in time, and poses of the first that spread over all that it reaches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from repro.errors import bad_input
from repro.robot_file.robot_file import RobotFile
from repro_live.robot.calibration_poses import farthest_points

LEAST_S = 5.0
"""Shortest time with poses for each of the two parts [s]."""
APART_S = 1.0
"""Time between the two parts, which belongs to neither [s]."""
POSES = 100
"""Most poses that a robot is calibrated with."""
LEAST_POSES = 20


@dataclass(frozen=True)
class TimeParts:
    """What a robot is calibrated with, and what it is judged on.

    Parameters
    ----------
    first
        Readings with a pose in the first part.
    rest
        All readings of the second part.
    first_s, rest_s
        Beginning and end of the two by the clock of the readings [s].
    """

    first: Bool[np.ndarray, " readings"]
    rest: Bool[np.ndarray, " readings"]
    first_s: tuple[float, float]
    rest_s: tuple[float, float]


def split_in_time(
    time_s: Float[np.ndarray, " readings"], known: Bool[np.ndarray, " readings"], share: float
) -> TimeParts:
    """Split the time over which poses are known: a share first, a gap of one second, the rest.

    Parameters
    ----------
    time_s
        Of the readings [s].
    known
        At which of them there is a pose.
    share
        Of the first part.

    Raises
    ------
    InputError
        If a part is shorter than :data:`LEAST_S`, or has too few readings with a pose.
    """
    if not 0 < share < 1:
        raise bad_input("share", "repro fit", "between 0 and 1", share)
    if not known.any():
        raise bad_input("readings and poses", "repro fit", "of one time", "no reading with a pose")
    start, end = float(time_s[known][0]), float(time_s[known][-1])
    border = start + share * (end - start)
    lengths = border - start, end - border - APART_S
    if min(lengths) < LEAST_S:
        expected = f"of {LEAST_S:g} s to calibrate with and {LEAST_S:g} s to judge, {APART_S:g} s apart"
        seen = f"{end - start:.1f} s in common, a share of {share:g} to calibrate with"
        raise bad_input("readings and poses", "repro fit", expected, seen)
    first = known & (time_s <= border)
    rest = (time_s >= border + APART_S) & (time_s <= end)
    for words, chosen in (("the first part", first), ("the rest", rest & known)):
        if chosen.sum() < LEAST_POSES:
            expected = f"at least {LEAST_POSES} readings with a pose in {words}"
            raise bad_input("readings and poses", "repro fit", expected, int(chosen.sum()))
    return TimeParts(first, rest, (start, border), (border + APART_S, end))


def spread(robot: RobotFile, q: Float[Tensor, "poses n_q"], most: int = POSES) -> Int[Tensor, " chosen"]:
    """Indices of poses that spread, in order: each next one is the farthest from those chosen before.

    Distances are in widths of the bounds; the first is the one nearest to the mean.
    """
    x = q / (robot.upper - robot.lower)
    first = (x - x.mean(0)).square().sum(-1).argmin()
    return torch.cat([first[None], farthest_points(x, x[first], min(most, len(q)) - 1)]).sort().values
