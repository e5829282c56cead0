"""Input that is no numbers is refused in words wherever it is given; files are written whole or not at all."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import repro
from repro import InputError
from repro.common import numbers, whole

ARM = repro.load_robot(repro.example() / "robot.toml")
Q, U = np.zeros((12, ARM.n_q)), np.zeros((12, ARM.n_readings))
SQUARES = repro.LevenbergMarquardt(ARM)
SOURCES = Path(repro.__file__).parents[1]
RAGGED, HUGE = [[1.0, 2.0], [1.0]], [10**400]


@given(
    st.recursive(
        st.one_of(st.none(), st.booleans(), st.floats(), st.integers(), st.just(10**400),
                  st.complex_numbers(), st.text(max_size=3), st.binary(max_size=3), st.just({}), st.builds(object)),
        lambda inner: st.lists(inner, max_size=3),
    )
)  # fmt: skip
def test_whatever_is_given_becomes_numbers_or_is_refused_in_one_line(value):
    said = refusal(value)
    assert not said or (said.startswith("Input q of a test must be ") and "\n" not in said)


def refusal(value) -> str:
    try:
        assert numbers(value, "q", "a test").dtype == np.float64
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (RAGGED, "numbers in rows of one length; instead received list [[1.0, 2.0], [1.0]]."),
        (HUGE, "numbers below 1.8e308; instead received a larger list."),
        (10**5000, "numbers below 1.8e308; instead received a larger int."),
        ([1j], "real numbers; instead received list [1j]."),
        ("abc", "numbers; instead received str 'abc'."),
    ],
    ids=["ragged", "huge", "of many digits", "complex", "text"],
)
def test_the_words_of_a_refusal(value, words):
    assert f"Input q of a test must be {words}" in refusal(value)


DOORS = {
    "Robot": (lambda **x: ARM.replaced(**x), ["lower", "upper", "start", "noise", "rate_hz", "earth"]),
    "Sensor": (lambda **x: repro.Sensor(1, 0.05, **x), [
        "radial", "azimuth", "tilt", "position", "direction", "range", "resolution", "noise", "gain",
        "offset", "per_mt",
    ]),
    "Imu": (lambda **x: repro.Imu(1, **({"at": 0.05} | x)), ["at", "orientation", "noise", "world"]),
    "Magnet": (lambda **x: repro.Magnet(repro.Cube(0.01, 1300.0), 1, **({"at": 0.05} | x)), ["at", "direction"]),
    "segments": (lambda **x: repro.ConstantCurvature(**({"length": 0.1, "radius": 0.02} | x)), ["length", "radius"]),
    "link": (repro.Link, ["length"]),
    "affine": (repro.AffineCurvature, ["length"]),
    "ring": (lambda **x: repro.Ring(**({"outer_diameter": 0.02, "inner_diameter": 0.01, "height": 0.01,
                                        "polarisation_mt": 1300.0} | x)),
             ["outer_diameter", "inner_diameter", "height", "polarisation_mt"]),
    "cube": (lambda **x: repro.Cube(**({"edge": 0.01, "polarisation_mt": 1300.0} | x)), ["edge", "polarisation_mt"]),
    "poses": (lambda q: ARM.poses(q, [magnet.place for magnet in ARM.magnets]), ["q"]),
    "calibrate": (lambda **x: repro.calibrate(ARM, **({"q": Q, "u": U} | x)), ["q", "u", "q_covariance"]),
    "fit_shape": (lambda **x: repro.fit_shape(ARM, **({"poses": np.tile(np.eye(4), (5, 2, 1, 1))} | x)),
                  ["poses", "times", "noise"]),
    "track": (lambda **x: repro.track(SQUARES, **({"readings": U} | x)),
              ["readings", "q0", "times", "rate_hz", "mask", "known"]),
    "step": (lambda **x: SQUARES.step(SQUARES.init(), **({"u": U[0]} | x)), ["u", "mask", "known"]),
}  # fmt: skip


@pytest.mark.parametrize("value", [RAGGED, HUGE, 10**400], ids=["ragged", "huge in a list", "huge"])
@pytest.mark.parametrize(
    ("door", "name"), [(door, name) for door, (_, names) in DOORS.items() for name in names]
)
def test_no_door_lets_words_of_numpy_out(door, name, value):
    if (door, name) == ("step", "mask") and value is not RAGGED:
        value = RAGGED
    with pytest.raises(InputError, match="instead received"):
        DOORS[door][0](**{name: value})


@pytest.mark.parametrize("word", ["²", "٣٣", "-1", "9", ""])
def test_a_part_that_there_is_not_is_refused_in_words(word):
    with pytest.raises(InputError, match=r"sensor of live must be one of B1 \(1\), B2 \(2\)"):
        ARM.part(word, "live")


def left(folder):
    return sorted(path.name for path in folder.iterdir())


def write(path, text, new=True):
    with whole(path, "a test", new=new) as part:
        part.write_text(text)
        assert path.exists() == (text != "new")  # until then, what was there before


def test_a_file_or_folder_takes_its_name_when_it_is_whole(tmp_path):
    for name in (".a.csv.part", ".a.part"):  # left by a process that was killed
        (tmp_path / name).mkdir()
    write(tmp_path / "a.csv", "new")
    write(tmp_path / "a.csv", "newer", new=False)
    with whole(tmp_path / "a", "a test") as part:
        part.mkdir()
        (part / "b.csv").write_text("inside")
    assert left(tmp_path) == [".a.csv.part", ".a.part", "a", "a.csv"]
    assert (tmp_path / "a.csv").read_text() == "newer"
    assert left(tmp_path / "a") == ["b.csv"]


def test_what_fails_leaves_nothing_and_replaces_nothing(tmp_path):
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(InputError, match=r"output of a test must be a new file .*mine \(File exists\)"):
        write(tmp_path / "mine", "another")
    with pytest.raises(InputError, match=r"must be a file that can be made; .*\(No such file or directory\)"):
        write(tmp_path / "none" / "a", "new")
    with pytest.raises(InputError, match=r"must be a file that can be made; .*"):  # nor can it be looked for
        write(tmp_path / ("a" * 250), "new")
    with pytest.raises(UnicodeEncodeError):
        write(tmp_path / "a", "\ud800")
    assert left(tmp_path) == ["mine"]
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_process_says_once_that_it_compiles_if_nothing_is_on_disk_and_a_page_never(tmp_path):
    code = "from repro.chain import turn; import numpy as np; "
    code += "turn(0.1, 0.2, 0.3, np.zeros((3, 4)), np.zeros((3, 3))); "
    code += "from repro.sensing import rotation_vector; rotation_vector(np.eye(3), np.zeros(3))"

    def said(**own):
        environment = os.environ | {"PYTHONPATH": str(SOURCES)} | own
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return done.stderr.splitlines()

    first, page = ({"NUMBA_CACHE_DIR": str(tmp_path / name)} for name in ("first", "page"))
    assert said(**page, REPRO_RESULTS=str(tmp_path)) == []
    (line,) = said(**first)
    assert line == "repro: Compiling for this machine once, about 10 s; later runs take it from disk."
    assert said(**first) == []


FIRST_ANSWER = """
import sys
import repro
from repro.sensing import evaluate

