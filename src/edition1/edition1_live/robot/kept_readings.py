"""Readings in poses as a file that grows with every pose, so that none is lost."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input

_FIRST_LINE = "# Readings in poses, taken by repro calibrate"
"""How such a file begins."""


@dataclass(frozen=True)
class Part:
    """Readings in one pose.

    Parameters
    ----------
    mean, deviation
        Mean and standard deviation of every value of a frame over the pose.
    frames
        How many.
    seconds
        Time from the first to the last of them [s].
    """

    mean: Float[np.ndarray, " channels"]
    deviation: Float[np.ndarray, " channels"]
    frames: int
    seconds: float


def part_of(values: Float[np.ndarray, "frames channels"], seconds: float) -> Part:
    """Mean, standard deviation (0 of one frame), number and duration of frames."""
    deviation = values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(values.shape[1])
    return Part(values.mean(axis=0), deviation, len(values), seconds)


def is_kept(path: Path) -> bool:
    """Whether a file is one of readings in poses."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_FIRST_LINE)) == _FIRST_LINE.encode()


class KeptReadings:
    """The file of a session: a CSV with a row for every pose, on the disk as soon as the pose is taken.

    Parameters
    ----------
    path
        The file; one that is there goes on where it ends.
    channels
        Values of a frame.

    Attributes
    ----------
    parts
        Readings of the poses so far.
    q
        Configurations for which they were taken, as asked for.

    Raises
    ------
    InputError
        If a file that is there holds something else, or it cannot be written.
    """

    def __init__(self, path: Path, channels: int, coordinates: tuple[str, ...]) -> None:
        self.path, self._columns = path, _columns(coordinates, channels)
        self.parts: list[Part] = []
        self.q: list[list[float]] = []
        try:
            if path.exists():
                self.parts, q = read_kept(path, channels, coordinates)
                self.q = q.tolist()
                content = path.read_bytes()
                os.truncate(path, content.rfind(b"\n") + 1)  # a line cut short by a crash
            else:
                self._append(f"{_FIRST_LINE}\n{','.join(self._columns)}\n", "xb")
        except OSError as error:
            raise bad_input("readings", path.name, "a file that can be written", error) from error

    def add(self, q: Float[Tensor, " n_q"], part: Part) -> None:
        """Write the readings of the next pose.

        Raises
        ------
        InputError
            If the disk refuses.
        """
        row = [len(self.parts) + 1, *q.tolist(), part.frames, part.seconds, *part.mean.tolist()]
        try:
            self._append(",".join(map(repr, [*row, *part.deviation.tolist()])) + "\n", "ab")
        except OSError as error:
            raise bad_input("readings", self.path.name, "a file that can be written", error) from error
        self.parts.append(part)
        self.q.append(q.tolist())

    def _append(self, text: str, mode: str) -> None:
        with self.path.open(mode) as file:
            file.write(text.encode())
            file.flush()
            os.fsync(file.fileno())


def read_kept(
    path: Path, channels: int, coordinates: tuple[str, ...]
) -> tuple[list[Part], Float[Tensor, "poses n_q"]]:
    """Read what :class:`KeptReadings` wrote, and the configurations; a last line cut short does not count.

    Raises
    ------
    InputError
        If it is another file, of another number of channels or of other coordinates, or damaged.
    """
    columns = _columns(coordinates, channels)
    lines = path.read_bytes().decode(errors="replace").split("\n")[:-1]
    if not lines or not lines[0].startswith(_FIRST_LINE):
        raise bad_input("readings", path.name, "a file that repro calibrate began", "another one")
    if lines[1:2] != [",".join(columns)]:
        received = lines[1] if len(lines) > 1 else "none"
        raise bad_input("columns", path.name, ", ".join(columns), received)
    try:
        rows = [[float(x) for x in line.split(",")] for line in lines[2:]]
        wrong = [k for k, row in enumerate(rows) if len(row) != len(columns) or row[0] != k + 1]
        if wrong or not np.isfinite(np.array(rows)).all():
            raise ValueError(f"line {wrong[0] + 3 if wrong else 'with a number that is not finite'}")
    except ValueError as error:
        raise bad_input("rows", path.name, "complete, of finite numbers, in order", error) from error
    n = 1 + len(coordinates)
    table = np.array(rows).reshape(-1, len(columns))
    parts = [
        Part(row[n + 2 : n + 2 + channels], row[n + 2 + channels :], int(row[n]), row[n + 1]) for row in table
    ]
    return parts, torch.from_numpy(table[:, 1:n].copy())


def _columns(coordinates: tuple[str, ...], channels: int) -> list[str]:
    numbers = range(1, channels + 1)
    named = [f"channel_{k}" for k in numbers], [f"channel_{k}_deviation" for k in numbers]
    return ["pose", *coordinates, "frames", "seconds", *named[0], *named[1]]
