r"""Estimates as a CSV, live or offline: one row for each, written as whole lines while they come.

The columns, in this order; those that an estimator does not have are left out:

- ``time_s``: by the clock of the board, or by arrival where it sends no time; since the first frame, and offline plus
  the time of the first frame in the recording or table;
- coordinates in the units of the robot file, such as ``delta_x_1_mm``; of IMUs, points along the robot from base to
  tip, ``point_1_x_mm``;
- standard deviations of the coordinates, ``delta_x_1_sd_mm``, and their correlations,
  ``delta_x_1__delta_y_1_correlation``, so that a covariance is the product of two deviations and a correlation;
- the tip in the base frame, ``tip_x_mm``, with its deviations and correlations, which follow from those of the
  coordinates to first order;
- ``chi2`` and ``dof``, the squared residual in units of the noise and its degrees of freedom; ``consistency``, one of
  :class:`~edition1.estimation.consistency.Status`.
"""

from __future__ import annotations

import math
import os
import queue
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import bad_input
from edition1.estimation.base import Estimate
from edition1.estimation.consistency import Status
from edition1.kinematics.motion import tip_motion
from edition1_live.follow.robot_estimator import RobotEstimator
from edition1_live.record.recording_file import WriteFailed
from edition1_live.robot.calibration_poses import coordinate_columns

WRITE_S = 0.2
"""Estimates are written this often [s]: together, since the tips of many cost little more than that of one."""
_MOST_WAITING = 1 << 16
"""Estimates that wait for a disk; beyond, the estimator waits too."""
_MM = 1e-3


