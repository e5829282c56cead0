"""Pictures have what they show at its place; a table has names, units and deviations."""

from __future__ import annotations

from dataclasses import replace

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from repro import (
    AffineCurvature,
    BallJoint,
    ConstantCurvature,
    Cube,
    Disc,
    GradientDescent,
    Imu,
    InputError,
    LevenbergMarquardt,
    Link,
    Magnet,
    Robot,
    Sensing,
    Sensor,
    fit_shape,
    simulated_readings,
    track,
)
from repro.estimators.track import Trajectory

mpl.use("agg")

ROBOT = Robot(
    [ConstantCurvature(0.09, 0.015), Link(0.02), AffineCurvature(0.08), BallJoint("xy"), Link(0.03)],
    [Magnet(Disc(8e-3, 3e-3, 1300.0), 1, 0.045), Magnet(Cube(4e-3, 1300.0), 5, 0.02, [1, 0, 0])],
    [Sensor(1, 0.055, radial=0.012, axes=3, name="chip"), Sensor(3, 0.06, radial=0.012)],
    [Imu(3, 0.08)],
    lower=[-0.02, -0.02, -0.001, -1, -1, np.nan, -0.002, -1, -1],
    upper=[0.02, 0.02, 0.005, 1.4, 1, np.nan, 0.002, 1, 1],
    noise=0.01,
)
BENT = np.array([0.015, 0.005, 0.002, 1.0, 0.5, 1.0, 0.001, 0.5, 0.2])


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def lines(ax):
    return [np.array(line.get_data_3d()).T for line in ax.lines]


def test_a_robot_is_drawn_where_it_is():
    ax = ROBOT.plot(BENT)
    drawn = lines(ax)
    T = ROBOT.poses(BENT, [m.place for m in ROBOT.magnets])
    heights = [3.0, 4.0]
    for pose, height in zip(T, heights, strict=True):
        for end in (0.5, -0.5):
            bar = 1e3 * pose[:3, 3] + np.outer([0, end * height], pose[:3, 2])
            found = [line.shape == bar.shape and np.allclose(line, bar) for line in drawn]
            assert ax.lines[found.index(True)].get_color() == ("#C1272D" if end > 0 else "#3B5BA5")
    tip = 1e3 * ROBOT.tip(BENT)[:3, 3]
    assert any(np.allclose(line[-1], tip) for line in drawn)
    rim = 1e3 * (
        ROBOT.poses(BENT, [ROBOT.sensors[0].place._replace(at=0.09, position=np.array([0.015, 0, 0]))])
    )
    assert any(np.allclose(line[0], rim[0, :3, 3]) for line in drawn)  # the radius of the first segment
    arrows = [c for c in ax.collections if type(c).__name__ == "Line3DCollection"]
    assert len(arrows) == 3 + 1 + 3
    assert (ax.get_xlabel(), ax.get_zlabel()) == ("x [mm]", "z [mm]")
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["magnet, north red", "sensor", "IMU"]


def test_several_shapes_on_each_other_and_on_given_axes():
    ax = ROBOT.plot([np.zeros(9), BENT], labels=["straight", "bent"])
    assert {"straight", "bent"} < {text.get_text() for text in ax.get_legend().get_texts()}
    before = len(ax.lines)
    assert ROBOT.plot(BENT, axes=ax) is ax
    assert len(ax.lines) == before * 3 // 2


@pytest.mark.parametrize("inches", [2.5, 3.5, 6.4])
def test_a_legend_lies_within_its_figure(inches):
    figure = plt.figure(figsize=(inches, inches))
    ax = ROBOT.plot(
        [np.zeros(9), BENT], axes=figure.add_subplot(projection="3d"), labels=["straight", "bent"]
    )
    figure.canvas.draw()
    box = ax.get_legend().get_window_extent()
    assert np.all(box.min >= 0)
    assert np.all(box.max <= figure.bbox.max)


def test_no_two_lines_have_one_colour():
    """Of twelve channels, of twelve coordinates, of seven shapes; where the usual colours suffice they are kept."""
    u, zero = np.tile(np.arange(12.0), (2, 1)), np.zeros(2)
    shape = Trajectory(zero, u, None, u, zero, zero, zero, readings=u)
    coordinates, above, _ = shape.plot()
    for ax in (coordinates, above):
        labelled = [line for line in ax.lines if not line.get_label().startswith("_")]
        assert len({to_rgb(line.get_color()) for line in labelled}) == len(labelled) == 12
    few = Trajectory(zero, u[:, :2], None, u[:, :2], zero, zero, zero, readings=u[:, :2]).plot()[0]
    assert [line.get_color() for line in few.lines] == plt.rcParams["axes.prop_cycle"].by_key()["color"][:2]
    names = list("abcdefg")
    ax = ROBOT.plot(np.linspace(0.0, 1.0, 7)[:, None] * BENT, labels=names)
    assert len({to_rgb(line.get_color()) for line in ax.lines if line.get_label() in names}) == 7


