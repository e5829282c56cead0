"""The commands for a robot and a board, as a user types them: from a robot file to an evaluated robot."""

from __future__ import annotations

import inspect
import io
import os
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import repro
from repro.check import check_design
from repro.estimators.calibration import load_calibration
from repro.improve import improve_design
from repro_board import cli, emulate, live
from repro_board.cli import main
from repro_board.evaluate import calibrate_files, evaluate_files, track_file
from repro_board.live import Follower
from repro_board.record import Writer
from tests.board.waiting import LONGEST_S, until

SEED = 3
CALLED = [
    (cli.check, check_design), (cli.check, improve_design), (cli.evaluate, evaluate_files), (cli.record, live.record),
    (cli.live, live.Line), (cli.live, live.Method), (cli.emulate, emulate.emulate),
]  # fmt: skip
"""Commands, and the functions that they call."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Return a folder with a robot, a recording of its motion and one of held poses, and measured poses."""
    folder = tmp_path_factory.mktemp("robot")
    shutil.copy(repro.example() / "robot.toml", folder)
    robot = repro.load_robot(folder / "robot.toml")
    poses = emulate.spread_poses(robot, seed=SEED)
    emulate.write_poses(folder / "poses.csv", robot, poses, hold_s=1.0)
    held = {"motion": lambda times: emulate.held(poses, 1.0, times)}
    for name, seconds, options in (("motion.rec", 30.0, {}), ("held.rec", 1.5 * len(poses), held)):
        with closing(Writer(folder / name, {"port": "emulated"})) as writer:
            for time_s, data in emulate.board_bytes(robot, tolerances=1, seed=SEED, **options):
                if time_s > seconds:
                    break
                writer.write(round(1e9 * time_s), data)
            writer.note(round(20e9), "load on")
    times = np.arange(0.0, 30.0, 0.025)
    q = 1e3 * emulate.course(robot, times, seed=SEED)
    q += 0.05 * np.random.default_rng(SEED).standard_normal(q.shape)  # a fixed coordinate is measured, too
    captured = pd.DataFrame(q, columns=[f"{name}_mm" for name in robot.coordinates])
    captured.assign(time_s=times + 0.7).to_csv(folder / "captured.csv", index=False)
    return folder


@contextmanager
def emulated(folder: Path, *options: str) -> Iterator[str]:
    command = [
        sys.executable,
        "-m",
        "repro_board.cli",
        "emulate",
        "robot.toml",
        "--port-file",
        "board",
        *options,
    ]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as board:
        try:
            assert board.stdout is not None
            assert "SYNTHETIC" in board.stdout.readline()
            board.stdout.readline()
            yield "board"
        finally:
            board.kill()


@pytest.mark.slow
def test_from_a_robot_file_to_an_evaluation(folder, monkeypatch, capsys):
    """The robot is not as its file says: only a calibration makes its estimates right."""
    monkeypatch.chdir(folder)
    assert main(["check", "robot.toml"]) == 0
    assert "can work once it is calibrated" in capsys.readouterr().out
    robot = ["--robot", "robot.toml"]
    assert main(["track", "motion.rec", *robot, "-o", "first.csv"]) == 0
    assert "the readings do not fit together" in capsys.readouterr().out
    assert main(["calibrate", "held.rec", "poses.csv", *robot, "-o", "calibration.json"]) == 0
    assert main(["track", "motion.rec", *robot, "--calibration", "calibration.json", "-o", "shape.csv"]) == 0
    truth = emulate.course(
        described := repro.load_robot("robot.toml"), (t := pd.read_csv("shape.csv"))["time_s"], seed=SEED
    )
    error = np.linalg.norm(
        t[["tip_x_mm", "tip_y_mm", "tip_z_mm"]] - 1e3 * described.tip(truth)[:, :3, 3], axis=1
    )
    assert np.median(error) < 1.5
    assert main(["export", "motion.rec", "-o", "motion.csv", *robot]) == 0
    assert (
        main(
            [
                "track",
                "motion.csv",
                *robot,
                "--smooth",
                "--calibration",
                "calibration.json",
                "-o",
                "smooth.csv",
            ]
        )
        == 0
    )
    capsys.readouterr()
    assert main(["evaluate", "motion.rec", "captured.csv", *robot, "-o", "evaluated"]) == 0
    lag_ms = re.search(r"Lag: (\S+) ± ", capsys.readouterr().out)
    assert lag_ms is not None
    assert float(lag_ms[1]) == pytest.approx(-700, abs=3)
    noted = re.search(
        r"^ +1 +(\S+)  load on$", Path("evaluated/report.txt").read_text(encoding="utf-8"), re.M
    )
    assert noted is not None
    assert float(noted[1]) == pytest.approx(20.0, abs=0.05)
    assert {path.name for path in Path("evaluated").iterdir()} >= {
        "report.txt",
        "errors.csv",
        "estimates.png",
    }


