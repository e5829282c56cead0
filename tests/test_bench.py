"""The benchmark runs: every row has its figure. No speed is asserted."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_every_row_has_a_figure(tmp_path):
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    command = [sys.executable, "bench/bench.py", "--fast", str(tmp_path / "fast.csv")]
    subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True)
    fast, committed = pd.read_csv(tmp_path / "fast.csv"), pd.read_csv(ROOT / "data" / "benchmark.csv")
    assert list(fast.columns) == ["capability", "figure", "target", "met", "processor"]
    pd.testing.assert_series_equal(fast["capability"], committed["capability"])
    there = fast["met"] != "not installed"
    assert np.isfinite(fast["figure"][there]).all()
    assert fast["figure"][~there].isna().all()
    pd.testing.assert_series_equal(fast["target"][there], committed["target"][there])
    assert (fast["met"][there].notna() == fast["target"][there].notna()).all()
    operations = (
        fast.set_index("capability")["figure"].filter(like="multipoles").filter(like="[floating-point")
    )
    of_evaluation, of_fit = (
        operations.filter(like="evaluation").to_numpy(),
        operations.filter(like="fit").to_numpy(),
    )
    assert (of_evaluation > 1000).all(), "some ten operations for each of three readings and four slopes"
    assert (of_fit > 4 * of_evaluation).all(), "three iterations evaluate four times, and solve"
