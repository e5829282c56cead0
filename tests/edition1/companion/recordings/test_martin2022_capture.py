"""Motion capture by a layout that is named: nothing is guessed."""

import numpy as np
import pytest

from edition1.errors import InputError
from edition1_companion.recordings.martin2022_trial import CAPTURE, OUTPUT_FOLDER, find_capture, read_capture

LAYOUT = {
    "header_row": 1,
    "first_row": 3,
    "time_s": 100.0,
    "base": ["bx", "by", "bz"],
    "M1": ["x1", "y1", "z1"],
    "M2": ["x2", "y2", "z2"],
    "metres_per_unit": 0.001,
}
TEXT = """Trajectories,100
t,bx,by,bz,x1,y1,z1,x2,y2,z2
s,mm,mm,mm,mm,mm,mm,mm,mm,mm
5.0,10,20,30,110,20,330,,,
5.5,10,20,30,120,20,330,210,20,530
"""


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "capture.csv"
    file.write_text(TEXT)
    return file


def test_markers_from_the_base_in_metres(path):
    found = read_capture(path, LAYOUT)
    np.testing.assert_allclose(found.time_s, [0, 0.01])
    np.testing.assert_allclose(found.markers[:, 0], [[0.1, 0, 0.3], [0.11, 0, 0.3]])
    np.testing.assert_allclose(found.markers[1, 1], [0.2, 0, 0.5])
    assert np.isnan(found.markers[0, 1]).all()
    assert found.dropped == 1
    np.testing.assert_allclose(read_capture(path, LAYOUT | {"time_s": "t"}).time_s, [5.0, 5.5])


def test_a_layout_that_is_not_whole_shows_the_file(path):
    message = (
        r"Input layout of capture.csv must be a mapping that names M2 \(names of the columns .*\); instead received "
        r"none of them; the file begins Trajectories,100 \| t,bx,by.* \| s,mm"
    )
    with pytest.raises(InputError, match=message):
        read_capture(path, {name: value for name, value in LAYOUT.items() if name != "M2"})


@pytest.mark.parametrize("names", [["x1", "y1"], ["x1", "y1", "w1"]])
def test_columns_that_are_not_there(path, names):
    message = (
        r"Input columns of capture.csv must be 3 among t, bx, .*, each there once; instead received \['x1'"
    )
    with pytest.raises(InputError, match=message):
        read_capture(path, LAYOUT | {"M1": names})


def test_times_that_do_not_increase(path):
    with pytest.raises(InputError, match=r"Input time_s of capture.csv must be increasing"):
        read_capture(path, LAYOUT | {"time_s": "bx"})


def test_no_file_and_another_file(tmp_path, monkeypatch):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    assert find_capture() is None
    with pytest.raises(FileNotFoundError, match="There is no file"):
        read_capture(tmp_path / "capture.csv", LAYOUT)
    other = tmp_path / OUTPUT_FOLDER / CAPTURE
    other.parent.mkdir(parents=True)
    other.write_bytes(b"")
    # The hash under which git stores nothing.
    with pytest.raises(
        InputError, match=r"git blob 63d79912.*; instead received git blob e69de29bb2d1d6434b8b29ae"
    ):
        find_capture()
