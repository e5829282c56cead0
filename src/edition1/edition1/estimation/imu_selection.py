"""Which IMUs a model of an arm is fed, where they are, and how long its links are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input
from edition1.estimation.orientations import UNIT_TOLERANCE, product

_INTERPOLATIONS = ("midpoints", "inner points")


@dataclass(frozen=True)
class Selection:
    """What a model of the arm is made of.

    Parameters
    ----------
    imus
        IMUs in use, base to tip: 0 is the base, 1 to 8 are IMUs #1 to #8.
    arcs
        Where they are on the arm: arc positions [m], increasing.
    link_lengths
        Lengths of the model's links [m], base to tip.
    markers
        Arc positions [m] along the model's chain that stand for the markers M1 and M2.
    sub_links
        Sub-segments n of each link, between two adjacent IMUs (section II-B); 0 for the rigid-body model,
        which has one link per IMU.
    interpolation
        How far from one IMU to the next sub-segment k of n is turned: "midpoints", (2k + 1)/2n as printed, or "inner
        points", (k + 1)/(n + 1) as in some released files. With one sub-segment both are 1/2.
    base_turn
        Turn of the base's frame against the one that is handed to `of`, a unit quaternion XYZW.
    origin_m
        Where the chain begins, from the base, in the world frame [m]; added to every position.

    Raises
    ------
    InputError
        If numbers of IMUs, arc positions and links do not fit together, arc positions do not increase, a length is
        not positive, the interpolation is unknown, or turn or origin cannot be used.
    """

    imus: tuple[int, ...]
    arcs: tuple[float, ...]
    link_lengths: tuple[float, ...]
    markers: tuple[float, float] = (0.36, 0.6)
    sub_links: int = 0
    interpolation: str = "midpoints"
    base_turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        arcs, lengths = np.array(self.arcs), np.array(self.link_lengths)
        if not self.imus or len(arcs) != len(self.imus):
            raise bad_input("arcs", "Selection", f"one per IMU, {len(self.imus)} in all", self.arcs)
        if not (np.isfinite(arcs).all() and (np.diff(arcs, prepend=-1e-12) > 0).all()):
            raise bad_input("arcs", "Selection", "increasing from 0 or above [m]", self.arcs)
        if self.sub_links < 0:
            raise bad_input("sub_links", "Selection", "0 (rigid-body model) or above", self.sub_links)
        links = len(arcs) - (self.sub_links > 0)
        if not links or len(lengths) != links:
            raise bad_input("link_lengths", "Selection", f"one per link, {links} in all", self.link_lengths)
        if not (np.isfinite(lengths) & (lengths > 0)).all():
            raise bad_input("link_lengths", "Selection", "positive [m]", self.link_lengths)
        if self.interpolation not in _INTERPOLATIONS:
            known = " or ".join(f'"{name}"' for name in _INTERPOLATIONS)
            raise bad_input("interpolation", "Selection", known, self.interpolation)
        if np.shape(self.base_turn) != (4,) or not abs(np.linalg.norm(self.base_turn) - 1) <= UNIT_TOLERANCE:
            raise bad_input("base_turn", "Selection", "a unit quaternion XYZW", self.base_turn)
        if np.shape(self.origin_m) != (3,) or not np.isfinite(self.origin_m).all():
            raise bad_input("origin_m", "Selection", "three finite coordinates [m]", self.origin_m)

    @property
    def turn_share(self) -> float:
        """Share of a link's turn that its n sub-segments are spread over, about its middle: 1, or n/(n + 1)."""
        return self.sub_links / (self.sub_links + 1) if self.interpolation == "inner points" else 1.0

    def of(self, orientations: Float[np.ndarray, "*samples nine 4"]) -> Float[np.ndarray, "*samples imus 4"]:
        """Pick the orientations of this selection out of those of the base and all IMUs, in order.

        That of the base is turned by ``base_turn``.

        Raises
        ------
        InputError
            If there is no orientation for one of the IMUs.
        """
        if np.ndim(orientations) < 2 or np.shape(orientations)[-2] <= max(self.imus):
            expected = f"those of the base and IMUs #1 to #{max(self.imus)} at least"
            raise bad_input("orientations", "Selection", expected, f"shape {np.shape(orientations)}")
        picked = orientations[..., list(self.imus), :]
        if self.imus[0] == 0 and self.base_turn != (0.0, 0.0, 0.0, 1.0):
            picked[..., 0, :] = product(picked[..., 0, :], np.array(self.base_turn))
        return picked
