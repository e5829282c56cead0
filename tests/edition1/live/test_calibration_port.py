"""Calibrating at a port: boards that go away, sessions that go on, readings that are kept; nonsense refused."""

import contextlib
import os
import subprocess
import sys
import threading
import time
import tty
from dataclasses import replace

import pytest
import torch
from test_calibrate import ROBOT, ROBOTS, Bench, built, noisy, random_poses, table

from edition1.errors import InputError
from edition1_live.record.ports import close_port, open_port
from edition1_live.robot.calibrate import calibrate, check_plausible, pose_covariance
from edition1_live.robot.calibration_port import guide, port_frames
from edition1_live.robot.calibration_poses import (
    coordinate_columns,
    pose_readings,
    read_kept_readings,
    read_poses,
)
from edition1_live.robot.kept_readings import KeptReadings, is_kept, part_of
from edition1_live.wire.formats import encode
from edition1_live.wire.frame import Frame

COORDINATES = tuple(coordinate_columns(ROBOT))
needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")


@pytest.fixture
def bench():
    found = Bench(ROBOT, built(ROBOT, 3))
    yield found
    found.close()


def frames_of(bench, say=print):
    return port_frames(bench.port, 115200, ROBOT, say)


@needs_pty
def test_a_board_that_falls_silent_is_waited_for(tmp_path, bench):
    """It is silent when the key is pressed, and for a second; meanwhile the robot is brought where it belongs."""
    q, said = random_poses(ROBOT, 2), []
    gate = threading.Event()
    gate.set()

    class Board:
        """Sends what the bench sends while the gate is open."""

        def __iter__(self):
            for frame in frames_of(bench):
                if gate.is_set():
                    yield frame

    def ask(question):
        bench.bring(q[0] if "Pose 1" in question else q[1])
        time.sleep(0.1)
        if "Pose 2" in question:
            gate.clear()
            threading.Timer(1.0, gate.set).start()

    poses = read_poses(table(tmp_path, q), ROBOT)
    taken = guide(ROBOT, poses, iter(Board()), say=said.append, ask=ask, silence_s=0.3)
    assert said == [
        "No frame for 0.3 s: waiting for the board. Keep the pose; Ctrl-C ends.",
        "The board is back; half a second from now on.",
    ]
    torch.testing.assert_close(taken.values, bench.truth.values(q), rtol=0, atol=5e-4)


@needs_pty
def test_a_port_that_disappears_is_opened_again(tmp_path):
    """A link stands for the port: the first terminal hangs up during a pose, the next one comes a moment later."""
    link, q, said = tmp_path / "board", random_poses(ROBOT, 1), []
    values = tuple(ROBOT.values(q)[0].tolist())

    def terminal():
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(slave))
        return master, slave

    def send(master, n):
        for k in range(n):
            with contextlib.suppress(BlockingIOError):  # nobody reads after the last pose
                os.write(master, encode("frames", Frame(0, k, k, values)))
            time.sleep(0.01)

    def board():
        send(first[0], 10)
        for end in first:
            os.close(end)
        time.sleep(0.5)
        second.extend(terminal())
        send(second[0], 150)

    first, second = terminal(), []
    source = port_frames(str(link), 115200, ROBOT, said.append)
    thread = threading.Thread(target=board)
    poses = read_poses(table(tmp_path, q), ROBOT)
    taken = guide(ROBOT, poses, source, say=said.append, ask=lambda _: thread.start(), silence_s=0.3)
    thread.join()
    for end in second:
        os.close(end)
    assert "is gone" in said[0]
    assert f"{link} is back." in said
    torch.testing.assert_close(taken.values[0], torch.tensor(values, dtype=torch.float64))


@needs_pty
@pytest.mark.parametrize("gone", [False, True])
def test_the_port_is_left_when_the_poses_end_whatever_the_board_does(tmp_path, gone):
    """A board that says nothing, or is gone: nobody reads its port any more, and the next program may."""
    master, slave = os.openpty()
    poses = read_poses(table(tmp_path, random_poses(ROBOT, 1)), ROBOT)
    port, before = os.ttyname(slave), threading.active_count()
    source = port_frames(port, 115200, ROBOT, print)
    ask = (lambda _: (os.close(master), os.close(slave))) if gone else print
    with pytest.raises(InputError, match="none for 0.5 s"):
        guide(ROBOT, poses, source, say=print, ask=ask, silence_s=0.3, patience_s=0.5)
    assert threading.active_count() == before
    if not gone:
        close_port(open_port(port))
        os.close(master)
        os.close(slave)


def test_a_port_that_was_never_there_is_refused(tmp_path):
    with pytest.raises(InputError, match="^Input port of repro calibrate must be one that is there "):
        port_frames(str(tmp_path / "board"), 115200, ROBOT, print)


