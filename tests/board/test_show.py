"""A recording as one page: what it holds, what is left out of a long one, and how it is used in a browser."""

from __future__ import annotations

import json
import shutil
from contextlib import ExitStack, closing

import numpy as np
import pandas as pd
import pytest
from page_on_screen import differing, pixels, red, wait_until, window

import repro
from repro import InputError
from repro_board import emulate
from repro_board.evaluate import track_file
from repro_board.record import Note, Writer
from repro_board.show import FRAMES, ROWS, page, read, show_file

NOTES = (
    Note(-0.5, "board on"),
    Note(2.0, "pushed <b>by hand</b>"),
    Note(2.1, "let go"),
    Note(9.0, "magnet near"),
)
FAULT_S = 6.0
WITHOUT_WEBGL = """const get = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind) {
  return kind === "webgl2" ? null : get.call(this, kind);
};"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a robot, a recording of which B2 sticks, and its estimates."""
    folder = tmp_path_factory.mktemp("show")
    shutil.copy(repro.example() / "robot.toml", folder)
    robot = repro.load_robot(folder / "robot.toml")
    with closing(Writer(folder / "a.rec", {"port": "emulated"})) as writer:
        for time_s, data in emulate.board_bytes(robot, faults=[("stick", "B2")], fault_from=FAULT_S, seed=1):
            if time_s > 12:
                break
            writer.write(round(1e9 * time_s), data)
    track_file(folder / "a.rec", folder / "robot.toml", output=folder / "shape.csv")
    return folder


@pytest.fixture(scope="module")
def page_file(folder):
    """Return a page about the recording with notes."""
    seen = read(folder / "a.rec", folder / "robot.toml")._replace(notes=NOTES)
    (folder / "a.html").write_text(page(seen, "a.rec")[0], encoding="utf-8")
    return folder / "a.html"


def told(path):
    """Return what a page is told, and what its viewer draws."""
    text = path.read_text(encoding="utf-8")
    parts = text.split('type="application/json">')[1:]
    viewer, own = (json.loads(part.split("</script>")[0]) for part in parts)
    return own, viewer


