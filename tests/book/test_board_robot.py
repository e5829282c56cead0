"""Robot files, calibrations and estimates in the browser against the library."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from board_example import frames
from edition1.errors import InputError
from edition1.estimation.levenberg_marquardt import LevenbergMarquardt
from edition1.estimation.model_error import WithModelError
from edition1.kernels import compiled
from edition1.robot_file.load import load_robot
from edition1_live.follow.estimate_table import EstimateRows
from edition1_live.follow.follower import Follower
from edition1_live.follow.robot_estimator import robot_estimator
from edition1_live.follow.time_steps import TimeStep
from edition1_live.robot.calibrate import Priors, calibrate, pose_covariance
from edition1_live.wire.formats import parser
from scipy import stats

ROOT = Path(__file__).resolve().parents[2]
STATIC = ROOT / "book" / "_static"
SCRIPTS = ("live/model", "board/wire", "board/recording", "board/robot", "board/example")
ROBOTS = sorted((ROOT / "data").rglob("*.toml"))
MODELLED = [path for path in ROBOTS if path.stem not in ("bend_sensor", "imu_arm")]
TOML = "text => { const f = BOARD.toml('x.toml', text); return {...f.top, ...f.tables}; }"
REFUSED = """text => { try { BOARD.robotOf('x.toml', text); return ''; } catch (error) { return error.message; } }"""


@pytest.fixture(scope="module")
def page(browser, tmp_path_factory):
    """Open a page that has the models and the robots."""
    path = tmp_path_factory.mktemp("robot") / "robot.html"
    scripts = "".join(f'<script src="{(STATIC / f"{name}.js").as_uri()}"></script>' for name in SCRIPTS)
    path.write_text(f'<!doctype html><meta charset="utf-8"><title>R</title>{scripts}', encoding="utf-8")
    page = browser.new_page()
    page.goto(path.as_uri())
    yield page
    page.close()


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_robot_files_are_read_as_by_tomllib(page, path):
    text = path.read_text(encoding="utf-8")
    assert page.evaluate(TOML, text) == tomllib.loads(text)


def test_what_robot_files_may_hold_is_read_as_by_tomllib(page):
    text = """# a comment = 1\r
a = [ # one
  [1, -2.5e+3, ], # two

  ["x # y", 'C:\\\\temp', "\\"q\\" \\\\ \\t µ"],
]
b = 1_000.25  # three\t
c=true
[stream]#
  d = []
