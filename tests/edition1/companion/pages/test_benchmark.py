"""The benchmark: its references compute the same thing, its verdicts follow from its numbers. No times are tested."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from edition1.estimation.imu_models import pcc_extended
from edition1.kinematics.paper_robots import pcc_robot
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import B444B, ring
from edition1.sensing.multipole import MultipoleField
from edition1.sensing.relations import relations
from edition1_companion.pages.performance.rows import COLUMNS, KINDS, Goal, rate, row
from edition1_companion.pages.performance.tables import (
    arithmetic,
    missed,
    ratios_of_kind,
    target_table,
    with_targets,
)
from edition1_companion.recordings.martin2022_models import selection
from edition1_companion.twins.bend_curves import bend_curve, bend_readings
from edition1_live.wire.binary import BinaryParser, encode_frame
from edition1_live.wire.frame import Frame

from bench import __main__ as bench_command
from bench.capabilities import (
    chain_rows,
    generator_rows,
    imu_orientations,
    particle_rows,
)
from bench.recorder import COMMANDS, decoded, parser_row, start_rows
from bench.references import (
    chain_by_equations,
    chain_vectorised,
    cosines_of,
    cube_fields,
    objects_per_configuration,
    readings_by_equations,
)
from bench.trackers import (
    Task,
    advance,
    against,
    descent,
    from_the_equations,
    implementations,
    least_squares,
    multipole,
)

DATA = Path(__file__).parents[4] / "data"
FIELD = MultipoleField.of(ring("released"))


@pytest.mark.parametrize("together", [True, False])
def test_objects_of_magpylib_read_the_same(together):
    q = 0.01 * torch.rand(3, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    ours = readings(pcc_robot(2), q, ring("published"))
    found = objects_per_configuration(pcc_robot(2), q, ring("published"), together=together)
    np.testing.assert_allclose(found, ours, rtol=1e-9)


def test_fields_of_the_cube_by_the_equations():
    q = bend_curve("flower")[5::200]
    np.testing.assert_allclose(cube_fields(q.numpy(), 15e-3, B444B), bend_readings(q), atol=1e-9)


@pytest.mark.parametrize("reference", [chain_by_equations, chain_vectorised])
def test_chain_by_the_equations_has_the_same_joints(reference):
    arm, q = selection("pcc", 4), imu_orientations(3)[:, ::2]
    arcs = np.arange(1, 17) * 0.04
    q[1, 2] = -q[1, 2]  # the same orientation: the way round stays the shorter one
    np.testing.assert_allclose(reference(q, arm)[:, 1:], pcc_extended(q, arm, arcs), atol=1e-12)


def test_vectorised_chain_of_a_straight_arm():
    q = np.tile([0.0, 0.0, 0.0, 1.0], (2, 9, 1))
    joints = chain_vectorised(q, selection("pcc", 8))
    np.testing.assert_allclose(joints[:, :, 2], np.tile(0.04 * np.arange(17), (2, 1)), atol=1e-15)


def test_readings_pair_by_pair():
    q = 0.01 * torch.rand(9, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    angles = relations(pcc_robot(3), q).angles()
    torch.testing.assert_close(cosines_of(angles), relations(pcc_robot(3), q).cosines(), atol=1e-14, rtol=0)
    plain = readings_by_equations(q, [lambda xi: FIELD(cosines_of(xi))] * 3)
    torch.testing.assert_close(plain, MagneticSensing(pcc_robot(3), FIELD)(q), atol=1e-12, rtol=0)


def test_rate_counts_items_per_processor_second():
    calls = []

    def work():
        calls.append(1)
        return 10 * sum(range(200_000)) and 7

    assert rate(work, repeats=2, least=1e-9) > 7
    assert len(calls) == 4
    rate(work, repeats=2, least=0.05)
    assert len(calls) > 8


@pytest.mark.parametrize(
    ("ours", "reference", "goal", "met"),
    [
        (100.0, 10.0, Goal(100.0, 10.0), True),
        (99.0, 1.0, Goal(100.0, 10.0), False),  # the rate is missed
        (100.0, 11.0, Goal(100.0, 10.0), False),  # the ratio is missed
        (100.0, 10.0, Goal(100.0, 10.0, released=10.0), True),
        (
            100.0,
            1.0,
            Goal(100.0, 10.0, released=2.0),
            False,
        ),  # the reference is slower than the released code
        (100.0, 10.0, Goal(None, 10.0), True),
        (1.0, 10.0, Goal(released=1.0), None),
        (1.0, 10.0, Goal(), None),
    ],
)
def test_targets_are_met_only_together(ours, reference, goal, met):
    line = row("c", "solver", "u", (ours, reference), 0.5, "n", goal)
    assert tuple(line) == COLUMNS
    assert line["met"] is met
    assert line["ratio"] == ours / reference
    assert ("DOES NOT COUNT" in line["note"]) == (goal.released is not None and reference < goal.released)


def test_rows_of_trackers_agree_with_their_references():
    task = Task(1, members=2, steps=1, repeats=1)
    lm, gd = least_squares(1, "multipole", multipole(1)), descent(1, "multipole", multipole(1))
    rows = [
        *implementations(lm, task, Goal(1.0, 1e12)),
        from_the_equations(lm, [lambda xi: FIELD(cosines_of(xi))], task),
    ]
    assert [r["kind"] for r in rows] == ["implementation"] * 4
    assert [r["met"] for r in rows] == [False, None, None, None]
    assert max(r["error"] for r in rows) < 1e-9  # mm
    line = against(lm, gd, "solver", task)
    assert 0.01 < line["error"] < 0.2  # mm: noise, no bias
    assert line["capability"].startswith(
        "time step, 3 LM iterations, multipole, n_b = 1, against 20 gradient"
    )


def test_robots_side_by_side_are_robots_one_by_one():
    task, method = Task(1, members=3, steps=2), least_squares(1, "multipole", multipole(1)).method
    together, first = advance(method, task, 3, seeds=False), advance(method, task, 1, seeds=False)
    assert torch.equal(together[:, :1], first)
    assert not torch.equal(together[:, :1], together[:, 1:2])


@pytest.mark.parametrize(
    ("rows", "errors"),
    [
        (lambda: generator_rows(samples=400, few=3, repeats=1), (1e-6, 1e-6, 1e-6, 1e-12)),
        (lambda: particle_rows(steps=12, repeats=1), (1e-4,) * 4),
        (lambda: chain_rows(samples=250, repeats=1), (1e-9,) * 4),
    ],
)
def test_rows_of_other_capabilities_agree_with_their_references(rows, errors):
    table = pd.DataFrame(list(rows()))
    assert table["capability"].is_unique
    assert set(table["kind"]) <= set(KINDS)
    assert (table["error"] <= list(errors)).all()
    assert with_targets(table)["capability"].size == {1e-6: 2, 1e-4: 1, 1e-9: 1}[errors[0]]


def a_table():
    met = row("time step, 3 LM iterations", "implementation", "per s", (9.0, 1.0), 0.0, "n", Goal(5.0, 2.0))
    not_met = row("training set", "model", "per s", (1.0, 1.0), 0.0, "n", Goal(5.0, 2.0))
    plain = row("training set, torch", "model", "per s", (1.0, 1.0), 0.0, "n")
    limit = row("arithmetic limit: kernel", "arithmetic limit", "per s", (1.0, 4.0), math.nan, "n")
    return pd.DataFrame([met, not_met, plain, limit])


def test_missed_targets_and_what_bounds_them():
    table = a_table()
    assert target_table(table)["met"].tolist() == [True, False]
    lines = missed(table)
    assert lines["capability"].tolist() == ["training set"]
    assert lines["bound_by"].str.contains("multipole series").all()
    assert ratios_of_kind(table, "model")["capability"].tolist() == ["training set", "training set, torch"]
    assert arithmetic(table)[["kernel", "share of the limit"]].to_numpy().tolist() == [["kernel", 0.25]]


def test_command_writes_all_tables_and_succeeds_when_a_target_is_missed(tmp_path, monkeypatch, capsys):
    """What is measured takes minutes and is replaced; what is written and returned is the command's own."""
    (tmp_path / "pyproject.toml").write_text("[tool.repro]\n")
    monkeypatch.chdir(tmp_path)
    points = pd.DataFrame({"capability": ["c"], "against": ["samples"], "size": [1], "seconds": [0.1]})
    monkeypatch.setattr(bench_command, "benchmark", lambda networks: (a_table(), points))
    monkeypatch.setattr(bench_command, "recorder_table", lambda: pd.DataFrame([parser_row(100)]))
    assert bench_command.main() == 0
    lines = pd.read_csv(tmp_path / "results" / "bench.csv")
    assert list(lines) == list(COLUMNS)
    assert lines["met"].tolist() == [True, False]
    assert len(pd.read_csv(tmp_path / "data" / "benchmark.csv")) == 4
    assert len(pd.read_csv(tmp_path / "data" / "benchmark_scaling.csv")) == 1
    assert len(pd.read_csv(tmp_path / "results" / "bench_recorder.csv")) == 1
    assert "training set" in (said := capsys.readouterr().out)
    assert "frames per CPU second" in said


