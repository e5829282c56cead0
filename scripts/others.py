"""Keep the figures of robots whose files have no licence: ``python scripts/others.py NAME ...``.

What a user writes for them, ``data/others/NAME/use.py``, reads the files from ``REPRO_DATA_DIR``. Its figures go to
``data/studies/others_NAME.csv``, whole or not at all, with what the stated regions cover and how large they are. Of
the files themselves only these errors are kept. ``imu_chain`` needs vqf from PyPI.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

from repro_companion.papers import others

STUDIES = Path(__file__).resolve().parents[1] / "data" / "studies"


def main() -> int:
    """Compute the robots that are named."""
    names = sys.argv[1:]
    if not names or set(names) - {*others.FETCHED}:
        print(f"Robots: {', '.join(others.FETCHED)}.", file=sys.stderr)
        return 2
    for name in names:
        table = pd.DataFrame(others.computed(name).figures.items(), columns=["figure", "value"])
        path = STUDIES / f"others_{name}.csv"
        partial = path.with_suffix(".partial")
        table.to_csv(partial, index=False, float_format="%.4g", lineterminator="\n")
        partial.replace(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
