"""A robot followed live over a real port, what is said when something is wrong, and the page's server."""

import asyncio
import contextlib
import http.client
import io
import json
import math
import os
import pty
import re
import socket
import threading
import time
import tty
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from page_on_screen import red, window
from rich.console import Console

import repro
from repro import (
    AffineCurvature,
    ConstantCurvature,
    Imu,
    InputError,
    KalmanFilter,
    Magnet,
    Ring,
    Robot,
    Sensor,
    track,
)
from repro.estimators.monitor import LEFT_OUT, UNCHECKED
from repro_board import live as module
from repro_board import session as session_module
from repro_board import view as view_module
from repro_board.emulate import course, faulty
from repro_board.live import Line, live, table_of_estimates
from repro_board.record import Writer, read_recording
from repro_board.session import (
    BEHIND_S,
    BURST,
    LOOK_S,
    MOMENT_S,
    Follower,
    Session,
    in_numbers,
    notes,
    open_port,
    sentences,
    summary,
    suspects,
)
from repro_board.view import FILES, MOST_PAGES, PageServer, message, scene
from repro_board.wire import encode, raw
from tests.board.waiting import LONGEST_S, Clock, until

RATE_HZ = 1000.0
ROBOT = Robot(
    [ConstantCurvature(0.11, 0.022)] * 2,
    [Magnet(Ring(24e-3, 12e-3, 6e-3, 1450.0), i, 0.055) for i in (1, 2)],
    [Sensor(i, 0.11, radial=0.013, azimuth=k * np.pi / 2) for i in (1, 2) for k in range(4)],
    lower=np.tile([-0.02073, -0.02073, 0.0], 2),
    upper=np.tile([0.02073, 0.02073, 0.0066], 2),
    noise=0.005,
    rate_hz=RATE_HZ,
)
N = 1500
TIMES = np.arange(N) / RATE_HZ
Q = course(ROBOT, TIMES)
U = ROBOT.sensing()(Q) + 0.005 * np.random.default_rng(0).normal(size=(N, 8))
BARE = Robot(
    [ConstantCurvature(0.065, 0.009)],
    [Magnet(Ring(9e-3, 4e-3, 5e-3, 1250.0), 1, 0.038)],
    [Sensor(1, 0.063, radial=0.007, azimuth=k * np.pi / 2) for k in range(4)],
    lower=[-0.009, -0.009, 0.0],
    upper=[0.009, 0.009, 0.006],
    noise=0.005,
    rate_hz=RATE_HZ,
)
"""Four readings for three unknowns: without one of them nothing can be checked."""
BARE_U = BARE.sensing()(course(BARE, TIMES)) + 0.005 * np.random.default_rng(0).normal(size=(N, 4))
LEFT = "What sensor 3 reads does not fit the other readings and is left out (--failed 3)."


def sent(u: np.ndarray) -> list[bytes]:
    """Frames of a board that reads this."""
    return [encode(row, sequence=k, time_us=round(1e6 * k / RATE_HZ)) for k, row in enumerate(u)]


def off_mm(found, q) -> float:
    return 1e3 * float(np.linalg.norm(ROBOT.tip(found.q)[:3, 3] - ROBOT.tip(q)[:3, 3]))


@pytest.fixture(scope="module", autouse=True)
def _warm():
    Follower(ROBOT, "kalman").warm()


@pytest.fixture(autouse=True)
def clock(monkeypatch) -> Clock:
    """The clock of sessions and their pages: a computer that stops for a while makes nothing old."""
    clock = Clock()
    for one in (session_module, view_module):
        monkeypatch.setattr(one, "time", clock)
    return clock


@pytest.fixture
def in_real_time(clock, monkeypatch) -> None:
    """The clock of sessions is the computer's, but nothing that has to wait for the computer is left out."""
    for one in (session_module, view_module):
        monkeypatch.setattr(one, "time", time)
    monkeypatch.setattr(session_module, "BEHIND_S", LONGEST_S)


@pytest.fixture
def wire():
    """The two ends of a serial line: a file that the board writes to, and the name of the port."""
    board, port = pty.openpty()
    tty.setraw(board)
    tty.setraw(port)
    yield board, os.ttyname(port)
    os.close(board)
    os.close(port)


def in_thread(work) -> threading.Thread:
    """Start what works beside the test; what fails there fails the test."""
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def session_of(frames=(), *, robot=ROBOT, name="", since_s: float = 0.0, port=None, format=None) -> Session:
    """A session that has taken frames in, and began some time ago."""
    port = port or SimpleNamespace(opened=1, lost="")
    session = Session(Follower(robot, name), port, format=format, with_shape=True)
    now = session_module.time.monotonic
    session.began = session.heard = session.estimated_at = now() - since_s
    for frame in frames:
        session.inbox.put((now(), frame))
        session.turn()
        while session.pending:
            session.turn()
    session.counts.clear()  # how long a computer takes for this is no pace of a board
    session.moment = session.look()
    return session


