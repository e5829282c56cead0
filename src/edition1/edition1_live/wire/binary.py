"""Our own frames: COBS between two zero bytes, with sequence number, device time and a CRC-32.

The page "Wire formats" of the book states every byte. A frame is accepted if checksum, version and length agree; then
it is what the board sent, but for a chance of about 2^-32 per damaged frame.
"""

from __future__ import annotations

import math
import struct
from zlib import crc32

from cobs import cobs

from edition1.errors import bad_input
from edition1_live.wire.frame import WRAP, Frame, Parser

_VERSION = 1
KINDS = {"float32": (1, "f", 59), "int16": (2, "h", 118)}
"""Of each type of value: its number in the frame, its letter in ``struct``, and how many a frame holds at most.

So a frame before COBS has at most 252 bytes, and COBS adds exactly one.
"""
LONGEST_PACKET = 253
"""Bytes between two delimiters."""
RESIDUE = 0x2144DF1C
"""CRC-32 of any bytes that are followed by their own CRC-32, lowest byte first."""
_LARGEST_FLOAT32 = (2 - 2**-23) * 2.0**127
_HEAD = struct.Struct("<BBBBII")
# By type and count of the values, as in a frame: its length, its reader, whether the values are whole numbers.
_LAYOUTS = {
    bytes([code, count]): (form.size, form.unpack, letter == "h")
    for code, letter, most in KINDS.values()
    for count in range(1, most + 1)
    for form in [struct.Struct(f"<4xII{count}{letter}4x")]
}


def encode_frame(frame: Frame, kind: str = "float32") -> bytes:
    """Return the bytes of a frame, delimiters included.

    Parameters
    ----------
    frame
        What to send: ``stream`` from 0 to 255, ``sequence`` and ``device_us`` of 32 bits, and values that the type
        holds. To ``float32`` they are rounded, and NaN stands for a reading that is missing; ``int16`` takes whole
        numbers.
    kind
        ``float32`` or ``int16``.

    Raises
    ------
    InputError
        If any of them does not fit.

    Examples
    --------
    >>> encode_frame(Frame(7, 1, 1000, (1.0,))).hex(" ")
    '00 06 01 07 01 01 01 01 01 03 e8 03 01 01 01 07 80 3f 7d 30 d6 ee 00'
    """
    if kind not in KINDS:
        raise bad_input("kind", "encode_frame", " or ".join(KINDS), kind)
    code, letter, most = KINDS[kind]
    stream, sequence, device_us, values = frame
    if not 0 <= stream <= 255:
        raise bad_input("stream", "encode_frame", "0 to 255", stream)
    for name, number in (("sequence", sequence), ("device_us", device_us)):
        if number is None or not 0 <= number < WRAP:
            raise bad_input(name, "encode_frame", "a number of 32 bits without sign", number)
    if not 1 <= len(values) <= most:
        raise bad_input("values", "encode_frame", f"1 to {most} of {kind}", len(values))
    if kind == "int16":
        fits = all(value % 1 == 0 and -32768 <= value <= 32767 for value in values)
    else:
        fits = all(not math.isfinite(value) or abs(value) <= _LARGEST_FLOAT32 for value in values)
    if not fits:
        raise bad_input("values", "encode_frame", f"numbers that {kind} holds", values)
    body = _HEAD.pack(_VERSION, stream, code, len(values), sequence, device_us)
    body += struct.pack(f"<{len(values)}{letter}", *(map(int, values) if kind == "int16" else values))
    return b"\0" + cobs.encode(body + crc32(body).to_bytes(4, "little")) + b"\0"


class BinaryParser(Parser):
    """Parser of our own frames.

    Sequence numbers are followed in each stream, across interruptions of the line too. A step ahead by more than one
    is a gap, of as many frames as it skips. A step back, counted round the 32 bits, is a restart. A frame equal in
    every byte to the one before in its stream is a repeat, and dropped; with the same number and another content it
    is a restart.

    Parameters
    ----------
    channels
        Values that each frame must have; None takes any number.
    """

    def __init__(self, channels: int | None = None) -> None:
        super().__init__(b"\0", LONGEST_PACKET)
        self._layouts = _LAYOUTS
        if channels is not None:
            self._layouts = {key: layout for key, layout in _LAYOUTS.items() if key[1] == channels}
        # By stream: sequence number and bytes of the last frame.
        self._last: dict[int, tuple[int, bytes]] = {}

    def _frames(self, packets: list[bytes], cut: bool) -> list[Frame]:
        frames, counters = [], self.counters
        # One frame takes about a microsecond here: looked up once, the names cost nothing in the loop.
        decode, layouts, last, add = cobs.decode, self._layouts, self._last, frames.append
        for packet in packets:
            begun, cut = cut, False
            if not packet:
                continue
            try:
                body = decode(packet)
            except cobs.DecodeError:
                body = b""
            if crc32(body) != RESIDUE:
                if begun:
                    counters.first_partial += 1
                else:
                    counters.checksum_errors += 1
                counters.discarded_bytes += len(packet)
                continue
            layout = layouts.get(body[2:4])
            if layout is None or layout[0] != len(body) or body[0] != _VERSION:
                known = _LAYOUTS.get(body[2:4])
                what = (
                    "another version or length"
                    if known is None or body[0] != _VERSION
                    else f"{body[3]} values"
                )
                self._refuse(len(packet), f"a frame of {what}")
                continue
            sequence, device_us, *values = layout[1](body)
            stream = body[1]
            before = last.get(stream)
            if before is not None and (step := (sequence - before[0]) % WRAP) != 1:
                if packet == before[1]:
                    counters.repeats += 1
                    counters.discarded_bytes += len(packet)
                    continue
                if 1 < step < WRAP // 2:
                    counters.gaps += step - 1
                else:
                    counters.restarts += 1
            last[stream] = (sequence, packet)
            add(Frame(stream, sequence, device_us, tuple(map(float, values) if layout[2] else values)))
        return frames
