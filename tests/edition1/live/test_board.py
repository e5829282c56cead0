"""A board: what it numbers and stamps, and that a parser returns all that it calls intact."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edition1_live.emulate.board import Reading, passages
from edition1_live.emulate.faults import Faults
from edition1_live.wire.formats import FORMATS, encode, parser
from edition1_live.wire.frame import Frame

RATE_HZ = 100.0
VALUES = {
    "frames": lambda k: (float(k), -0.5 * k),
    "hall": lambda k: (float(k % 8000), -float(k // 8000), 7.0),
    "millivolts": lambda k: (k % 2048 + 0.5, k // 2048 + 0.25, 1000.0),
    "quaternions": lambda k: (0.0, round(np.sin(k * 1e-3), 6), 0.0, round(np.cos(k * 1e-3), 6)),
    "csv": lambda k: (0.1 * k, -1e-3 * k, 12.5),
}
ALL = Faults(
    flips=3e-3,
    drops=3e-3,
    duplicates=3e-3,
    bursts=3e-4,
    burst_bytes=20,
    stalls=3e-3,
    stall_s=0.1,
    disconnects=5e-3,
    away_s=0.1,
    reboots=5e-3,
    boot_s=0.05,
)


def readings(format, count, streams=1):
    for k in range(count):
        yield Reading(k / (RATE_HZ * streams), k % streams, VALUES[format](k))


def arrived(format, sent, cuts=()):
    """Frames that a parser returns; chunks end at every connection and at ``cuts``."""
    p, connection, frames = parser(format), 0, []
    if format == "csv":  # three lines that agree tell their form
        p.feed(b"\n" + 3 * encode(format, Frame(0, None, None, VALUES[format](0))))
        p.reopened()
        p.counters.frames = p.counters.first_partial = 0
    for passage in sent:
        if passage.connection != connection:
            p.reopened()
            connection = passage.connection
        edges = [0, *sorted(cut for cut in cuts if cut < len(passage.data)), len(passage.data)]
        for a, b in pairwise(edges):
            frames += p.feed(passage.data[a:b])
    return frames, p.counters


def is_subsequence(some, whole):
    rest = iter(whole)
    return all(frame in rest for frame in some)


@pytest.mark.parametrize("format", FORMATS)
def test_without_faults_all_frames_arrive(format):
    (sent,) = passages(readings(format, 500), format)
    frames, counters = arrived(format, [sent])
    # A text line that comes first may be the end of a longer one, so that it is not intact and not accepted.
    first = 0 if format == "frames" else 1
    assert sent.intact.tolist() == [False] * first + [True] * (500 - first)
    assert frames == sent.frames[first:]
    assert counters.frames == 500 - first
    assert counters.gaps == counters.restarts == counters.checksum_errors == counters.malformed == 0
    np.testing.assert_allclose(sent.time_s, np.arange(500) / RATE_HZ)


@pytest.mark.parametrize("format", FORMATS)
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32), cuts=st.lists(st.integers(0, 4000), max_size=5))
def test_what_is_intact_is_returned_in_order(format, seed, cuts):
    streams = 2 if format in ("frames", "quaternions") else 1
    sent = list(passages(readings(format, 300, streams), format, ALL, seed=seed))
    frames, counters = arrived(format, sent, cuts)
    intact = [frame for p in sent for frame, good in zip(p.frames, p.intact, strict=True) if good]
    assert is_subsequence(intact, frames)
    assert counters.frames == len(frames)
    if format == "frames":  # nothing is made up
        assert is_subsequence(frames, [frame for p in sent for frame in p.frames])
        # a restart whose first frames are lost and which comes soon can look like a gap or a step ahead
        assert counters.restarts <= sum(p.frames[0].sequence == 0 for p in sent) * streams


def test_the_clock_drifts_and_wraps():
    ahead = Faults(drift_ppm=200.0)
    times = (0.0, 100.0, 2**32 * 1e-6)
    (sent,) = passages((Reading(t, 0, (1.0,)) for t in times), "frames", ahead)
    assert [frame.device_us for frame in sent.frames] == [0, 100_020_000, round(2**32 * 1.0002) - 2**32]


def test_a_reboot_restarts_numbers_and_clock_in_the_middle_of_a_frame():
    faults = Faults(reboots=0.01, boot_s=0.2)
    sent = list(passages(readings("frames", 400), "frames", faults, seed=2))
    starts = [p for p in sent if p.frames[0].sequence == 0]
    assert len(starts) > 2
    assert {p.connection for p in sent} == {0}
    for before, after in pairwise(sent):
        assert not before.intact[-1]
        assert before.intact[:-1].all()
        assert after.frames[0].sequence == 0
        assert after.frames[0].device_us < 1e6 / RATE_HZ
        assert after.time_s[0] - before.time_s[-1] == pytest.approx(0.2, abs=1.01 / RATE_HZ)
    frames, counters = arrived("frames", sent)
    assert counters.restarts == len(sent) - 1
    assert counters.checksum_errors == len(sent) - 1
    assert len(frames) == sum(p.intact.sum() for p in sent)


def test_a_disconnect_loses_what_is_sent_meanwhile():
    faults = Faults(disconnects=0.01, away_s=0.2)
    sent = list(passages(readings("frames", 400), "frames", faults, seed=2))
    assert [p.connection for p in sent] == list(range(len(sent)))
    assert len(sent) > 2
    for before, after in pairwise(sent):
        missing = after.frames[0].sequence - before.frames[-1].sequence - 1
        assert missing == pytest.approx(0.2 * RATE_HZ, abs=1)
        assert after.time_s[0] - before.time_s[-1] == pytest.approx(0.2, abs=1.01 / RATE_HZ)
        assert not before.intact[-1]
        assert not after.intact[0]
    frames, counters = arrived("frames", sent)
    assert counters.frames == len(frames) == sum(p.intact.sum() for p in sent)
    assert counters.gaps == frames[-1].sequence - frames[0].sequence + 1 - len(frames)
    assert counters.restarts == 0


def test_a_stall_holds_frames_back_and_loses_none():
    faults = Faults(stalls=0.01, stall_s=0.3)
    sent = list(passages(readings("frames", 400), "frames", faults, seed=2))
    time_s = np.concatenate([p.time_s for p in sent])
    frames, counters = arrived("frames", sent)
    assert [frame.sequence for frame in frames] == list(range(400))
    assert counters.gaps == 0
    late = time_s - np.arange(400) / RATE_HZ
    assert late.max() == pytest.approx(0.3)
    assert (np.diff(time_s) >= 0).all()
    assert [frame.device_us for frame in frames] == [round(1e6 * k / RATE_HZ) for k in range(400)]


def test_the_same_seed_gives_the_same_bytes():
    once, again, other = (
        b"".join(p.data for p in passages(readings("frames", 6000), "frames", ALL, seed=seed))
        for seed in (4, 4, 5)
    )
    assert once == again != other


def test_only_the_fault_that_is_asked_for_happens():
    for name in ("stalls", "disconnects", "reboots"):
        one = replace(Faults(), **{name: getattr(ALL, name)})
        sent = list(passages(readings("frames", 600), "frames", one, seed=1))
        assert len(sent) > 1
        assert (sent[-1].connection > 0) == (name == "disconnects")
        assert any(p.frames[0].sequence == 0 for p in sent[1:]) == (name == "reboots")