@needs_pty
def test_half_a_second_is_a_time_and_the_rate_is_told(tmp_path):
    """A board of 40 Hz with a robot file that says 1000 Hz."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    stop = threading.Event()

    def send():
        k = 0
        while not stop.wait(0.025):
            with contextlib.suppress(BlockingIOError):
                os.write(master, encode("frames", Frame(0, k, k, (1.0, 2.0, 3.0))))
            k += 1

    thread = threading.Thread(target=send)
    thread.start()
    poses = read_poses(table(tmp_path, random_poses(ROBOT, 2)), ROBOT)
    source = port_frames(os.ttyname(slave), 115200, ROBOT, print)
    kept = KeptReadings(tmp_path / "c.readings.csv", ROBOT.channels, COORDINATES)
    taken = guide(ROBOT, poses, source, say=print, ask=lambda _: None, kept=kept)
    stop.set()
    thread.join()
    os.close(master)
    os.close(slave)
    assert all(2 <= part.frames < 50 and part.seconds >= 0.5 for part in kept.parts)
    (note,) = taken.notes
    assert note.endswith("frames arrive per second; one_segment.toml says rate_hz = 1000.")


def stream(values_of):
    """Frames without end, in time, of what ``values_of()`` returns."""
    while True:
        time.sleep(2e-3)
        yield Frame(0, 0, 0, tuple(values_of()))


def test_a_session_goes_on_where_it_was_interrupted(tmp_path):
    q, at, said = random_poses(ROBOT, 4), [0], []
    values = ROBOT.values(q).tolist()
    poses, path = read_poses(table(tmp_path, q), ROBOT), tmp_path / "c.readings.csv"

    def session(last):
        kept = KeptReadings(path, ROBOT.channels, COORDINATES)

        def ask(question):
            at[0] = int(question.split()[1]) - 1
            said.append(question.split(":")[0])
            if at[0] == last:
                raise KeyboardInterrupt

        return guide(
            ROBOT, poses, stream(lambda: values[at[0]]), say=said.append, ask=ask, kept=kept, silence_s=60.0
        )

    with pytest.raises(KeyboardInterrupt):
        session(2)
    with path.open("a") as file:
        file.write("3,0.1,0.2")  # killed while it wrote
    taken = session(None)
    assert said == [
        *("Pose 1 of 4", "Pose 2 of 4", "Pose 3 of 4"),
        "c.readings.csv holds the readings of 2 poses. Going on with pose 3; to begin anew, move it away.",
        *("Pose 3 of 4", "Pose 4 of 4"),
    ]
    torch.testing.assert_close(taken.values, ROBOT.values(q), rtol=0, atol=1e-12)
    assert is_kept(path)
    again = read_kept_readings(path, ROBOT, poses)
    assert torch.equal(again.values, taken.values)
    assert torch.equal(session(None).values, taken.values)
    assert said[-1].startswith("c.readings.csv holds the readings of 4 poses. All are taken")
    other = read_poses(table(tmp_path, q.flip(0), name="other.csv"), ROBOT)
    with pytest.raises(InputError, match="must be of the first poses of the table .* those of 4 other poses"):
        guide(ROBOT, other, iter(()), say=print, ask=print, kept=KeptReadings(path, 3, COORDINATES))
    assert read_kept_readings(path, ROBOT, other).notes[-1] == (
        "c.readings.csv was taken with another table of poses; the one given is used."
    )
    fewer = read_poses(table(tmp_path, q[:3], name="fewer.csv"), ROBOT)
    with pytest.raises(InputError, match="must be of all 3 poses of the table .* instead received 4 poses"):
        read_kept_readings(path, ROBOT, fewer)


def test_files_of_readings_that_are_damaged(tmp_path):
    path = tmp_path / "c.readings.csv"
    kept = KeptReadings(path, 3, COORDINATES)
    kept.add(torch.zeros(3), part_of(torch.ones(5, 3).numpy(), 0.5))
    intact = path.read_text()
    for text, message in (
        ("a,b\n", "must be a file that repro calibrate began"),
        (intact.replace("pose,", "row,"), "Input columns of c.readings.csv must be pose, delta_x_1_mm"),
        (intact + "3" + intact.splitlines()[-1][1:] + "\n", "must be complete, of finite numbers, in order"),
        (intact + "2,nan\n", "must be complete, of finite numbers, in order"),
        (intact + "2,x\n", "must be complete, of finite numbers, in order"),
        (intact.replace("1.0,1.0,1.0", "nan,1.0,1.0"), "must be complete, of finite numbers, in order"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            KeptReadings(path, 3, COORDINATES)
        assert path.read_text() == text
    with pytest.raises(InputError, match="readings of c.csv must be a file that can be written"):
        KeptReadings(tmp_path / "none" / "c.csv", 3, COORDINATES)


def test_some_frames_of_another_width_are_left_out_many_are_refused(tmp_path):
    q = random_poses(ROBOT, 1)
    poses, count, values = read_poses(table(tmp_path, q), ROBOT), [0], ROBOT.values(q)[0].tolist()

    def every(n, other):
        def row():
            count[0] += 1
            return other if count[0] % n == 0 else values

        return stream(row)

    for other in ((9.0, 9.0), (9.0, float("nan"), 9.0)):
        taken = guide(ROBOT, poses, every(5, other), say=print, ask=lambda _: None)
        torch.testing.assert_close(taken.values, ROBOT.values(q), rtol=0, atol=1e-12)
    with pytest.raises(InputError, match="of 3 channels, as described in one_segment.toml; .* 2 values"):
        guide(ROBOT, poses, every(1, (9.0, 9.0)), say=print, ask=lambda _: None)
    with pytest.raises(InputError, match="Input frames of the stream must be of finite numbers"):
        guide(ROBOT, poses, every(1, (9.0, float("nan"), 9.0)), say=print, ask=lambda _: None)


POSES_AS_STATED = pose_covariance(ROBOT, 2e-4, 0.01)
X, L = (torch.tensor([name.startswith(f"delta_{axis}") for name in COORDINATES]) for axis in "xL")
NONSENSE = {
    "axes exchanged": lambda q: q[:, [1, 0, 2]],
    "in m": lambda q: 1e-3 * q,
    "in cm": lambda q: 0.1 * q,
    "another order": lambda q: q.flip(0),
    "one row too late": lambda q: q.roll(1, 0),
    "wrong sign of x": lambda q: torch.where(X, -q, q),
    "wrong sign of x and y": lambda q: torch.where(L, q, -q),
    "wrong sign of the elongation": lambda q: torch.where(L, -q, q),
}


def session(poses, seed):
    """Readings and measured poses of a robot unlike its drawing, with offsets and an Earth field."""
    truth, q = built(ROBOT, seed, offset=0.3, earth=(0.02, 0.0, -0.04)), random_poses(ROBOT, poses, seed)
    return noisy(truth.values(q), ROBOT.noise, seed + 1), noisy(q, 2e-4, seed + 2)


@pytest.mark.parametrize("poses", [20, 40])
def test_honest_calibrations_pass(poses):
    values, q = session(poses, poses)
    check_plausible(calibrate(ROBOT, values, q, POSES_AS_STATED), ROBOT)
    check_plausible(calibrate(ROBOT, ROBOT.values(q), q, POSES_AS_STATED), ROBOT)  # exactly as described


@pytest.mark.parametrize("name", NONSENSE)
def test_nonsense_is_refused(name):
    values, q = session(20, 7)
    with pytest.raises(InputError, match="usual causes if not: axes exchanged"):
        check_plausible(calibrate(ROBOT, values, NONSENSE[name](q), POSES_AS_STATED), ROBOT)


def test_a_fit_that_is_worse_than_the_drawing_is_refused():
    found = calibrate(
        ROBOT, ROBOT.values(random_poses(ROBOT, 8)), random_poses(ROBOT, 8), torch.eye(3).double()
    )
    check_plausible(replace(found, before=1.0, after=1.1, chi2=1.0), ROBOT)
    with pytest.raises(
        InputError, match="a residual of 1.1 mT in poses held out of the fit, above the 1 mT as desc"
    ):
        check_plausible(replace(found, before=1.0, after=1.1, chi2=5.0), ROBOT)


def test_the_command_refuses_nonsense_and_takes_the_kept_readings_again(tmp_path):
    q, truth = random_poses(ROBOT, 20), built(ROBOT, 3)
    path, output = tmp_path / "c.readings.csv", tmp_path / "c.json"
    kept = KeptReadings(path, 3, COORDINATES)
    for pose, values in zip(q, noisy(truth.values(q), ROBOT.noise, 5), strict=True):
        kept.add(pose, part_of(values[None].numpy(), 0.0))
    before = path.read_bytes()
    wrong = table(tmp_path, q[:, [1, 0, 2]], name="wrong.csv")

    def run(poses):
        command = [
            sys.executable,
            "-m",
            "edition1_companion.cli",
            "calibrate",
            path,
            "--robot",
            ROBOTS / "one_segment.toml",
        ]
        return subprocess.run(
            [*map(str, command), "--poses", str(poses), "-o", str(output)],
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )

    refused = run(wrong)
    assert refused.returncode == 2
    assert "usual causes if not: axes exchanged or of the wrong sign, another unit" in refused.stderr
    assert not output.exists()
    assert path.read_bytes() == before
    assert "was taken with another table of poses" in refused.stdout
    done = run(table(tmp_path, q))
    assert done.returncode == 0, done.stderr
    assert output.exists()


def test_the_rate_of_a_recording_is_compared_with_the_file():
    robot = replace(ROBOT, rate_hz=40.0)
    part = part_of(ROBOT.values(random_poses(ROBOT, 21)).numpy() * 0, 0.5)
    assert pose_readings([part], robot).notes == ()
    assert pose_readings([part], replace(ROBOT, rate_hz=60.0)).notes == (
        "40 frames arrive per second; one_segment.toml says rate_hz = 60.",
    )
