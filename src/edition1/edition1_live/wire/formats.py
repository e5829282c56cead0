"""The five formats by name: a parser, the bytes of a frame, and the names of its values."""

from __future__ import annotations

from edition1.errors import bad_input, require
from edition1.robot_file.columns import FORMATS
from edition1_live.wire.binary import KINDS, BinaryParser, encode_frame
from edition1_live.wire.csv_text import MOST_VALUES, CsvParser, write_line
from edition1_live.wire.frame import Frame, Parser
from edition1_live.wire.text import HALL, QUATERNION, Line, TextParser, millivolts

_NAMES = {
    "hall": ["z_counts", "y_counts", "x_counts"],
    "quaternions": ["x", "y", "z", "w"],
}


def parser(format: str, channels: int | None = None, unit: str | None = None) -> Parser:
    r"""Return a new parser of a format, as after opening a port.

    Parameters
    ----------
    format
        One of :data:`FORMATS`.
    channels
        Values that every frame must have. By default any number for ``frames``, that of the first lines for ``csv``,
        three for ``millivolts``; ``hall`` has three and ``quaternions`` four.
    unit
        Unit that lines of ``csv`` must say if they say one; by default, and for ``raw``, any. Other formats say none.

    Raises
    ------
    InputError
        If there is no such format, or it cannot have that many values.

    Examples
    --------
    >>> hall = parser("hall")
    >>> hall.feed(b"34,5\r\n12,-7,2310\r\n12,-7,23")
    [Frame(stream=0, sequence=None, device_us=None, values=(12.0, -7.0, 2310.0))]
    >>> hall.counters.first_partial
    1
    """
    if format == "frames":
        most = max(most for _, _, most in KINDS.values())
        require(channels is None or 1 <= channels <= most, "channels", "frames", f"1 to {most}", channels)
        return BinaryParser(channels)
    if format == "csv":
        if channels is not None and not 1 <= channels <= MOST_VALUES:
            raise bad_input("channels", "csv", f"1 to {MOST_VALUES}", channels)
        return CsvParser(channels, unit)
    return TextParser(_line(format, channels))


def encode(format: str, frame: Frame, *, kind: str = "float32") -> bytes:
    """Return the bytes that a board sends for a frame, delimiters included.

    Text lines are rounded to what a board prints (``millivolts`` 4 decimals, ``quaternions`` 6, ``csv`` all) and
    have no place for sequence and time; ``hall`` and ``int16`` take whole numbers only.

    Parameters
    ----------
    format
        One of :data:`FORMATS`.
    frame
        What to send.
    kind
        For ``frames``: ``float32`` or ``int16``.

    Raises
    ------
    InputError
        If there is no such format, or the frame does not fit it.
    """
    if format == "frames":
        return encode_frame(frame, kind)
    if format == "csv":
        return write_line(frame)
    return _line(format, len(frame.values) if format == "millivolts" else None).write(frame)


def _line(format: str, channels: int | None) -> Line:
    require(format in FORMATS, "format", "the parser", f"one of {', '.join(FORMATS)}", format)
    if format == "millivolts":
        require(channels is None or channels >= 1, "channels", format, "1 or more", channels)
        return millivolts(channels or 3)
    line = HALL if format == "hall" else QUATERNION
    require(channels in (None, line.count), "channels", format, f"{line.count}, or none given", channels)
    return line


def channel_names(format: str, n: int) -> list[str]:
    """Return the names of the values of a frame, with the unit where the format has one.

    Parameters
    ----------
    format
        One of :data:`FORMATS`.
    n
        Number of values.

    Examples
    --------
    >>> channel_names("millivolts", 3)
    ['u1_mV', 'u2_mV', 'u3_mV']
    """
    names = _NAMES.get(format, [])
    if len(names) == n:
        return list(names)
    unit = "_mV" if format == "millivolts" else ""
    return [f"u{j + 1}{unit}" for j in range(n)]
