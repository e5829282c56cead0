"""The rules of the scorecard: against exact arithmetic, the committed table, and by hand."""

from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from repro_companion.scorecard import (
    COLUMNS,
    ERRORS,
    WITH_FILES,
    beside,
    changed,
    counts,
    is_error,
    kinds,
    published,
    scorecard,
    summary,
    write,
)
from repro_companion.show import KEY, ROW_COLUMNS

ROOT = Path(__file__).resolve().parents[2]
PUBLISHED, RESULTS = ROOT / "data" / "published" / "published.csv", ROOT / "results"


def card_of(folder: Path, printed: list[dict], ours: list[dict], *sources: list[dict]) -> pd.DataFrame:
    """Scorecard of numbers given by what is not usual about them; ours are of a.rows.csv, further ones of b, c."""
    usual = dict.fromkeys(KEY, "a") | {"std": "", "setting": "s", "comparable": "true"}
    groups = dict(zip("abc", [ours, *sources], strict=False))
    tables = {f"{name}.rows": (ROW_COLUMNS, rows) for name, rows in groups.items()}
    tables["published"] = [*KEY, "value", "std"], printed
    for name, (columns, rows) in tables.items():
        frame = pd.DataFrame([usual | row for row in rows], dtype=str).reindex(columns=columns, fill_value="")
        frame.to_csv(folder / f"{name}.csv", index=False)
    return scorecard(folder / "published.csv", *([folder / f"{name}.rows.csv"] for name in groups))


@pytest.fixture(scope="module")
def card() -> pd.DataFrame:
    return scorecard(PUBLISHED, sorted(RESULTS.glob("*.rows.csv")))


def test_printed_numbers_keep_their_digits():
    table = published("baaij2023", "Table 1").set_index(["row", "quantity"])
    one = table.loc[("n_b=1", "delta_x_1")]
    assert (one["value"], one["std"], one["printed"], one["printed_std"]) == (1.7, 1.0, "1.7", "1.0")
    assert len(table) == 13 * 10 - 6 - 3


def test_the_committed_scorecard_comes_out_byte_for_byte(card, tmp_path):
    files, studies = (sorted(folder.glob("*.rows.csv")) for folder in (RESULTS, ROOT / "data" / "studies"))
    both = beside(card, scorecard(PUBLISHED, files, studies, files))
    write(both, tmp_path / "scorecard.csv")
    assert (tmp_path / "scorecard.csv").read_bytes() == (RESULTS / "scorecard.csv").read_bytes()
    assert list(both) == [*COLUMNS, *WITH_FILES]


def test_no_verdict_is_another_than_the_reference(card):
    assert changed(card, ROOT / "data" / "scorecard_reference.csv") == []


def test_counts_are_those_of_every_paper_and_of_all(card):
    table = counts(card)
    # whether a number is weak may be decided by rounding, which verdict it has is not
    assert table.loc["baaij2023", ["reproduced", "weak", "printed again"]].sum() == 126
    assert table.loc["martin2022", ["reproduced", "not comparable"]].to_list() == [0, 43]
    assert table.loc["all", "all"] == len(card)
    assert (table.iloc[:-1].sum() == table.loc["all"]).all()


def test_what_was_read_off_a_figure_has_a_deviation():
    """Martin et al. print none; that of a reading makes the band of Figs 3 and 5, and of nothing else."""
    printed = pd.read_csv(PUBLISHED, dtype=str, keep_default_na=False).query("paper == 'martin2022'")
    read_off = printed["artefact"].isin(["Fig. 3", "Fig. 5"])
    assert set(printed[read_off]["unit"]) == {"mm"}
    assert set(printed[read_off]["std"]) == {"1.5"}
    assert set(printed[~read_off]["std"]) == {""}


numbers = st.decimals(0, 20, places=2).map(str)
deviations = st.just("") | st.decimals(0, 3, places=2).map(str)


quantities = st.sampled_from([("baaij2023", "e_u"), ("martin2022", "reduction"), ("yours2027", "e_u")])
cells = st.tuples(numbers, deviations, numbers, deviations, quantities)


