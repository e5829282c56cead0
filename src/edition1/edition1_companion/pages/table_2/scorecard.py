"""Table 2, and the means in the abstract and section 5.5, of Baaij et al. 2023 as rows of the scorecard."""

from __future__ import annotations

from typing import Any

import pandas as pd

from edition1_companion.pages.table_2.reliability import RELATIVE
from edition1_companion.twins.rig_descent import row_name
from edition1_companion.twins.table_1_scorecard import scorecard_line, scorecard_lines, seeds_note

SETTING = "as released: elongation known, start at ground truth, momentum carried, split {train:g}/{test:g}"
BEST_METHOD = "polynomial map fitted to T5.train, common bias estimated, no known start or elongation"
SYNTHETIC_NOTE = "synthetic: recorded by the digital twin, so not comparable with the authors' hardware"
OWN_NOTE = "recordings of the reader's own under the authors' names, so not comparable with what they printed"
KEYS = ["row", "quantity", "unit"]
NOT_PRINTED = (row_name("T1"), "delta_y", "%")
"""T1 bends along x alone: the paper has no relative error of the other direction."""
MEANS = (
    ("Abstract", "experiments mean relative error", ("delta_x", "delta_y")),
    ("Section 5.5", "experiments mean relative e_u", ("e_u",)),
)
"""Means of the printed cells of Table 2: 4.5 % of eleven for the bend, 3.1 % of six for the readings."""


def table_2_setting(
    twin_sha256: str | None, *, own_files: bool = False, test_share: float = 0.3, longest_s: float = 0.0
) -> str:
    """What the paper's method was run on and with."""
    released = SETTING.format(train=100 * (1 - test_share), test=100 * test_share)
    recorded = ["recordings not of the authors"] if own_files else []
    source = recorded if twin_sha256 is None else [f"synthetic twin {twin_sha256[:8]}"]
    cut = [f"here the first {longest_s:g} s of each test part"] if longest_s else []
    return "; ".join([*source, released, *cut])


def table_2_rows(
    table: pd.DataFrame,
    *,
    setting: str,
    synthetic: bool,
    own_files: bool,
    best: pd.DataFrame,
    rounding: pd.DataFrame,
) -> list[dict[str, Any]]:
    """Rows of the scorecard from the errors of the paper's method.

    Parameters
    ----------
    table
        Columns ``row, seed, quantity, unit, error``, with one elongation.
    setting
        From :func:`table_2_setting`.
    synthetic
        Whether a twin recorded the data: then no row is comparable, and none has a best value.
    own_files
        Whether recorded files are not the authors': the same.
    best
        Columns ``row, quantity, unit, error``: what ours reaches.
    rounding
        From :func:`~edition1_companion.pages.table_2.reliability.rounding_table`: notes name the chaotic rows.
    """
    decided = {
        (
            x["row"],
            x["quantity"],
            x["unit"],
        ): f"; decided by rounding: {x['lowest']:.3g} to {x['highest']:.3g} from starts {RELATIVE:g} apart"
        for x in rounding[rounding["chaotic"]].to_dict("records")
    }
    printed, ours = _printed(table), {}
    about: dict[str, Any] = {}
    if synthetic or own_files:
        about = {"note": SYNTHETIC_NOTE if synthetic else OWN_NOTE, "comparable": False}
    else:
        ours = _printed(best[best["quantity"] != "e_u"]).set_index(KEYS)["error"].to_dict()
    rows: list[dict[str, Any]] = []
    for line in scorecard_lines("Table 2", printed, setting):
        line |= about
        key = (line["row"], line["quantity"], line["unit"])
        line["note"] += decided.get(key, "")
        if key in ours:
            line |= {"best": ours[key], "best_method": BEST_METHOD}
        rows.append(line)
    if len(set(printed["row"])) < 6:  # a mean over some of the trajectories is another mean
        return rows
    for artefact, row, quantities in MEANS:
        relative = printed[(printed["unit"] == "%") & printed["quantity"].isin(quantities)]
        by_seed = relative.groupby("seed")["error"].mean()
        numbers = (by_seed.mean(), by_seed.std(), len(by_seed), setting)
        line = scorecard_line(artefact, row, "mean", "%", *numbers) | {"note": seeds_note(by_seed)} | about
        own = [error for (_, _, unit), error in ours.items() if unit == "%"]
        if own and artefact == "Abstract":
            line |= {"best": sum(own) / len(own), "best_method": BEST_METHOD}
        rows.append(line)
    return rows


def _printed(table: pd.DataFrame) -> pd.DataFrame:
    return table[~pd.MultiIndex.from_frame(table[KEYS]).isin([NOT_PRINTED])]
