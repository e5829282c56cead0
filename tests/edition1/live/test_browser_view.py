"""The live page: only this computer may ask, only its own files are served, and it shows what is estimated."""

from __future__ import annotations

import http.client
import json
import math
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from page_on_screen import NO_GPU, differing, pixels, wait_until

from edition1.errors import InputError
from edition1.estimation.consistency import Verdict
from edition1.robot_file.load import load_robot
from edition1_live.follow.browser import MOST_CLIENTS, WAITING, BrowserView, message
from edition1_live.follow.follower import Follower
from edition1_live.follow.latency import STAGES, Latencies
from edition1_live.follow.live_state import LiveState
from edition1_live.follow.page_server import ASK_S, FILES, MOST_CONNECTIONS
from edition1_live.follow.robot_estimator import robot_estimator
from edition1_live.follow.time_steps import TimeStep
from edition1_live.record.recorder import Summary
from edition1_live.view.robot_view import backbone_deviation
from edition1_live.wire.frame import Frame

ROBOTS = Path(__file__).parents[3] / "data" / "robots"


SERVER = f"""
import time
from edition1_live.follow.browser import BrowserView
from edition1_live.follow.robot_estimator import robot_estimator
from edition1.robot_file.load import load_robot
with BrowserView(robot_estimator(load_robot({str(ROBOTS / "bend_sensor.toml")!r}))) as server:
    print(server.port, flush=True)
    time.sleep(100)
"""


@pytest.fixture(scope="module")
def estimator():
    return robot_estimator(load_robot(ROBOTS / "one_segment.toml"))


@pytest.fixture(scope="module")
def states(estimator) -> list[LiveState]:
    """States of a session in which the robot bends; in the last one sensor 2 is silent."""
    follower, found = Follower(estimator), []
    robot = estimator.robot
    for k in range(40):
        q = robot.start.clone()
        q[0] = 0.018 * math.sin(k / 8)
        values = robot.values(q).tolist()
        if k == 39:
            values[1] = math.nan
        u, estimate = follower.step(TimeStep(k / 20, 0, 0, (Frame(0, k, None, tuple(values)),)))
        found.append(state(estimator, follower, k / 20, u, estimate, gone=k == 39))
    return found


def state(estimator, follower, time_s=math.nan, u=None, estimate=None, gone=False) -> LiveState:
    return LiveState(
        verdict=Verdict(),
        doubted=0,
        seconds=1.0,
        time_s=time_s,
        since_s=0.0,
        readings=u,
        estimate=estimate,
        age_s=0.0,
        silent=False,
        arriving="frames",
        foreign="",
        rate_hz=20.0,
        estimated=follower.estimated,
        dropped=0,
        refused=0,
        dropped_now=False,
        refused_now=False,
        refusal="",
        missing=tuple(follower.missing),
        missing_now=(False, gone, False),
        other_streams={},
        recorded=Summary(None, {"frames": follower.estimated, "gaps": 3}, 1.0),
        latencies={stage: Latencies() for stage in STAGES},
    )


@pytest.fixture
def view(estimator) -> Iterator[BrowserView]:
    with BrowserView(estimator) as server:
        yield server


def ask(view: BrowserView, path: str, method: str = "GET", **headers: str):
    """Send one request as it stands; return status, headers and content."""
    link = http.client.HTTPConnection("127.0.0.1", view.port, timeout=10)
    try:
        link.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
        for name, value in ({"Host": f"127.0.0.1:{view.port}"} | headers).items():
            if value:
                link.putheader(name, value)
        link.endheaders()
        answer = link.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        link.close()


def stream(view: BrowserView, **headers: str) -> http.client.HTTPResponse:
    link = http.client.HTTPConnection("127.0.0.1", view.port, timeout=10)
    link.request("GET", "/events", headers=headers)
    return link.getresponse()


def wait(condition) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline, "never"
        time.sleep(0.01)


def event(answer: http.client.HTTPResponse) -> tuple[str, str]:
    """Next event that is more than a sign of life: its name and data."""
    name, data = "message", ""
    while line := answer.readline().decode():
        line = line.rstrip("\n")
        if line.startswith("event: "):
            name = line[7:]
        elif line.startswith("data:"):
            data = line[5:].strip()
        elif not line and (data or name != "message"):
            return name, data
    return "closed", ""


def test_only_the_loopback_address_is_bound(view):
    assert view.address == f"http://127.0.0.1:{view.port}/"
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
    for other in others - {"127.0.0.1"}:
        with socket.socket() as trial:
            assert trial.connect_ex((other, view.port)) != 0