def heard(event, given):
    if event == "subprocess.Popen":
        print("process")
        if "alone" in sys.argv:
            raise PermissionError

sys.addaudithook(heard)
robot = repro.load_robot(repro.example() / "robot.toml")
method = repro.LevenbergMarquardt(robot)
_, estimate = method.step(method.init(), [0.1 * k for k in range(robot.n_readings)])
print(sum(evaluate.stats.cache_hits.values()))
print(estimate.q.tobytes().hex(), estimate.covariance.tobytes().hex())
"""


@pytest.mark.slow
@pytest.mark.skipif(os.cpu_count() == 1, reason="one process compiles everything")
def test_two_processes_compile_the_same_kernels_as_one(tmp_path):
    """And what is on disk starts no process."""

    def answered(folder, *words):
        environment = os.environ | {"PYTHONPATH": str(SOURCES), "NUMBA_CACHE_DIR": str(tmp_path / folder)}
        command = [sys.executable, "-c", FIRST_ANSWER, *words]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        *said, bits = done.stdout.splitlines()
        return said, bits, sorted(x.name.split("-")[0] for x in (tmp_path / folder).rglob("*.nbc"))

    said, *together = answered("together")
    assert said == ["process", "1"]
    assert answered("together") == (["0"], *together)
    assert answered("alone", "alone")[0] == ["process", "0"]
    assert answered("alone") == (["0"], *together)
