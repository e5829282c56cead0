"""Which IMUs a model of the arm is fed, and how long its links are: Table I of Martin et al., three readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from repro.errors import bad_input

IMU_ARCS = (0.0, 0.08, 0.16, 0.24, 0.32, 0.4, 0.48, 0.56, 0.64)
"""Arc positions [m] of the base and of IMUs #1 to #8 (Table I)."""

MARKERS = (0.36, 0.6)
"""Arc positions [m] of the motion-capture markers M1 and M2 (section III-A)."""

READINGS = ("table", "text", "files")

# Arc positions at which most of the released curves were evaluated: the joints below the markers.
_RELEASED_POINTS = (0.32, 0.56)
_RIGID_IMUS = {
    ("table", 2): (2, 6),
    ("table", 4): (2, 4, 6, 8),
    ("text", 2): (2, 6),
    ("text", 4): (1, 3, 5, 7),
    ("files", 2): (1, 6),
    ("files", 4): (1, 3, 5, 7),
}
_PCC_IMUS = {2: (0, 4, 8), 4: (0, 2, 4, 6, 8), 8: (0, 1, 2, 3, 4, 5, 6, 7, 8)}


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

    Raises
    ------
    InputError
        If numbers of IMUs, arc positions and links do not fit together, arc positions do not increase, or a
        length is not positive.
    """

    imus: tuple[int, ...]
    arcs: tuple[float, ...]
    link_lengths: tuple[float, ...]
    markers: tuple[float, float] = MARKERS
    sub_links: int = 0

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

    def of(self, orientations: Float[np.ndarray, "*samples nine 4"]) -> Float[np.ndarray, "*samples imus 4"]:
        """Pick the orientations of this selection out of those of the base and all IMUs, in order.

        Raises
        ------
        InputError
            If there is no orientation for one of the IMUs.
        """
        if np.ndim(orientations) < 2 or np.shape(orientations)[-2] <= max(self.imus):
            expected = f"those of the base and IMUs #1 to #{max(self.imus)} at least"
            raise bad_input("orientations", "Selection", expected, f"shape {np.shape(orientations)}")
        return orientations[..., list(self.imus), :]


def selection(model: str, n_imus: int, reading: str = "table", *, segments: int | None = None) -> Selection:
    """Return the IMUs and links of one of the paper's models.

    The rigid-body model has one link per IMU. Table I puts its 2 IMUs (#2, #6) in the middle of their
    sections, its 8 at the ends; for 4 the table has #2, 4, 6, 8 (section ends), the text ("midpoint of each
    of four equal sections", section III-B1) means #1, 3, 5, 7. The PCC-extended model has one link between
    each two of the base and the IMUs in use, cut into sub-segments; table and text agree.

    The reading "files" is what the curves in the authors' repository were computed with (folder ``data
    analysis/data``), to be confirmed with the motion-capture file, which is not released:

    ========================================= ========================== ================================
    published                                 file                       IMUs; points evaluated [mm]
    ========================================= ========================== ================================
    Fig. 3, 2 IMUs                            ``fly/less_imu_2``         #1, #6; 320, 560
    Fig. 3, 4 IMUs                            ``fly/less_imu_4``         #1, 3, 5, 7; 320, 560
    Fig. 3, 8 IMUs; Table II; Fig. 4, 8       ``elephant/pcc/pcc1``      base, #1 to 7, one sub-segment
    segments                                                             per link; 320, 560
    Fig. 4, 16, 32, 64; Table II; Fig. 5, 8   ``elephant/pcc/pcc2``,     base, #1 to 8, base link 5 mm
                                              ``pcc4``, ``pcc8``         short; the markers (355, 595)
    Fig. 5, 2 and 4 IMUs                      ``fly/pcc16_2``, ``_4``    as in the table (inferred);
                                                                         320, 560
    ========================================= ========================== ================================

    So ``selection("rigid", 8, "files")`` has the links of a PCC-extended model:
    `repro.estimation.imu_models.chain` takes either.

    Parameters
    ----------
    model
        "rigid" or "pcc" (PCC-extended).
    n_imus
        2, 4 or 8 IMUs, the base not counted.
    reading
        "table", "text" or "files".
    segments
        Sub-segments of the PCC-extended model in all: a multiple of the number of links, 16 when not given.

    Raises
    ------
    InputError
        Unknown model, number of IMUs or reading; segments that do not divide evenly, were not released, or
        belong to no PCC-extended model.

    Examples
    --------
    >>> selection("rigid", 4, "text").imus, selection("pcc", 4).sub_links
    ((1, 3, 5, 7), 4)
    """
    if model not in ("rigid", "pcc"):
        raise bad_input("model", "selection", '"rigid" or "pcc"', model)
    if n_imus not in _PCC_IMUS:
        raise bad_input("n_imus", "selection", "2, 4 or 8", n_imus)
    if reading not in READINGS:
        raise bad_input("reading", "selection", 'one of "table", "text" and "files"', reading)
    if model == "pcc":
        return _pcc(n_imus, reading, 16 if segments is None else segments)
    if segments is not None:
        raise bad_input("segments", "selection", "left out for the rigid-body model", segments)
    if n_imus == 8:
        return _pcc(8, reading, 8) if reading == "files" else _made((1, 2, 3, 4, 5, 6, 7, 8), (0.08,) * 8)
    points = _RELEASED_POINTS if reading == "files" else MARKERS
    return _made(_RIGID_IMUS[reading, n_imus], (0.64 / n_imus,) * n_imus, points)


def _pcc(n_imus: int, reading: str, segments: int) -> Selection:
    """Return the selection of a PCC-extended model."""
    if segments < n_imus or segments % n_imus:
        raise bad_input("segments", "selection", f"a multiple of {n_imus} (one link per IMU)", segments)
    imus, lengths, sub_links = _PCC_IMUS[n_imus], (0.64 / n_imus,) * n_imus, segments // n_imus
    if reading != "files":
        return _made(imus, lengths, MARKERS, sub_links)
    if segments not in (released := (8, 16, 32, 64) if n_imus == 8 else (16,)):
        raise bad_input("segments", "selection", f"one of those released, {released}", segments)
    if segments == 8:
        return _made(imus[:-1], lengths[:-1], _RELEASED_POINTS, sub_links)
    if n_imus == 8:
        return _made(imus, (0.075, *lengths[1:]), (0.355, 0.595), sub_links)
    return _made(imus, lengths, _RELEASED_POINTS, sub_links)


def _made(
    imus: tuple[int, ...],
    lengths: tuple[float, ...],
    markers: tuple[float, float] = MARKERS,
    sub_links: int = 0,
) -> Selection:
    return Selection(imus, tuple(IMU_ARCS[imu] for imu in imus), lengths, markers, sub_links)