@pytest.mark.parametrize("path", [*FILES, "/scene.json", "/events"])
@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "example.org"},
        {"Host": "127.0.0.1:1"},
        {"Host": ""},
        {"Origin": "http://example.org"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
    ],
)
def test_other_hosts_and_origins_are_refused(view, path, headers):
    status, _, content = ask(view, path, **headers)
    assert status == 403
    assert content == b"Only for pages of this address.\n"


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_its_own_files_are_served_with_a_strict_policy(view, name):
    host = f"{name}:{view.port}"
    for path, (file, kind) in FILES.items():
        status, headers, content = ask(view, path, Host=host, Origin=f"http://{host}")
        assert (status, headers["Content-Type"], content) == (200, kind, file.read_bytes())
        assert headers["Content-Security-Policy"].startswith("default-src 'none'; script-src 'self'; ")
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert "Access-Control-Allow-Origin" not in headers
    assert json.loads(ask(view, "/scene.json")[2])["traces"] == ["sensor 1", "sensor 2", "sensor 3"]


@pytest.mark.parametrize("path", ["/../pyproject.toml", "/page", "/page.js?x", "/%2e%2e/", "http://x/"])
def test_nothing_else_is_served(view, path):
    assert ask(view, path)[0] == 404


def test_nothing_can_be_sent_to_it(view):
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "CONNECT"):
        assert ask(view, "/", method)[0] == 501


def test_events_bring_states_and_the_end(estimator, states):
    with BrowserView(estimator) as server:
        answer = stream(server, Origin=f"http://127.0.0.1:{server.port}")
        assert answer.headers["Content-Type"] == "text/event-stream"
        for each in (states[3], states[39]):
            server.publish(each)
            name, data = event(answer)
            assert name == "message"
            assert json.loads(data) == json.loads(json.dumps(message(estimator, each)))
        told = json.loads(data)
    name = "message"
    while name == "message":  # a page that comes is told the last state, perhaps twice
        name, _ = event(answer)
    assert name == "end"
    assert told["readings"][1] is None
    assert told["alerts"] == ["sensor 2 gives no reading and is left out."]
    assert told["counters"] == "40 frames, 3 gaps"
    assert told["quantities"][0].startswith("delta_x_1 ")
    assert told["shape"]["shapes"][0]["points"][:3] == [0, 0, 0]


def test_a_slow_browser_misses_states_and_nobody_waits(view, estimator, states):
    slow = stream(view)
    quick = stream(view)
    wait(lambda: len(view._clients) == 2)
    heard: list[float] = []

    def listen():
        while (found := event(quick))[0] == "message":
            heard.append(json.loads(found[1])["time_s"])

    listener = threading.Thread(target=listen)
    listener.start()
    longest = 0.0
    for _ in range(60):
        for each in states:
            began = time.perf_counter()
            view.publish(each)
            longest = max(longest, time.perf_counter() - began)
        time.sleep(0.01)
    wait(lambda: len(heard) > 5)
    assert longest < 0.5
    assert all(client.qsize() <= WAITING for client in view._clients)
    slow.close()
    view.__exit__()
    listener.join(10)
    assert not listener.is_alive()


def test_pages_that_leave_are_forgotten_and_too_many_refused(view, states):
    answers = [stream(view) for _ in range(MOST_CLIENTS)]
    wait(lambda: len(view._clients) == MOST_CLIENTS)
    assert ask(view, "/events")[0] == 503
    for answer in answers:
        answer.close()

    def gone() -> bool:
        view.publish(states[0])
        return not view._clients

    wait(gone)


def test_the_tube_is_that_of_the_derivatives(estimator, states):
    found = message(estimator, states[20])["shape"]["shapes"][0]["deviation"]
    estimate = states[20].estimate
    expected = 1e3 * backbone_deviation(estimator.robot.robot, estimate.q, estimate.covariance)
    np.testing.assert_allclose(found, expected, atol=6e-4)


def test_what_is_undetermined_stays_on_the_screen():
    two = robot_estimator(load_robot(ROBOTS / "one_segment.toml"), failed=[2])
    follower = Follower(two)
    frame = Frame(0, 0, None, tuple(two.robot.values(two.robot.start).tolist()))
    u, estimate = follower.step(TimeStep(0.0, 0, 0, (frame,)))
    told = message(two, state(two, follower, 0.0, u, estimate))
    assert max(told["shape"]["shapes"][0]["deviation"]) == 110.0
    assert told["quantities"][0].endswith("(undetermined)")


