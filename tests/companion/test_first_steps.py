"""The page of Figs 2(a) and 4(a): the code that it shows, and the tables that it draws."""

import ast
import json
import re
from pathlib import Path

import magpylib
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import repro
from repro.chain import point_on
from repro.sensing import relations
from repro_companion.papers import baaij

ROOT = Path(__file__).resolve().parents[2]
SIZES = st.floats(1e-3, 20e-3) | st.floats(-20e-3, -1e-3)


@pytest.fixture(scope="module")
def shown():
    """Return the functions ``walk`` and ``arc`` as the page shows them."""
    page = json.loads((ROOT / "notebooks" / "first_steps.ipynb").read_text(encoding="utf-8"))
    source = next("".join(c["source"]) for c in page["cells"] if "def walk(" in "".join(c["source"]))
    tree = ast.parse(source)
    tree.body = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    names = {"np": np, "L_0": baaij.LENGTH, "radius": baaij.RADIUS}
    exec(compile(tree, "first_steps", "exec"), names)  # the page's own code
    return names


@given(SIZES, SIZES, st.floats(0, 6e-3), st.floats(0.05, 1))
def test_shown_positions_are_those_of_the_library(shown, delta_x, delta_y, delta_L, v):
    q = np.array([delta_x, delta_y, delta_L])
    delta = np.hypot(delta_x, delta_y)
    place = point_on(1, v * baaij.LENGTH)
    expected = baaij.robot(1).poses(q, [place])[0, :3, 3]
    walked = shown["walk"](lambda w: w * delta / baaij.RADIUS, q[:2] / delta, baaij.LENGTH + delta_L, v)
    np.testing.assert_allclose(shown["arc"](q, v), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(walked, expected, atol=1e-7)


def test_the_printed_position_is_right_at_the_tip_only(shown):
    q = np.array([17.28e-3, 0.0, 0.0])
    near_base = shown["arc"](q, 1e-6) / 1e-6
    np.testing.assert_allclose(near_base, [0, 0, baaij.LENGTH], atol=1e-7)
    table = pd.read_csv(ROOT / "results" / "kinematics_equation_15.csv")
    ours = 1e3 * np.array([shown["arc"](q, v) for v in table["v"]])
    np.testing.assert_allclose(ours[:, [0, 2]], table[["x_mm", "z_mm"]], rtol=1e-8)
    printed = table[["x_printed_mm", "z_printed_mm"]]
    np.testing.assert_allclose(ours[:, [0, 2]] / table[["v"]].to_numpy(), printed, rtol=1e-8)


@pytest.mark.parametrize("n", [1, 2])
def test_the_field_around_a_robot_is_magpylibs(n):
    robot, q, ring = baaij.robot(n, ring="published"), baaij.planar(n, 30.0), baaij.RINGS["published"]
    size = ring.inner_diameter / 2, ring.outer_diameter / 2, ring.height, 0, 360
    rings = [
        magpylib.magnet.CylinderSegment(
            T[:3, 3], Rotation.from_matrix(T[:3, :3]), dimension=size, polarization=(0, 0, 1.45)
        )
        for T in robot.poses(q, [magnet.place for magnet in robot.magnets])
    ]
    found = baaij.field_in_plane(robot, q, rows=11)
    points = 1e-3 * np.stack([found["x_mm"], 0 * found["x_mm"], found["z_mm"]], axis=-1)
    expected = 1e3 * magpylib.getB(rings, points, sumup=True)
    np.testing.assert_allclose(found[["b_x_mT", "b_z_mT"]], expected[:, [0, 2]], rtol=1e-8, atol=1e-9)


def test_what_a_reading_is_made_of():
    """One dipole moment gives the first term of the series that the page adds up."""
    robot, q = baaij.robot(1), baaij.planar(1, 70.0)
    _, d, cos_alpha, cos_beta, cos_theta = relations(robot, q)[0]
    moment = baaij.RINGS["released"].multipoles(1)[0]
    dipole = moment / d**3 * (3 * cos_theta * cos_beta - cos_alpha)
    np.testing.assert_allclose(repro.Sensing(robot, moments=[moment])(q)[0], dipole, rtol=1e-12)


def test_the_exercise_about_the_dipole():
    """Its terms are the field on the axis; from 40 to 80 mm the dipole's relative error falls to a quarter."""
    page = json.loads((ROOT / "notebooks" / "first_steps.ipynb").read_text(encoding="utf-8"))
    source = next("".join(c["source"]) for c in page["cells"] if c["id"] == "dipole-solution")
    printed: list[str] = []
    exec(source, {"np": np, "baaij": baaij, "ring": "released", "print": printed.append})
    mm, dipole, whole = np.array([re.findall(r"[\d.]+", line) for line in printed], dtype=float).T
    ring = baaij.RINGS["released"]
    size = ring.inner_diameter / 2, ring.outer_diameter / 2, ring.height, 0, 360
    magnet = magpylib.magnet.CylinderSegment(dimension=size, polarization=(0, 0, 1.45))
    at = np.outer(1e-3 * mm, [0, 0, 1])
    np.testing.assert_allclose(
        whole[1:], 1e3 * magnet.getB(at)[1:, 2], rtol=1e-4, atol=6e-4
    )  # of what is printed
    off = dict(zip(mm, dipole / whole - 1, strict=True))
    assert off[80] / off[40] == pytest.approx(0.25, rel=0.1)
    assert 0.08 < off[55] < 0.1