class EstimateRows:
    """Makes the rows of a table of estimates.

    Parameters
    ----------
    estimator
        Whose estimates.
    first
        The first of them: it tells which columns there are.

    Attributes
    ----------
    header
        Names of the columns.
    """

    def __init__(self, estimator: RobotEstimator, first: Estimate) -> None:
        self._estimator = estimator
        if estimator.positions:
            points = range(1, len(estimator.start) // 3 + 1)
            self._columns = {f"point_{k}_{axis}_mm": _MM for k in points for axis in "xyz"}
        else:
            self._columns = coordinate_columns(estimator.robot)
        self._known = first.covariance is not None
        self._said = [name for name in ("chi2", "dof", "status") if name in first.diagnostics]
        names, tip = list(self._columns), [f"tip_{axis}_mm" for axis in "xyz"]
        self.header = [
            "time_s",
            *names,
            *(_uncertainty(names) if self._known and not estimator.positions else []),
        ]
        self.header += [*tip, *(_uncertainty(tip) if self._known else [])]
        self.header += ["consistency" if name == "status" else name for name in self._said]

    def rows(self, times_s: Sequence[float], estimates: Sequence[Estimate]) -> list[list[str]]:
        """Cells of estimates; empty where a number is missing or not finite."""
        factor = torch.tensor(list(self._columns.values()), dtype=torch.float64)
        q = torch.stack([estimate.q.double() for estimate in estimates])
        C = None
        if self._known:
            nothing = q.new_full((q.shape[1],) * 2, torch.nan)
            C = torch.stack([nothing if e.covariance is None else e.covariance.double() for e in estimates])
        parts = [q / factor]
        if self._estimator.positions:
            tip, tip_C = q[:, -3:], None if C is None else C[:, -3:, -3:]
        else:
            tip, J = tip_motion(self._estimator.robot.robot, q)
            tip_C = None if C is None else J @ C @ J.mT
            parts += _spread(C, factor)
        parts += [tip / _MM, *_spread(tip_C, factor.new_full((3,), _MM))]
        cells = [[_cell(x) for x in row] for row in torch.cat(parts, -1).tolist()]
        for row, estimate in zip(cells, estimates, strict=True):
            said = (float(estimate.diagnostics.get(name, torch.nan)) for name in self._said)
            row += [
                Status(int(x)).word if name == "status" and not math.isnan(x) else _cell(x)
                for name, x in zip(self._said, said, strict=True)
            ]
        return [[f"{time_s:.6f}", *row] for time_s, row in zip(times_s, cells, strict=True)]


def _uncertainty(names: Sequence[str]) -> list[str]:
    split = [name.rsplit("_", 1) for name in names]
    pairs = [(a, b) for k, (a, _) in enumerate(split) for b, _ in split[k + 1 :]]
    return [f"{name}_sd_{unit}" for name, unit in split] + [f"{a}__{b}_correlation" for a, b in pairs]


def _spread(C: Tensor | None, factor: Float[Tensor, " n"]) -> list[Tensor]:
    """Return standard deviations in the units of a table, and correlations row by row above the diagonal."""
    if C is None:
        return []
    deviation = C.diagonal(dim1=-2, dim2=-1).clamp_min(0).sqrt()
    upper = torch.triu_indices(len(factor), len(factor), 1)
    correlation = C / (deviation[:, :, None] * deviation[:, None, :])  # none where a deviation is zero
    return [deviation / factor, correlation[:, upper[0], upper[1]]]


def _cell(x: float) -> str:
    return f"{x:.9g}" if math.isfinite(x) else ""


class EstimateFile:
    """A CSV of estimates being written; use it in a ``with`` statement.

    A thread writes what has come, in whole lines, every :data:`WRITE_S`; so an estimator does not wait for a disk,
    and whatever ends the program, the file holds whole lines only. It is created with the first estimate.

    Parameters
    ----------
    path
        A new file.
    estimator
        Whose estimates.

    Raises
    ------
    InputError
        If the file exists.
    """

    def __init__(self, path: Path, estimator: RobotEstimator) -> None:
        if path.exists():
            raise bad_input("estimates", "repro", "a new file (give another name, or move the old one)", path)
        self.path = path
        self.written = 0
        """Estimates in the file."""
        self._estimator = estimator
        self._rows: EstimateRows | None = None
        self._waiting: queue.Queue[tuple[float, Estimate] | None] = queue.Queue(_MOST_WAITING)
        self._failure: BaseException | None = None
        self._file = -1
        self._bytes = 0
        self._thread = threading.Thread(target=self._write_all, daemon=True)
        self._thread.start()

    def add(self, time_s: float, estimate: Estimate) -> None:
        """Take the next estimate.

        Raises
        ------
        WriteFailed
            If an earlier one could not be written; those before it are kept.
        """
        self._check()
        self._waiting.put((time_s, estimate))

    def close(self) -> None:
        """Write what waits and close the file.

        Raises
        ------
        WriteFailed
            If it could not be written.
        """
        self._waiting.put(None)
        self._thread.join()
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
        self._check()

    def __enter__(self) -> EstimateFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _check(self) -> None:
        if isinstance(self._failure, OSError):
            words = (
                f"{self.path} cannot be written: {self._failure.strerror}; {self.written} estimates are kept."
            )
            raise WriteFailed(words) from self._failure
        if self._failure is not None:
            raise self._failure

    def _write_all(self) -> None:
        over = False
        while not over:
            part = [self._waiting.get()]
            if part[0] is not None:
                time.sleep(WRITE_S)
            while part[-1] is not None and not self._waiting.empty():
                part.append(self._waiting.get())
            over = part[-1] is None
            estimates = [one for one in part if one is not None]
            if not estimates or self._failure is not None:  # then only the queue is emptied
                continue
            try:
                self._write(estimates)
            except BaseException as failure:  # belongs to whoever adds
                self._failure = failure

    def _write(self, part: list[tuple[float, Estimate]]) -> None:
        lines = []
        if self._rows is None:
            self._rows = EstimateRows(self._estimator, part[0][1])
            self.path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | getattr(os, "O_BINARY", 0)
            self._file = os.open(self.path, flags, 0o666)
            lines.append(self._rows.header)
        lines += self._rows.rows([time_s for time_s, _ in part], [estimate for _, estimate in part])
        data = "".join(",".join(line) + "\n" for line in lines).encode()
        try:
            rest = memoryview(data)
            while rest:
                rest = rest[os.write(self._file, rest) :]
        except OSError:
            os.ftruncate(self._file, self._bytes)  # to the last whole line
            raise
        self._bytes += len(data)
        self.written += len(part)