def said(session: Session) -> list[str]:
    return list(sentences(session))


def noted(session: Session) -> list[str]:
    return list(notes(session))


# --------------------------------------------------------------------------------------------------------- the loop
def test_every_frame_of_a_serial_line_is_estimated_and_recorded(wire, tmp_path, in_real_time):
    """Frames come a millisecond apart or more, and no more than 20 of them before they are estimated."""
    board, name = wire
    port, writer = open_port(name), Writer(tmp_path / "a.rec", {})
    session, rows = Session(Follower(ROBOT), port), []
    session.follower.warm()
    session.record, session.rows = writer.take, rows
    look, made = session.look, []
    session.look = lambda: made.append(time.monotonic()) or look()

    def play() -> None:
        for k, frame in enumerate(sent(U[:400])):
            time.sleep(1 / RATE_HZ)
            until(lambda k=k: k < session.own["estimates"] + 20)
            os.write(board, frame)
        until(lambda: session.own["estimates"] == 400 and len(made) > 8)
        session.stop.set()

    thread = in_thread(play)
    session.run(LONGEST_S)
    thread.join(LONGEST_S)
    port.close()
    writer.close()
    assert session.own["bytes"] == sum(map(len, sent(U[:400])))
    assert session.own["time_steps"] == session.own["estimates"] == 400
    assert session.own["skipped"] == 0
    assert len(rows) == len(session.latencies) == 400
    assert max(off_mm(found, q) for (_, _, found), q in zip(rows[50:], Q[50:400], strict=True)) < 12
    samples = read_recording(tmp_path / "a.rec").samples
    np.testing.assert_array_equal([x.values for x in samples], U[:400].astype(np.float32))
    assert 0 < min(session.latencies) <= max(session.latencies) < time.monotonic() - session.began
    assert min(np.diff(made)) >= MOMENT_S * 0.99


def test_what_fails_in_the_thread_of_the_reader_or_of_the_table_ends_the_session(tmp_path, in_real_time):
    failing = SimpleNamespace(opened=1, lost="", read=lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        Session(Follower(ROBOT), failing).run(LONGEST_S)
    session = session_of(sent(U[:20]))
    (tmp_path / "a.csv").write_text("of another process")
    message = r"output of live must be a new file .*a\.csv"
    with pytest.raises(InputError, match=message), table_of_estimates(tmp_path / "a.csv", session):
        session.rows.append(session.last)
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_estimates_are_those_of_track():
    session, rows = session_of(name="kalman"), []
    session.rows = rows
    for k, frame in enumerate(sent(U[:200])):
        session.inbox.put((session.began + TIMES[k], frame))
        session.turn()
    expected = track(
        KalmanFilter(ROBOT), U[:200].astype(np.float32).astype(float), times=[t for t, _, _ in rows]
    )
    np.testing.assert_allclose([found.q for *_, found in rows], expected.q, atol=1e-12)
    np.testing.assert_allclose(rows[-1][2].covariance, expected.covariance[-1])


def test_a_session_that_is_behind_takes_the_newest_and_counts_the_others(clock):
    session = session_of()
    late = clock.monotonic() - 2 * BEHIND_S
    for frame in sent(U[:50]):
        session.inbox.put((late, frame))
    session.turn()
    assert session.own["skipped"] == 49
    assert session.own["estimates"] == 1
    assert list(session.latencies) == [pytest.approx(2 * BEHIND_S, abs=1e-3)]
    np.testing.assert_array_equal(session.last[1], U[49].astype(np.float32))
    assert "slower than the board" in said(session)[0]
    assert noted(session)[-1].startswith("49 time steps were left out")


def test_a_packet_of_many_frames_is_no_reason_to_leave_any_out():
    session = session_of([b"".join(sent(U[:50]))])
    assert session.own["estimates"] == 50
    assert not session.own["skipped"]


@pytest.mark.parametrize("name", ["levenberg_marquardt", "kalman"])
def test_an_alarm_is_named_and_a_long_one_costs_little(name):
    follower, looks = Follower(ROBOT, name), []
    step = follower.monitor.step
    follower.monitor.step = lambda *given: looks.append(1) or step(*given)
    u = faulty(U, "scaled", 2, since=300, size=1.0)
    for k in range(1300):
        found = follower.step(u[k], TIMES[k])
        if k == 299:
            looks.clear()
        if k >= 400:
            assert found.details["status"] == LEFT_OUT
            assert suspects(found) == (2,)
            assert found.missing == 1
            assert off_mm(found, Q[k]) < 12
    assert len(looks) <= BURST + 2 + 1.0 / LOOK_S
    for k in range(1300, N):
        found = follower.step(U[k], TIMES[k])
    for k in range(500):  # the robot stays, and the sensor is back
        found = follower.step(
            U[-1] + 0.005 * np.random.default_rng(k).normal(size=8), N / RATE_HZ + k / RATE_HZ
        )
    assert found.details["status"] == 0


def test_deviations_are_grown_and_failed_sensors_not_used():
    plain, grown = Follower(ROBOT, "kalman"), Follower(ROBOT, "kalman", failed=[3], grown=2.0)
    other = Follower(ROBOT, "kalman", failed=[3])
    u = U[0].copy()
    u[2] = 1e3
    one, two, three = plain.step(U[0], 0.0), grown.step(u, 0.0), other.step(u, 0.0)
    assert one.missing == 0
    assert two.missing == 1
    np.testing.assert_allclose(two.covariance, 4 * three.covariance)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"failed": [9]}, "sensor of live must be one of sensor 1 (1), sensor 2 (2)"),
        ({"failed": [0]}, "sensor 8 (8); instead received 0"),
        ({"grown": 0.0}, "grown of live must be positive"),
        ({"grown": math.inf}, "grown of live must be positive"),
        (
            {"name": "particle_filter"},
            "estimator of live must be one of levenberg_marquardt, kalman; instead",
        ),
    ],
)
def test_what_cannot_be_used_is_refused(given, words):
    with pytest.raises(InputError, match=re.escape(words)):
        Follower(ROBOT, **given)


