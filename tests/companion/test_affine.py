"""The page of Figs 6 and 7: its shape, its errors, its robots, and the rows that its networks were trained on."""

import ast
import hashlib
import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import training_sets
from hypothesis import given
from hypothesis import strategies as st

import repro
from repro_companion.papers import baaij
from repro_companion.scorecard import published
from tests.library.robots import STORED

ROOT = Path(__file__).resolve().parents[2]
SHAPES = st.tuples(
    st.floats(-0.9, 0.9),
    st.floats(0.01, 3.7) | st.floats(-3.7, -0.01),
    st.floats(-7, 7),
    st.floats(0, 6.6e-3),
)


def flower(steps: int) -> np.ndarray:
    s = np.linspace(0, 1, steps)
    petal = (1 - np.cos(6 * np.pi * s)) / 2
    columns = (
        np.pi / 4 * petal,
        np.pi * (0.1 + 0.9 * petal),
        2 * np.pi * s,
        2.75e-3 * (1 + np.sin(2 * np.pi * s)),
    )
    return np.stack(columns, axis=-1)


@pytest.fixture(scope="module")
def backbone():
    """Return the function that the page shows."""
    page = json.loads((ROOT / "notebooks" / "affine_curvature.ipynb").read_text(encoding="utf-8"))
    source = next("".join(c["source"]) for c in page["cells"] if "def backbone(" in "".join(c["source"]))
    tree, names = ast.parse(source), {"np": np}
    tree.body = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    exec(compile(tree, "affine_curvature", "exec"), names)
    return names["backbone"]


@given(SHAPES)
def test_the_sum_of_the_page_is_the_backbone(backbone, q):
    found = backbone(np.array(q), np.linspace(0, 1, 9))
    np.testing.assert_allclose(found, baaij.affine_robot().backbone(q, 9), rtol=0, atol=2e-6)


@pytest.mark.parametrize("bend", [0.3, math.pi / 2])
def test_without_a_slope_the_segment_is_an_arc(backbone, bend):
    """Towards x at an azimuth of a quarter turn, with a radius of length over bend."""
    arc = 0.2 / bend * np.array([1 - math.cos(bend), 0.0, math.sin(bend)])
    np.testing.assert_allclose(backbone((bend, 0.0, math.pi / 2, 0.0), np.ones(1))[0], arc, rtol=0, atol=1e-7)


@given(SHAPES, st.integers(-2, 2))
def test_the_other_name_of_a_shape_is_no_error(q, turns):
    truth = np.array([q])
    renamed = truth * [-1, -1, 1, 1] + [0, 0, math.pi + 2 * math.pi * turns, 0]
    np.testing.assert_allclose(baaij.affine_difference(renamed, truth), 0, rtol=0, atol=1e-12)


def test_errors_are_relative_to_the_range():
    """A tenth of the range too much, in the azimuth a whole turn beside; eq. (13)."""
    truth = flower(301)
    tenth = np.ptp(truth, axis=0) / 10
    found = truth + tenth + [0, 0, 2 * math.pi, 0]
    np.testing.assert_allclose(baaij.affine_percent(found, truth), 10, rtol=1e-12)


def test_ours_have_as_many_digits_as_the_published_ones():
    card = {
        "paper": "baaij2023",
        "artefact": "Section 4.4",
        "quantity": "kappa_0",
        "unit": "%",
        "weak": "false",
    }
    card |= {"published": "5.4", "published_std": "0.7", "regenerated": "6.4567", "regenerated_std": "1.8765"}
    table = baaij.affine_beside_print(pd.DataFrame([card | {"verdict": "reproduced"}]))
    assert table.iloc[0].to_list() == ["κ₀ [%]", "5.4 ± 0.7", "6.5 ± 1.9", "reproduced"]


def test_a_descent_from_the_other_name_is_the_mirror_image():
    """What the exercise of the page says."""
    truth = flower(60)
    u = repro.simulated_readings(baaij.affine_robot(), truth)
    descent = repro.GradientDescent(repro.Sensing(baaij.affine_robot()), [1.0, 5.0, 1.0, 2e-4])
    other = truth[0] * [-1, -1, 1, 1] + [0, 0, math.pi, 0]
    one, two = (repro.track(descent, u, start).q for start in (truth[0], other))
    np.testing.assert_allclose(two, one * [-1, -1, 1, 1] + [0, 0, math.pi, 0], rtol=0, atol=1e-7)


