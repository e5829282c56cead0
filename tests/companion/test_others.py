"""Robots of others: what a user writes runs in an empty folder, and reaches what the page promises."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from repro_companion.papers import others
from repro_companion.papers.fetch import listed_files
from repro_companion.run import project_folder, recordings_folder

ROBOTS = others.robots()
COMMITTED = [name for name, about in ROBOTS.items() if about["licence"] == "MIT"]
FETCHED = [name for name in ROBOTS if name not in COMMITTED]
BARS = {
    "toronto": {"slow_free_space_rms_mm": 9.6, "impulse_1_rms_mm": 13.4},
    "asl_trunk": {"adiabatic_tip_median_mm": 5.0, "controlled_tip_median_mm": 5.0},
    "tentacle": {},
    "eflesh": {"x_rms_mm": 0.55, "y_rms_mm": 0.55},
    "magnet_array": {"position_mean_mm": 0.101, "axis_mean_deg": 0.29},
    "hall_joint": {"cycle_1_mean_rms_deg": 0.53},
    "soft_arm_3000": {"arcs_3_median_mm": 0.94},
    "imu_chain": {"trial1_rigid_joint_4_rms_mm": 55.0},
}
"""What the printed figures may be at most: errors of the sources, or of what was tried before."""


def run(name: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a user's script from an empty folder; that kernels are compiled is no remark."""
    kept = {key: value for key, value in os.environ.items() if key != "REPRO_DATA_DIR"}
    command = [sys.executable, "-W", "error", str(others.script(name))]
    done = subprocess.run(
        command, cwd=folder, env=kept | environment, capture_output=True, text=True, check=False
    )
    done.stderr = re.sub(r"^repro: Compiling .*\n", "", done.stderr)  # once on every machine
    return done


def printed(said: str) -> dict[str, float]:
    """Return the figures that a script prints, a line each."""
    return {key: float(value) for key, value in re.findall(r"^(\w+) +([\d.]+)$", said, re.MULTILINE)}


def within_its_bars(name: str, done: subprocess.CompletedProcess[str]) -> None:
    assert (done.returncode, done.stderr) == (0, "")
    found = printed(done.stdout)
    assert all(found[key] <= bar for key, bar in BARS[name].items())


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMITTED)
def test_what_a_user_writes_runs_in_an_empty_folder_within_its_bars(name, tmp_path):
    within_its_bars(name, run(name, tmp_path))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", FETCHED)
def test_where_files_have_no_licence_the_script_reads_what_was_fetched(name, tmp_path):
    place = recordings_folder()
    if not any((place / name).rglob("*.csv")):
        pytest.skip(f"`repro fetch {name}` brings the files")
    if name == "imu_chain" and not importlib.util.find_spec("vqf"):
        pytest.skip("`pip install vqf` brings what turns raw readings into orientations")
    within_its_bars(name, run(name, tmp_path, REPRO_DATA_DIR=str(place)))


@pytest.mark.parametrize("folders", [False, True], ids=["nothing", "empty folders"])
@pytest.mark.parametrize("name", FETCHED)
def test_without_the_files_the_script_says_what_to_do_in_one_sentence(name, folders, tmp_path):
    for source in listed_files(name) if folders else []:
        (tmp_path / source.name).parent.mkdir(parents=True, exist_ok=True)
    done = run(name, tmp_path)
    missing_vqf = name == "imu_chain" and not importlib.util.find_spec("vqf")
    words = "`pip install vqf` first." if missing_vqf else f"`repro fetch {name}`"
    assert done.returncode == 1
    assert words in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_user_needs_public_names_only_and_not_many_lines():
    for name in ROBOTS:
        tree = ast.parse(others.script(name).read_text(encoding="utf-8"))
        imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom | ast.Import)]
        modules = [
            node.module if isinstance(node, ast.ImportFrom) else node.names[0].name for node in imports
        ]
        assert not [
            module for module in modules if module and module.startswith(("repro_board", "repro_companion"))
        ]
        names = [alias.name for node in imports for alias in node.names]
        assert not [one for one in names if one.startswith("_")]
        assert others.written_lines(others.script(name)) <= 55


