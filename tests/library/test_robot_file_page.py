"""The page on the robot file: it names every key, its examples load, and its message is what a mistake gets."""

import re
import tomllib
from pathlib import Path

import pytest

from repro import InputError, load_robot, robot_file
from repro.tolerances import Tolerances
from repro_board.evaluate import TOLERANCES

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "book" / "robot_file.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```toml\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)


def loaded(folder: Path, text: str):
    (folder / "robot.toml").write_text(text, encoding="utf-8")
    return load_robot(folder / "robot.toml")


@pytest.fixture
def known(monkeypatch):
    """Return all keys that reading a file looks for."""
    keys, read = set(), robot_file._Document.read

    def listed(self, table, *place):
        keys.update(table)
        return read(self, table, *place)

    monkeypatch.setattr(robot_file._Document, "read", listed)
    return keys


def test_the_page_names_every_key(known, tmp_path):
    raw = EXAMPLES[0].replace('unit = "mT"\nnoise_mt', 'unit = "raw"\nnoise_raw')
    loaded(tmp_path, raw.replace("axes = 3", "axes = 3\ngain_raw_per_mt = 100.0"))
    mv = EXAMPLES[0].replace('unit = "mT"\nnoise_mt', 'unit = "mV"\nnoise_mv')
    loaded(tmp_path, mv.replace("axes = 3", "axes = 3\ngain_mv_per_mt = 5.0"))
    for text in EXAMPLES:
        loaded(tmp_path, text)
    for kinds in robot_file._SEGMENTS.values():
        known.update(*kinds)
    for kind in (*robot_file._MAGNETS.values(), *robot_file._CUBE_BY_SIDE.values()):
        known.update(kind)
    for tolerances in robot_file._TOLERANCES.values():
        known.update(tolerances)
    tables = {f"[[{name}]]" for name in robot_file._PARTS} | {"[stream]", "[model]"}
    named = set(re.findall(r"`([\w]+)`", PAGE)) | {"networks"} & set(re.findall(r"`(\w+) = ", PAGE))
    missing = {
        key for key in known if key not in named and f"[[{key}]]" not in tables and f"[{key}]" not in tables
    }
    assert not missing
    assert tables <= set(re.findall(r"^## `(\[.*?\]+)`", PAGE, re.MULTILINE))


def test_the_page_names_every_kind_format_and_unit():
    words = (
        *robot_file._SEGMENTS,
        *robot_file._MAGNETS,
        *robot_file._FORMATS,
        *robot_file._PER_MT,
        "mV",
        "raw",
    )
    assert [word for word in words if f"`{word}`" not in PAGE] == []


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_examples_load_and_can_work(number, tmp_path):
    robot = loaded(tmp_path, EXAMPLES[number])
    assert robot.check(samples=20).can_work
    assert robot.rate_hz == tomllib.loads(EXAMPLES[number])["stream"]["rate_hz"]


def test_the_report_of_the_page_is_what_its_example_gets(tmp_path):
    (report,) = re.findall(r"^```text\n(Tip in .*?)\n```", PAGE, re.DOTALL | re.MULTILINE)
    assert report == str(loaded(tmp_path, EXAMPLES[0]).check())


def test_the_message_of_the_page_is_what_a_mistake_gets(tmp_path):
    (message,) = re.findall(r"^```text\n(Input .*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    with pytest.raises(InputError) as error:
        loaded(tmp_path, EXAMPLES[0].replace("polarisation_mt = 1300.0", "polarisation_mt = 1.3"))
    assert str(error.value) == message.replace("\n", " ").strip()


def test_usual_tolerances_are_those_of_the_library():
    usual = Tolerances()
    rows = dict(
        re.findall(r"^\| `(\w+)`.*\| (.*) \|$", PAGE[PAGE.index("(robot-file-tolerance)=") :], re.MULTILINE)
    )
    assert rows["position_mm"].startswith(f"magnets {1e3 * usual.magnet_position:g},")
    chip = f"{1e3 * usual.chip_position:g}"
    assert rows["position_mm"].endswith(f"chips with three axes also {chip} across")
    assert rows["at_mm"].startswith(f"chips with three axes {chip},")
    assert rows["radial_mm"] == f"{100 * usual.sensor_radius:g} % of the distance, 3.6°"
    gains = (
        f"{100 * usual.sensor_gain:g} in `repro check`, {100 * TOLERANCES.sensor_gain:g} in `repro calibrate`"
    )
    assert rows["gain_percent"] == gains
    assert rows["offset_mt"] == f"none in `repro check`, {TOLERANCES.sensor_offset:g} in `repro calibrate`"
    assert usual.sensor_azimuth == pytest.approx(3.6 * 3.141592653589793 / 180)
    assert f"differ by {100 * usual.moments:g} %" in rows["polarisation_percent"]