def test_a_robot_is_drawn_at_its_start_in_the_middle_or_straight():
    middle = lines(ROBOT.plot())
    np.testing.assert_allclose(middle[0], lines(ROBOT.plot((ROBOT.lower + ROBOT.upper) / 2))[0])
    np.testing.assert_allclose(lines(ROBOT.replaced(start=BENT).plot())[0], lines(ROBOT.plot(BENT))[0])
    bare = Robot([ConstantCurvature(0.11, 0.022)])
    np.testing.assert_allclose(lines(bare.plot())[0][-1], [0, 0, 110])


def test_what_cannot_be_drawn_is_refused():
    with pytest.raises(InputError, match=r"Input q of plot must be of shape \(n_q\) or \(k, n_q\)"):
        ROBOT.plot(np.zeros((2, 2, 9)))
    with pytest.raises(
        InputError, match="Input labels of plot must be one for each of 1 shapes; instead received 2"
    ):
        ROBOT.plot(BENT, labels=["a", "b"])


def test_tex_in_a_matplotlibrc_does_not_matter():
    with mpl.rc_context({"text.usetex": True}):
        ax = ROBOT.plot(BENT)
    assert not ax.xaxis.label.get_usetex()


def arm():
    return Robot(
        [ConstantCurvature(0.11, 0.022)],
        [Magnet(Disc(12e-3, 6e-3, 1450.0), 1, 0.055)],
        [Sensor(1, 0.09, radial=0.013, azimuth=k * 2.1, axes=3, name=f"B{k + 1}") for k in range(3)],
        lower=[-0.02, -0.02, 0.0],
        upper=[0.02, 0.02, 0.006],
        noise=5e-3,
    )


def motion(robot, n=40, fault=0.0):
    s = np.linspace(0, 1, n)
    q = np.stack([0.012 * np.sin(6 * s), 0.01 * np.cos(6 * s), 0.003 + 0.002 * s], axis=-1)
    u = simulated_readings(robot, q) + 5e-3 * np.random.default_rng(0).normal(size=(n, robot.n_readings))
    u[n // 2 :, 4] += fault
    return q, track(LevenbergMarquardt(robot), u, rate_hz=20.0)


def test_a_table_has_names_units_and_deviations():
    robot = arm()
    q, shape = motion(robot)
    table = shape.to_frame()
    assert list(table)[:5] == ["time_s", "delta_x_1_mm", "delta_y_1_mm", "delta_L_1_mm", "delta_x_1_sd_mm"]
    assert list(table)[7:13] == [f"tip_{axis}{sd}_mm" for sd in ("", "_sd") for axis in "xyz"]
    assert list(table)[13:] == ["chi2", "dof", "missing", "status", "suspects", "at_bound"]
    np.testing.assert_allclose(table.time_s, np.arange(40) / 20)
    np.testing.assert_allclose(table.delta_y_1_mm, 1e3 * shape.q[:, 1])
    np.testing.assert_allclose(table.delta_L_1_sd_mm, 1e3 * np.sqrt(shape.covariance[:, 2, 2]))
    tip = 1e3 * robot.tip(shape.q)[:, :3, 3]
    np.testing.assert_allclose(table[["tip_x_mm", "tip_y_mm", "tip_z_mm"]], tip)
    off = (tip - 1e3 * robot.tip(q)[:, :3, 3]) / table[["tip_x_sd_mm", "tip_y_sd_mm", "tip_z_sd_mm"]]
    assert np.sqrt(np.mean(off.to_numpy() ** 2)) == pytest.approx(1.0, abs=0.25)
    assert (table.suspects == "").all()


def test_units_of_every_kind_of_coordinate():
    shape = Trajectory(
        np.zeros(1), BENT[None], None, np.zeros((1, 7)), np.zeros(1), np.zeros(1), np.zeros(1), robot=ROBOT
    )
    table = shape.to_frame()
    assert list(table)[4:10] == [
        "kappa_0_3_rad", "kappa_1_3_rad", "phi_3_deg", "delta_L_3_mm", "rotation_x_4_deg", "rotation_y_4_deg"
    ]  # fmt: skip
    known = np.array([0.01, 0.0, 0.002, 1.0, 2.0, np.pi / 2, 0.003, np.pi, np.pi / 6])
    stated = replace(shape, q=known[None], covariance=np.diag(known**2)[None]).to_frame().iloc[0]
    for values in (stated.iloc[1:10], stated.iloc[10:19]):
        np.testing.assert_allclose(values.tolist(), [10, 0, 2, 1, 2, 90, 3, 180, 30], rtol=1e-12)
    many = Trajectory(
        np.zeros(1), BENT[None, None], None, np.zeros((1, 1, 7)), np.zeros(1), np.zeros(1), np.zeros(1)
    )
    with pytest.raises(InputError, match="Input shape of to_frame must be of one robot"):
        many.to_frame()


def test_lost_shapes_are_empty_in_a_table():
    robot = Robot([ConstantCurvature(0.11, 0.022)] * 2)
    T = robot.poses(
        np.full((2, 6), 0.004), [Sensor(g, 0.11).place._replace(rotation=np.eye(3)) for g in (1, 2)]
    )
    T[1, 1] = np.nan
    table = fit_shape(robot, T).to_frame()
    assert table.isna().sum(axis=1).tolist() == [0, 9]  # three coordinates and the tip with its deviations
    assert np.isinf(table.delta_x_2_sd_mm[1])
    assert table.residual_mm.max() < 1e-6


def test_the_tip_is_open_along_the_axes_that_an_open_coordinate_moves():
    """A straight arm: its elongation moves the tip along z alone; bent towards x it moves x and z."""
    robot, C = Robot([ConstantCurvature(0.11, 0.022)]), np.diag([1e-6, 1e-6, np.inf])
    C[2, :2] = C[:2, 2] = np.nan
    q = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.01, 0.01, 0.0]])
    nothing = np.zeros(3)
    shape = Trajectory(
        nothing, q, np.stack([C] * 3), np.zeros((3, 1)), nothing, nothing, nothing, robot=robot
    )
    table = shape.to_frame()
    np.testing.assert_array_equal(table.delta_L_1_sd_mm, np.inf)
    stated = table[["tip_x_sd_mm", "tip_y_sd_mm", "tip_z_sd_mm"]].to_numpy()
    np.testing.assert_array_equal(np.isinf(stated), [[0, 0, 1], [1, 0, 1], [1, 1, 1]])
    slopes = 1e3 * robot.tip_slopes(q)[1][..., :2] * 1e-3
    expected = np.sqrt(np.square(slopes).sum(-1))
    np.testing.assert_allclose(stated[np.isfinite(stated)], expected[np.isfinite(stated)], rtol=1e-12)