def test_live_states_what_a_calibration_leaves_open(folder):
    """As track does, which computes it for every row."""
    robot, file = repro.load_robot(folder / "robot.toml"), folder / "calibration.json"
    if not file.exists():
        calibrate_files(folder / "held.rec", folder / "poses.csv", folder / "robot.toml", file)
    calibration = load_calibration(file, robot)
    tracked = track_file(folder / "motion.rec", folder / "robot.toml", calibration=file).found
    follower = Follower(calibration.robot, calibration=calibration)
    rows = zip(tracked.readings, tracked.times, strict=True)
    covariances = np.array([follower.step(u, t).covariance for u, t in rows])
    stated, tip = (np.sqrt(np.trace(C, axis1=1, axis2=2)) for C in (covariances, tracked.covariance))
    assert np.median(stated / tip) == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
def test_a_port_is_recorded_and_followed(folder, monkeypatch, capsys):
    """Until somebody presses Ctrl-C, when there is enough."""
    monkeypatch.chdir(folder)

    def lines(name: str) -> int:
        """Of a file that is there or being written, under another name."""
        with suppress(FileNotFoundError):  # it has just got its name
            return sum(path.read_bytes().count(b"\n") for path in folder.glob(f"*{name}*"))
        return 0

    def stop(name: str) -> None:
        until(lambda: lines(name) > 21)
        os.kill(os.getpid(), signal.SIGINT)

    at_most = ["--duration", f"{2 * LONGEST_S:.0f}"]
    live = ["live", "board", "--robot", "robot.toml", "--estimates", "live.csv"]
    with emulated(folder):  # it has said that its port is there
        for words, name in ((["record", "board", "-o", "port.rec"], "port.rec"), (live, "live.csv")):
            thread = threading.Thread(target=stop, args=(name,), daemon=True)
            thread.start()
            assert main([*words, *at_most]) == 0
            thread.join(LONGEST_S)
    assert len(pd.read_csv("live.csv")) > 20
    assert main(["track", "port.rec", "--robot", "robot.toml", "-o", "port.csv"]) == 0
    assert {"time_s", "tip_x_mm", "status", "suspects"} <= {*pd.read_csv("port.csv")}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("track none.csv --robot robot.toml", "none.csv"),
        ("track motion.rec --robot none.toml", "none.toml"),
        ("track motion.rec", "parameter --robot requires an argument"),
        ("track motion.rec --robot robot.toml --estimator best", "must be one of levenberg_marquardt"),
        ("track motion.rec --robot robot.toml -o robot.toml", "must be one that does not exist yet"),
        ("show motion.rec --robot robot.toml -o robot.toml", "must be one that does not exist yet"),
        ("show motion.rec --robot robot.toml", "parameter -o requires an argument"),
        ("calibrate held.rec --robot robot.toml -o c.json", "must be given"),
        (
            "calibrate u.csv --self --pose-noise-deg 1 --robot robot.toml -o c.json",
            "must be left out with --self",
        ),
        ("record -o x.rec", "must be given (repro record --list shows them)"),
        ("record nowhere -o x.rec", "nowhere"),
        ("emulate none.toml", "none.toml"),
        ("emulate robot.toml --fault gravity 1", "must be one of"),
        ("export robot.toml -o x.csv", "robot.toml"),
        ("check robot.toml --before-calibration", "must be left out without --target-mm or --improve"),
        ("live nowhere --robot robot.toml --browser-socket 7", "must be left out without --browser"),
        ("live nowhere --robot robot.toml --grown 1e300", "must be positive and at most 1e6"),
        ("live nowhere --robot robot.toml -o x --estimates x", "must be another file than the recording"),
        ("emulate robot.toml --tolerances 1e300", "must be 0 to 100"),
        ("check robot.toml --samples 50.7", "--samples: it must be a whole number"),
        ("record nowhere -o x.rec --channels 2.5", "--channels: it must be a whole number"),
        ("emulate robot.toml --seed 0.4", "--seed: it must be a whole number"),
        ("weigh robot.toml", "weigh"),
    ],
)
def test_wrong_input_ends_with_2_and_one_line(words, said, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert main(words.split()) == 2
    line = capsys.readouterr().err
    assert said in line
    assert len(line.splitlines()) == 1
    assert line.startswith("repro")


@pytest.mark.parametrize(
    ("rows", "words", "said"),
    [
        (
            1,
            "calibrate few.csv poses.csv -o new.json",
            "pose of poses.csv, line 2, must be within the readings",
        ),
        (
            1,
            "calibrate few.csv --self -o new.json",
            "there in three rows or more, for --self; instead received 1 of",
        ),
        (
            2,
            "evaluate few.csv captured.csv -o new",
            "given with the readings, three or more; instead received 2",
        ),
        (
            9,
            "calibrate nothing.csv --self -o new.json",
            "in three rows or more, for --self; instead received 0 of B1x",
        ),
    ],
)
def test_too_few_readings_are_refused_in_words(rows, words, said, folder, tmp_path, monkeypatch, capsys):
    robot = repro.load_robot(folder / "robot.toml")
    u = pd.DataFrame(np.ones((rows, 12)), columns=robot.names).assign(time_s=0.1 * np.arange(rows))
    shutil.copytree(folder, tmp_path / "a", symlinks=True)  # that of a port is left
    monkeypatch.chdir(tmp_path / "a")
    u.to_csv("few.csv", index=False)
    u.assign(**dict.fromkeys(robot.names, "nan")).to_csv("nothing.csv", index=False)
    assert main([*words.split(), "--robot", "robot.toml"]) == 2
    assert said in (line := capsys.readouterr().err)
    assert len(line.splitlines()) == 1


AT_ROBOT = "--robot robot.toml"
WRITERS = {
    "check robot.toml --improve -o": "output",
    "check robot.toml --improve --picture": "picture",
    f"track motion.rec {AT_ROBOT} -o": "output",
    f"show motion.rec {AT_ROBOT} -o": "output",
    f"calibrate held.rec poses.csv {AT_ROBOT} -o": "output",
    f"calibrate motion.rec --self {AT_ROBOT} -o": "output",
    f"evaluate motion.rec captured.csv {AT_ROBOT} -o": "output",
    "export motion.rec --to csv -o": "output",
    "record socket://127.0.0.1:1 -o": "output",
    f"live socket://127.0.0.1:1 {AT_ROBOT} -o": "output",
    f"live socket://127.0.0.1:1 {AT_ROBOT} --estimates": "estimates",
    "emulate robot.toml --hold-poses": "output",
    "emulate robot.toml --port-file": "port_file",
}
"""Commands that write, up to the file, and what messages call it."""


@pytest.mark.parametrize("output", ["robot.toml", ".", "none/x"])
@pytest.mark.parametrize("words", WRITERS)
def test_every_command_refuses_what_it_cannot_write_before_it_works(
    words, output, folder, monkeypatch, capsys
):
    """A file that is there, a folder, and one in no folder; no search and no port is begun before."""
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    assert main([*words.split(), output]) == 2
    line = capsys.readouterr().err
    assert line.startswith(f"repro {words.split()[0]}: Input {WRITERS[words]} of ")
    assert len(line.splitlines()) == 1
    assert output in line
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("words", ["record", f"live {AT_ROBOT} --estimates new.csv"])
def test_a_port_from_which_nothing_comes_ends_with_1_and_a_sentence(words, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    with socket.create_server(("127.0.0.1", 0)) as board:
        name, *options = words.split()
        port = f"socket://127.0.0.1:{board.getsockname()[1]}"
        assert main([name, port, *options, "-o", "new.rec", "--duration", "0.3"]) == 1
    said = capsys.readouterr()
    assert re.search("^(Nothing|No readings of this robot) came, .*[.]$", said.out + said.err, re.MULTILINE)
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    "words",
    [
        "track motion.rec --robot robot.toml -o new.csv",
        "show motion.rec --robot robot.toml -o new.html",
        "export motion.rec --robot robot.toml -o new.csv",
        "export motion.rec -o new.mcap",
    ],
)
def test_a_full_disk_ends_with_1_and_leaves_nothing(words, folder, monkeypatch, capsys):
    """A limit of the file size, which the operating system enforces as it does a full disk."""
    monkeypatch.chdir(folder)
    before, limit = sorted(folder.iterdir()), resource.getrlimit(resource.RLIMIT_FSIZE)
    track_file("motion.rec", "robot.toml")  # all that it needs is compiled
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # of a module: it would be cut off, and stay so
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limit[1]))
    try:
        assert main(words.split()) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    name = " ".join(words.split()[:1])
    said = f"repro {name}: a file cannot be read or written: new.{words[-4:].strip('.')}: File too large"
    assert said in capsys.readouterr().err
    assert sorted(folder.iterdir()) == before


