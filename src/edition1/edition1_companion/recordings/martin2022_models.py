"""Which IMUs the models of Martin et al. are fed, and how long their links are: Table I, three readings."""

from __future__ import annotations

from dataclasses import replace

from edition1.errors import bad_input, require
from edition1.estimation.imu_selection import Selection

IMU_ARCS = (0.0, 0.08, 0.16, 0.24, 0.32, 0.4, 0.48, 0.56, 0.64)
"""Arc positions [m] of the base and of IMUs #1 to #8 (Table I)."""


READINGS = ("table", "text", "files")


FILES_ORIGIN_M = (0.0, 0.0, 0.0178)
"""Where the chains of the released files begin, from the base [m]."""


FILES_BASE_TURN = (0.0, 0.0, 1.0, 0.0)
"""Turn of the base in the released chains, XYZW: half a turn about the vertical (``base_orientation_quaternion`` of
``my_config.yaml``)."""


_RIGID_IMUS = {
    ("table", 2): (2, 6),
    ("table", 4): (2, 4, 6, 8),
    ("text", 2): (2, 6),
    ("text", 4): (1, 3, 5, 7),
    ("files", 2): (1, 6),
    ("files", 4): (1, 3, 5, 7),
}


_PCC_IMUS = {2: (0, 4, 8), 4: (0, 2, 4, 6, 8), 8: (0, 1, 2, 3, 4, 5, 6, 7, 8)}


def selection(model: str, n_imus: int, reading: str = "table", *, segments: int | None = None) -> Selection:
    """Return the IMUs and links of one of the paper's models.

    The rigid-body model has one link per IMU. Table I puts its 2 IMUs (#2, #6) in the middle of their
    sections, its 8 at the ends; for 4 the table has #2, 4, 6, 8 (section ends), the text ("midpoint of each
    of four equal sections", section III-B1) means #1, 3, 5, 7. The PCC-extended model has one link between
    each two of the base and the IMUs in use, cut into sub-segments; table and text agree.

    The reading "files" is what the curves in the authors' repository were computed with (State-Estimator-for-Soft-
    Arm-SESA, commit 6045c11, folder ``data analysis/data``): its chains give the points of the released tables to
    1e-6 m from the orientations of the trial (checked in the tests where the tables are found).

    ========================================= ========================== ================================
    published                                 file                       IMUs; points evaluated [mm]
    ========================================= ========================== ================================
    Fig. 3, 2 IMUs                            ``fly/less_imu_2``         #1, #6; 320, 560
    Fig. 3, 4 IMUs                            ``fly/less_imu_4``         #1, 3, 5, 7; 320, 560
    Fig. 3, 8 IMUs; Table II; Fig. 4, 8       ``elephant/pcc/pcc1``      base, #1 to 7, one sub-segment
    segments                                                             per link; 315, 555
    Fig. 4, 16, 32, 64; Table II; Fig. 5, 8   ``elephant/pcc/pcc2``,     base, #1 to 8, inner points;
                                              ``pcc4``, ``pcc8``         the markers (355, 595)
    Fig. 5, 2 and 4 IMUs                      ``fly/pcc16_2``, ``_4``    as in the table; 320, 560
    ========================================= ========================== ================================

    All begin 17.8 mm above the base; those with a link from the base have it turned by half a turn about the
    vertical (`FILES_BASE_TURN`). In the ``pcc`` files IMU #1 is 74.8 mm from the base along the chain, where Table I
    has 80 mm, so that their points are 5 mm short; in the others it is within 0.2 mm.

    So ``selection("rigid", 8, "files")`` has the links of a PCC-extended model:
    `edition1.estimation.imu_models.chain` takes either.

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
    require(model in ("rigid", "pcc"), "model", "selection", '"rigid" or "pcc"', model)
    require(n_imus in _PCC_IMUS, "n_imus", "selection", "2, 4 or 8", n_imus)
    require(reading in READINGS, "reading", "selection", 'one of "table", "text" and "files"', reading)
    if model == "pcc":
        return _pcc(n_imus, reading, 16 if segments is None else segments)
    require(segments is None, "segments", "selection", "left out for the rigid-body model", segments)
    imus = _RIGID_IMUS.get((reading, n_imus), tuple(range(1, 9)))
    if reading != "files":
        return _made(imus, (0.64 / n_imus,) * n_imus)
    if n_imus == 8:
        return _pcc(8, reading, 8)
    lengths = (0.64 / n_imus - 0.018, *(0.64 / n_imus,) * (n_imus - 1))
    return replace(_made(imus, lengths), markers=(0.302, 0.542), origin_m=FILES_ORIGIN_M)


def _pcc(n_imus: int, reading: str, segments: int) -> Selection:
    """Return the selection of a PCC-extended model."""
    if segments < n_imus or segments % n_imus:
        raise bad_input("segments", "selection", f"a multiple of {n_imus} (one link per IMU)", segments)
    imus, lengths, sub_links = _PCC_IMUS[n_imus], (0.64 / n_imus,) * n_imus, segments // n_imus
    if reading != "files":
        return _made(imus, lengths, sub_links)
    if segments not in (released := (8, 16, 32, 64) if n_imus == 8 else (16,)):
        raise bad_input("segments", "selection", f"one of those released, {released}", segments)
    if n_imus < 8:
        lengths = (lengths[0] - FILES_ORIGIN_M[2], *lengths[1:])
        made = replace(_made(imus, lengths, sub_links), markers=(0.3022, 0.5422))
    elif segments == 8:
        made = replace(_made(imus[:-1], (0.057, *lengths[2:]), sub_links), markers=(0.297, 0.537))
    else:
        made = _made(imus, (0.057, *lengths[1:]), sub_links)
        made = replace(made, markers=(0.337, 0.577), interpolation="inner points")
    return replace(made, base_turn=FILES_BASE_TURN, origin_m=FILES_ORIGIN_M)


def _made(imus: tuple[int, ...], lengths: tuple[float, ...], sub_links: int = 0) -> Selection:
    return Selection(imus, tuple(IMU_ARCS[imu] for imu in imus), lengths, sub_links=sub_links)


MARKERS = Selection.markers
"""Arc positions [m] of the motion-capture markers M1 and M2 (section III-A)."""
