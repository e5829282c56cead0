"""What the viewer is given: numbers that unpack to what went in, deviations, words, and pages that hold together."""

from __future__ import annotations

import base64
import io
import json
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import torch
from PIL import Image

from edition1.errors import InputError
from edition1.kinematics.paper_robots import Dimensions, affine_robot, pcc_robot
from edition1.kinematics.robot import Robot
from edition1_live.view.robot_view import (
    POINTS_PER_SEGMENT,
    backbone_deviation,
    backbone_points,
    body_radius,
    live_frame,
    live_scene,
    shape_view,
)
from edition1_live.view.shape_view import ROLES, VIEWER, Markers, Shape, ShapeView, Traces
from edition1_live.view.style import MAGNET, SENSOR

FRAMES = 60
TIMES = np.linspace(0.0, 5.9, FRAMES)


def motion(robot: Robot) -> torch.Tensor:
    """Return a configuration for each of the times."""
    phase = torch.as_tensor(TIMES)[:, None] + torch.arange(robot.n_q, dtype=torch.float64)
    scale = torch.tensor(
        [0.003 if name.startswith("delta_L") else 0.02 for name in robot.coordinates], dtype=torch.float64
    )
    return scale * torch.sin(phase)


def view_of(robot: Robot, **changes) -> ShapeView:
    """Return a view with everything in it."""
    q = motion(robot)
    covariance = torch.diag(torch.full((robot.n_q,), 1e-6, dtype=torch.float64)).expand(FRAMES, -1, -1)
    readings = {f"sensor {k + 1}": np.sin(TIMES + k) for k in range(len(robot.sensors))}
    given = {
        "times": TIMES,
        "label": "A robot, synthetic.",
        "estimate": q + 2e-4,
        "covariance": covariance,
        "traces": [Traces("readings", "mT", readings)],
    }
    return shape_view(robot, q, **(given | changes))


def unpack(text: str, quantum: float) -> np.ndarray:
    """Return packed numbers."""
    return quantum * np.frombuffer(base64.b64decode(text), dtype="<i2")


class Parts(HTMLParser):
    """The picture and the data of a snippet."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: dict[str, dict] = {}
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        """Keep names and attributes."""
        self.tags.append(tag)
        self.attributes[tag] = dict(attrs)

    def handle_data(self, data):
        """Keep the text."""
        self.text += data


@pytest.mark.parametrize("robot", [pcc_robot(), pcc_robot(3), affine_robot()], ids=["one", "three", "affine"])
def test_numbers_survive_the_packing(robot):
    """Positions come back within half a tenth of a millimetre, axes within half of 1e-4."""
    view = view_of(robot)
    data = json.loads(json.dumps(view.data()))
    for shape, packed in zip(view.shapes, data["shapes"], strict=True):
        found = unpack(packed["points"], 0.1).reshape(shape.points_m.shape)
        np.testing.assert_allclose(found, 1e3 * shape.points_m, atol=0.0501)
    deviation = view.shapes[1].deviation_m
    assert deviation is not None
    found = unpack(data["shapes"][1]["deviation"], 0.01).reshape(deviation.shape)
    np.testing.assert_allclose(found, 1e3 * deviation, atol=0.00501)
    poses = {"magnets": robot.magnet_poses(motion(robot)), "sensors": robot.sensor_poses(motion(robot))}
    for name, T in poses.items():
        points, directions = (
            unpack(data[name][key], unit) for key, unit in (("points", 0.1), ("directions", 1e-4))
        )
        np.testing.assert_allclose(points, 1e3 * T[..., :3, 3].numpy().ravel(), atol=0.0501)
        np.testing.assert_allclose(directions, T[..., :3, 2].numpy().ravel(), atol=5.01e-5)
    low, high = np.array(data["box"])
    every = 1e3 * np.concatenate([shape.points_m.reshape(-1, 3) for shape in view.shapes])
    assert bool((every >= low - 0.06).all())
    assert bool((every <= high + 0.06).all())


def test_points_lie_on_the_backbone():
    """Nine per segment, where segments meet one: those of the robot's own backbone."""
    robot = pcc_robot(2)
    q = motion(robot)[7]
    own = robot.backbone(q, POINTS_PER_SEGMENT).numpy()
    expected = np.delete(own, POINTS_PER_SEGMENT, axis=0)
    np.testing.assert_allclose(backbone_points(robot, q), expected, atol=1e-15)