def test_a_page_has_shape_readings_alarms_and_notes(folder, page_file, tmp_path):
    report = show_file(folder / "a.rec", folder / "robot.toml", tmp_path / "a.html")
    assert report.text.endswith("Written: a.html")
    assert "No table" not in report.text
    frame = pd.read_csv(folder / "shape.csv")
    own, viewer = told(page_file)
    assert told(tmp_path / "a.html") == (own | {"from": 0.0, "notes": []}, viewer)
    assert own["notes"] == [[note.time_s, note.text] for note in NOTES]
    assert [chart["title"] for chart in own["charts"]] == ["Readings [mT]", "Tip [mm]"]
    readings, tip = own["charts"]
    u = track_file(folder / "a.rec", folder / "robot.toml").found.readings
    np.testing.assert_allclose(np.array(readings["rows"], float), u, rtol=1e-4)
    np.testing.assert_allclose(tip["rows"], frame[["tip_x_mm", "tip_y_mm", "tip_z_mm"]], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(viewer["time_s"], frame["time_s"], atol=1e-4)
    said = [own["said"][k]["words"] for k in own["at"]]
    suspects = frame["suspects"].fillna("")
    pairs = zip(frame["status"], suspects, strict=True)
    assert said == [f"{status} ({who})" if who else status for status, who in pairs]
    assert "left out (B2)" in said
    assert [bool(marked) for marked in viewer["suspects"]["frames"]] == [who != "" for who in suspects]
    assert sum(rows for *_, rows, _ in own["alarms"]) == (frame["status"] != "consistent").sum()
    assert own["alarms"][0][0] == frame["time_s"][(frame["status"] != "consistent").idxmax()] > FAULT_S


def test_estimates_alone_and_beside_their_recording_are_shown_as_they_are(folder, tmp_path):
    robot, frame = folder / "robot.toml", pd.read_csv(folder / "shape.csv")
    show_file(folder / "a.rec", robot, tmp_path / "a.html")
    show_file(folder / "shape.csv", robot, tmp_path / "alone.html")
    show_file(folder / "a.rec", robot, tmp_path / "beside.html", estimates=folder / "shape.csv")
    (first, drawn), (alone, alone_drawn), (beside, _) = (
        told(tmp_path / f"{x}.html") for x in ("a", "alone", "beside")
    )
    assert [chart["title"] for chart in alone["charts"]] == ["Tip [mm]"]
    assert beside["charts"][0]["rows"] == first["charts"][0]["rows"]
    for own in (alone, beside):
        assert [own["said"][k] for k in own["at"]] == [first["said"][k] for k in first["at"]]
        np.testing.assert_allclose(own["alarms"], first["alarms"], atol=1e-5)
        np.testing.assert_allclose(
            own["charts"][-1]["rows"], first["charts"][-1]["rows"], rtol=1e-4, atol=1e-4
        )
    shape, alone_shape = drawn["shapes"][0], alone_drawn["shapes"][0]
    assert (alone_shape["name"], "deviation" in alone_shape, "deviation" in shape) == (
        "estimate",
        False,
        True,
    )
    late = frame.assign(time_s=frame["time_s"] + 1.7e9)  # since 1970: five digits of it would be one time
    late.to_csv(tmp_path / "late.csv", index=False)
    report = show_file(tmp_path / "late.csv", robot, tmp_path / "late.html")
    assert "Times count from 1700000000 s." in report.text
    np.testing.assert_allclose(told(tmp_path / "late.html")[1]["time_s"], frame["time_s"], atol=1e-4)


def test_a_long_recording_is_thinned_but_no_alarm_and_no_extreme(folder, tmp_path):
    """A minute at 100 Hz, with alarms of one row each, a peak of one row, and rows without an estimate."""
    robot = repro.load_robot(folder / "robot.toml")
    n, rng = 6_000, np.random.default_rng(0)
    times = np.arange(n) / 100
    q = emulate.course(robot, times, seed=2)
    u = rng.normal(size=(n, len(robot.names)))
    u[3_123, 3], u[100:200, 5] = 40.0, np.nan
    q[500:520] = np.nan
    status = np.full(n, "consistent", object)
    alarms = np.sort(rng.choice(np.arange(1000, n, 2), 300, replace=False))
    status[alarms] = "inconsistent"
    known = np.isfinite(q).all(1)
    tip = np.full((n, 3), np.nan)
    tip[known] = 1e3 * robot.tip(q[known])[:, :3, 3]
    columns = {f"{name}_mm": x for name, x in zip(robot.coordinates, 1e3 * q.T, strict=True)}
    columns |= {f"tip_{axis}_mm": x for axis, x in zip("xyz", tip.T, strict=True)}
    pd.DataFrame({"time_s": times, **columns, "chi2": 1.0, "dof": 6.0, "status": status}).to_csv(
        tmp_path / "e.csv", index=False
    )
    pd.DataFrame(u, columns=[f"{name}_mT" for name in robot.names]).assign(time_s=times).to_csv(
        tmp_path / "u.csv", index=False
    )
    report = show_file(
        tmp_path / "u.csv", folder / "robot.toml", tmp_path / "a.html", estimates=tmp_path / "e.csv"
    )
    own, viewer = told(tmp_path / "a.html")
    np.testing.assert_allclose([begin for begin, *_ in own["alarms"]], times[alarms])
    assert {1} == {rows for *_, rows, _ in own["alarms"]}
    assert set(np.round(times[alarms], 3)) <= set(np.round(viewer["time_s"], 3))  # each can be looked at
    lines = np.array(own["charts"][0]["rows"], float)
    assert (len(lines), np.nanmax(lines)) == (ROWS, 40.0)
    np.testing.assert_allclose(np.nanmin(lines, axis=0), np.nanmin(u, axis=0), rtol=1e-4)
    assert len(viewer["time_s"]) <= FRAMES + 300
    assert f"{len(viewer['time_s'])} of 5980 shapes are drawn; the alarms are all there." in report.text
    assert "the least and the largest of every few values" in (tmp_path / "a.html").read_text(
        encoding="utf-8"
    )
    assert (tmp_path / "a.html").stat().st_size < 3e6


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_rows_that_are_seconds_apart_are_joined_and_one_row_has_a_place_in_time(folder, tmp_path, rows):
    few = pd.read_csv(folder / "shape.csv").head(rows).assign(time_s=10.0 * np.arange(rows))
    few.to_csv(tmp_path / "few.csv", index=False)
    show_file(tmp_path / "few.csv", folder / "robot.toml", tmp_path / "few.html")
    own = told(tmp_path / "few.html")[0]
    assert own["from"] < own["to"]
    assert rows == 1 or own["charts"][0]["gap_s"] > 10.0


@pytest.mark.parametrize(("start_s", "counted"), [(86_399.0, False), (86_401.5, True)])
def test_times_beyond_a_day_count_from_their_first_whole_second(folder, tmp_path, start_s, counted):
    few = pd.read_csv(folder / "shape.csv").head(3).assign(time_s=start_s + np.arange(3.0))
    few.to_csv(tmp_path / "few.csv", index=False)
    report = show_file(tmp_path / "few.csv", folder / "robot.toml", tmp_path / "few.html")
    assert ("Times count from 86401 s." in report.text) == counted
    assert told(tmp_path / "few.html")[0]["from"] == (0.5 if counted else start_s)


def test_what_cannot_be_shown_is_refused_and_leaves_nothing(folder, tmp_path):
    robot = folder / "robot.toml"
    with closing(Writer(tmp_path / "empty.rec", {})) as writer:
        writer.write(0, b"no sample")
    text = robot.read_text(encoding="utf-8")
    (tmp_path / "other.toml").write_text(
        text.replace("length_mm = 90.0", "length_mm = 91.0"), encoding="utf-8"
    )
    (tmp_path / "there.html").write_text("mine", encoding="utf-8")
    (tmp_path / "plain.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    pd.read_csv(folder / "shape.csv").assign(time_s=lambda x: x["time_s"] + 60).to_csv(
        tmp_path / "late.csv", index=False
    )
    before = sorted(tmp_path.iterdir())
    assert (tmp_path / "other.toml").read_text(encoding="utf-8") != text
    for source, options, words in [
        (folder / "none.rec", {}, r"file of repro show must be one that exists"),
        (tmp_path / "empty.rec", {}, r"recording of empty\.rec must be one with samples; instead received none"),
        (tmp_path / "plain.csv", {}, r"plain\.csv"),
        (folder / "shape.csv", {"robot": tmp_path / "other.toml"}, r"shape\.csv must be estimates of this robot"),
        (folder / "a.rec", {"robot": tmp_path / "other.toml", "estimates": folder / "shape.csv"}, r"of this robot"),
        (folder / "a.rec", {"estimates": tmp_path / "late.csv"}, r"time_s of late\.csv must be within the recording"),
        (folder / "a.rec", {"estimates": tmp_path / "plain.csv"}, r"plain\.csv must be a table of repro track"),
        (folder / "shape.csv", {"estimates": folder / "shape.csv"}, r"estimates of repro show must be left out"),
        (folder / "a.rec", {"output": tmp_path / "there.html"}, r"output of repro show must be one that does not"),
        (folder / "a.rec", {"output": tmp_path / "a.txt"}, r"output of repro show must be a file whose name ends in"),
    ]:  # fmt: skip
        given = {"robot": robot, "output": tmp_path / "a.html"} | options
        with pytest.raises(InputError, match=words):
            show_file(source, **given)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("cell", ["delta_x_1_mm", "tip_z_sd_mm", "status"])
def test_estimates_that_were_cut_are_refused_by_their_line(folder, tmp_path, cell):
    """In the middle of a row, in whichever cell before the status is whole."""
    head, *rows = (folder / "shape.csv").read_text().splitlines()
    before = rows[9].split(",")[: head.split(",").index(cell)]
    (tmp_path / "cut.csv").write_text("\n".join([head, *rows[:9], ",".join([*before, ""])]))
    words = "cut.csv must be a whole table of repro track; instead received line 11 without a status"
    for source, options in (
        (folder / "a.rec", {"estimates": tmp_path / "cut.csv"}),
        (tmp_path / "cut.csv", {}),
    ):
        with pytest.raises(InputError, match=words):
            read(source, folder / "robot.toml", **options)


@pytest.fixture
def opened(browser, page_file):
    """Return what opens the page from its file, wide or narrow, in light or dark."""
    with ExitStack() as windows:

        def open_page(width, scheme, script=""):
            page, asked = windows.enter_context(window(browser, width, scheme))
            page.add_init_script(script)
            page.goto(page_file.as_uri())
            page.wait_for_selector("#charts canvas")
            windows.callback(lambda: all_of_the_file(asked))
            return page

        def all_of_the_file(asked):
            assert {url for url in asked if not url.startswith("data:")} == {page_file.as_uri()}

        yield open_page


def left(element) -> float:
    return element.bounding_box()["x"]


@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (390, "dark")])
@pytest.mark.slow
def test_the_slider_moves_shape_mark_and_words_by_keyboard(opened, page_file, width, scheme):
    page = opened(width, scheme)
    own, viewer = told(page_file)
    canvas, mark = page.locator("#charts canvas").first, page.locator(".now").first
    slider, place = page.locator("#time"), page.locator(".shape-view canvas")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    box, before = canvas.bounding_box(), pixels(place)
    assert page.inner_text("#status") == "Consistent."
    slider.focus()
    page.keyboard.press("End")
    assert page.inner_text("#status").startswith("Left out (B2): ")
    assert page.inner_text("#clock") == f"{viewer['time_s'][-1]:.2f} s"
    at = lambda time: box["x"] + 52 + (time - own["from"]) / (own["to"] - own["from"]) * (box["width"] - 60)  # noqa: E731
    assert left(mark) == pytest.approx(at(viewer["time_s"][-1]) - 1, abs=1.5)
    assert differing(pixels(place), before) > 200
    for _ in range(3):
        page.keyboard.press("ArrowLeft")
    assert page.inner_text("#clock") == f"{viewer['time_s'][-4]:.2f} s"
    chart = own["charts"][0]
    assert not chart["thinned"]
    read = chart["rows"][chart["time_s"].index(viewer["time_s"][-4])]
    values = page.locator(".values").first.locator("li").all_inner_texts()
    shown = [text.split()[-1].replace("−", "-") for text in values]
    assert [None if text == "–" else float(text) for text in shown] == read
    inner = page.locator(".shape-view input")
    assert (inner.input_value(), slider.input_value()) == (str(len(viewer["time_s"]) - 4),) * 2
    inner.focus()
    page.keyboard.press("Home")
    assert page.inner_text("#clock") == "0.00 s"
    assert left(mark) == pytest.approx(at(0.0) - 1, abs=1.5)


