"""A calibration as a small JSON file that belongs to one robot file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input, require
from edition1.files import write_whole

_SCHEMA = 2
"""Version of the format."""
_LARGEST = 2**53
"""Beyond it a whole number is no longer exact as a JSON number; no count of poses comes near."""


@dataclass(frozen=True)
class RobotCalibration:
    """What measured poses say about a robot, and how well it is known.

    Parameters
    ----------
    robot, robot_sha256
        Name of the robot file and the hash of its content.
    names
        Names of the parameters, then of the offsets and the components of the Earth field.
    parameters
        Geometry, gains and moments in the order of :func:`edition1.sensing.placement.parameter_names`, against the
        file; m, rad, relative.
    offset
        Added to the offsets of the file [unit of the readings].
    earth_mt
        Earth field in the base frame [mT].
    covariance
        Posterior covariance of everything in ``names``, in their units: m, rad, relative, then [unit] and mT.
    undetermined
        What the poses do not determine, in words; it stays near the file, within its tolerance.
    poses, held_out
        Number of poses that were fitted, and of those that were held out of the fit behind the residuals.
    before, after
        Root mean square residual of the held-out poses as described, and calibrated on the others [unit]; none if
        no pose was held out.
    chi2
        Weighted mean square residual of all poses: near 1 if noise, poses and tolerances are as stated.
    """

    robot: str
    robot_sha256: str
    names: tuple[str, ...]
    parameters: Float[Tensor, " k"]
    offset: Float[Tensor, " s"]
    earth_mt: Float[Tensor, " 3"]
    covariance: Float[Tensor, "all all"]
    undetermined: tuple[str, ...]
    poses: int
    held_out: int
    before: float | None
    after: float | None
    chi2: float

    @property
    def deviation(self) -> Float[Tensor, " all"]:
        """Posterior standard deviation of everything in ``names``, in their units."""
        return self.covariance.diagonal().sqrt()

    def write(self, path: Path) -> None:
        """Write it as JSON, whole or not at all; reading it returns the same bits."""
        rows = self.covariance.tolist()
        content: dict[str, Any] = {"schema": _SCHEMA}
        for field in fields(self):
            value = getattr(self, field.name)
            content[field.name] = value.tolist() if isinstance(value, Tensor) else value
        content["covariance"] = [f"row {k}" for k in range(len(rows))]
        text = json.dumps(content, indent=1)
        for k, row in enumerate(rows):  # a row of the matrix in a line, not every number
            text = text.replace(f'"row {k}"', json.dumps(row), 1)
        write_whole(path, text + "\n")

    @classmethod
    def read(cls, path: Path) -> RobotCalibration:
        """Read what :meth:`write` wrote.

        Raises
        ------
        InputError
            If the file is not there, is not a calibration, has another version, or a value in it is of another kind,
            not finite, or does not fit the others.
        """
        owner = str(path.name)
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise bad_input(
                "path", "RobotCalibration.read", "a file that repro calibrate wrote", path
            ) from error
        except (ValueError, RecursionError) as error:
            raise bad_input("file", owner, "JSON that repro calibrate wrote", error) from error
        if not isinstance(content, dict) or content.get("schema") != _SCHEMA:
            received = content.get("schema") if isinstance(content, dict) else type(content).__name__
            expected = f"{_SCHEMA} (older files lack the uncertainty of their parameters: calibrate again)"
            raise bad_input("schema", owner, expected, received)
        names = {field.name for field in fields(cls)}
        if wrong := names.symmetric_difference(content.keys() - {"schema"}):
            raise bad_input(
                "keys", owner, f"{', '.join(sorted(names))}", f"a difference in {', '.join(sorted(wrong))}"
            )
        for name, (is_it, words) in _KINDS.items():
            if not is_it(content[name]):
                raise bad_input(name, owner, words, repr(content[name]))
        values: dict[str, Any] = {name: content[name] for name in names}
        for name in ("parameters", "offset", "earth_mt", "covariance"):
            values[name] = torch.tensor(content[name], dtype=torch.float64)
        for name in ("names", "undetermined"):
            values[name] = tuple(content[name])
        found = cls(**values)
        n = len(found.parameters) + len(found.offset) + len(found.earth_mt)
        require(len(found.names) == n, "names", owner, f"those of {n} numbers", f"{len(found.names)}")
        C = found.covariance
        if C.shape != (n, n) or not torch.equal(C, C.mT):
            raise bad_input("covariance", owner, f"symmetric, {n} x {n}", f"shape {tuple(C.shape)}")
        d = C.diagonal().clamp_min(torch.finfo(C.dtype).tiny).sqrt()
        if float(torch.linalg.eigvalsh(C / d.unsqueeze(-1) / d).min()) < -1e-9 * n:
            raise bad_input("covariance", owner, "that of random numbers", "one with a negative variance")
        return found


def _number(value: Any) -> bool:
    """Whether it is a number that double precision holds; neither NaN nor infinite."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < _LARGEST


def _numbers(value: Any) -> bool:
    return isinstance(value, list) and all(map(_number, value))


def _rows(value: Any) -> bool:
    return isinstance(value, list) and all(_numbers(row) and len(row) == len(value) for row in value)


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _texts(value: Any) -> bool:
    return isinstance(value, list) and all(map(_text, value))


def _number_or_none(value: Any) -> bool:
    return value is None or _number(value)


_Kind = tuple[Callable[[Any], bool], str]
_KINDS: dict[str, _Kind] = {
    **dict.fromkeys(("robot", "robot_sha256"), (_text, "text")),
    **dict.fromkeys(("names", "undetermined"), (_texts, "a list of texts")),
    **dict.fromkeys(("parameters", "offset"), (_numbers, "a list of finite numbers")),
    "earth_mt": (lambda value: _numbers(value) and len(value) == 3, "three finite numbers"),
    "covariance": (_rows, "a square table of finite numbers"),
    **dict.fromkeys(("poses", "held_out"), (_count, "a whole number, not negative")),
    **dict.fromkeys(("before", "after"), (_number_or_none, "a finite number, or null")),
    "chi2": (_number, "a finite number"),
}
"""What every value must be."""
