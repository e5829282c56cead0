"""Errors by number of sensors: on the bound, as averaging has it, and open where readings are too few."""

import math
from pathlib import Path

import pandas as pd
import pytest

from edition1.errors import InputError
from edition1_companion.twins.sensor_count import against_three, sensor_count_errors

STUDY = Path(__file__).parents[4] / "data" / "studies" / "sensor_sweep.csv"


@pytest.mark.parametrize("n_segments", [1, 2])
def test_errors_lie_on_the_bound(n_segments):
    table = sensor_count_errors(n_segments, 3, 2e-4, draws=20, steps=60)
    (bound,) = set(table["bound_percent"])
    # 20 draws of 60 steps and at least 3 coordinates: the mean is known to 1/sqrt(2 * 3600) = 1.2 %
    assert table["mean_percent"].mean() == pytest.approx(bound, rel=0.04)


@pytest.mark.parametrize(
    ("n_segments", "percent"),
    # mean relative bound at 4.8e-5, 7.1e-4 and 5e-3 mT from an independent prototype
    [(1, (0.0083, 0.12, 0.87)), (2, (0.0099, 0.15, 1.03)), (3, (0.0112, 0.17, 1.17))],
)
def test_bound_at_known_levels(n_segments, percent):
    for noise_mt, known in zip((4.8e-5, 7.1e-4, 5e-3), percent, strict=True):
        bound = sensor_count_errors(n_segments, 3, noise_mt, draws=1, steps=400)["bound_percent"][0]
        assert round(bound, len(str(known).partition(".")[2])) == known


def test_sensors_average_the_noise():
    # sensors spaced evenly around a straight segment: information grows with their number
    three, twelve = (sensor_count_errors(1, n, 2e-4, draws=1, steps=30)["bound_percent"][0] for n in (3, 12))
    assert twelve / three == pytest.approx(0.5, rel=0.03)


def test_two_sensors_leave_a_coordinate_open():
    table = sensor_count_errors(1, 2, 1e-5, draws=2, steps=30)
    assert set(table["bound_percent"]) == {math.inf}
    assert table["mean_percent"].min() > 10


def test_seeds_name_the_noise():
    one, same, other = (sensor_count_errors(1, 3, 1e-3, seed=s, draws=2, steps=10) for s in (0, 0, 1))
    assert one.equals(same)
    assert not one["mean_percent"].equals(other["mean_percent"])
    assert len(set(one["mean_percent"])) == 2


@pytest.mark.parametrize(("noise", "draws"), [(0.0, 1), (math.nan, 1), (1e-3, 0)])
def test_settings_that_are_refused(noise, draws):
    with pytest.raises(InputError) as refused:
        sensor_count_errors(1, 3, noise, draws=draws)
    assert str(refused.value) == (
        "Input noise_mt, draws of sensor_count_errors must be positive and at least 1; "
        f"instead received ({noise}, {draws})."
    )


def test_means_beside_three_sensors():
    columns = [
        "n_segments",
        "n_sensors",
        "noise_mt",
        "mean_percent",
        "bound_percent",
        "tip_mm",
        "at_bound_percent",
    ]
    rows = [
        (1, 3, 0.1, 2, 2, 1, 0),
        (1, 3, 0.1, 4, 2, 3, 2),
        (1, 12, 0.1, 1.5, 1, 1, 0),
        (2, 3, 0.1, 5, 5, 1, 0),
    ]
    means = against_three(pd.DataFrame(rows, columns=columns))
    assert means["n_sensors"].tolist() == [3, 12, 3]
    assert means["mean_percent"].tolist() == [3, 1.5, 5]
    assert means["ratio"].tolist() == [1, 0.5, 1]
    assert means["averaging"].tolist() == [1, 0.5, 1]


def test_the_committed_sweep_is_what_the_code_gives_and_what_the_page_says():
    table = pd.read_csv(STUDY)
    here = table.query("n_segments == 2 and n_sensors == 4 and noise_mt == 5e-3")
    again = sensor_count_errors(2, 4, 5e-3)
    assert here["mean_percent"].tolist() == pytest.approx(again["mean_percent"].tolist(), rel=1e-6)
    means = against_three(table)
    ratio = means.groupby("n_sensors")["ratio"].agg(["min", "max"]).round(2)
    assert ratio.loc[4].tolist() == [0.83, 0.87]
    assert ratio.loc[6].tolist() == [0.69, 0.70]
    two, more = means[means["n_sensors"] == 2], means[means["n_sensors"] > 2]
    assert (two["mean_percent"].min().round(), two["mean_percent"].max().round()) == (18, 22)
    assert more["at_bound_percent"].max() == pytest.approx(19, abs=0.5)
    by_segments = more.pivot_table(
        index=["n_sensors", "noise_mt"], columns="n_segments", values=["mean_percent", "tip_mm"]
    )
    error, tip = (by_segments[x][3] / by_segments[x][1] for x in ("mean_percent", "tip_mm"))
    assert (error.min() > 1.3, error.max() < 1.37) == (True, True)
    assert (tip.min() > 5.5, tip.max() < 6.5) == (True, True)
    assert (more["mean_percent"] / more["bound_percent"]).between(0.96, 1.02).all()