def test_estimates_over_time():
    shape = motion(arm(), fault=0.5)[1]
    coordinates, above, below = shape.plot()
    assert coordinates.get_ylabel() == "coordinates [mm]"
    np.testing.assert_allclose(coordinates.lines[1].get_ydata(), 1e3 * shape.q[:, 1])
    band = coordinates.collections[1].get_paths()[0].vertices[:, 1]
    half = 1.96e3 * np.sqrt(shape.covariance[:, 1, 1])
    assert band.max() == pytest.approx((1e3 * shape.q[:, 1] + half).max())
    np.testing.assert_allclose(above.lines[0].get_ydata(), shape.u_hat[:, 0])
    np.testing.assert_allclose(above.lines[1].get_ydata(), shape.readings[:, 0])
    np.testing.assert_allclose(below.lines[0].get_ydata(), shape.readings[:, 0] - shape.u_hat[:, 0])
    assert below.get_legend().get_texts()[0].get_text() == "suspect: B2"
    marks = [line for line in below.lines if line.get_marker() == "x"]
    assert len(marks) == 3  # the axes of one chip
    assert marks[0].get_xdata().min() >= 1.0
    later = np.isin(shape.times, marks[0].get_xdata())
    np.testing.assert_array_equal(marks[0].get_ydata(), below.lines[3].get_ydata()[later])


def test_every_estimator_over_a_robot_names_its_coordinates():
    sensing = Sensing(arm())
    shape = track(GradientDescent(sensing, [1e-6] * 3), sensing(np.zeros((2, 3))))
    assert list(shape.to_frame())[1] == "delta_x_1_mm"
    own = track(LevenbergMarquardt(lambda q: 2 * q, [-1.0], [1.0], 0.1), [[0.2], [0.4]])
    assert list(own.to_frame())[:3] == ["time_s", "q_1", "q_1_sd"]
    assert [ax.get_ylabel() for ax in own.plot()] == ["coordinates", "readings", "residuals"]


def test_residuals_of_imus_are_rotations():
    robot = Robot([ConstantCurvature(0.11, 0.022)], imus=[Imu(1, 0.11)])
    turned = np.array([[0.0, 0.0, 6.2]])
    zero = np.zeros((1, 3))
    shape = Trajectory(
        np.zeros(1), zero, None, zero, np.zeros(1), np.zeros(1), np.zeros(1), readings=turned, robot=robot
    )
    below = shape.plot()[-1]
    assert below.get_ylabel() == "residuals [mT, rad]"
    assert below.lines[2].get_ydata()[0] == pytest.approx(6.2 - 2 * np.pi)
