"""Motion capture exported by OptiTrack Motive: the header, and the numbers of its frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from edition1.errors import bad_input, require

HEADER_LINES = 7
"""Lines of an export before the first frame."""


def read_header(rows: list[list[str]], owner: str, *, version: str, frames: int) -> dict[str, str]:
    """Read the first line of an export, after a check of format and number of frames.

    Parameters
    ----------
    rows
        At least the first :data:`HEADER_LINES` lines, split at commas.
    owner
        Name of the file, for messages.
    version
        The format version expected.
    frames
        Number of lines after the header.

    Returns
    -------
    dict
        Names and values; ``Take Name`` and ``Capture Frame Rate`` (above zero) are there, rotations are quaternions.

    Raises
    ------
    InputError
        Another format or rotation type, a field that is missing, another number of frames, no frame rate.
    """
    header = dict(zip(rows[0][0::2], rows[0][1::2], strict=False)) if rows else {}
    for name, expected in (("Format Version", version), ("Rotation Type", "Quaternion")):
        require(header.get(name) == expected, name, owner, expected, header.get(name, "nothing"))
    for name in ("Take Name", "Total Exported Frames", "Capture Frame Rate"):
        require(name in header, name, owner, "in the header", "nothing")
    if not header["Total Exported Frames"].isdecimal():
        raise bad_input("Total Exported Frames", owner, "a whole number", header["Total Exported Frames"])
    if frames != int(header["Total Exported Frames"]):
        expected = f"{header['Total Exported Frames']}, as its header says"
        raise bad_input("number of frames", owner, expected, max(frames, 0))
    try:
        rate_hz = float(header["Capture Frame Rate"])
    except ValueError:
        rate_hz = 0.0
    require(0 < rate_hz < np.inf, "Capture Frame Rate", owner, "above zero", header["Capture Frame Rate"])
    return header


def read_frames(
    rows: Sequence[Sequence[str]], picked: Sequence[int], owner: str
) -> Float[np.ndarray, "frames k"]:
    """Numbers in the picked columns of the rows below the header; NaN where a cell is empty.

    Raises
    ------
    InputError
        If a row is shorter, or a cell holds no number.
    """
    try:
        return np.array([[float(row[k] or "nan") for k in picked] for row in rows]).reshape(-1, len(picked))
    except (ValueError, IndexError) as error:
        raise bad_input("frames", owner, "rows of numbers", error) from error
