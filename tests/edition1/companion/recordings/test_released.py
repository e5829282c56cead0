"""Files against the list of the released ones, with a synthetic list; and the recordings where found."""

import hashlib
import re
from pathlib import Path

import pytest

from edition1_companion.recordings.released import unlike_released
from edition1_companion.recordings.sources import RecordedFile, data_dir, read_sources

FOLDER = "mitchell2021"
HALL = "experiment_data/bend_test_0_try_1.csv"
ROWS = "".join(f"[-2.3{k % 10} 0.1{k % 7} 0.0{k % 3}],{1.0 + 0.016 * k}\n" for k in range(300))


@pytest.fixture
def place(tmp_path) -> Path:
    path = tmp_path / FOLDER / HALL
    path.parent.mkdir(parents=True)
    path.write_text(ROWS)
    return path


def listed(by_git: bool = False) -> RecordedFile:
    content = ROWS.encode()
    sha256 = "" if by_git else hashlib.sha256(content).hexdigest()
    blob = hashlib.sha1(b"blob %d\0" % len(content) + content, usedforsecurity=False).hexdigest()
    return RecordedFile(FOLDER, HALL, "owner/name", "0" * 40, sha256, blob, len(content), large=False)


@pytest.mark.parametrize("by_git", [False, True])
def test_released_files_are_told_from_others(tmp_path, place, by_git):
    assert unlike_released([place], [listed(by_git)], tmp_path) == {}
    place.write_text(ROWS[:-3])
    size = len(ROWS)
    assert unlike_released([place], [listed(by_git)], tmp_path) == {
        f"{FOLDER}/{HALL}": f"other content than the released file, {size - 3} bytes instead of {size}"
    }


def test_exchanged_columns_do_not_pass(tmp_path, place):
    """Such a file reads like a good one."""
    place.write_text(re.sub(r"\[(\S+) (\S+) (\S+)\]", r"[\1 \3 \2]", ROWS))
    (what,) = unlike_released([place], [listed()], tmp_path).values()
    assert what == "other content than the released file, of the same size"


def test_a_file_of_ones_own_is_not_in_the_list(tmp_path, place):
    own = place.with_name("bend_test_6_try_1.csv")
    own.write_text(ROWS)
    assert unlike_released([place, own], [listed()], tmp_path) == {
        f"{FOLDER}/experiment_data/bend_test_6_try_1.csv": "not in the list of the released files"
    }


def test_the_recordings_are_the_released_ones():
    listed = read_sources(Path(__file__).parents[4] / "data/sources.json", [FOLDER])
    found = [path for file in listed if (path := data_dir() / FOLDER / file.path).is_file()]
    if not found:
        pytest.skip("no recordings of Mitchell et al. are below REPRO_DATA_DIR")
    assert unlike_released(found, listed, data_dir()) == {}
