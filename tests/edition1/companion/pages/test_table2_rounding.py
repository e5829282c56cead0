"""What rounding decides in Table 2: spread over starts that differ by rounding, and what is said of it."""

from functools import cache

import pandas as pd

from edition1_companion.book.project import find_project
from edition1_companion.pages.table_2.reliability import RELATIVE, errors_by_start, rounding_table
from edition1_companion.pages.table_2.scorecard import table_2_rows
from edition1_companion.twins.rig_data import load_recordings
from edition1_companion.twins.rig_networks import rig_networks
from edition1_companion.twins.rig_twins import nominal_twin


@cache
def twin_and_network():
    folder = find_project().data / "networks"
    data = load_recordings("twin", trajectories=("T2",))
    return data, rig_networks(folder, (0,), twin_sha256=nominal_twin().sha256)


def spread(seconds, shorter):
    """Return by how much errors on T2 differ between four starts, in units of their mean."""
    data, model = twin_and_network()
    errors = errors_by_start(data.shortened(seconds), data, model, (0,), starts=4, shorter=shorter)
    assert set(errors["start"]) == set(range(4))
    return float(rounding_table(errors)["seed_apart_percent"].to_numpy().max()) / 100


def test_rounding_grows_where_the_step_is_too_long():
    """In the first 5 s of T2 to a good part of the error itself.

    With this network half of the step is still too long on a fifth of T2; a quarter is short enough on all of it.
    """
    assert spread(2.0, 1) < 1e3 * RELATIVE
    assert spread(5.0, 1) > 0.1
    assert spread(5.0, 4) < 0.01


def made_up():
    """Errors of two seeds from three starts: the first cell moves with the start, the second does not."""
    cells = {"T5.train->T2.test": [[1.0, 2.0, 3.0], [4.0, 4.0, 4.0]], "T5.train->T4": [[1.0] * 3, [3.0] * 3]}
    return pd.DataFrame(
        [
            {"row": row, "seed": s, "start": k, "quantity": "delta_x", "unit": "mm", "error": error}
            for row, seeds in cells.items()
            for s, errors in enumerate(seeds)
            for k, error in enumerate(errors)
        ]
    )


def test_table_of_made_up_errors():
    """By hand: means over the seeds are 2.5, 3 and 3.5; the first seed moves by 2 about 2."""
    table = rounding_table(made_up())
    assert table["row"].tolist() == ["T5.train->T2.test", "T5.train->T4"]
    assert table["lowest"].tolist() == [2.5, 2.0]
    assert table["highest"].tolist() == [3.5, 2.0]
    assert table["seed_apart_percent"].tolist() == [100.0, 0.0]
    assert table["chaotic"].tolist() == [True, False]


def test_notes_of_the_scorecard_name_what_rounding_decides():
    errors = made_up().query("start == 0").drop(columns="start")
    options = {"setting": "x", "synthetic": True, "own_files": False, "best": errors}
    moved, kept = table_2_rows(errors, **options, rounding=rounding_table(made_up()))
    assert moved["note"].endswith("; decided by rounding: 2.5 to 3.5 from starts 1e-12 apart")
    assert "rounding" not in kept["note"]
