"""The parser of frames gives what that of the first edition gave: frames and counters, whatever the line does."""

import pytest

from bench.soak.parsers_2 import compare


@pytest.mark.parametrize(("streams", "channels"), [(1, None), (3, None), (3, 2)])
def test_frames_and_counters_are_equal_on_a_faulty_line(streams, channels):
    found = compare(2000, streams=streams, channels=channels, seed=streams)
    assert found["intact"] > 800
    assert (found["different"], found["lost"], found["counters"]) == (0, 0, 0)
    assert found["checksum_errors"] > 10