def test_deviation_is_that_of_random_configurations():
    """The largest standard deviation of the tip agrees with the spread of many drawn configurations."""
    robot = pcc_robot(2)
    q = motion(robot)[11]
    root = 1e-4 * torch.randn(6, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    covariance = root @ root.T
    drawn = (
        q + torch.randn(20_000, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(4)) @ root.T
    )
    tips = backbone_points(robot, drawn)[:, -1]
    expected = np.sqrt(np.linalg.eigvalsh(np.cov(tips.T))[-1])
    deviation = backbone_deviation(robot, q, covariance)
    assert deviation[-1] == pytest.approx(expected, rel=0.02)
    assert deviation[0] == 0.0


def test_configuration_is_drawn_in_its_units():
    """Lengths in millimetres and angles in radians, the estimate beside the truth; then what was added."""
    robot = affine_robot()
    view = view_of(robot)
    lengths, angles, readings = view.traces
    assert (lengths.unit, list(lengths.values)) == ("mm", ["delta_L_1"])
    assert (angles.unit, list(angles.values)) == ("rad", ["kappa_0_1", "kappa_1_1", "phi_1"])
    np.testing.assert_allclose(lengths.values["delta_L_1"], 1e3 * motion(robot)[:, 3].numpy())
    np.testing.assert_allclose(angles.estimates["phi_1"], motion(robot)[:, 2].numpy() + 2e-4)
    assert (readings.title, readings.estimates) == ("readings", {})
    without = view_of(robot, estimate=None)
    assert without.traces[0].estimates == {}
    assert [(shape.name, shape.role) for shape in without.shapes] == [("shape", "truth")]
    assert without.shapes[0].deviation_m is not None


def test_label_says_the_numbers():
    """Who does not see the picture learns how far the tip moves and how far off its estimate is."""
    view = view_of(pcc_robot())
    truth, estimate = (1e3 * shape.points_m[:, -1] for shape in view.shapes)
    aside, error = np.hypot(truth[:, 0], truth[:, 1]), np.linalg.norm(truth - estimate, axis=1)
    assert view.label == (
        "A robot, synthetic. 60 frames from 0 to 5.9 s. "
        f"The tip is {aside.min():.1f} to {aside.max():.1f} mm off the axis of the base. "
        f"The estimated tip is {np.median(error):.2f} mm from the true one in the median, "
        f"{error.max():.2f} mm at most."
    )
    assert repr(view) == f"ShapeView of 60 frames, 0 to 5.9 s: {view.label}"


def test_snippet_holds_picture_and_data():
    """One division: the picture with its text, and the data; words cannot end an element; every time the same."""
    view = replace(view_of(pcc_robot()), label='1 < 2 & "</script><b>"')
    text = view._repr_html_()
    parts = Parts(text)
    assert parts.tags == ["div", "img", "script"]
    assert parts.attributes["div"] == {"class": "shape-view"}
    assert parts.attributes["img"]["alt"] == view.label
    assert json.loads(parts.text) == view.data()
    assert text == view.to_html()
    assert len(parts.text) < 32_000, "60 frames of one segment"
    assert len(text) < 60_000


def test_picture_keeps_its_colours():
    """The few pixels of magnets and sensors are not lost when the picture is made small."""
    source = Parts(view_of(pcc_robot()).to_html()).attributes["img"]["src"]
    picture = Image.open(io.BytesIO(base64.b64decode(source.removeprefix("data:image/png;base64,"))))
    pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3).astype(int)
    for colour in (MAGNET, SENSOR, ROLES["estimate"]):
        rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
        assert (np.abs(pixels - rgb).max(1) < 24).sum() >= 10, colour


def test_gaps_and_digits_of_traces():
    """A missing reading is null, never the text NaN, which no browser reads."""
    values = np.where(np.arange(FRAMES) == 2, np.nan, np.pi)
    view = view_of(pcc_robot(), traces=[Traces("readings", "mT", {"one": values})])
    found = view.data()["traces"][-1]["series"][0]["values"]
    assert found[:4] == [3.142, 3.142, None, 3.142]
    assert "NaN" not in json.dumps(view.data())


