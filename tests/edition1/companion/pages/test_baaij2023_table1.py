"""The rows of Table 1 and the batches they are computed in; small networks stand in for trained ones."""

import math
from pathlib import Path

import pandas as pd
import pytest
import torch

from edition1.errors import InputError
from edition1.estimation.base import track
from edition1.estimation.gradient_descent import GradientDescent
from edition1.sensing.ensemble import SeedEnsemble
from edition1.sensing.magnetic import MagneticSensing, readings
from edition1.sensing.magnets import ring
from edition1.sensing.network import PerSensor, paper_network
from edition1.sensing.weights import save_weights
from edition1_companion.book.project import find_project
from edition1_companion.book.published import read_published
from edition1_companion.pages.table_1.scorecard import scorecard_rows
from edition1_companion.twins import table_1_method as table1
from edition1_companion.twins.networks import NetworkSpec
from edition1_companion.twins.table_1_rows import ROWS, groups, rows_named, simulate
from edition1_companion.twins.table_1_scorecard import SETTING, setting


def untrained(n_segments, seeds):
    generator = torch.Generator().manual_seed(0)
    return [
        [paper_network(1 + 4 * n_segments, generator).eval() for _ in range(n_segments)] for _ in range(seeds)
    ]


def test_rows_are_those_of_the_published_table():
    published = read_published(find_project().published)
    wanted = {key.row for key in published if key.artefact == "Table 1"}
    assert {name for row in ROWS for name in (row.name, *row.same_as)} == wanted
    assert len(ROWS) == 11


def test_every_column_of_the_table_is_filled():
    published = {key for key in read_published(find_project().published) if key.artefact == "Table 1"}
    errors = [
        {"row": row.name, "seed": seed, "quantity": quantity, "unit": unit, "error": 1.0 + seed}
        for row in ROWS
        for seed in (0, 1, 2)
        for quantity, unit in [("e_u", "mT"), *((c, "%") for c in row.robot().coordinates)]
    ]
    rows = scorecard_rows(pd.DataFrame(errors))
    keys = {tuple(line[c] for c in ("paper", "artefact", "row", "quantity", "unit")) for line in rows}
    assert {tuple(key) for key in published} <= keys
    assert all(line["regenerated"] == pytest.approx(2.0) and line["note"] for line in rows)
    assert all(
        line["regenerated_std"] == pytest.approx(1.0) for line in rows if line["artefact"] == "Table 1"
    )
    assert rows[-1]["row"] == "tilted and shifted sensors mean error"


def test_batched_rows_read_what_each_row_reads_alone():
    rows = rows_named(["n_b=3", "n_s=6", "n_s=18", "psi_s=10deg", "d_s_r=16mm"])
    simulation = simulate(rows, steps=7)
    assert simulation.mask.sum(-1).tolist() == [9, 6, 18, 9, 9]
    for k, row in enumerate(rows):
        alone = readings(row.robot(), simulation.q, ring("released"))
        torch.testing.assert_close(simulation.u[:, k, simulation.mask[k]], alone, atol=1e-12, rtol=0)


def test_batch_of_rows_and_seeds_equals_each_row_and_seed_alone():
    """Padding, masks and stacked networks change nothing: against PerSensor and one row at a time."""
    rows = rows_named(["n_b=3", "n_s=6", "n_s=12"])
    networks = untrained(3, 2)
    simulation = simulate(rows, steps=3)
    model = SeedEnsemble(networks, [i for i in range(3) for _ in range(4)])
    estimates, predicted = table1.paper_method(simulation, model, 2, iterations=4)
    errors = table1.errors_of_estimates(simulation, estimates, predicted, (0, 1))
    for seed in range(2):
        for k, row in enumerate(rows):
            robot = row.robot()
            alone = MagneticSensing(
                robot,
                lambda xi, nets=networks[seed], r=robot: PerSensor(nets, r.sensors.segment)(
                    xi.float()
                ).double(),
                "angles",
            )
            u = readings(robot, simulation.q, ring("released"))
            one = track(GradientDescent(alone, table1.step_sizes(3), 0.3, 4), u, simulation.q[0])
            torch.testing.assert_close(estimates.q[:, seed, k], one.q, atol=1e-7, rtol=1e-4)
            e_u = ((alone(simulation.q) - u) ** 2).mean(0).sqrt().mean()
            here = errors.query(f"row == '{row.name}' and seed == {seed} and quantity == 'e_u'")["error"]
            assert float(here.iloc[0]) == pytest.approx(float(e_u.detach()), rel=1e-4)


def test_error_of_a_perfect_estimate_is_zero():
    rows = rows_named(["n_b=1"])
    simulation = simulate(rows, steps=20)
    perfect = table1.Trajectory(simulation.q[:, None, None], None, simulation.u[:, None], {})
    errors = table1.errors_of_estimates(simulation, perfect, simulation.u[None], (0,))
    assert errors["error"].tolist() == [0.0] * 4


def test_rows_are_grouped_by_their_networks():
    names = [[row.name for row in group] for group in groups(ROWS)]
    assert names == [
        ["n_b=1"],
        ["n_b=2"],
        ["n_b=3", "n_s=6", "n_s=12", "n_s=18", "psi_s=10deg", "d_s_r=16mm"],
        ["n_e=(1,0,0)", "n_e=(0,1,0)", "n_e=(0,0,1)"],
    ]


def test_whole_run_with_networks_from_files(tmp_path):
    for seed, networks in enumerate(untrained(1, 2)):
        spec = NetworkSpec(1, 0, False, seed)
        save_weights(networks[0], tmp_path / f"{spec.name}.safetensors", {"recipe": "paper"})
    assert [row.name for row in table1.available(ROWS, tmp_path, (0, 1))] == ["n_b=1"]
    assert table1.available(ROWS, tmp_path) == ()  # seed 2 is not there
    table = table1.run(rows_named(["n_b=1"]), (0, 1), tmp_path, steps=3, iterations=2, jobs=1)
    assert list(table.columns) == ["row", "seed", "quantity", "unit", "error"]
    assert len(table) == 2 * 4
    assert table["error"].map(math.isfinite).all()
    assert table1.run((), (0, 1), tmp_path).empty


def test_setting_names_what_differs_from_the_released_code():
    assert setting(20, [], 0.0, 400) == SETTING
    assert setting(5, [1e-4, 1e-4], 0.001, 400).removeprefix(SETTING) == (
        "; here 5 evaluations; here step sizes [0.0001, 0.0001]; here noise 0.001 mT"
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: rows_named(["n_b=4"]),
            r"Input rows of Table 1 must be among .*; instead received \['n_b=4'\].",
        ),
        (
            lambda: table1.run((), (0,), Path(), step_size=[1e-3]),
            "Input step_size of Table 1 must be two numbers",
        ),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()