def test_a_parser_and_its_reference_read_the_same():
    frames = [Frame(0, k, 1000 * k, (k + 0.25, -k / 8, 3.0)) for k in range(300)]
    data = b"".join(map(encode_frame, frames))
    found = [(frame.sequence, frame.device_us, *frame.values) for frame in BinaryParser().feed(data)]
    assert decoded(data) == found == [(f.sequence, f.device_us, *f.values) for f in frames]


def test_commands_of_the_recorder_are_measured():
    rows = list(start_rows(repeats=1))
    assert [row["what"] for row in rows] == [f"repro {command}" for command in COMMANDS]
    assert all(row["ratio"] > 0 and row["memory_mb"] > 10 for row in rows)


def test_committed_table():
    table = pd.read_csv(DATA / "benchmark.csv")
    assert list(table) == list(COLUMNS)
    assert table["capability"].is_unique
    assert (
        table.loc[table["kind"].isin(KINDS), ["ours", "reference", "ratio", "error"]].notna().all(axis=None)
    )
    lines = with_targets(table)
    assert lines["target"].tolist() == [
        80_000,
        30_000,
        4_000,
        200,
        200_000,
        200_000,
        5_000,
        pytest.approx(8000 / 0.015, 1e-3),
    ]
    assert lines["target_ratio"].tolist() == [300, 300, 80, 12, 2000, 500, 6, 4]
    reached = (lines["ours"] >= lines["target"]) & (lines["ratio"] >= lines["target_ratio"])
    assert (lines["met"].astype(str) == reached.astype(str)).all()
