"""Run what a user writes for the robots of others, and keep the figures: ``python scripts/others.py NAME ...``.

Every folder of ``data/others`` has a ``use.py``. Its figures are written to ``data/studies/others_NAME.csv``, whole
or not at all, beside the source's own figure and the number of lines. Recordings without a licence are read from
``REPRO_DATA_DIR``; of them only errors are kept.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pandas as pd

ROOT = Path(__file__).resolve().parents[1]
SOURCES = {
    "toronto": "filter 11.46 mm, window 11.00 mm (raw, geometric mean of four trials)",
    "magnet_array": "more than 100 Hz, no error stated",
    "asl_trunk": "none",
    "eflesh": "0.5 mm",
    "tentacle": "8.1, 6.5, 4.9, 6.1 mm at the four markers (another task: from the tension)",
    "hall_joint": "lookup 2.0 deg rms",
    "soft_arm_3000": "none",
    "imu_chain": "none",
}
"""What the source states itself."""


def written_lines(path: Path) -> int:
    """Return how many lines a user writes: neither blank nor a comment."""
    lines = (line.strip() for line in path.read_text(encoding="utf-8").splitlines())
    return sum(bool(line) and not line.startswith("#") for line in lines)


def study(name: str) -> pd.DataFrame:
    """Return the figures of one robot, one row for each."""
    path = ROOT / "data" / "others" / name / "use.py"
    figures = runpy.run_path(str(path), run_name="__main__")["figures"]
    rows = []
    for what, value in figures.items():
        values = value if isinstance(value, list) else [value]
        place = [f"marker {k}" for k in range(1, len(values) + 1)] if len(values) > 1 else [""]
        rows += [(what, where, float(x)) for where, x in zip(place, values, strict=True)]
    table = pd.DataFrame(rows, columns=["measured", "where", "ours"])
    return table.assign(source=SOURCES[name], lines=written_lines(path))


def main() -> int:
    """Run the robots that are named."""
    names = sys.argv[1:]
    if not names or set(names) - SOURCES.keys():
        print(f"Robots: {', '.join(SOURCES)}.", file=sys.stderr)
        return 2
    for name in names:
        table, path = study(name), ROOT / "data" / "studies" / f"others_{name}.csv"
        partial = path.with_suffix(".partial")
        table.to_csv(partial, index=False, float_format="%.4g", lineterminator="\n")
        partial.replace(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
