"""Thin the recordings of others whose licence lets us pass them on: ``python scripts/thin_recordings.py NAME ...``.

The files of the source lie in ``REPRO_DATA_DIR/NAME``; the README of ``data/recordings/NAME`` names them, their
repository and their commit. What is written there is written whole or not at all, and is always the same.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from itertools import permutations
from pathlib import Path

import numpy as np
import pandas as pd

SOURCES = Path(os.environ.get("REPRO_DATA_DIR", ""))
RECORDINGS = Path(__file__).resolve().parents[1] / "data" / "recordings"
MOST_BYTES = 1_000_000


def asl_trunk(source: Path) -> dict[str, pd.DataFrame]:
    """Return poses of the three discs in mm and unit quaternions, and positions alone for the static shapes.

    Each file is thinned by taking every n-th row; the slow motion keeps every frame, because its exchanged markers
    show from frame to frame.
    """
    files = {
        "adiabatic": ("observations_adiabatic_global_4", 1),
        "controlled": ("observations_controlled_3.0", 2),
        "still": ("observations_zeros_0g", 60),
        "steady_200g": ("steady_state_ik_y-up_200g", 2),
        "steady": ("steady_state_ethz_demo", 2),
    }
    tables = {}
    for name, (file, every) in files.items():
        rows = pd.read_csv(source / f"{file}.csv").iloc[::every]
        columns = {}
        for body in (1, 2, 3):
            columns |= {f"{axis}_{body}_mm": 1e3 * rows[f"{axis}{body}"] for axis in "xyz"}
            if f"w{body}" in rows:
                columns |= {f"q{axis}_{body}": rows[f"q{axis}{body}"] for axis in "xyz"}
                columns[f"qw_{body}"] = rows[f"w{body}"]
        table = pd.DataFrame(columns)
        tables[name] = table.round({column: 2 if column.endswith("_mm") else 4 for column in table})
    return tables


def eflesh(source: Path) -> dict[str, pd.DataFrame]:
    """Return readings of the five chips with the probe: all contacts, and every third row of the pressed ones."""
    folders = {
        "contacts": ("spatial_resolution/20250316_155729_probe", 1),
        "pressed": ("normal_force/20250401_014340_probe", 3),
    }
    chips = [f"b{axis}{chip}_uT" for chip in range(1, 6) for axis in "xyz"]
    tables = {}
    for name, (folder, every) in folders.items():
        sensor = np.loadtxt(source / folder / "sensor.csv", delimiter=",")[::every]
        probe = np.loadtxt(source / folder / "states.csv", delimiter=",")[::every]
        table = pd.DataFrame(sensor[:, 1:], columns=chips).round(1)
        table.insert(0, "time_s", np.round(sensor[:, 0] - sensor[0, 0], 2))
        for axis, values in zip(["x_mm", "y_mm", "z_mm", "force_g"], probe[:, 1:].T, strict=False):
            table[axis] = np.round(values, 2)
        tables[name] = table
    return tables


def tentacle(source: Path) -> dict[str, pd.DataFrame]:
    """Return the 22 shapes in the base frame, what the cameras saw of each, and the errors of the source's models.

    Which file a shape comes from, and which marker is which, follows from the distances between the markers.
    """
    files = sorted(source.glob("m*_u*.csv"))
    seen = np.array([np.loadtxt(file, delimiter=",")[:, 2:].reshape(-1, 5, 3).mean(0) for file in files])
    shapes = np.load(source / "measured_pts.npy")
    lines, raw = [], []
    for shape in shapes:
        tried = [
            (np.abs(_distances(points[list(order)]) - _distances(shape)).max(), k, order)
            for k, points in enumerate(seen)
            for order in permutations(range(5), 4)
        ]
        _, k, order = min(tried)
        lines.append([files[k].stem, *1e3 * shape.ravel()])
        raw.append([files[k].stem, *1e3 * seen[k][list(order)].ravel()])
    columns = ["load", *(f"{axis}_{marker}_mm" for marker in range(1, 5) for axis in "xyz")]
    errors = {"marker": np.arange(1, 5)}
    for column, file in (
        ("identified_mm", "errnorm_pred"),
        ("without_residual_mm", "errnorm_zero"),
        ("as_built_mm", "errnorm_before_id"),
    ):
        errors[column] = 1e3 * np.load(source / f"{file}.npy")
    return {
        "shapes": pd.DataFrame(lines, columns=columns).round(3),
        "cameras": pd.DataFrame(raw, columns=columns).round(3),
        "released_errors": pd.DataFrame(errors).round(2),
    }


def _distances(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points[:, None] - points[None], axis=-1)


SETS = {"asl_trunk": asl_trunk, "eflesh": eflesh, "tentacle": tentacle}
FOLDERS = {"tentacle": "soromox_tentacle"}
"""Where the source's files lie, if not in a folder of the same name."""


def write(name: str) -> None:
    """Write one set beside the old one, and replace the files once all are there and small enough."""
    source, folder = SOURCES / FOLDERS.get(name, name), RECORDINGS / name
    folder.mkdir(parents=True, exist_ok=True)
    partial = {}
    for stem, table in SETS[name](source).items():
        part = folder / f".{stem}.csv.part"
        table.to_csv(part, index=False, lineterminator="\n")
        partial[part] = folder / f"{stem}.csv"
    licence = folder / ".LICENSE.part"
    shutil.copyfile(source / "LICENSE", licence)
    partial[licence] = folder / "LICENSE"
    size = sum(part.stat().st_size for part in partial)
    if size > MOST_BYTES:
        for part in partial:
            part.unlink()
        raise SystemExit(f"{name} would have {size} bytes, more than {MOST_BYTES}")
    for part, path in partial.items():
        part.replace(path)
        print(hashlib.sha256(path.read_bytes()).hexdigest()[:12], path.relative_to(RECORDINGS))
    print(f"{name}: {size} bytes")


def main() -> int:
    """Thin the sets that are named."""
    names = sys.argv[1:]
    if not names or set(names) - SETS.keys():
        print(f"Sets: {', '.join(SETS)}.", file=sys.stderr)
        return 2
    missing = [name for name in names if not (SOURCES / FOLDERS.get(name, name) / "LICENSE").is_file()]
    if missing:
        print(f"REPRO_DATA_DIR has no files of {', '.join(missing)}.", file=sys.stderr)
        return 1
    for name in names:
        write(name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