[[magnets]]
e = +7
[[magnets]]
e = 0.5
"""
    assert page.evaluate(TOML, text) == tomllib.loads(text.replace("\r\n", "\n"))


REFUSALS = [
    "a = 1979-05-27", "a = {b = 1}", "a.b = 1", "a = inf", "a = 0x10", "a = 01", "a = 1.", "a = .5", "a = 1__0",
    "a = 1 2", "a =", "a = [1 2]", "a = [1", "a = [,]", 'a = "x', 'a = "\\q"', "a = 'x' 'y'", 'a = """x"""',
    "a = 1\na = 2", "[a]\n[a]", "[[a]]\n[a]", "[a]\n[[a]]", "[a.b]", "[a", "[[a]", "a = 1\n[a]", "a", "= 1",
    "a = True", "a = \x01", "a = 1e", "a = +_1",
]  # fmt: skip


@pytest.mark.parametrize("text", REFUSALS)
def test_what_is_not_understood_is_refused_with_its_line(page, text):
    """Everything that tomllib refuses is refused, and some that robot files do not use."""
    words = page.evaluate(
        "text => { try { BOARD.toml('x.toml', text); } catch (e) { return e.message; } }", "\n\n" + text
    )
    assert words is not None
    assert (
        words.startswith(f"Input x.toml, line {3 + text.count(chr(10))}, must be ")
        or "the end of the file" in words
    )


ONE = (ROOT / "data" / "robots" / "one_segment.toml").read_text(encoding="utf-8")
TWO = (ROOT / "data" / "robots" / "two_segments.toml").read_text(encoding="utf-8")
WRONG = [
    ("radius_mm = 22.0", "radius_m = 0.022"),
    ("radius_mm = 22.0", ""),
    ("radius_mm = 22.0", "radius_mm = 0.022"),
    ("radius_mm = 22.0", 'radius_mm = "22"'),
    ("segment = 1", "segment = 2"),
    ("segment = 1", "segment = 1.0"),
    ("at_mm = 55.0", "at_mm = 155.0"),
    ("channel = 2", "channel = 1"),
    ("channel = 3", "channel = 300"),
    ("rate_hz = 1000.0", "rate_hz = 0"),
    ("inner_diameter_mm = 12.0", "inner_diameter_mm = 25.0"),
    ('unit = "mT"', 'unit = "T"'),
    ('format = "frames"', 'format = "hall"'),
    ('format = "frames"', 'format = "quaternions"'),
    ("[0.0, 6.6]", "[6.6, 0.0]"),
    ("[0.0, 6.6]", "[-120.0, 6.6]"),
    ("radial_mm = 13.0", "radial_mm = -13.0"),
    ("azimuth_deg = 120.0", "direction = [0, 0, 0]"),
    ("azimuth_deg = 120.0", "direction = [1, 0, 0]\ntilt_deg = 3"),
    ('unit = "mT"', 'unit = "mT"\nchannels = 2'),
    ("polarisation_mt = 1450.0", "polarisation_mt = 1.45"),
    ("# One", "earth_mt = [0, 50, 0]\n# One"),
    ("at_mm = 110.0\nradial_mm = 13.0\nazimuth_deg = 0.0", "at_mm = 55.0"),
    ('kind = "ring"', 'kind = "disc"'),
    ("[stream]", "[strema]"),
    ("length_mm = 110.0", "length_mm = true"),
    ('kind = "constant_curvature"', 'kind = "constant_curvature"\nlength = 3'),
]


@pytest.mark.parametrize(("old", "new"), WRONG)
def test_what_the_library_refuses_is_refused_here(page, tmp_path, old, new):
    assert old in ONE
    text = ONE.replace(old, new, 1)
    (tmp_path / "x.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError):
        load_robot(tmp_path / "x.toml")
    words = page.evaluate(REFUSED, text)
    assert words.startswith("Input ")
    assert "x.toml" in words


def test_what_the_page_cannot_model_is_refused_by_name(page):
    texts = {
        "cube": (ROOT / "data" / "robots" / "bend_sensor.toml").read_text(encoding="utf-8"),
        "IMUs": (ROOT / "data" / "robots" / "imu_arm.toml").read_text(encoding="utf-8"),
        "networks": ONE + '\n[model]\nnetworks = ["a.safetensors"]\n',
        "affine_curvature": ONE.replace("constant_curvature", "affine_curvature", 1).replace(
            "One segment of affine", "One"
        ),
        "equal ones": TWO.replace("length_mm = 70.0", "length_mm = 80.0", 1),
        "magnets that are alike": TWO.replace("height_mm = 6.0", "height_mm = 5.0", 1),
    }
    texts["affine_curvature"] = ONE.replace('kind = "constant_curvature"', 'kind = "affine_curvature"')
    for word, text in texts.items():
        assert word in page.evaluate(REFUSED, text)


HEIGHTS = iter(("105.0", "90.0", "20.0"))
ON_AXIS = re.sub("110.0(?=\nradial)", lambda _: next(HEIGHTS), ONE).replace(
    "radial_mm = 13.0", "radial_mm = 0.0"
)
ACROSS = ON_AXIS.replace("azimuth_deg = 0.0", "direction = [1, 0, 0]")
REMARKED = {
    "out of range": TWO.replace("noise_mt = 7.1e-4", "noise_mt = 0.5"),
    "two readings": ONE[: ONE.rindex("[[sensors]]")],
    "one reading": ONE[: ONE.index("[[sensors]]", ONE.index("[[sensors]]") + 1)],
    "on the axis": ON_AXIS,
    "bent, they do": f"earth_mt = [0.05, 0.0, 0.02]\n{ACROSS}",
    "nothing": TWO,
}


@pytest.mark.parametrize("name", REMARKED)
def test_what_readings_cannot_say_is_remarked_as_by_the_library(page, tmp_path, name):
    (tmp_path / "x.toml").write_text(REMARKED[name], encoding="utf-8")
    expected = load_robot(tmp_path / "x.toml").notes
    assert page.evaluate("text => BOARD.robotOf('x.toml', text).notes", REMARKED[name]) == list(expected)
    assert bool(expected) == (name != "nothing")


def variants(path: Path) -> str:
    """The file with an Earth field, gains, offsets, tilts and a direction."""
    text = "earth_mt = [0.02, -0.01, 0.04]\n" + path.read_text(encoding="utf-8")
    text = text.replace("channel = 1\n", "channel = 1\ngain = 1.25\noffset_mt = -0.5\n").replace(
        "channel = 2\n", "channel = 2\ntilt_deg = -12.5\n"
    )
    return text.replace("azimuth_deg = 240.0", "azimuth_deg = 240.0\ndirection = [1, -0.5, 2]")


@pytest.mark.parametrize("path", MODELLED, ids=lambda path: f"{path.parent.name}-{path.stem}")
@pytest.mark.parametrize("changed", [False, True])
def test_readings_bounds_and_slopes(page, tmp_path, path, changed):
    text = variants(path) if changed else path.read_text(encoding="utf-8")
    (tmp_path / "x.toml").write_text(text, encoding="utf-8")
    robot, rng = load_robot(tmp_path / "x.toml"), np.random.default_rng(0)
    q = robot.lower + torch.from_numpy(rng.random((50, len(robot.lower)))) * (robot.upper - robot.lower)
    body = """([text, all]) => { const robot = BOARD.robotOf('x.toml', text), sensing = BOARD.sensingOf(robot);
      const {low, high, start, offset, noise, channel, rate_hz, format, unit, channels} = robot;
      return [low, high, start, offset, noise, channel, rate_hz, format, unit, channels,
        all.map(q => { const {u, J} = sensing(q); return [[...u], J.map(row => [...row])]; })]; }"""
    *about, found = page.evaluate(body, [text, q.tolist()])
    expected = [x.tolist() for x in (robot.lower, robot.upper, robot.start, robot.offset)]
    for a, b in zip(about[:4], expected, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-15)
    assert about[4:] == [
        robot.noise,
        list(robot.channel),
        robot.rate_hz,
        robot.format,
        robot.unit,
        robot.channels,
    ]
    u, J = robot.sensing().linearise(q)  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_allclose([x for x, _ in found], u, rtol=1e-9, atol=1e-9 * float(u.abs().max()))
    np.testing.assert_allclose([x for _, x in found], J, rtol=1e-9, atol=1e-9 * float(J.abs().max()))


def calibration_of(path: Path, folder: Path):
    """Calibrate a robot whose parts are not where its file says."""
    robot, rng = load_robot(path), np.random.default_rng(1)
    q = robot.lower + torch.from_numpy(rng.random((24, len(robot.lower)))) * (robot.upper - robot.lower)
    values = robot.values(q) * (1 + 0.01 * torch.from_numpy(rng.normal(size=robot.channels))) + 0.02
    found = calibrate(robot, values, q, pose_covariance(robot, 1e-4, 1e-3), priors=Priors())
    found.write(folder / "robot.json")
    return robot.calibrated(found)


@pytest.mark.parametrize("name", ["one_segment", "two_segments"])
def test_a_calibrated_robot_and_what_its_calibration_leaves_uncertain(page, tmp_path, name):
    path = ROOT / "data" / "robots" / f"{name}.toml"
    robot = calibration_of(path, tmp_path)
    rng, n = np.random.default_rng(2), len(robot.lower)
    q = robot.lower + torch.from_numpy(0.1 + 0.8 * rng.random((20, n))) * (robot.upper - robot.lower)
    q[0, 0] = robot.lower[0]
    u = robot.values(q)[:, list(robot.channel)] + robot.noise * torch.from_numpy(
        rng.normal(size=(20, len(robot.channel)))
    )
    u[1, 0] = torch.nan
    body = """async ([text, calibration, all]) => {
      const robot = await BOARD.calibrated(BOARD.robotOf('x.toml', text), 'robot.json', calibration);
      return all.map(values => {
        const f = new BOARD.Follower(robot);
        f.step(values.map(x => x ?? NaN));
        const seen = f.window[0];
        return [f.q, f.C, seen.chi2, seen.dof, seen.systematic, f.excess, f.status, f.cause]; });
    }"""
    calibration = (tmp_path / "robot.json").read_text(encoding="utf-8")
    rows = [[None if np.isnan(x) else x for x in row] for row in u.tolist()]
    found = page.evaluate(body, [path.read_text(encoding="utf-8"), calibration, rows])
    plain = LevenbergMarquardt(compiled(robot.sensing()), robot.lower, robot.upper, robot.noise)
    assert robot.error is not None
    method = WithModelError(plain, robot.sensing(), robot.noise, robot.error, (robot.lower, robot.upper))
    for k, (here, C, chi2, dof, systematic, excess, status, _) in enumerate(found):
        if status:
            C = np.array(C) / max(excess, 1) ** 2
        _, expected = method.step(method.init(robot.start), u[k] - robot.offset, 0.0)
        np.testing.assert_allclose(here, expected.q, atol=1e-9)
        assert expected.covariance is not None
        covariance = expected.covariance.numpy()
        scale = np.sqrt(np.diagonal(covariance))
        np.testing.assert_allclose(C / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=1e-4)
        assert dof == int(expected.diagnostics["dof"])
        np.testing.assert_allclose(chi2, float(expected.diagnostics["chi2"]), rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(
            systematic, float(expected.diagnostics["systematic"]), rtol=1e-4, atol=1e-6
        )


def test_a_calibration_of_another_file_is_refused(page, tmp_path):
    path = ROOT / "data" / "robots" / "one_segment.toml"
    calibration_of(path, tmp_path)
    calibration = json.loads((tmp_path / "robot.json").read_text(encoding="utf-8"))
    body = """([text, c]) => BOARD.calibrated(BOARD.robotOf('x.toml', text), 'c.json', c)
      .then(() => '', e => e.message)"""
    assert page.evaluate(body, [ONE, json.dumps(calibration)]) == ""
    wrong = [
        (ONE + "\n", {}),
        (ONE, {"schema": 1}),
        (ONE, {"parameters": [0.0]}),
        (ONE, {"more": 1}),
        (ONE, {"offset": [0, 0, None]}),
    ]
    for text, change in wrong:
        assert page.evaluate(body, [text, json.dumps(calibration | change)]).startswith("Input ")
    assert page.evaluate(body, [ONE, "{"]).startswith("Input file of c.json must be JSON")


def test_the_chance_of_a_chi_square(page):
    pairs = [(x, k) for k in (1, 1.37, 2, 3, 20, 90, 400) for x in (0.01, 0.5, 1, 5, 30, 80, 150, 600)]
    found = page.evaluate("pairs => pairs.map(([x, k]) => BOARD.chance(x, k))", pairs)
    np.testing.assert_allclose(found, [stats.chi2.sf(x, k) for x, k in pairs], rtol=1e-7, atol=1e-12)


def test_the_example_is_estimated_as_by_a_live_session(page):
    """The same shapes while all is well, and an alarm once a sensor sticks; grown deviations, also of the tip."""
    path = ROOT / "data" / "robots" / "two_segments.toml"
    sent = parser("frames").feed(frames())
    body = """() => {
      const robot = BOARD.robotOf('x.toml', BOARD.example.robot);
      const reader = BOARD.parser('frames'), f = new BOARD.Follower(robot, 2.5);
      return reader.feed(Uint8Array.from(atob(BOARD.example.frames), c => c.charCodeAt(0))).map(frame => {
        f.step(frame.values); const {p, deviation} = f.tip();
        return [[...f.q], f.C.map((row, k) => row[k] * f.grown ** 2), [...p, ...deviation], f.status]; }); }"""
    found = page.evaluate(body)
    robot = load_robot(path)
    method = replace(robot_estimator(replace(robot, rate_hz=min(robot.rate_hz, 60.0))), grown=2.5)
    follower, alarms, shown = Follower(method), [], []
    assert len(found) == len(sent)
    for k, (frame, (q, variance, tip, status)) in enumerate(zip(sent, found, strict=True)):
        _, estimate = follower.step(TimeStep(0.04 * k, k, k, (frame,)))
        assert estimate is not None
        alarms.append((int(follower.verdict.status), status))
        if not any(alarms[-1]):
            np.testing.assert_allclose(q, estimate.q, atol=1e-7)
            assert estimate.covariance is not None
            np.testing.assert_allclose(variance, estimate.covariance.diagonal(), rtol=1e-4)
            shown.append((estimate, tip))
    rows = EstimateRows(method, shown[0][0])
    cells = rows.rows([0.0] * len(shown), [one for one, _ in shown])
    table = pd.DataFrame(cells, columns=rows.header).apply(pd.to_numeric, errors="coerce")
    position, deviation = np.split(1e3 * np.array([tip for _, tip in shown]), 2, axis=1)
    np.testing.assert_allclose(position, table[["tip_x_mm", "tip_y_mm", "tip_z_mm"]], atol=1e-4)
    np.testing.assert_allclose(deviation, table[["tip_x_sd_mm", "tip_y_sd_mm", "tip_z_sd_mm"]], rtol=1e-4)
    assert all(a == b for a, b in alarms)
    assert [a for a, _ in alarms[:250]] == [0] * 250
    assert all(a == 2 for a, _ in alarms[-50:])
