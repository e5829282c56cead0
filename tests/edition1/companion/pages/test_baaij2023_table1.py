"""The rows of Table 1, and the readings of the batches that they are computed in."""

import pytest
import torch

from edition1.errors import InputError
from edition1.sensing.magnetic import readings
from edition1.sensing.magnets import ring
from edition1_companion.book.project import find_project
from edition1_companion.book.published import read_published
from edition1_companion.twins.table_1_rows import ROWS, groups, rows_named, simulate


def test_rows_are_those_of_the_published_table():
    published = read_published(find_project().published)
    wanted = {key.row for key in published if key.artefact == "Table 1"}
    assert {name for row in ROWS for name in (row.name, *row.same_as)} == wanted
    assert len(ROWS) == 11


def test_batched_rows_read_what_each_row_reads_alone():
    rows = rows_named(["n_b=3", "n_s=6", "n_s=18", "psi_s=10deg", "d_s_r=16mm"])
    simulation = simulate(rows, steps=7)
    assert simulation.mask.sum(-1).tolist() == [9, 6, 18, 9, 9]
    for k, row in enumerate(rows):
        alone = readings(row.robot(), simulation.q, ring("released"))
        torch.testing.assert_close(simulation.u[:, k, simulation.mask[k]], alone, atol=1e-12, rtol=0)


def test_rows_are_grouped_by_their_networks():
    names = [[row.name for row in group] for group in groups(ROWS)]
    assert names == [
        ["n_b=1"],
        ["n_b=2"],
        ["n_b=3", "n_s=6", "n_s=12", "n_s=18", "psi_s=10deg", "d_s_r=16mm"],
        ["n_e=(1,0,0)", "n_e=(0,1,0)", "n_e=(0,0,1)"],
    ]


def test_a_name_that_no_row_has_is_refused():
    with pytest.raises(
        InputError, match=r"Input rows of Table 1 must be among .*; instead received \['n_b=4'\]."
    ):
        rows_named(["n_b=4"])