DRAWN = """([rows, gap]) => {
    const canvas = document.body.appendChild(make("canvas"));
    canvas.style.cssText = "width: 400px; height: 100px";
    drawLines(canvas, { rows, count: 1, limits: [0, 3], labels: [], gap, from: 0, to: 10 });
    const { data } = canvas.getContext("2d").getImageData(canvas.width / 2, 0, 1, canvas.height);
    const ratio = canvas.height / 100;
    canvas.remove();
    return [...data.keys()].filter((k) => k % 4 === 0 && data[k + 2] - data[k] > 60).map((k) => k / 4 / ratio);
}"""
"""How far below the top a blue line is in the middle of 10 s [px]."""


def test_lines_over_time_have_round_ticks_room_and_gaps(opened, page_file):
    page = opened(1400, "light")
    joined = [page.evaluate(DRAWN, [[[0, [1]], [10, [1]]], gap]) for gap in (9, 10, 11)]
    assert [bool(line) for line in joined] == [False, True, True]
    for value, below in (
        (0, 80),
        (1, 56),
        (3, 8),
        (9, 8),
        (-9, 80),
    ):  # beyond the limits it stays at the edge
        line = page.evaluate(DRAWN, [[[0, [value]], [10, [value]]], 11])
        assert np.mean(line) == pytest.approx(below, abs=1.0)
    texts = ["0.00", "-0.00", "-0.01", "-10", "5"]
    assert page.evaluate("(texts) => texts.map(signed)", texts) == ["0.00", "0.00", "−0.01", "−10", "5"]
    times = np.array(told(page_file)[1]["time_s"])
    between = np.linspace(times[0] - 1, times[-1] + 1, 23).tolist()
    expected = [int(np.abs(times - time).argmin()) for time in between]
    assert page.evaluate("(times) => times.map(nearest)", between) == expected
    for low, high in ((0, 0.03), (-4, 4), (1, 1.7), (0, 2500)):
        values, digits = page.evaluate(f"ticks({low}, {high})")
        assert 4 <= len(values) <= 7
        assert [float(f"{x:.{digits}f}") for x in values] == pytest.approx(values, abs=1e-9)
    for value in (0, 5, -5):
        low, high = page.evaluate(f"widened({value}, {value})")
        assert low < value < high