def test_a_terminal_without_a_sign_shows_a_question_mark(folder, monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    assert main(["check", str(folder / "robot.toml"), "--samples", "20"]) == 0
    sys.stdout.flush()
    assert b"known to ?" in sys.stdout.buffer.getvalue()


def test_check_proposes_a_better_robot_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = (repro.example() / "robot.toml").read_text(encoding="utf-8")
    Path("robot.toml").write_text(text, encoding="utf-8")
    few = ["--samples", "20"]
    error = 1e3 * np.median(repro.load_robot("robot.toml").check(samples=20).tip_within_bounds)
    assert main(["check", "robot.toml", *few, "--target-mm", f"{1.01 * error}"]) == 0
    capsys.readouterr()
    assert main(["check", "robot.toml", *few, "--target-mm", f"{0.9 * error}"]) == 1
    assert capsys.readouterr().out.endswith(f"The target of ±{0.9 * error:g} mm is missed.\n")
    new = ["--improve", "-o", "new.toml", "--picture", "chips.svg"]
    assert main(["check", "robot.toml", *few, "--target-mm", f"{1.01 * error}", *new]) == 0
    assert "new.toml is not written: there is nothing to write." in capsys.readouterr().err
    assert main(["check", "robot.toml", *few, "--target-mm", f"{0.9 * error}", *new]) == 0
    said = capsys.readouterr().out.splitlines()
    assert main(["check", "new.toml", *few, "--target-mm", f"{0.9 * error}"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == said[-1]
    assert Path("chips.svg").read_bytes().startswith(b"<?xml")
    assert main(["check", "robot.toml", *few, "-o", "other.toml"]) == 2
    assert "output of repro check must be left out without --improve" in capsys.readouterr().err
    assert main(["check", "robot.toml", *few, "--target-mm", "0"]) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["chips.svg", "new.toml", "robot.toml"]


@pytest.mark.parametrize(("command", "function"), CALLED)
def test_what_a_command_takes_for_a_number_that_is_not_given_its_function_takes_too(command, function):
    typed, called = (
        {name.removesuffix("_s"): one.default for name, one in inspect.signature(own).parameters.items()}
        for own in (command, function)
    )
    both = [name for name in typed.keys() & called.keys() if isinstance(typed[name], int | float)]
    assert both
    assert {name: typed[name] for name in both} == {name: called[name] for name in both}