def is_within(difference: Fraction, printed: str, *deviations: str) -> bool:
    """Return whether a difference lies within the band, in fractions: its edge belongs to it."""
    half = Fraction(10) ** int(Decimal(printed).as_tuple().exponent) / 2
    return abs(difference) <= half or difference**2 <= 3 * sum(Fraction(x or 0) ** 2 for x in deviations)


@settings(max_examples=6, deadline=None)
@given(st.lists(cells, min_size=1, max_size=60))
def test_verdicts_are_those_of_exact_arithmetic(tmp_path_factory, drawn):
    names = ("value", "std", "regenerated", "regenerated_std", "paper", "quantity")
    rows = [
        dict(zip(names, [*cell[:4], *cell[4]], strict=True)) | {"row": str(k), "note": "n"}
        for k, cell in enumerate(drawn)
    ]
    ours = [{name: x for name, x in row.items() if name not in ("value", "std")} for row in rows]
    found = card_of(tmp_path_factory.mktemp("card"), rows, ours)
    for (value, std, regenerated, ours_std, quantity), line in zip(
        drawn, found.to_dict("records"), strict=True
    ):
        d, band = Fraction(regenerated) - Fraction(value), (value, std, ours_std)
        better = "better" if d < 0 and quantity == ("baaij2023", "e_u") else "differs"
        expected = "reproduced" if is_within(d, *band) else better
        inner, outer = (is_within(d * 20 / share, *band) for share in (19, 21))
        truths = str(is_within(Fraction(value), *band)).lower(), str(outer and not inner).lower()
        assert (line["verdict"], line["weak"], line["near_edge"]) == (expected, *truths)


@pytest.mark.parametrize(
    ("ours", "expected"),
    [
        ({"regenerated": "1.75"}, "reproduced"),  # half a printed unit belongs to the band
        ({"regenerated": "1.76", "note": "n"}, "differs"),
        ({"regenerated": "1.6", "note": "n"}, "differs"),  # of what is no error nothing is better
        ({"regenerated": "9", "comparable": "false"}, "not_comparable"),
        ({"regenerated": "9", "setting": "benchmark"}, "not_comparable"),
    ],
)
def test_a_number_without_deviations_must_agree_to_its_last_printed_digit(tmp_path, ours, expected):
    assert card_of(tmp_path, [{"value": "1.7"}], [ours])["verdict"].to_list() == [expected]


def test_only_a_smaller_error_is_better(tmp_path):
    """An accuracy of 96.63 % where 96.7 % is printed asks for a note, as an accuracy of 97 % does."""
    for quantity, verdicts in (("median", ["better", "differs"]), ("accuracy", ["differs", "differs"])):
        names = [{"paper": "martin2022", "quantity": quantity, "row": row} for row in "ab"]
        printed = [name | {"value": "96.7"} for name in names]
        ours = [
            name | {"regenerated": x, "note": "n"} for name, x in zip(names, ["96.63", "97"], strict=True)
        ]
        assert card_of(tmp_path, printed, ours)["verdict"].to_list() == verdicts


def test_what_each_paper_prints_is_an_error_or_not(card):
    """A printed quantity is listed as an error, or it is one of those that are none: a new one is asked about."""
    printed = card[["paper", "quantity"]].drop_duplicates()
    assert set(printed["paper"]) == set(ERRORS)
    none = printed[~printed.apply(is_error, axis=1)]["quantity"]
    assert set(none) == {"update_rate", "reduction", "time"}


def test_a_printed_number_that_nobody_regenerates_is_missing(tmp_path):
    found = card_of(
        tmp_path, [{"value": "1"}, {"value": "2", "row": "b"}], [{"regenerated": "2", "row": "b"}]
    )
    assert found["verdict"].to_list() == ["missing", "reproduced"]
    assert found["published"].to_list() == ["1", "2"]


def test_weak_and_repeated_numbers_count_apart(tmp_path):
    printed = [{"value": "1", "row": row} for row in "abc"] + [{"value": "1", "std": "2", "row": "d"}]
    found = card_of(
        tmp_path,
        printed,
        [{"regenerated": x, "row": r} for x, r in zip(["1", "1", "1.1", "1"], "abcd", strict=True)],
    )
    assert kinds(found).to_list() == ["reproduced", "printed again", "reproduced", "weak"]


