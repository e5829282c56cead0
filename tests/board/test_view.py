"""The 3-D viewer on a page: what it is given, and that its script belongs to its sources."""

import base64
import hashlib
import json
import re

import numpy as np
import pytest

from repro import ConstantCurvature, Disc, InputError, Magnet, Robot, Sensor
from repro_board.shape_view import VIEWER, view

ROBOT = Robot(
    [ConstantCurvature(0.11, 0.022), ConstantCurvature(0.11, 0.022)],
    [Magnet(Disc(8e-3, 3e-3, 1300.0), 1, 0.055)],
    [Sensor(2, 0.11, 0.013)],
)
TIMES = np.arange(5) / 10
Q = np.linspace(0, 1, 5)[:, None] * [0.01, 0.0, 0.002, -0.005, 0.004, 0.0]


def unpacked(text: str, quantum: float, *shape: int) -> np.ndarray:
    return quantum * np.frombuffer(base64.b64decode(text), "<i2").reshape(shape)


def test_points_are_those_of_the_robot():
    data = view(ROBOT, Q, TIMES, "A bend.").data
    points = unpacked(data["shapes"][0]["points"], 0.1, 5, 17, 3)  # the middle joint once
    np.testing.assert_allclose(points[:, -1], 1e3 * ROBOT.tip(Q)[:, :3, 3], atol=0.051)
    np.testing.assert_allclose(points[:, 0], 0.0)
    place = ROBOT.sensors[0].place
    sensors = 1e3 * ROBOT.poses(Q, [place])[:, 0, :3, 3]
    np.testing.assert_allclose(unpacked(data["sensors"]["points"], 0.1, 5, 3), sensors, atol=0.051)
    axes = ROBOT.poses(Q, [place])[:, 0, :3, 2]
    np.testing.assert_allclose(unpacked(data["sensors"]["directions"], 1e-4, 5, 3), axes, atol=0.51e-4)
    magnets = unpacked(data["magnets"]["points"], 0.1, 5, 3)
    drawn, around = np.concatenate([points.reshape(-1, 3), sensors, magnets]), [22.0, 22.0, 0.0]
    assert data["radius"] == 22.0  # a body is no thinner than its segments, and no robot than a twentieth
    np.testing.assert_allclose(data["box"], [drawn.min(0) - around, drawn.max(0) + around], atol=0.11)


def test_what_is_farther_away_than_sixteen_bits_tell_stays_at_their_end():
    long = Robot([ConstantCurvature(9.0, 0.022)])
    data = view(long, np.zeros((1, 3)), [0.0], "Long.").data
    assert unpacked(data["shapes"][0]["points"], 0.1, 9, 3)[:, 2] == pytest.approx(
        [0, 1125, 2250, *[3276.7] * 6]
    )
    assert (data["radius"], data["box"][1]) == (450.0, [450.0, 450.0, 9000.0])


def test_begins_where_the_estimate_is_farthest_off():
    estimate = Q.copy()
    estimate[3, 1] += 0.01
    data = view(ROBOT, Q, TIMES, "Lost.", estimate=estimate).data
    assert data["start"] == 3
    assert [shape["role"] for shape in data["shapes"]] == ["truth", "estimate"]


def test_tube_has_the_deviation_of_the_tip():
    """The tip of a straight segment moves by half its length times the angle: 0.055/0.022 per metre of delta_x."""
    robot = Robot([ConstantCurvature(0.11, 0.022)])
    covariance = np.diag([1e-4, 0.0, 0.0])[None] ** 2
    data = view(robot, np.zeros((1, 3)), [0.0], "Straight.", covariance=covariance).data
    assert data["shapes"][0]["role"] == "estimate"
    assert unpacked(data["shapes"][0]["deviation"], 0.01, 9)[-1] == pytest.approx(0.25)


def test_html_holds_a_picture_and_the_data_and_no_address():
    text = view(ROBOT, Q, TIMES, "u </script> & more").to_html()
    assert re.search(r'<img src="data:image/png;base64,[^"]+" alt="u &lt;/script&gt; &amp; more">', text)
    data = json.loads(text.split('<script type="application/json">')[1].split("</script>")[0])
    assert data["label"] == "u </script> & more"
    assert "://" not in text


def test_long_recordings_are_thinned():
    q = np.zeros((1000, 6))
    assert len(view(ROBOT, q, np.arange(1000.0), "Long.", frames=75).data["time_s"]) <= 75


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times": TIMES[::-1]}, "times of view must be increasing [s], at least one"),
        ({"times": []}, "times of view must be increasing [s], at least one"),
        (
            {"estimate": Q[:4]},
            "estimate of view must be one row for each of 5 times; instead received 4 rows",
        ),
        ({"frames": 3001}, "frames of view must be 1 to 3000; instead received 3001"),
    ],
)
def test_what_cannot_be_shown_is_refused(changes, message):
    with pytest.raises(InputError, match=re.escape(message)):
        view(ROBOT, Q, **({"times": TIMES, "label": ""} | changes))


def test_script_is_the_one_recorded():
    """The committed script belongs to these sources and these versions; its lock names no host."""
    page = VIEWER.parents[1]
    manifest = json.loads((VIEWER.parent / "manifest.json").read_text(encoding="utf-8"))
    known = manifest["sha256"]
    assert {"vendor/shape_viewer.js", "vendor/LICENSE.three", "viewer.js", "package-lock.json"} <= set(known)
    sources = {path.name for path in [*page.glob("*.js"), *page.glob("*.css")]} - {
        "live.js",
        "live.css",
        "show.js",
        "traces.js",
    }
    assert sources <= set(known), "a source that the manifest does not know"
    for name, digest in known.items():
        found = hashlib.sha256((page / name).read_bytes()).hexdigest()
        assert found == digest, f"{name} has changed: make vendor"
    package = json.loads((page / "package.json").read_text(encoding="utf-8"))
    assert package["dependencies"] == {"three": manifest["three"]}
    assert package["devDependencies"] == {"esbuild": manifest["esbuild"]}
    lock = (page / "package-lock.json").read_text(encoding="utf-8")
    assert "://" not in lock
    for name in ("three", "esbuild"):
        entry = json.loads(lock)["packages"][f"node_modules/{name}"]
        assert entry["version"] == manifest[name]
        assert entry["integrity"].startswith("sha512-")
    assert "three.js authors" in (VIEWER.parent / "LICENSE.three").read_text(encoding="utf-8")