def test_imus_are_shown_as_points_and_angles():
    arm = robot_estimator(load_robot(ROBOTS / "imu_arm.toml"))
    half = math.sqrt(0.5)
    frames = [Frame(k, None, None, (0.0, 0.0, 0.0, 1.0)) for k in range(7)]
    frames += [Frame(7, None, None, (half, 0.0, 0.0, half))]
    follower = Follower(arm)
    u, estimate = follower.step(TimeStep(0.0, 0, 0, tuple(frames)))
    now = replace(state(arm, follower, 0.0, u, estimate), missing_now=(False,) * 8)
    told = message(arm, now)
    assert told["readings"] == pytest.approx([0.0] * 7 + [90.0])
    points = np.reshape(told["shape"]["shapes"][0]["points"], (-1, 3))
    assert points[0].tolist() == [0, 0, 0]
    assert points[56].tolist() == pytest.approx([0, 0, 560])
    assert len(told["shape"]["shapes"][0]["deviation"]) == len(points) == 65


def connected(view: BrowserView, sent: bytes = b"") -> socket.socket:
    link = socket.create_connection(("127.0.0.1", view.port), timeout=10)
    link.sendall(sent)
    return link


def answering() -> int:
    """Threads of this process that answer requests."""
    return sum("process_request_thread" in thread.name for thread in threading.enumerate())


def test_half_a_request_is_given_up_soon(view):
    began = time.monotonic()
    with connected(view) as silent, connected(view, b"GET / HTTP/1.1\r\nHo") as half:
        wait(lambda: answering() == 2)
        assert silent.recv(100) == half.recv(100) == b""
    assert ASK_S * 0.9 < time.monotonic() - began < ASK_S + 5
    wait(lambda: answering() == 0)


def test_a_request_that_drips_is_given_up_as_soon(view):
    def drip(link: socket.socket) -> None:
        for _ in range(300):
            link.sendall(b"X")
            time.sleep(0.05)

    began = time.monotonic()
    with connected(view, b"GET / HTTP/1.1\r\n") as link, pytest.raises(OSError, match=r"reset|pipe"):
        drip(link)
    assert ASK_S * 0.9 < time.monotonic() - began < ASK_S + 5
    wait(lambda: answering() == 0)


def test_many_that_ask_nothing_cost_few_threads_and_the_page_still_comes(view):
    page = stream(view)
    links = []
    for _ in range(3 * MOST_CONNECTIONS):
        links.append(connected(view, b"GET / HTTP/1.1\r\n"))
        assert answering() <= MOST_CONNECTIONS + 1 + 5, "those that were closed may take a moment to end"
        time.sleep(0.002)
    assert ask(view, "/")[0] == 200
    view.publish(state(view._estimator, Follower(view._estimator)))
    assert event(page)[0] == "message", "an open page is not closed in favour of others"
    for link in links:
        link.close()
    wait(lambda: answering() == 1)
    page.close()


def test_a_port_is_taken_as_asked_or_refused(estimator, view):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
    with BrowserView(estimator, number) as server:
        assert server.address == f"http://127.0.0.1:{number}/"
        assert ask(server, "/")[0] == 200
    for wrong, must in ((view.port, f"a free port; instead received {view.port}: "), (-1, "0 to 65535; ")):
        with pytest.raises(InputError, match=f"^Input browser_socket of repro live must be {must}"):
            BrowserView(estimator, wrong)


# -- in a browser


@pytest.fixture
def show(browser, view) -> Iterator:
    """Open the page; at the end nothing may have gone wrong, and nothing else been asked."""
    requests, console, pages = [], [], []

    def open_page(before: str = ""):
        page = browser.new_page()
        pages.append(page)
        page.on("request", lambda request: requests.append(request.url))
        page.on("pageerror", lambda error: console.append(str(error)))
        page.on("console", lambda line: console.append(line.text))
        if before:
            page.add_init_script(before)
        page.goto(view.address)
        wait_until(page, "document.getElementById('robot').textContent !== ''")
        wait(lambda: view._clients)
        return page

    yield open_page
    for page in pages:
        page.close()
    assert [line for line in console if NO_GPU not in line] == []
    assert requests != []
    assert [url for url in requests if not url.startswith((view.address, "data:"))] == []


def play(view, page, states) -> None:
    """Publish states, and wait until the page shows the last one."""
    for each in states:
        view.publish(each)
        page.wait_for_timeout(20)
    first = message(view._estimator, states[-1])["quantities"][0]
    wait_until(page, f"document.querySelector('#quantities li')?.textContent === {json.dumps(first)}")


