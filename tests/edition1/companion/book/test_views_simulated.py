"""Views of the simulated robots: what is shown is what the experiments found, next to the truth."""

import math

import numpy as np
import pytest
import torch

from edition1.errors import InputError
from edition1.kinematics.paper_robots import affine_robot, pcc_robot
from edition1_companion.book.project import find_project
from edition1_companion.book.views_frames import every_nth, readings
from edition1_companion.book.views_simulated import FRAMES, lemniscate_view, paper_method_view
from edition1_companion.pages.affine_curvature import method as affine
from edition1_companion.pages.affine_curvature.method import flower_view
from edition1_companion.twins import table_1_method as table1
from edition1_companion.twins.table_1_rows import rows_named
from edition1_companion.twins.trajectories import lemniscate
from edition1_live.view.robot_view import backbone_points

NETWORKS = find_project().data / "networks"


@pytest.mark.parametrize(("samples", "most"), [(1, 1), (99, 100), (100, 100), (101, 100), (7750, 200)])
def test_frames_are_even_and_not_too_many(samples, most):
    taken = np.arange(samples)[every_nth(samples, most)]
    assert taken[0] == 0
    assert len(set(np.diff(taken))) <= 1
    assert most / 2 < len(taken) <= most or len(taken) == samples


def test_no_frame_is_refused():
    with pytest.raises(InputError) as caught:
        every_nth(0, 100)
    assert (
        str(caught.value) == "Input samples, most of every_nth must be at least 1; instead received (0, 100)."
    )


def test_each_sensor_has_its_line():
    panel = readings(np.array([[1.0, 2.0], [3.0, 4.0]]), "mV", np.array([[5.0, 6.0], [7.0, 8.0]]))
    assert {name: x.tolist() for name, x in panel.values.items()} == {"u_1": [1, 3], "u_2": [2, 4]}
    assert panel.estimates["u_2"].tolist() == [6, 8]
    assert readings(np.ones((2, 1)), "mV").estimates == {}


def test_lemniscate_is_shown_once_around():
    view = lemniscate_view(2, 0.01)
    q = lemniscate(2, amplitude_m=0.01)[::4]
    assert len(view.time_s) == FRAMES
    assert view.time_s[-1] == pytest.approx(9.9)
    np.testing.assert_allclose(view.shapes[0].points_m, backbone_points(pcc_robot(2), q), atol=1e-15)
    assert view.magnets is not None
    assert view.magnets.points_m.shape == (FRAMES, 2, 3)
    assert "2 in all" in view.label


def test_errors_of_the_view_are_those_of_the_table():
    """By another route: the table of the same run, from the numbers of the panels."""
    rows, steps = rows_named(["n_b=1"]), 20
    view = paper_method_view(rows, NETWORKS, 0, steps=steps)
    table = table1.run(rows, [0], NETWORKS, steps=steps, jobs=1).set_index("quantity")["error"]
    panel = view.traces[0]
    assert panel.unit == "mm"
    for name, truth in panel.values.items():
        error = 100 * np.sqrt(((panel.estimates[name] - truth) ** 2).mean()) / np.ptp(truth)
        assert error == pytest.approx(table[name], rel=1e-9)
    assert "Row n_b=1 of Table 1, simulated: a robot of 1 segment on" in view.label
    assert "seed 0" in view.label


def test_robot_with_the_most_segments_is_shown():
    view = paper_method_view(rows_named(["n_b=1", "n_b=2"]), NETWORKS, 0, steps=4, step_size=(3e-3, 3e-4))
    assert "Row n_b=2" in view.label
    assert len(view.traces[0].values) == 6
    assert view.traces[1].title == "readings"
    assert list(view.traces[1].estimates) == [f"u_{j}" for j in range(1, 7)]


def test_no_row_is_refused():
    with pytest.raises(InputError, match="rows of paper_method_view must be at least one with trained"):
        paper_method_view((), NETWORKS, 0)


def test_estimate_is_shown_in_the_configuration_next_to_the_truth():
    """The other configuration of the same shape, two turns on, is no error; a small error stays what it is."""
    data = affine.Flower.simulated(30)
    run = affine.paper_method(data, affine.networks(NETWORKS, [0]), [0])
    other = run.estimates.q * torch.tensor([-1.0, -1.0, 1.0, 1.0], dtype=torch.float64)
    other = other + torch.tensor([0.0, 0.0, 5 * math.pi, 0.0], dtype=torch.float64)
    moved = affine.PaperRun(
        data, run.seeds, run.estimates.__class__(other, None, run.estimates.u_hat, {}), run.predicted
    )
    for view in (flower_view(run), flower_view(moved)):
        found = view.shapes[1].points_m
        expected = backbone_points(affine_robot(), run.estimates.q[:, 0])
        np.testing.assert_allclose(found, expected, atol=1e-9)
        azimuth = view.traces[1]
        assert np.abs(azimuth.estimates["phi_1"] - azimuth.values["phi_1"]).max() < math.pi
    first, second = (flower_view(x).traces[1].estimates["kappa_1_1"] for x in (run, moved))
    np.testing.assert_allclose(first, second, atol=1e-12)
