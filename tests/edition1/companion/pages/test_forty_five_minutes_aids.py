"""Readings of a straight robot with parts moved: closed forms, and a regression on readings that are drawn."""

import numpy as np
import pytest
import torch

from edition1_companion.pages.forty_five_minutes.aids import AIDS, aids, left, prior
from edition1_companion.pages.forty_five_minutes.poses import POSE_M, described


def std(robot, aid):
    return left(robot, AIDS[aid]).diagonal().sqrt().numpy()


def test_two_readings_with_opposite_magnets_add_up_to_twice_the_offset():
    robot = described("three_segments")
    before = prior(robot)[-1].item()
    closed_form = (1 / (1 / before + 2 / robot.noise**2)) ** 0.5
    np.testing.assert_allclose(std(robot, "magnets turned round")[-9:], closed_form, rtol=1e-6)
    assert std(robot, "straight")[-9:].min() > 100 * closed_form


def test_where_all_sensors_read_the_same_an_exchange_says_next_to_nothing_of_each():
    """Three sensors around the axis behind a ring; those of two segments read three fields."""
    one, two = (described(name) for name in ("one_segment", "two_segments"))
    np.testing.assert_allclose(std(one, "sensors exchanged"), std(one, "straight"), rtol=1e-3)
    exchanged, straight = std(two, "sensors exchanged"), std(two, "straight")
    assert (exchanged < 1.001 * straight).all()
    assert exchanged[:1] < 0.6 * straight[:1]


@pytest.mark.parametrize("aid", AIDS)
def test_a_regression_on_readings_that_are_drawn_is_as_sure(aid):
    """Errors a hundred times smaller, so that their products are below the noise; sensors moved one by one."""
    robot, draws, small = described("two_segments"), 20_000, 0.01
    n, rng = len(robot.gain), np.random.default_rng(11)
    errors = small * prior(robot).sqrt().numpy() * rng.standard_normal((draws, 1 + 2 * n))
    m, g, o = errors[:, :1], errors[:, 1 : 1 + n], errors[:, 1 + n :]
    off = small * torch.from_numpy(np.array([POSE_M]) * rng.standard_normal((draws, robot.robot.n_q)))
    field = robot.sensing()(robot.start + off).numpy()
    u = []
    for moved, sign in AIDS[aid]:
        for place in range(n):
            sensor = (place + moved) % n
            noise = small * robot.noise * rng.standard_normal(draws)
            u.append((1 + m[:, 0]) * (1 + g[:, sensor]) * sign * field[:, place] + o[:, sensor] + noise)
    u = np.stack(u, axis=1)
    u -= u.mean(axis=0)
    slope = np.linalg.lstsq(u, errors, rcond=None)[0]
    scatter = (errors - u @ slope).std(axis=0) / small
    np.testing.assert_allclose(scatter, std(robot, aid), rtol=0.03)


def test_more_readings_are_never_less_sure_and_all_aids_come_near_poses():
    table = aids(["one_segment"]).set_index("aid")
    assert table.loc["both", "stated_percent"] < table.loc["magnets turned round", "stated_percent"]
    assert table.loc["magnets turned round", "stated_percent"] < table.loc["straight", "stated_percent"]