def test_a_number_counts_with_the_authors_files_if_it_was_computed_with_them(tmp_path):
    """Rows of further groups are taken if their setting says so, and if they do not say that they do not compare."""
    real = {"setting": "authors' files, as the authors did", "regenerated": "5"}
    printed = [{"value": "5", "row": row} for row in "abcd"]
    ours = [{"regenerated": "9", "row": row, "comparable": "false"} for row in "abcd"]
    group = [real | {"row": "a"}, {"regenerated": "5", "row": "b"}, real | {"row": "d"}]
    not_these = [real | {"regenerated": "9", "row": row, "comparable": "false"} for row in "ac"]
    later = real | {"row": "d", "regenerated": "7", "regenerated_std": "0.5", "note": "n"}
    first = card_of(tmp_path, printed, ours)
    second = card_of(tmp_path, printed, ours, group, [later, *not_these])
    both = beside(first, second)
    assert both["with_files_verdict"].to_list() == ["reproduced", "", "", "differs"]
    assert both.loc[3, WITH_FILES].to_list() == ["7", "0.5", real["setting"], "differs", "n"]
    assert both[COLUMNS].equals(first)
    assert summary(first, second).splitlines()[-1].split() == ["a", "1", "0", "1", "0", "0", "2", "0", "4"]
    with pytest.raises(ValueError, match="must have a note: a / a / d / a / a of c.rows.csv has none"):
        card_of(tmp_path, printed, ours, group, [later | {"note": ""}])


def test_the_summary_says_whose_files_are_not_here(card):
    """Mitchell et al. print no measured error, so their files decide none."""
    absent = [
        f"{paper}: not computed here; repro fetch {paper}, then make book"
        for paper in ("baaij2023", "martin2022")
    ]
    assert summary(card, card).splitlines()[-3:] == ["With them:", *absent]


def test_a_number_that_differs_must_have_a_note(tmp_path):
    with pytest.raises(ValueError, match="must have a note: a / a / a / a / a of a.rows.csv has none"):
        card_of(tmp_path, [{"value": "1"}], [{"regenerated": "3"}])


def test_a_number_is_regenerated_once(tmp_path):
    card_of(tmp_path, [{"value": "1"}], [{"regenerated": "1"}])
    (tmp_path / "b.rows.csv").write_bytes((tmp_path / "a.rows.csv").read_bytes())
    with pytest.raises(
        ValueError, match=r"a.rows.csv and b.rows.csv regenerate one number twice: a / a / a / a / a"
    ):
        scorecard(tmp_path / "published.csv", sorted(tmp_path.glob("*.rows.csv")))


@pytest.mark.parametrize(
    ("ours", "message"),
    [
        (
            {"regenerated": "1", "row": "b"},
            "a.rows.csv regenerates what published.csv does not list: a / a / b",
        ),
        ({"regenerated": "x"}, "regenerated of a.rows.csv must be a number in a / a / a / a / a; it is 'x'"),
        ({"regenerated": ""}, "must be a number in a / a / a / a / a; it is ''"),
        ({"regenerated": "1", "regenerated_std": "inf"}, "regenerated_std of a.rows.csv must be a number"),
    ],
)
def test_broken_rows_are_refused_in_words(tmp_path, ours, message):
    with pytest.raises(ValueError, match=message):
        card_of(tmp_path, [{"value": "1"}], [ours])


def test_another_table_is_refused_in_words(tmp_path):
    (tmp_path / "published.csv").write_text("paper,value\na,1\n")
    with pytest.raises(
        ValueError, match=r"published.csv must have the columns paper, .*; it has paper, value"
    ):
        scorecard(tmp_path / "published.csv", [])
    with pytest.raises(ValueError, match="There is no table"):
        scorecard(tmp_path / "nothing.csv", [])


def test_changed_verdicts_are_listed_both_ways(tmp_path):
    found = card_of(tmp_path, [{"value": "1"}, {"value": "1", "row": "b"}], [{"regenerated": "1"}])
    then = pd.DataFrame([dict.fromkeys(KEY, "a") | {"verdict": "not_comparable"}])
    then.to_csv(tmp_path / "reference.csv", index=False)
    assert changed(found, tmp_path / "reference.csv") == [
        "a / a / a / a / a: was not comparable, is reproduced",
        "a / a / b / a / a: was not listed, is missing",
    ]