@pytest.mark.slow
def test_notes_and_alarms_are_seen_and_lead_to_their_time(opened, page_file):
    page = opened(1400, "light")
    own, viewer = told(page_file)
    marks = page.locator("#marks span")
    assert marks.all_inner_texts() == [note.text for note in NOTES]
    places = [left(mark) for mark in marks.all()]
    assert places == sorted(places)
    assert len({*places}) == 4
    texts = page.locator("#noted button").all_inner_texts()
    assert texts == [
        "−0.50 s: board on",
        "2.00 s: pushed <b>by hand</b>",
        "2.10 s: let go",
        "9.00 s: magnet near",
    ]
    page.locator("#noted button").nth(1).focus()
    page.keyboard.press("Enter")
    assert page.inner_text("#clock") == "2.00 s"
    alarms = page.locator("#alarmed button")
    assert alarms.count() == len(own["alarms"])
    assert "left out (B2), " in alarms.last.inner_text()
    alarms.last.focus()
    page.keyboard.press("Enter")
    assert alarms.last.get_attribute("aria-current") == "time"
    begin, end, _, k = own["alarms"][-1]
    assert page.inner_text("#clock") == f"{begin:.2f} s"
    page.evaluate(f"go(nearest({end}))")
    assert alarms.last.get_attribute("aria-current") == "time"
    assert (own["said"][k]["level"], page.locator("#status").get_attribute("data-level")) == (1, "1")
    assert red(page.locator(".shape-view canvas")) > 50
    box = page.locator("#charts canvas").first.bounding_box()
    at = lambda time: (time - own["from"]) / (own["to"] - own["from"]) * (box["width"] - 60) + 52  # noqa: E731
    image = pixels(page.locator("#charts canvas").first)
    column = image[: int(box["height"]) - 22, round(at((begin + end) / 2))]
    assert np.ptp(column[12], axis=-1) > 50  # a band, and none where all is well
    assert np.ptp(image[12, round(at(1.0))], axis=-1) < 10
    page.mouse.click(box["x"] + at(1.0), box["y"] + 100)
    nearest = min(viewer["time_s"], key=lambda time: abs(time - 1.0))
    assert page.inner_text("#clock") == f"{nearest:.2f} s"


