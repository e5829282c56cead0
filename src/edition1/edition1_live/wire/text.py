"""The papers' text lines: three integers, three millivolts, or the quaternion of one IMU.

They carry no checksum. A line is accepted if every character is as a board prints it, the number of fields is right
and every value is possible; the page "Wire formats" of the book says what that cannot detect. Nothing else becomes
data: a line that does not fit is dropped and counted.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from edition1.errors import bad_input
from edition1_live.wire.frame import Frame, Parser

HALL_RANGE = (-8192.0, 8191.0)
"""Components of the sensor of Mitchell et al., an MLX90363: 14 bits with sign [counts]."""
MILLIVOLT_RANGE = (0.0, 2048.0)
"""Readings of the rig of Baaij et al. (section 5.1, "in the range [0 mV, 2048 mV]") [mV]."""
NORM_TOLERANCE = 1e-3
"""Largest distance of a quaternion's norm from 1, as elsewhere in the package: four decimals stay within.

In the released recordings of Martin et al. it is at most 5.5e-5.
"""
_LONGEST_FIELD = 25
"""Bytes of the longest number and the comma after it."""
_WHOLE = re.compile(rb"0|-?[1-9][0-9]{0,3}")
_NUMBER = re.compile(rb"-?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]{1,3})?")
_IDENTITY = re.compile(rb"0|[1-9][0-9]{0,2}")


@dataclass(frozen=True)
class Line:
    r"""One kind of line: fields separated by commas, ended by ``\r\n`` or ``\n``.

    Attributes
    ----------
    count
        How many values.
    lowest, highest
        Range of each.
    decimals
        With how many decimals they are written; 0: whole numbers. Read are as many as come.
    identity
        Whether the number of a stream, 0 to 255, stands before them.
    unit_quaternion
        Whether they are w, x, y, z of a unit quaternion; frames hold x, y, z, w.
    """

    count: int
    lowest: float
    highest: float
    decimals: int
    identity: bool = False
    unit_quaternion: bool = False

    def read(self, line: bytes) -> Frame | None:
        """Return the frame of a line without its end, or None if it is none."""
        fields = line.split(b",")
        if len(fields) != self.count + self.identity:
            return None
        stream = 0
        if self.identity:
            first = fields.pop(0)
            if not _IDENTITY.fullmatch(first) or (stream := int(first)) > 255:
                return None
        form = _NUMBER if self.decimals else _WHOLE
        if not all(map(form.fullmatch, fields)):
            return None
        values = tuple(map(float, fields))
        if not self.possible(values):
            return None
        return Frame(stream, None, None, values[1:] + values[:1] if self.unit_quaternion else values)

    def possible(self, values: tuple[float, ...]) -> bool:
        """Whether the values are finite, in range and, for a quaternion, of norm 1 within `NORM_TOLERANCE`."""
        if not all(self.lowest <= value <= self.highest for value in values):
            return False
        return not self.unit_quaternion or abs(math.hypot(*values) - 1) <= NORM_TOLERANCE

    def write(self, frame: Frame) -> bytes:
        r"""Return the line of a frame, ``\r\n`` included; sequence and time have no place in it.

        Raises
        ------
        InputError
            If the stream has no place in the line either, or the values are not as many as it has, not possible, or
            fractions where it has whole numbers.
        """
        owner, last = "a line of text", 255 if self.identity else 0
        if not 0 <= frame.stream <= last:
            raise bad_input("stream", owner, f"0 to {last}" if last else "0, the only one", frame.stream)
        if len(frame.values) != self.count:
            raise bad_input("values", owner, f"{self.count} numbers", len(frame.values))
        # Adding 0 turns -0 into 0.
        values = tuple(round(value, self.decimals) + 0.0 for value in frame.values)
        if not self.possible(values) or (not self.decimals and values != tuple(frame.values)):
            kind = "numbers" if self.decimals else "whole numbers"
            must_be = f"{kind} from {self.lowest:g} to {self.highest:g}"
            if self.unit_quaternion:
                must_be = f"a quaternion of norm 1 within {NORM_TOLERANCE:g}"
            raise bad_input("values", owner, must_be, frame.values)
        if self.unit_quaternion:
            values = values[-1:] + values[:-1]
        fields = [str(frame.stream)] * self.identity + [f"{value:.{self.decimals}f}" for value in values]
        return ",".join(fields).encode() + b"\r\n"


HALL = Line(3, *HALL_RANGE, decimals=0)
"""Three counts of 0.01 mT, as the board of Mitchell et al. sends them: the last is the component along the body."""
QUATERNION = Line(4, -1 - NORM_TOLERANCE, 1 + NORM_TOLERANCE, decimals=6, identity=True, unit_quaternion=True)
"""Number of the IMU and its orientation, in the order of the messages of Martin et al.: ID, w, x, y, z."""


def millivolts(channels: int = 3) -> Line:
    """Lines of ``channels`` readings; four decimals hold the converter's step of 0.0625 mV exactly."""
    return Line(channels, *MILLIVOLT_RANGE, decimals=4)


class TextParser(Parser):
    """Parser of one kind of line.

    The first line after an opening is dropped, whatever it looks like: without a checksum ``123,4,5`` cannot be told
    from the end of ``9123,4,5``.
    """

    def __init__(self, line: Line) -> None:
        super().__init__(b"\n", _LONGEST_FIELD * (line.count + line.identity))
        self._line = line

    def _frames(self, packets: list[bytes], cut: bool) -> list[Frame]:
        frames = []
        if cut:
            self.counters.first_partial += 1
            self.counters.discarded_bytes += len(packets.pop(0))
        for line in packets:
            frame = self._line.read(line.removesuffix(b"\r"))
            if frame is None:
                self._refuse(len(line), repr(line[:80].removesuffix(b"\r"))[1:])
            else:
                frames.append(frame)
        return frames
