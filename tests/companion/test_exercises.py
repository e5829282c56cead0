"""Every command that a page asks its reader to run: it runs, and what it shows is what the solution says."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from repro_companion import cli

ROOT = Path(__file__).resolve().parents[2]
COMMAND = re.compile(r"^\.venv/bin/repro run (notebooks/(\w+)\.ipynb .+)$", re.MULTILINE)


def commands() -> dict[str, list[str]]:
    """Return the arguments of each command, by the page that it is on."""
    texts = {path.stem: path.read_text(encoding="utf-8") for path in sorted(ROOT.glob("book/*.md"))}
    for path in sorted(ROOT.glob("notebooks/*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        texts[path.stem] = "\n".join("".join(cell["source"]) for cell in cells)
    return {page: shlex.split(found[1]) for page, text in texts.items() for found in COMMAND.finditer(text)}


class Run:
    """Tables and printed text of an executed notebook, and the tables of the book."""

    def __init__(self, output: Path):
        self.output = output

    def table(self, name: str) -> pd.DataFrame:
        return pd.read_csv(self.output.with_suffix("") / f"{name}.csv")

    def book(self, name: str) -> pd.DataFrame:
        return pd.read_csv(ROOT / "results" / f"{name}.csv")

    def printed(self) -> str:
        cells = json.loads(self.output.read_text(encoding="utf-8"))["cells"]
        outputs = [output for cell in cells for output in cell.get("outputs", [])]
        return "".join("".join(output.get("text", "")) for output in outputs)


def of_closed_loop(run: Run) -> None:
    """Which estimator comes closest to the loop with the truth, and what limits least squares."""
    table = run.table("closed_loop_means").query("session == 'as modelled'")
    error = table.set_index(["controller", "estimator"])["tracking_mm"]
    slow, fast = error["moderate gain"], error["high gain"]
    noisy = ["Kalman filter", "Kalman filter with command", "least squares"]
    assert slow["truth"] < slow["Kalman filter"] < 1.1 * slow["truth"]
    assert list(slow[noisy].sort_values().index) == noisy
    assert fast["least squares"] == pytest.approx(1.25 * fast["truth, one sample late"], rel=0.05)
    assert fast["Kalman filter with command"] < fast["truth, one sample late"] < fast["Kalman filter"]


def of_drift(run: Run) -> None:
    """With three times the drift the error grows a little, and the filter states more than it has."""
    error, normalised = map(float, re.findall(r"drift in the state +([\d.]+) % +([\d.]+)", run.printed())[0])
    usual = run.book("forty_five_minutes").query("method == 'self-calibrating'")
    assert 1.1 < error / usual["tip_rmse_percent"].mean() < 1.4
    assert normalised < 0.5 * usual["nees"].mean()


def of_live(run: Run) -> None:
    """A frame of 31 bytes is lost with the chance that one of them is hit, and none is read wrong."""
    table = run.table("recording_faults").set_index("fault")
    lost = 1 - table["accepted"] / table["sent"]
    chance = 1 - 0.99**31
    assert abs(lost["flips"] - chance) < 4 * np.sqrt(chance * (1 - chance) / table.loc["flips", "sent"])
    assert (table["wrong"] == 0).all()


def of_particle_filter(run: Run) -> None:
    """Half the noise, half the error."""
    half, usual = (
        t.query("setting == 'as printed'").set_index(["particles", "curve"])["mean_mm"]
        for t in (run.table("bend_summary"), run.book("bend_summary"))
    )
    np.testing.assert_allclose(half / usual[half.index], 0.5, atol=0.03)


def of_sensor_failure(run: Run) -> None:
    """Sensors on an axis see the slope along it, so the bend in x loses most, and the bend in y hardly anything."""
    factors = re.findall(r"^segment \d\s+\[([\d. ]+)\]", run.printed(), re.MULTILINE)
    assert len(factors) == 3
    for x, y, elongation in (map(float, row.split()) for row in factors):
        assert x > elongation > y
        assert y < 1.1


def of_index(run: Run) -> None:
    """A magnet halfway along a segment points half as far to the side as the segment bends."""
    first = run.table("first_steps_parts").iloc[0]
    np.testing.assert_allclose(first[["axis_x", "axis_z"]].astype(float), [0.5, 0.75**0.5])


LAWS: dict[str, Callable[[Run], None]] = {
    "closed_loop": of_closed_loop,
    "drift": of_drift,
    "index": of_index,
    "live": of_live,
    "particle_filter": of_particle_filter,
    "sensor_failure": of_sensor_failure,
}


def test_every_command_has_a_law():
    assert set(commands()) == set(LAWS)


@pytest.mark.slow
@pytest.mark.parametrize("page", LAWS)
def test_a_command_shows_what_its_solution_says(page, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path / "none"))
    notebook, *parameters = commands()[page]
    output = tmp_path / "run.ipynb"
    assert cli.app(["run", notebook, *parameters, "-o", str(output)], result_action="return_value") == 0
    LAWS[page](Run(output))
