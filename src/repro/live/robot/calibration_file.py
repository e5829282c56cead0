"""A calibration as a small JSON file that belongs to one robot file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from repro.errors import bad_input
from repro.report.files import write_whole

SCHEMA = 1
"""Version of the format."""
_TENSORS = ("parameters", "deviation", "offset", "earth_mt")


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
        Geometry, gains and moments in the order of :func:`repro.sensing.placement.parameter_names`, against the
        file; m, rad, relative.
    offset
        Added to the offsets of the file [unit of the readings].
    earth_mt
        Earth field in the base frame [mT].
    deviation
        Posterior standard deviation of everything in ``names``: m, rad, relative, then [unit] and mT.
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
    deviation: Float[Tensor, " all"]
    undetermined: tuple[str, ...]
    poses: int
    held_out: int
    before: float | None
    after: float | None
    chi2: float


def write_calibration(path: Path, calibration: RobotCalibration) -> None:
    """Write a calibration as JSON, whole or not at all; reading it returns the same bits."""
    content: dict[str, Any] = {"schema": SCHEMA}
    for field in fields(calibration):
        value = getattr(calibration, field.name)
        content[field.name] = value.tolist() if isinstance(value, Tensor) else value
    write_whole(path, json.dumps(content, indent=1) + "\n")


def read_calibration(path: Path) -> RobotCalibration:
    """Read what :func:`write_calibration` wrote.

    Raises
    ------
    InputError
        If the file is not there, is not a calibration, or has another version.
    """
    owner = str(path.name)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise bad_input("path", "read_calibration", "a file that repro calibrate wrote", path) from error
    except ValueError as error:
        raise bad_input("file", owner, "JSON that repro calibrate wrote", error) from error
    if not isinstance(content, Mapping) or content.get("schema") != SCHEMA:
        received = content.get("schema") if isinstance(content, Mapping) else type(content).__name__
        raise bad_input("schema", owner, f"{SCHEMA}", received)
    names = {field.name for field in fields(RobotCalibration)}
    if wrong := names.symmetric_difference(content.keys() - {"schema"}):
        raise bad_input(
            "keys", owner, f"{', '.join(sorted(names))}", f"a difference in {', '.join(sorted(wrong))}"
        )
    values: dict[str, Any] = {name: content[name] for name in names}
    for name in _TENSORS:
        numbers = values[name]
        if not isinstance(numbers, list) or not all(isinstance(x, int | float) for x in numbers):
            raise bad_input(name, owner, "a list of numbers", numbers)
        values[name] = torch.tensor(numbers, dtype=torch.float64)
        if not bool(torch.isfinite(values[name]).all()):
            raise bad_input(name, owner, "finite", numbers)
    values |= {name: tuple(values[name]) for name in ("names", "undetermined")}
    return RobotCalibration(**values)