# ----------------------------------------------------------------------------------------------- what is said of it
def damaged(frames: list[bytes], every: int) -> list[bytes]:
    return [f[:9] + bytes([f[9] ^ 1 or 2]) + f[10:] if k % every == 0 else f for k, f in enumerate(frames)]


def text(n: int) -> list[bytes]:
    return [b"Temperature: 21.5 C, all is well\r\n"] * n


CASES = {
    "nothing yet": (lambda: session_of(since_s=2), "Nothing arrives yet."),
    "garbage": (
        lambda: session_of([bytes(range(1, 256)) * 4], format="frames", since_s=2),
        "Bytes arrive, but no readings. Is --baud",
    ),
    "what a board says when it starts": (
        lambda: session_of([b"rst:0x1 (POWERON_RESET),boot:0x13"], format="frames", since_s=2),
        "Bytes arrive, but no readings. It is text, but not of the expected form",
    ),
    "text on a port of frames": (
        lambda: session_of(text(20), format="frames", since_s=2),
        "no readings. Text arrives",
    ),
    "a third damaged": (lambda: session_of(damaged(sent(U[:90]), 3)), "About 30 % of the frames are damaged"),
    "half damaged": (lambda: session_of(damaged(sent(U[:90]), 2)), "About 50 % of the frames are damaged"),
    "six of a hundred damaged": (
        lambda: session_of(damaged(sent(U[:101]), 16)),
        "About 10 % of the frames are d",
    ),
    "another robot": (
        lambda: session_of(sent(U[:20, :6]), since_s=2),
        "What arrives does not fit this robot.",
    ),
    "an alarm": (lambda: session_of(sent(faulty(U[:400], "unplugged", 2, since=200))), LEFT),
    "an alarm that leaves no reading to spare": (
        lambda: session_of(sent(faulty(BARE_U, "stuck", 2, since=100)), robot=BARE),
        LEFT,
    ),
    "no chip": (
        lambda: session_of(sent(faulty(U[:60], "missing", 4, since=9))),
        "There is no reading of sensor 5",
    ),
    "all frozen": (
        lambda: session_of(sent(faulty(U[:800], "frozen", 0, since=50))),
        "the board repeats itself",
    ),
    "undetermined": (
        lambda: session_of(sent(faulty(U[:60], "missing", [0, 1, 2], since=9))),
        "Do not trust the shape: there are fewer readings than unknowns.",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_wrong_is_said(case):
    make, words = CASES[case]
    found = said(make())
    assert any(words in text for text in found), found


def test_the_last_bytes_are_shown_where_they_are_no_readings():
    """On the terminal and on the page; 32 of them, however they arrived."""
    session = session_of([b"x" * 99, b"ets Jul 29 2019\r\n", b"boot: \x1b\xff"], format="frames", since_s=2)
    kept = b"x" * 7 + b"ets Jul 29 2019\r\nboot: \x1b\xff"
    shown = f"The last 32 bytes as text: xxxxxxxets Jul 29 2019..boot: ..\nin hex: {kept.hex(' ')}"
    assert message(session.moment)["raw"] == shown
    console = Console(file=io.StringIO(), width=200)
    console.print(module.terminal(session.moment))
    assert shown in console.file.getvalue()
    assert message(session_of(since_s=2).moment)["raw"] == ""


@pytest.mark.parametrize("every", [1000, 22])
def test_all_is_well_and_nothing_is_said(every):
    """Also of a twentieth of damaged frames, the first of which may have been cut."""
    session = session_of(damaged(sent(U[:100]), every))
    assert said(session) == []
    assert session.moment.raw == ""
    assert summary(session)["fit"].startswith("consistent, residuals ")
    assert in_numbers(session)[0].startswith("tip x ")
    assert in_numbers(session)[3].endswith(" mm")


def test_fit_and_latency_are_said_in_their_units():
    session = session_of(sent(U[:3]))
    t, u, found = session.last
    session.last = t, u, found._replace(chi2=40.0, dof=10)
    session.latencies.clear()
    session.latencies.extend(np.arange(1, 102) / 1e3)
    assert summary(session)["fit"].endswith("residuals 2.0 times the noise")
    assert summary(session)["latency"] == "51 ms in the median, 1e+02 ms in 99 %"
    session.latencies.extend(np.full(101, 1e-3))
    assert summary(session)["latency"].startswith("1 ms in the median, 99 ms")


@pytest.mark.parametrize(
    ("share", "ends"),
    [(0.259, " mm"), (0.261, " mm by its bounds alone"), (0.99, "alone"), (1.01, " undetermined")],
)
def test_a_deviation_is_seen_beside_what_the_bounds_leave(share, ends):
    """A uniform distribution over them has their width over the root of 12: nine tenths of it are 0.26."""
    session, width = session_of(), ROBOT.upper - ROBOT.lower
    found = SimpleNamespace(q=ROBOT.usual_shape, covariance=np.diag((share * width) ** 2))
    session.last = 0.0, U[0], found
    coordinates = in_numbers(session)[3:]
    assert [text.split()[0] for text in coordinates] == list(ROBOT.coordinates)
    assert all(text.endswith(ends) for text in coordinates)


def test_lengths_and_degrees_have_two_decimals_and_radians_four():
    robot = Robot([AffineCurvature(0.2)], lower=[-3, -9, -3, -0.02], upper=[3, 9, 3, 0.02])
    found = SimpleNamespace(q=np.array([0.1, 0.2, 0.3, 0.004]), covariance=1e-8 * np.eye(4))
    said = in_numbers(SimpleNamespace(robot=robot, last=(0.0, None, found)))
    in_rad = ("kappa_0_1 0.1000 ± 0.0001 rad", "kappa_1_1 0.2000 ± 0.0001 rad")
    assert said[3:] == (*in_rad, "phi_1 17.19 ± 0.01 deg", "delta_L_1 4.00 ± 0.10 mm")


@pytest.mark.parametrize("since_s", [0.2, 0.9])
def test_the_first_second_of_garbage_is_no_silence(since_s):
    assert said(session_of([b"\x01\x02\x03" * 9], format="frames", since_s=since_s)) == []


def test_a_remark_of_the_past_explains_no_fault_of_now(clock):
    """Two frames of stream 3, then readings, then garbage; and then stream 3 again."""
    session = session_of([encode(U[0], 3, k) for k in range(2)] + sent(U[:50]), since_s=2)
    other = "Samples of stream 3 are none of the robot's: left out."
    assert noted(session) == [other]
    assert "2 other streams" in summary(session)["received"]

    def after(frame: bytes) -> str:
        session.counts.clear()
        session.turn()
        session.inbox.put((clock.monotonic(), frame))
        session.turn()
        return said(session)[0]

    assert after(bytes(range(1, 256))).startswith("Bytes arrive, but no readings. Is --baud")
    assert after(encode(U[0], 3, 2)) == f"What arrives does not fit this robot. {other}"
    assert noted(session) == [other]


def test_a_slow_board_is_not_taken_for_a_silent_one(clock):
    session = session_of(sent(U[:3]), robot=ROBOT.replaced(rate_hz=0.3), since_s=4)
    session.counts.append((clock.monotonic() - 2, session.counters()))
    session.heard = session.estimated_at = clock.monotonic() - 3
    assert said(session) == []
    assert session.age_s == 0


def test_silence_and_a_lost_port_are_told_apart(clock):
    session = session_of(sent(U[:20]))
    session.heard = session.estimated_at = clock.monotonic() - 1.6
    assert said(session)[0].startswith("Nothing arrives any more.")
    assert summary(session)["fit"].startswith("2 s old; ")
    session.lost = "unplugged"
    assert said(session) == ["The port is gone; we wait until it is there again."]


@pytest.mark.parametrize(
    ("factor", "wrong"), [(2.0, True), (1.5, True), (1.1, False), (0.9, False), (0.5, True)]
)
def test_another_rate_than_stated_is_said(clock, factor, wrong):
    session, now = session_of(sent(U[:10])), clock.monotonic()
    session.counts.clear()
    session.counts.append((now - 1.0, session.counters()))
    session.own["time_steps"] += round(factor * RATE_HZ)
    word = "More" if factor > 1 else "Fewer"
    expected = f"{word} than the 1000 time steps of the robot file arrive in a second."
    assert said(session) == [expected] * wrong


def test_what_was_asked_for_and_what_cannot_be_told_is_noted():
    session = session_of()
    session.follower = Follower(ROBOT, failed=[2], grown=1.5)
    assert noted(session) == [
        "Not used, as asked: sensor 2.",
        "Every ± is 1.5 times what the estimator states.",
    ]
    session.follower = Follower(ROBOT.replaced(sensors=ROBOT.sensors[:6]))
    session.robot = session.follower.robot
    session.last = 0.0, U[0, :6], SimpleNamespace(details={"status": UNCHECKED})
    assert noted(session) == [
        "There are no more readings than unknowns: a wrong sensor looks like another shape."
    ]


def test_a_whole_session_by_its_files(tmp_path, monkeypatch, in_real_time):
    """The command: a board behind a socket, a robot file, a recording, and a table as that of a trajectory.

    What it shows on the terminal fails.
    """
    monkeypatch.setattr(module, "terminal", lambda _: 1 / 0)
    stop, estimate = threading.Event(), Session._estimate

    def counted(session: Session, *given) -> None:
        estimate(session, *given)
        if session.own["estimates"] == 40:
            stop.set()

    monkeypatch.setattr(Session, "_estimate", counted)
    robot = repro.load_robot(repro.example() / "robot.toml")
    u = robot.sensing()(course(robot, np.arange(40) / 25.0))
    lines = ["time_s," + ",".join(f"{name}_mT" for name in robot.names)]
    lines += [f"{k / 25}," + ",".join(f"{x:.4f}" for x in row) for k, row in enumerate(u)]
    with socket.create_server(("127.0.0.1", 0)) as server:

        def board() -> None:
            line, _ = server.accept()
            with line:
                for text in lines:
                    line.sendall(f"{text}\r\n".encode())
                    time.sleep(0.01)
                stop.wait(LONGEST_S)

        in_thread(board)
        address = f"socket://127.0.0.1:{server.getsockname()[1]}"
        paths = {"output": tmp_path / "a.rec", "estimates": tmp_path / "a.csv"}
        end = live(Line(address), repro.example() / "robot.toml", stop=stop, duration_s=LONGEST_S, **paths)
    table = pd.read_csv(tmp_path / "a.csv")
    assert list(table.columns) == list(track(Follower(robot).estimator, u).to_frame().columns)
    assert len(table) == 40
    assert (table["status"] == "consistent").all()
    assert len(read_recording(tmp_path / "a.rec").samples) == 40
    assert "40 estimates by levenberg_marquardt" in str(end)
    assert end.found["estimates"] == 40
    assert (
        "The view on the terminal has failed, and the session goes on without it (ZeroDivisionError"
        in str(end)
    )
    with pytest.raises(InputError, match="output of live must be one that does not exist yet"):
        live(Line(address), repro.example() / "robot.toml", **paths)


def test_a_robot_file_without_noise_is_refused_before_a_port_is_opened(tmp_path):
    lines = (repro.example() / "robot.toml").read_text(encoding="utf-8").splitlines()
    (tmp_path / "robot.toml").write_text("\n".join(line for line in lines if "noise" not in line))
    with pytest.raises(
        InputError, match=r"robot of live must be one whose file states the noise .*robot\.toml"
    ):
        live(Line("nowhere"), tmp_path / "robot.toml")


# ---------------------------------------------------------------------------------------------------------- the page
@pytest.fixture
def page(clock):
    with PageServer(session_of(sent(U[:50]))) as server:
        yield server


def ask(page, path="/", method="GET", *, token=True, **headers: str) -> tuple[int, dict[str, str], bytes]:
    """Send one request as it stands; return status, headers and content."""
    link = http.client.HTTPConnection("127.0.0.1", page.port, timeout=LONGEST_S)
    own = {"Host": f"127.0.0.1:{page.port}"} | (
        {"Cookie": f"repro_{page.port}={page.token}"} if token else {}
    )
    try:
        link.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
        for name, value in (own | {name.replace("_", "-"): value for name, value in headers.items()}).items():
            if value:
                link.putheader(name, value)
        link.endheaders()
        answer = link.getresponse()
        return (
            answer.status,
            dict(answer.getheaders()),
            answer.read(answer.length or 0),
        )  # a stream has no end
    finally:
        link.close()


@pytest.fixture
def stream():
    """A function that opens the stream of events of a page."""
    links = []

    def opened(page) -> http.client.HTTPResponse:
        links.append(http.client.HTTPConnection("127.0.0.1", page.port, timeout=LONGEST_S))
        links[-1].request("GET", "/events", headers={"Cookie": f"repro_{page.port}={page.token}"})
        answer = links[-1].getresponse()
        answer.link = links[-1]
        return answer

    yield opened
    for link in links:
        link.close()


def event(answer) -> dict:
    while not (line := answer.readline()).startswith(b"data: {"):
        assert line, "the stream has ended"
    return json.loads(line[6:])


def test_the_address_opens_the_page_once_and_for_all(page):
    assert page.address.startswith(f"http://127.0.0.1:{page.port}/?token=")
    status, headers, _ = ask(page, page.address.partition(str(page.port))[2], token=False)
    assert (status, headers["Location"]) == (302, "/")
    assert "HttpOnly" in headers["Set-Cookie"]
    assert "SameSite=Strict" in headers["Set-Cookie"]
    cookie = headers["Set-Cookie"].partition(";")[0]
    for path in (*FILES, "/scene.json"):
        status, headers, content = ask(page, path, token=False, Cookie=cookie)
        assert status == 200
        assert content
        assert headers["Content-Security-Policy"].startswith("default-src 'none'")
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        assert b"://" not in content or path == "/viewer.js"  # it asks no other host


HOSTILE = [
    *[
        {"Host": x}
        for x in ("", "evil.example", "127.0.0.1", "127.0.0.1:1", "localhost.evil.example", "[::1]", "x, y")
    ],
    *[
        {"Origin": x}
        for x in ("http://evil.example", "null", "https://127.0.0.1", "http://127.0.0.1", "file://")
    ],
    *[{"Sec_Fetch_Site": x} for x in ("cross-site", "same-site")],
    *[{"Cookie": x} for x in ("", "repro=1", "repro_1=abc", "repro_PORT=", "repro_PORT=abc", "repro_PORT=é")],
]


@pytest.mark.parametrize("path", ["/", "/viewer.js", "/scene.json", "/events", "/?token=abc"])
@pytest.mark.parametrize("headers", HOSTILE, ids=str)
def test_requests_from_elsewhere_get_nothing(page, path, headers):
    headers = {name: value.replace("PORT", str(page.port)) for name, value in headers.items()}
    try:
        status, given, content = ask(page, path, **headers)
    except http.client.HTTPException:  # it was closed without an answer
        return
    assert status in (400, 403)
    assert b"estimate" not in content
    assert "Set-Cookie" not in given


@pytest.mark.parametrize(
    "path", ["/../live.py", "/live", "/live.js?x", "/%2e%2e/", "http://x/", "/vendor/", "//", "/é"]
)
@pytest.mark.parametrize("method", ["GET", "POST", "PUT", "DELETE", "HEAD", "OPTIONS"])
def test_nothing_else_is_served_and_nothing_can_be_sent(page, path, method):
    path = path.encode().decode("latin-1") if path == "/é" else path
    try:
        status, _, content = ask(page, path, method)
    except (http.client.HTTPException, UnicodeError):
        return
    assert status in (400, 403, 404, 405)
    assert b"import" not in content


def connected(page) -> list[socket.socket]:
    """Connections that ask slowly, or nothing."""
    links = [socket.create_connection(("127.0.0.1", page.port), LONGEST_S) for _ in range(40)]
    for k, link in enumerate(links):
        link.sendall(
            (b"", b"G", b"GET / HTTP/1.1\r\n", b"POST / HTTP/1.1\r\nContent-Length: 999\r\n\r\n")[k % 4]
        )
    return links


def test_slow_and_silent_connections_delay_nobody(page, monkeypatch):
    """Others are answered while these wait, for much longer than an answer may take."""
    monkeypatch.setattr(view_module, "ASK_S", 10 * LONGEST_S)
    with PageServer(page.session) as server:
        links = connected(server)
        assert ask(server)[0] == 200
        for link in links:
            link.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                assert link.recv(4096) != b"", "it was given up"
            link.close()


def test_slow_and_silent_connections_are_given_up(page):
    for link in connected(page):
        with link, contextlib.suppress(ConnectionResetError):
            while link.recv(4096):
                pass


def test_a_page_that_takes_nothing_delays_no_other_and_too_many_are_refused(page, stream, monkeypatch):
    """What it does not take is more than all buffers hold."""
    monkeypatch.setattr(view_module, "STALLED_S", 10 * LONGEST_S)
    monkeypatch.setattr(view_module, "message", lambda seen: message(seen) | {"long": "x" * 1_000_000})
    stuck, other = [stream(page) for _ in range(MOST_PAGES - 1)], stream(page)
    shown = [event(other) for _ in range(20)]
    assert len(stuck) < len(page.pages)
    assert shown[-1]["shape"]["shapes"]
    assert ask(page, "/events")[0] == 503
    other.link.close()
    other.close()
    until(lambda: len(page.pages) < MOST_PAGES)
    assert stream(page).status == 200


def test_a_page_that_takes_nothing_for_long_is_given_up(page, stream, monkeypatch):
    """Its buffers are full after some time; those of a page that reads never are."""
    monkeypatch.setattr(view_module, "STALLED_S", 1.0)
    monkeypatch.setattr(view_module, "UPDATE_S", 0.005)
    monkeypatch.setattr(view_module, "message", lambda _: {"long": "x" * 30_000})
    stream(page)
    other = stream(page)
    until(lambda: event(other) and len(page.pages) == 1)
    assert event(other)["long"]


def test_pages_are_told_of_the_end(stream):
    with PageServer(session_of(sent(U[:50]))) as server:
        answer = stream(server)
        event(answer)
    assert b"event: end\n" in answer.read()


def test_a_server_that_does_not_end_is_left_alone(stream, monkeypatch):
    stuck, free, over, before = *(threading.Event() for _ in range(3)), threading.active_count()
    monkeypatch.setattr(view_module, "LEFT_S", 0.2)
    monkeypatch.setattr(view_module, "message", lambda _: [stuck.set(), free.wait(20), over.set()])
    server = PageServer(session_of(sent(U[:50])))
    with server:
        stream(server)
        assert stuck.wait(30)
    assert not over.is_set(), "the end of the session did not wait for the page"
    free.set()
    until(lambda: threading.active_count() == before, 30)


def test_a_message_names_the_suspect_and_is_json():
    told = message(session_of(sent(faulty(U[:400], "unplugged", 2, since=200))).moment)
    assert list(told["suspects"]) == told["shape"]["suspects"] == [2]
    assert told["alarms"] == (LEFT,)
    assert told["doubt"] == "left out"
    assert abs(told["residuals"][2]) > 100
    for case in ("nothing yet", "no chip", "undetermined", "all frozen"):
        json.dumps(message(CASES[case][0]().moment), allow_nan=False)


def test_a_page_knows_the_names_of_readings_and_their_units():
    for robot, unit in ((ROBOT, "mT"), (ROBOT.replaced(imus=[Imu(2, 0.11)]), "mT, rad")):
        told = scene(robot)
        assert (told["readings"], told["unit"]) == (robot.names, unit)


def test_a_moment_that_nothing_takes_the_place_of_is_old():
    session = session_of(sent(U[:50]))
    assert message(session.moment)["doubt"] == ""
    assert message(session.moment._replace(made_s=session.moment.made_s - 1.1))["doubt"] == "old"


def test_a_moment_that_cannot_be_made_says_so_and_the_session_goes_on(monkeypatch):
    session = session_of(sent(U[:50]))
    monkeypatch.setattr(session_module, "in_numbers", lambda _: 1 / 0)
    session.moment = session.look()
    failed = "The view has failed, and the session goes on without it (ZeroDivisionError: division by zero)."
    assert message(session.moment) == {
        "doubt": "old", "numbers": ("not known",), "summary": {}, "alarms": (failed,), "raw": "", "notes": (),
        "suspects": (),
    }  # fmt: skip
    session.inbox.put((session.moment.made_s, sent(U[:51])[-1]))
    session.turn()
    assert session.own["estimates"] == 51
    assert noted(session) == [failed]
    session.blinded("page", ValueError("late"))
    session.settle()
    assert noted(session)[0].startswith("The page has failed")


def test_a_page_that_cannot_be_made_says_so_and_goes_on(page, stream, monkeypatch):
    answer = stream(page)
    assert event(answer)["numbers"]
    for fault in ({"alarms": [np.nan]}, None):
        with monkeypatch.context() as patch:
            patch.setattr(view_module, "message", lambda _, told=fault: told["alarms"] and told)
            told = next(told for told in (event(answer) for _ in range(100)) if told["doubt"] == "old")
        assert told["alarms"][0].startswith("The page has failed, and the session goes on without it (")
        assert any(event(answer)["doubt"] != "old" for _ in range(100))
    page.session.turn()
    assert noted(page.session)[0].startswith("The page has failed")


def test_a_port_that_there_is_not_is_refused(page):
    for port, words in ((-1, "0 to 65535"), (65536, "0 to 65535"), (page.port, "a free port, or 0")):
        with pytest.raises(
            InputError, match=f"browser_socket of live must be {words}; instead received {port}"
        ):
            PageServer(page.session, port)


def test_the_usual_port_is_in_no_name_that_a_browser_gives(page):
    assert f"localhost:{page.port}" in page.hosts
    try:
        server = PageServer(page.session, 80)
    except InputError as error:
        pytest.skip(f"port 80 is taken or forbidden here: {error}")
    with server:
        assert server.hosts == ("127.0.0.1", "localhost")


async def cut_off(server) -> None:
    """Close the connections of all pages without a word."""
    for page in list(server.pages):
        page.detach().close()


TRACED = """([calls, most]) => {
    const traces = new Traces(null, 1, most ?? Infinity);
    for (const call of calls) traces.add(...call);
    return [traces.rows.map(([time]) => time), traces.end, traces.limits()];
}"""
TRACES = [
    (
        [[9, [1], 0], [1, [3], 0]],
        None,
        [1],
        1,
        [2.85, 3.15],
    ),  # what a board sent before it began anew is gone
    ([[10, [1], 0.2], [11, [3], 0.25]], None, [10, 11], 11, [0.9, 3.1]),
    (
        [[10, [1], 0.3], [11, [3], 5]],
        None,
        [10, 11],
        16,
        [0.9, 3.1],
    ),  # old readings stand where their time is
    ([[3, [1], 0], [3, [1], 0], [4, [3], 0]], None, [3, 4], 4, [0.9, 3.1]),
    ([[0, [1], 0], [20, [3], 0]], None, [0, 20], 20, [0.9, 3.1]),
    ([[0, [9], 0], [19, [1], 0], [20.1, [3], 0]], None, [19, 20.1], 20.1, [0.9, 3.1]),
    (
        [[0, [-1], 0], [1, [2], 0]],
        30,
        [0, 1],
        1,
        [-4.4, 4.4],
    ),  # residuals: four deviations at least, 30 at most
    ([[0, [-29], 0], [1, [99], 0]], 30, [0, 1], 1, [-31.95, 32.95]),
    ([[0, [-99], 0], [1, [0], 0]], 30, [0, 1], 1, [-31.7, 5.7]),
]
"""Readings with their ages, a limit for them, and the times that are kept, where "now" is, and what is drawn."""


@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (390, "dark")])
@pytest.mark.slow
def test_a_browser_shows_the_shape_and_the_alarm_and_asks_nobody_else(browser, stream, width, scheme):
    session = session_of(sent(faulty(U[:400], "unplugged", 2, since=200)))
    raw_bytes = raw(bytes(range(50, 82)))
    session.moment = session.moment._replace(raw=raw_bytes)
    with PageServer(session) as server, window(browser, width, scheme) as (page, asked):
        page.goto(server.address)
        page.wait_for_selector("#numbers li")
        page.wait_for_selector("#alarms p")
        assert page.inner_text("#alarms p") == LEFT
        assert page.inner_text("#raw") == raw_bytes
        assert page.inner_text("#values li.suspect").startswith("sensor 3")
        values = [text.split()[-1].replace("−", "-") for text in page.locator("#values li").all_inner_texts()]
        np.testing.assert_allclose(np.array(values, float), session.last[1], rtol=5.1e-4)  # four digits
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert red(page.locator("#shape canvas")) > 50
        for calls, most, times, end, limits in TRACES:
            assert page.evaluate(TRACED, [calls, most]) == [times, end, pytest.approx(limits)]
        others = [stream(server) for _ in range(MOST_PAGES - 1)]
        one_more = page.context.new_page()
        one_more.route("**/viewer.js", lambda route: route.abort())  # its pictures take long
        one_more.goto(f"http://127.0.0.1:{server.port}/")
        one_more.wait_for_selector("#status:text('Too many pages show this session.')")
        assert len(others) == len(server.pages) - 1
        server.token = "another"  # as if the server were killed and started again on its socket
        asyncio.run_coroutine_threadsafe(cut_off(server), server._loop).result(LONGEST_S)
        page.wait_for_selector(
            "#status:text('If it was started again, open the address that it prints now.')"
        )
    assert all(url.startswith(f"http://127.0.0.1:{server.port}/") for url in asked)


def test_a_chip_too_near_a_magnet_is_left_out_and_said():
    """Within the sphere of the ring no field is known: live asks what every other command asks."""
    chips = [Sensor(1, 0.04, axes=3, name="inside"), Sensor(1, 0.025, axes=3)]
    robot = Robot(
        [ConstantCurvature(0.06, 0.015)], [Magnet(Ring(24e-3, 12e-3, 6e-3, 1450.0), 1, 0.05)], chips,
        lower=[-0.004, -0.004, 0.0], upper=[0.004, 0.004, 0.0], noise=0.05, rate_hz=50.0,
    )  # fmt: skip
    q = np.array([0.002, -0.001, 0.0])
    u = repro.simulated_readings(robot, q) + 0.05 * np.random.default_rng(0).standard_normal((20, 6))
    follower = Follower(robot)
    found = [follower.step(row, 0.02 * k) for k, row in enumerate(u)]
    assert {int(x.details["status"]) for x in found} == {0}
    assert np.abs(np.array([x.q for x in found]) - q).max() < 2e-3
    session = session_of()
    session.follower, session.robot, session.last = follower, robot, (0.4, u[-1], found[-1])
    assert any(text.startswith("inside is so close to a magnet") for text in said(session))