def test_lines_are_counted_without_blanks_comments_and_the_first(tmp_path):
    path = tmp_path / "use.py"
    path.write_text('"""What it is."""\n\n# why\nx = 1  # what\nfor k in range(3):\n    x += k\n')
    assert others.written_lines(path) == 3


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_regions_of_true_covariances_cover_as_often_as_they_should(dimensions):
    rng = np.random.default_rng(dimensions)
    A = rng.normal(size=(dimensions, dimensions))
    error = rng.normal(size=(20_000, dimensions)) @ A.T
    covered, longest = others.coverage(error, np.tile(A @ A.T, (20_000, 1, 1)))
    assert covered == pytest.approx(90, abs=4 * np.sqrt(90 * 10 / 20_000))
    edge = {1: 1.645, 2: 2.146, 3: 2.500}[dimensions]  # radii that hold 90 % of a standard normal
    assert longest == pytest.approx(edge * np.linalg.norm(A, 2), rel=1e-3)
    judged = {"judged": {"a": (error, np.tile(A @ A.T, (20_000, 1, 1)))}}
    off, half = np.split(others.region(others.Found({}, {}, judged), "a").to_numpy(), 2, axis=1)
    np.testing.assert_allclose(100 * (np.abs(off) < half).mean(0), 90, atol=4 * np.sqrt(90 * 10 / 20_000))


def test_a_jump_is_a_turn_of_more_than_ten_degrees_from_frame_to_frame():
    """One body turns by 9, 11 and 2 degrees, the other one back by 15, 3 and 25."""
    turns = np.radians([[0, 0], [9, -15], [20, -18], [22, -43]])
    poses = np.zeros((4, 2, 7))
    poses[..., 5], poses[..., 6] = np.sin(turns / 2), np.cos(turns / 2)
    assert others._jumps(poses) == 3


def test_tips_of_a_trunk_stand_at_the_frames_that_are_judged_every_one_of_the_short_motion():
    """Of six frames one is not kept; errors are those of the last four."""
    kept, off = np.array([True, False, True, True, True, True]), np.array([3.0, 4.0, 0.0]) * np.ones((4, 1))
    names = {"kept": dict.fromkeys(("adiabatic", "controlled"), (None, kept, off))}
    names["judged"] = dict.fromkeys(("adiabatic", "controlled"), (2 * off, None))
    table = others.tips_of_trunk(others.Found({}, {}, names), every=3).set_index("motion")
    assert table.loc["adiabatic", "frame"].tolist() == [2, 5]
    assert table.loc["controlled", "frame"].tolist() == [2, 3, 4, 5]
    assert (table[["arcs", "with what was learned"]] == [5, 10]).all(axis=None)


def test_the_page_counts_what_regions_hold_as_for_all_robots():
    page = json.loads((project_folder() / "notebooks/others.ipynb").read_text(encoding="utf-8"))
    cells = ["".join(cell["source"]) for cell in page["cells"] if cell["cell_type"] == "code"]
    space = {}
    exec("\n".join(cells[:3]), space)
    covered, longest = others.coverage(space["error"], space["C"])
    assert (100 * space["inside"].mean(), np.median(space["longest"])) == (covered, longest)


def test_where_no_file_is_here_figures_are_those_that_were_committed(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    found = {name: others.found(name) for name in FETCHED}
    table = others.rows(found)
    assert set(table["computed"]) == {"before"}
    assert list(table["name"]) == FETCHED
    for name, own in found.items():
        study = pd.read_csv(project_folder() / f"data/studies/others_{name}.csv")
        assert own.figures == dict(zip(study["figure"], study["value"], strict=True))
        assert f"<code>.venv/bin/repro fetch {name}</code>" in others.table(table).data
    assert set(others.pictures(found)["look"]) == {"drawn", "bodies"}
    for source in [source for name in FETCHED for source in listed_files(name)]:  # others than were released
        (tmp_path / source.name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / source.name).write_text("a,b\n1,2\n")
    assert {name: others.found(name).figures for name in FETCHED} == {
        name: own.figures for name, own in found.items()
    }


def test_files_without_a_licence_can_be_fetched_from_the_commit_that_the_table_names():
    sources = json.loads((project_folder() / "data/sources.json").read_text(encoding="utf-8"))
    for name in FETCHED:
        about = ROBOTS[name]
        assert sources[name]["repository"] == f"https://github.com/{about['repository']}"
        assert sources[name]["commit"].startswith(about["commit"])


@pytest.mark.parametrize("name", [name for name in COMMITTED if name not in ("toronto", "magnet_array")])
def test_a_committed_set_names_its_source_and_has_its_licence(name):
    folder = project_folder() / "data/recordings" / name
    words, about = (folder / "README.md").read_text(encoding="utf-8"), ROBOTS[name]
    assert f"https://github.com/{about['repository']}" in words
    assert f"`{about['commit']}`" in words
    assert "Permission is hereby granted, free of charge" in (folder / "LICENSE").read_text(encoding="utf-8")
    assert sum(path.stat().st_size for path in folder.iterdir()) < 1_000_000
