"""Faults of a line: as often as told, the same for a seed, and what is called whole is whole."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edition1.errors import InputError
from edition1_live.emulate.faults import Faults, damage, faults_named
from edition1_live.emulate.sensor_faults import SensorFaults

PACKETS = [bytes([0, *range(1, 20), 0])] * 50_000
BYTES = sum(map(len, PACKETS))


def pieces(damaged):
    """What is left of each packet."""
    starts = np.concatenate([[0], damaged.ends[:-1]])
    return [damaged.data[a:b] for a, b in zip(starts, damaged.ends, strict=True)]


def test_without_faults_everything_arrives():
    damaged = damage([b"abc", b"d", b"ef"], Faults(), np.random.default_rng(0))
    assert damaged.data == b"abcdef"
    assert damaged.ends.tolist() == [3, 4, 6]
    assert damaged.whole.all()
    assert damaged.closed.all()


@given(
    st.lists(st.binary(min_size=1, max_size=12), min_size=1, max_size=20),
    st.builds(
        Faults,
        flips=st.floats(0, 0.2),
        drops=st.floats(0, 0.2),
        duplicates=st.floats(0, 0.2),
        bursts=st.floats(0, 0.1),
        burst_bytes=st.integers(1, 30),
    ),
    st.integers(0, 2**32),
)
def test_what_is_whole_and_closed_is_so_in_the_data(packets, faults, seed):
    damaged = damage(packets, faults, np.random.default_rng(seed))
    assert damaged.ends[-1] == len(damaged.data)
    for packet, piece, whole, closed in zip(
        packets, pieces(damaged), damaged.whole, damaged.closed, strict=True
    ):
        if whole:
            assert piece in (packet, packet + packet[-1:])  # the last byte may have come twice
        if closed:
            assert piece[-1:] == packet[-1:]
        assert not whole or closed
    again = damage(packets, faults, np.random.default_rng(seed))
    assert again.data == damaged.data


@given(
    st.lists(st.binary(min_size=2, max_size=12), min_size=1, max_size=20, unique=True), st.integers(0, 2**32)
)
def test_flips_alone_spare_exactly_the_unchanged_packets(packets, seed):
    damaged = damage(packets, Faults(flips=0.05), np.random.default_rng(seed))
    assert damaged.whole.tolist() == [
        piece == packet for piece, packet in zip(pieces(damaged), packets, strict=True)
    ]


@pytest.mark.parametrize(
    ("name", "bytes_more"), [("flips", 0), ("drops", -1), ("duplicates", 1), ("bursts", 0)]
)
def test_faults_are_as_frequent_as_told(name, bytes_more):
    chance = 1e-3
    damaged = damage(PACKETS, Faults(**{name: chance}, burst_bytes=1), np.random.default_rng(1))
    # A binomial number, less the few that meet the same byte; five standard deviations.
    expected, slack = chance * BYTES, 5 * np.sqrt(chance * BYTES) + chance**2 * BYTES
    assert abs(len(damaged.data) - BYTES - bytes_more * expected) <= (slack if bytes_more else 0)
    if bytes_more == 0:
        sent = np.frombuffer(b"".join(PACKETS), np.uint8)
        bits = np.unpackbits(sent ^ np.frombuffer(damaged.data, np.uint8)).sum()
        each = {"flips": 1.0, "bursts": 4.0}[name]  # noise differs in half of the bits
        assert abs(bits - each * expected) <= 2 * each * slack


def test_a_burst_replaces_a_run():
    packet = bytes(10_000)
    damaged = damage([packet], Faults(bursts=1e-4, burst_bytes=16), np.random.default_rng(5))
    changed = np.flatnonzero(np.frombuffer(damaged.data, np.uint8))
    assert len(damaged.data) == len(packet)
    assert 8 <= len(changed) <= 16 * 8
    assert not damaged.whole[0]


def test_names_and_values_as_typed():
    assert faults_named([], Faults, SensorFaults) == (Faults(), SensorFaults())
    given = [("drift_ppm", "-50"), ("reboots", "0.01")]
    assert faults_named(given, Faults) == (Faults(drift_ppm=-50.0, reboots=0.01),)


@pytest.mark.parametrize(
    ("given_faults", "message"),
    [
        ([("flip", "1")], "Input fault of repro emulate must be one of flips, .*; instead received flip."),
        (
            [("flips", "1"), ("flips", "1")],
            "Input fault of repro emulate must be given once; instead received flips twice.",
        ),
        (
            [("flips", "often")],
            "Input flips of repro emulate must be a number; instead received 'often'.",
        ),
        (
            [("burst_bytes", "1.5")],
            "Input burst_bytes of repro emulate must be a whole number; instead received '1.5'.",
        ),
        ([("flips", "2")], "Input flips of Faults must be a chance from 0 to 1; instead received 2.0."),
        ([("flips", "nan")], "Input flips of Faults must be a chance from 0 to 1; instead received nan."),
        (
            [("stall_s", "inf")],
            r"Input stall_s of Faults must be a time of 0 or more \[s\]; instead received inf.",
        ),
        ([("burst_bytes", "0")], "Input burst_bytes of Faults must be 1 or more; instead received 0."),
        (
            [("drift_ppm", "1e6")],
            r"Input drift_ppm of Faults must be between -1e6 and 1e6 \[parts per million\]; "
            "instead received 1000000.0.",
        ),
    ],
)
def test_bad_faults_are_refused(given_faults, message):
    with pytest.raises(InputError, match=f"^{message}$"):
        faults_named(given_faults, Faults)
