"""Claims of the papers beside our numbers."""

import re
from pathlib import Path

import pandas as pd
import pytest

from repro_companion import claims

ROOT = Path(__file__).resolve().parents[2]
CARD = pd.DataFrame(
    {
        "artefact": ["A"] * 3,
        "row": ["r"] * 3,
        "quantity": ["q", "p", "s"],
        "unit": ["%"] * 3,
        "published": ["0.04", "13.5", "60"],
        "regenerated": ["0.0251", "12", "4323.2"],
    }
)


def test_a_number_stands_where_it_is_named():
    """By its name on the home page, or by its row of the scorecard, with two digits or, from ten on, as published."""
    text = claims.filled("{A|r|q|%} % of {home.x}, not {A|r|p|%} or {A|r|s|%}", CARD, {"home.x": "7"})
    assert text == "0.025 % of 7, not 12.0 or 4320"


def test_a_name_without_a_number_is_refused():
    """A renamed row does not leave a hole in a sentence."""
    with pytest.raises(ValueError, match=r"names \{A\|r\|z\|%\}, which is 0 rows of the scorecard"):
        claims.filled("{A|r|z|%}", CARD, {})


def test_the_committed_claims_name_sections_pages_and_numbers():
    """Every claim says where the paper makes it, and stands on a page that is there."""
    card = pd.read_csv(ROOT / "results" / "scorecard.csv", dtype=str, keep_default_na=False)
    known = dict.fromkeys(re.findall(r"\{(home\.\w+)\}", (ROOT / claims.CLAIMS).read_text()), "1")
    found = claims.claims_of(ROOT, card, known)
    assert (found[["paper", "section", "page", "claim", "found", "why"]] != "").all(axis=None)
    assert not found["found"].str.contains("[{}]").any()
    assert all((ROOT / f"{page}.ipynb").is_file() for page in found["page"])
    assert found.groupby("paper")["headline"].apply(lambda x: (x == "yes").sum()).to_dict() == {
        "baaij2023": 3,
        "martin2022": 2,
        "mitchell2021": 1,
    }


def test_what_a_claim_says_of_one_point_is_in_the_table_of_chains():
    """These numbers are of no row of the scorecard."""
    chains = pd.read_csv(ROOT / "results" / "imu_markers_chains.csv", index_col="chain")
    fine, links = chains.loc["16 interpolated links, files"], chains.loc["8 interpolated links"]
    less = {
        (where, k): f"{100 * (1 - fine[f'm{k}_mm'] / links[f'{where}m{k}_mm']):.0f} %"
        for where in ("before_", "")
        for k in (1, 2)
    }
    said = "{} at M1 and {} at M2 on the synthetic arm with the chains of the files; {} and {} once both"
    assert said.format(*less.values()) in (ROOT / claims.CLAIMS).read_text()


def test_in_how_many_draws_the_relative_error_falls_from_one_marker_to_the_other():
    errors = pd.read_csv(ROOT / "results" / "imu_markers_errors.csv").query("evaluation == 'as in the files'")
    medians = errors.pivot_table("median_mm", ["case", "draw"], "marker")
    falls = (medians["M2"] / 600 < medians["M1"] / 360).groupby("case").sum()
    rigid, extended = falls["rigid-body, 8 IMUs"], falls["PCC-extended, 8 IMUs, 16 segments"]
    said = f"the first falls in {rigid} of the draws, the second in {extended}"
    assert said in (ROOT / claims.CLAIMS).read_text()


def test_what_a_claim_says_of_the_bend_tests_is_in_their_tables():
    """These numbers are of no row of the scorecard either."""
    medians = pd.read_csv(ROOT / "results" / "bend_tests_medians.csv", index_col="name")
    names = [f"paper's filter, released settings{mm} mm" for mm in (", 13", " but 15")] + [
        "ratios, calibrated on other tests"
    ]
    (y, z), (longer, _), (ratios_y, ratios_z) = medians.loc[names, ["rmse_deg", "rmse_tilt_z_deg"]].to_numpy()
    events = pd.read_csv(ROOT / "results" / "light_bulb_counts.csv").query("frozen").iloc[0]
    text = (ROOT / claims.CLAIMS).read_text()
    for said in (
        f"with the released settings has a median error of {y:.0f}° and calibrated ratios have {ratios_y:.1f}°",
        f"the filter has {z:.1f}° and the ratios {ratios_z:.1f}°",
        f"comes to {longer:.1f}° against y",
        "our detector finds {light_0}, {light_1} and {light_2} events".format(**events),
    ):
        assert said in text


def test_a_page_has_its_own_claims_and_the_home_page_the_headlines():
    """A table has a line for each claim; a page without claims has none."""
    found = pd.DataFrame(
        {
            "paper": ["x"],
            "section": ["Abstract"],
            "page": ["notebooks/a"],
            "headline": ["yes"],
            "claim": ["it works"],
            "found": ["it does"],
            "why": ["because"],
        }
    )
    table = claims.claims_table(found, "notebooks/a")
    assert "| it works (Abstract) | it does | because |" in table
    assert claims.claims_table(found, "notebooks/b").strip() == ""
    assert "| X | it works | it does | [Table 1](notebooks/a.ipynb) |" in claims.headlines(
        found, {"notebooks/a": "Table 1: errors"}, {"x": "X"}
    )