def test_the_page_draws_shape_and_readings_and_they_move(show, view, states):
    page = show()
    wait_until(page, "document.getElementById('status').textContent === 'The estimator is being prepared.'")
    play(view, page, states[:2])
    assert page.get_by_role("status").inner_text() == "Estimating."
    assert not page.locator("#no-shape").is_visible()
    drawn = page.locator("#shape canvas"), page.locator("#traces")
    before = [pixels(part) for part in drawn]
    play(view, page, states[2:13])
    for part, then in zip(drawn, before, strict=True):
        assert differing(then, pixels(part)) > 300, "it did not move"
    assert page.locator("#values li").first.inner_text().startswith("sensor 1 -")
    assert page.locator("#counters").inner_text() == "13 frames, 3 gaps"
    play(view, page, states[13:])
    assert page.get_by_role("status").inner_text() == "sensor 2 gives no reading and is left out."
    assert page.locator("#values li").nth(1).inner_text() == "sensor 2 —"
    view.__exit__()
    wait_until(page, "document.getElementById('status').textContent === 'The session has ended.'")


def colours_at(traces: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Columns of a picture in which a line of this colour is."""
    return np.flatnonzero((np.abs(traces - colour).max(-1) < 60).any(0))


def test_what_is_old_is_grey_marked_and_ends_where_it_ended(show, view, states):
    page = show()
    play(view, page, states[:20])
    marks, shape = page.locator(".mark"), page.locator("#shape canvas")
    assert marks.all_inner_texts() == [""] * 3
    before = pixels(shape)
    coloured = before.max(-1) - before.min(-1) > 60
    assert coloured.sum() > 100
    silent = replace(states[19], age_s=6.2, silent=True, arriving="nothing")
    view.publish(silent)
    wait_until(page, "document.querySelector('.mark').textContent === '6 s old'")
    assert marks.all_inner_texts() == ["6 s old"] * 3
    assert page.get_by_role("status").inner_text() == "No readings: nothing arrives any more."
    assert page.locator("#head").inner_text().startswith("no readings for 6 s; ")
    after = pixels(shape)
    assert (after.max(-1) - after.min(-1) > 60).sum() == 0, "all is grey"
    width = pixels(page.locator("#traces")).shape[1]
    blue = colours_at(pixels(page.locator("#traces")), (0, 0x72, 0xB2))
    assert blue.max() < width * (1 - 6 / 20 * 0.9), "the line ends where the readings did"
    again = [replace(s, time_s=s.time_s + 7.0, since_s=states[20].time_s + 7.0) for s in states[20:30]]
    play(view, page, again)
    assert marks.all_inner_texts() == [""] * 3
    blue = colours_at(pixels(page.locator("#traces")), (0, 0x72, 0xB2))
    assert np.diff(blue).max() > width * 6 / 20 * 0.8, "no line through the time without readings"
    view.__exit__()
    wait_until(page, "document.querySelector('.mark').textContent === 'the last ones'")


def test_a_page_begins_anew_with_another_session_on_its_port(browser, estimator, states):
    """Its time, or its robot, is another one."""
    earlier = subprocess.Popen([sys.executable, "-c", SERVER], stdout=subprocess.PIPE, text=True)
    try:
        number = int(earlier.stdout.readline())
        page = browser.new_page()
        page.goto(f"http://127.0.0.1:{number}/")
        wait_until(page, "document.getElementById('robot').textContent === 'bend_sensor.toml'")
    finally:
        earlier.kill()
        earlier.communicate()
    wait_until(page, "document.getElementById('status').textContent.startsWith('The connection is lost')")
    with BrowserView(estimator, number) as server:
        # The page loads itself anew: for a moment it has no elements.
        wait_until(page, "document.getElementById('robot')?.textContent === 'one_segment.toml'")
        wait(lambda: server._clients)
        play(server, page, states[:2])
    page.close()


def test_without_webgl_the_numbers_stay(show, view, states):
    page = show(
        "const real = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...more)"
        " { return kind === '2d' ? real.call(this, kind, ...more) : null; };"
    )
    play(view, page, states[:3])
    assert page.locator("#no-shape").is_visible()
    assert page.locator("#shape canvas").count() == 0
    assert len(np.unique(pixels(page.locator("#traces")).reshape(-1, 3), axis=0)) > 10


def test_it_fits_a_telephone(show, view, states):
    page = show()
    page.set_viewport_size({"width": 320, "height": 800})
    play(view, page, states[:3])
    assert page.evaluate("document.documentElement.scrollWidth") <= 320