def test_live_frames_are_those_of_a_view():
    """What is sent one by one is what a recording shows; the scene announces it and has room for every shape."""
    robot = pcc_robot(2)
    view = view_of(robot, estimate=None)
    q = motion(robot)[5]
    frame = live_frame(robot, q, 1e-6 * torch.eye(6, dtype=torch.float64))
    (shape,) = view.shapes
    assert shape.deviation_m is not None
    np.testing.assert_allclose(frame["shapes"][0]["points"], 1e3 * shape.points_m[5].ravel(), atol=0.0051)
    np.testing.assert_allclose(frame["shapes"][0]["deviation"], 1e3 * shape.deviation_m[5], atol=0.00051)
    assert view.sensors is not None
    np.testing.assert_allclose(
        frame["sensors"]["points"], 1e3 * view.sensors.points_m[5].ravel(), atol=0.0051
    )
    scene = live_scene(robot, label="Live.", covariance=True)
    assert {"magnets", "sensors"} <= set(scene)
    assert "deviation" in scene["shapes"][0]
    low, high = np.array(scene["box"])
    points = np.reshape(frame["shapes"][0]["points"], (-1, 3))
    assert bool(((points >= low) & (points <= high)).all())
    json.dumps([scene, frame], allow_nan=False)
    bare = Robot(robot.segments)
    assert not {"magnets", "sensors"} & (set(live_scene(bare, label="")) | set(live_frame(bare, q)))


def test_body_has_a_radius():
    """That of the segments; else that of the sensors; else a twentieth of the length."""
    assert body_radius(pcc_robot()) == 0.022
    assert body_radius(affine_robot()) == pytest.approx(Dimensions.SENSOR_RADIAL_M)
    assert body_radius(Robot(affine_robot().segments)) == pytest.approx(0.010)


STRAIGHT = Shape("arm", np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]] * 2))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"shapes": ()}, "Input shapes of ShapeView must be at least one; instead received none."),
        (
            {"shapes": (replace(STRAIGHT, role="guess"),)},
            "Input role of shape arm must be one of truth, estimate; instead received guess.",
        ),
        (
            {"time_s": np.arange(301.0)},
            "Input time_s of ShapeView must be 1 to 300 finite times; instead received 301 times.",
        ),
        (
            {"time_s": np.array([1.0, 1.0])},
            "Input time_s of ShapeView must be increasing; instead received a time that is not later than the one "
            "before.",
        ),
        (
            {"sensors": Markers(np.zeros((3, 1, 3)), np.zeros((3, 1, 3)))},
            "Input points_m of sensors of ShapeView must be given for each of 2 frames; instead received 3.",
        ),
        (
            {"traces": (Traces("readings", "mT", {"one": np.zeros(1)}),)},
            "Input one of readings of ShapeView must be given for each of 2 frames; instead received 1.",
        ),
        (
            {"shapes": (replace(STRAIGHT, points_m=40.0 * STRAIGHT.points_m),)},
            "Input points_m of arm of ShapeView must be finite and below 3.2; instead received 4.0.",
        ),
        (
            {"shapes": (replace(STRAIGHT, points_m=np.nan * STRAIGHT.points_m),)},
            "Input points_m of arm of ShapeView must be finite and below 3.2; instead received nan.",
        ),
        (
            {"shapes": (replace(STRAIGHT, deviation_m=np.full((2, 2), -0.001)),)},
            "Input deviation_m of arm of ShapeView must be not negative; instead received -0.001.",
        ),
        (
            {"traces": (Traces("q", "mm", {"x": np.zeros(2)}, {"y": np.zeros(2)}),)},
            "Input estimates of traces q must be named like values; instead received y.",
        ),
    ],
)
def test_wrong_input(changes, message):
    """Nothing is cut, repeated or repaired."""
    good = {"label": "", "time_s": np.array([0.0, 1.0]), "shapes": (STRAIGHT,), "radius_m": 0.01}
    with pytest.raises(InputError) as caught:
        ShapeView(**(good | changes))
    assert str(caught.value) == message


def test_batch_of_robots_is_refused():
    """One picture shows one robot."""
    batch = pcc_robot(tilt=torch.tensor([0.0, 0.1], dtype=torch.float64))
    with pytest.raises(
        InputError, match="Input robot of shape_view must be one robot; instead received a batch"
    ):
        view_of(batch)


def test_script_and_figures_have_the_same_colours():
    """A magnet has one colour, in the picture and in the figures."""
    source = (VIEWER.parents[1] / "colours.js").read_text(encoding="utf-8")
    for role, colour in {**ROLES, "magnets": MAGNET, "sensors": SENSOR}.items():
        assert f'{role}: "{colour}"' in source