def test_rows_of_the_scorecard():
    """The slip of print is not compared, and our method has relative errors only."""
    truth, u = flower(5), np.zeros((5, 9))
    errors = baaij.affine_errors(np.stack([truth, truth + 0.01]), np.zeros((2, 5, 9)), truth, u, [0, 1])
    ours = baaij.affine_best({True: np.outer([0, 0, 3], np.arange(4.0)), False: np.ones((1, 4))})
    table = baaij.affine_rows(errors, "setting", ours)
    printed = published("baaij2023", "Section 4.4")
    assert set(zip(table["quantity"], table["unit"], strict=True)) == set(
        zip(printed["quantity"], printed["unit"], strict=True)
    )
    assert table.loc[~table["comparable"], "unit"].tolist() == ["mm"]
    assert table.loc[table["unit"] == "%", "best"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert table.loc[table["unit"] != "%", ["best", "best_method"]].isna().all(axis=None)


@pytest.mark.parametrize(("n", "segment", "earth"), [(1, 0, False), (2, 1, False), (3, 1, True)])
def test_rows_of_a_network_of_table_1(n, segment, earth):
    xi, u = training_sets.SegmentNetwork(n, segment, earth, 0).rows(40)
    np.testing.assert_allclose(xi, STORED[f"rows_{n}_xi"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(u, STORED[f"rows_{n}_u"], rtol=0, atol=1e-6)


NETWORKS = [training_sets.AffineNetwork(8, 0), training_sets.SegmentNetwork(1, 0, False, 0)]


@pytest.mark.parametrize("network", NETWORKS, ids=lambda network: network.name)
def test_all_rows_are_those_that_a_committed_network_was_trained_on(network):
    """Bit for bit: so the committed networks are what a training would give again."""
    xi, u = network.rows()
    manifest = json.loads((ROOT / "data" / "networks" / f"{network.name}.json").read_text(encoding="utf-8"))
    assert hashlib.sha256(xi.tobytes() + u.tobytes()).hexdigest() == manifest["data_sha256"]


def test_there_are_networks_for_every_row_of_the_paper():
    names = [network.name for network in training_sets.trained_networks()]
    assert len(set(names)) == 54
    assert all((ROOT / "data" / "networks" / f"{name}.safetensors").is_file() for name in names)


def test_errors_of_section_4_4_by_hand():
    """A tenth of the range in the root mean square over two steps; one of nine sensors is 9 mT off."""
    truth, off = np.array([[0.0, 1.0, 0.0, 0.0], [1.0, 3.0, 2.0, 4e-3]]), np.array([0.1, 0.2, 0.2, 4e-4])
    found, predicted = truth + np.outer([0, 2**0.5], off), np.outer([0, 9 * 2**0.5], np.eye(9)[4])
    table = baaij.affine_errors(found[None], predicted[None], truth, np.zeros((2, 9)), [0])
    assert table["error"].to_numpy() == pytest.approx([1.0, 10, 10, 10, 10, 0.1, 0.2, 0.2, 0.4])
    assert table["unit"].to_list() == ["mT", *4 * ["%"], "rad/m", "rad/m^2", "rad", "mm"]
    turned = truth + off + np.array([0, 0, 2 * np.pi, 0])  # an azimuth a whole turn further is the same
    course = baaij.affine_series(
        np.stack([truth, truth + 2 * off, turned]), predicted[[[0, 1]] * 3], truth, 0 * predicted
    )
    values = course.set_index("name").loc[["phi", "delta_L"], ["truth", "mean", "std"]]
    np.testing.assert_allclose(values, [[0, 0.2, 0.2], [0, 0.4, 0.4]], atol=1e-12)


def test_stills_of_the_flower_stand_at_six_even_times_and_end_before_it_begins_again():
    truth = flower(12)
    shapes, parts = baaij.affine_stills(baaij.affine_robot(), truth, np.stack([truth + 1e-3, truth]))
    np.testing.assert_allclose(shapes["time_s"].unique(), np.arange(0, 12, 2) / baaij.RATE_HZ)
    assert list(shapes["run"].unique()) == ["truth", "network 1", "network 2"]
    tips = shapes.groupby(["run", "time_s"])[["x_mm", "y_mm", "z_mm"]].last()
    for run in ("truth", "network 2"):
        np.testing.assert_allclose(tips.loc[run], 1e3 * baaij.affine_robot().tip(truth[::2])[:, :3, 3])
    assert list(parts["time_s"].unique()) == list(shapes["time_s"].unique())
