"""The gallery: every robot loads and can work, and its page says what is in its file and what comes out of it."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

from repro import load_robot

ROOT = Path(__file__).parents[2]
SPEC = importlib.util.spec_from_file_location("gallery", ROOT / "scripts" / "gallery.py")
assert SPEC is not None
assert SPEC.loader is not None
gallery = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(gallery)
PAGE = (ROOT / "book" / "gallery.md").read_text(encoding="utf-8")
SECTIONS = dict(zip(gallery.TITLES, PAGE.split(":::{grid-item-card} ")[1:], strict=True))


def test_every_file_is_on_the_page():
    assert {path.stem for path in gallery.FILES.glob("*.toml")} == set(gallery.TITLES)
    assert {path.stem for path in (ROOT / "book" / "gallery").iterdir()} == set(gallery.TITLES)


@pytest.mark.parametrize("name", gallery.TITLES)
def test_a_robot_can_work_and_its_numbers_are_those_of_the_page(name):
    robot, section = load_robot(gallery.FILES / f"{name}.toml"), SECTIONS[name]
    check = robot.check()
    assert check.can_work
    assert not check.saturated
    assert not any("so close to a magnet" in note for note in check.notes)
    assert section.startswith(gallery.TITLES[name])
    assert (gallery.FILES / f"{name}.toml").read_text(encoding="utf-8") in section
    said, _, numbers = check.verdict.partition(":")
    assert f"`repro check {name}.toml`: *{said}.*" in section
    (row,) = re.findall(rf"^\| \[[^|]*\]\(#robot-{name}\) \|(.*)\|$", PAGE, re.MULTILINE)
    _, noise, *cells = row.split("|")
    *sizes, error = map(float, cells)
    assert robot.noise is not None
    first = 1e-3 if robot.sensors else np.radians(1.0)  # µT in mT, or degrees
    assert float(re.findall(r"[\d.]+", noise)[0]) * first == pytest.approx(robot.noise[0])
    assert sizes == pytest.approx([float(x) for x in re.findall(r"([\d.]+) mm", numbers)], rel=0.06)
    assert error == pytest.approx(gallery.tip_error(robot), rel=0.1)
    assert error < 1.5 * 1e3 * float(check.tip_within_bounds.mean())