@pytest.mark.slow
def test_an_alarm_is_named_with_its_time_or_its_times_and_the_number_of_its_rows(folder, tmp_path, browser):
    """Without a chip the shape is to be trusted all the same, and a shape that does not fit is not."""
    status = ["consistent", "inconsistent", "consistent", "left out", "left out", "consistent"]
    who = ["B1" * (words == "left out") for words in status]
    few = pd.read_csv(folder / "shape.csv").head(6).assign(time_s=np.arange(6.0))
    few.assign(status=status, suspects=who).to_csv(tmp_path / "e.csv", index=False)
    show_file(tmp_path / "e.csv", folder / "robot.toml", tmp_path / "a.html")
    with window(browser, 390, "light") as (page, _):
        page.goto((tmp_path / "a.html").as_uri())
        buttons = page.locator("#alarmed button")
        texts, levels = buttons.all_inner_texts(), [x.get_attribute("data-level") for x in buttons.all()]
    assert texts == ["1.00 s: inconsistent, 1 row", "3.00 to 4.00 s: left out (B1), 2 rows"]
    assert levels == ["2", "1"]


@pytest.mark.slow
def test_without_webgl_there_is_a_picture_and_the_slider_works(opened):
    page = opened(390, "light", WITHOUT_WEBGL)
    assert page.locator(".shape-view img").is_visible()
    assert page.locator("#no-shape").is_visible()
    page.locator("#time").focus()
    page.keyboard.press("End")
    wait_until(page, "document.querySelector('#status').textContent.startsWith('left out (B2)')")
