"""What is asked of a page: its size, and that no result is typed into its text."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pandas as pd
import pytest

from repro.common import InputError
from repro_companion.run import declared
from repro_companion.scorecard_page import findings
from repro_companion.show import checked

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    path.stem: json.loads(path.read_text(encoding="utf-8"))["cells"]
    for path in sorted(ROOT.glob("notebooks/*.ipynb"))
}
HIDDEN = {"parameters", "remove-input", "hide-input", "remove-cell", "hide-cell"}
DIRECTIVE = re.compile(r"^(`{3,}|:{3,})\{(?:dropdown|figure)\}.*?^\1\s*$", re.DOTALL | re.MULTILINE)


def hidden(cell: dict) -> bool:
    """Whether a reader never sees the code of a cell at once; a solution is folded, and counts as shown."""
    tags = set(cell["metadata"].get("tags", []))
    return bool(HIDDEN & tags) and "solution" not in tags


def statements(code: str) -> int:
    """Return the number of statements."""
    return sum(isinstance(node, ast.stmt) for node in ast.walk(ast.parse(code)))


def sources(page: str, kind: str) -> list[str]:
    """Return the cells of one kind."""
    return ["".join(cell["source"]) for cell in PAGES[page] if cell["cell_type"] == kind]


@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_short(page):
    """CONTRIBUTING says so: 12 cells, 110 statements, 88 columns where a reader sees the code."""
    code = sources(page, "code")
    exercise = any("solution" in cell["metadata"].get("tags", []) for cell in PAGES[page])
    assert len(code) <= 13 + 2 * exercise, "12 and the parameters, 14 with an exercise in code"
    assert sum(map(statements, code)) <= 110
    shown = [
        "".join(cell["source"]) for cell in PAGES[page] if cell["cell_type"] == "code" and not hidden(cell)
    ]
    assert max(len(line) for cell in shown for line in cell.splitlines()) <= 88


@pytest.mark.parametrize("page", PAGES)
def test_at_most_a_third_of_the_code_of_a_page_is_hidden(page):
    """Parameters apart, and with the folded solution of an exercise."""
    sizes = {True: 0, False: 0}
    for cell in PAGES[page]:
        tags = set(cell["metadata"].get("tags", []))
        if cell["cell_type"] == "code" and "parameters" not in tags:
            sizes[bool(HIDDEN & tags)] += statements("".join(cell["source"]))
    assert 2 * sizes[True] <= sizes[False]


@pytest.mark.parametrize("page", PAGES)
def test_a_page_shows_its_item_first(page):
    tags = [tag for cell in PAGES[page] for tag in cell["metadata"].get("tags", [])]
    assert 1 <= tags.count("first") <= 2
    assert tags.count("parameters") == 1


@pytest.mark.parametrize("page", PAGES)
def test_every_number_that_a_page_takes_has_limits(page):
    """Else a huge count runs without end; seeds may be anything from 0."""
    for name, one in declared(ROOT / "notebooks" / f"{page}.ipynb").items():
        if one.kind in ("int", "float"):
            assert not one.allows(-1e30), name
            assert name == "seed" or one.kind == "float" or not one.allows(10**30), name


@pytest.mark.parametrize("page", PAGES)
def test_a_page_outside_of_the_project_stops_in_its_first_cell(page, tmp_path, monkeypatch):
    """As papermill runs it from another folder: before the work, not where it saves a table."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("REPRO_RESULTS", raising=False)
    parameters, first, *_ = sources(page, "code")
    with pytest.raises(InputError, match="must be inside a checkout of the project; instead received"):
        exec(f"{parameters}\n{first}", {})


@pytest.mark.parametrize("page", PAGES)
def test_a_page_refuses_a_text_for_a_number_in_its_first_cell(page):
    """As plain papermill hands it on; what the notebook itself declares is allowed, and whole numbers for any."""
    parameters, first, *_ = sources(page, "code")
    assert not ast.unparse(ast.parse(first).body[-1]).startswith("checked("), "or the page shows its folder"
    given: dict[str, object] = {}
    exec(parameters, given)
    assert checked(page, given) == ROOT
    for name, one in declared(ROOT / "notebooks" / f"{page}.ipynb").items():
        if one.kind in ("int", "float"):
            words = (
                rf"parameter {name} of {page}\.ipynb must be {one.kind}: a .*number.*; instead received '1'\."
            )
            with pytest.raises(InputError, match=words):
                exec(f"{parameters}\n{name} = '1'\n{first}", {})
            if one.kind == "float" and one.allows(1):
                checked(page, given | {name: 1})


@pytest.mark.parametrize("page", PAGES)
def test_no_result_is_typed_into_the_text(page):
    """A number with three or more significant digits that stands in a column that the page computed."""
    code = "\n".join(sources(page, "code"))
    computed: set[str] = set()
    for name in set(re.findall(r"\"([a-z0-9_.]+)\"", code)):
        path = ROOT / "results" / f"{name}.csv"
        if path.is_file():
            numbers = pd.read_csv(path).select_dtypes("float").to_numpy().ravel()
            computed |= {f"{number:.{digits}g}" for number in numbers for digits in (3, 4, 5)}
    text = DIRECTIVE.sub(" ", "\n".join(sources(page, "markdown")))
    typed = {
        found
        for found in re.findall(r"(?<![\w.{-])\d+\.\d+", text)
        if len(found.replace(".", "").lstrip("0")) > 2
    }
    assert typed & computed == set()


# Sizes that stand in words, because a sentence with digits would read worse


def results(name: str) -> pd.DataFrame:
    """Return a committed table."""
    return pd.read_csv(ROOT / "results" / f"{name}.csv")


def card(**chosen: str) -> pd.DataFrame:
    """Return rows of the scorecard."""
    return results("scorecard").query(" and ".join(f"{name} == '{value}'" for name, value in chosen.items()))


def by_imus(evaluation: str) -> pd.DataFrame:
    """Return medians of the rigid-body model, a row for each number of IMUs, a column for each marker."""
    rigid = results("imu_markers_errors").query(f"figure == 'Fig. 3' and evaluation == '{evaluation}'")
    return rigid.pivot_table("median_mm", "n_imus", "marker")


def of_filter() -> pd.DataFrame:
    """Return how our filter compares with the descent of Table 2, a row for each robot."""
    return results("table_2_filter").set_index("robot")


def of_particles() -> pd.DataFrame:
    """Return errors of the filter as printed [mm], a row for each curve, a column for each number of particles."""
    return (
        results("bend_summary")
        .query("setting == 'as printed'")
        .pivot(index="curve", columns="particles", values="rmse_mm")
    )


HOME = findings(
    pd.read_csv(ROOT / "results" / "scorecard.csv", dtype=str, keep_default_na=False),
    *(
        pd.read_csv(ROOT / "data" / "studies" / f"{name}.csv")
        for name in ("table_1_noise", "table_2_networks")
    ),
)


def worse_readings() -> float:
    """Return in which share of the rows of Table 1 our networks predict the readings worse, as far as print tells."""
    rows = card(artefact="Table 1", quantity="e_u").query("row not in ['n_s=9', 'nominal']")
    return (rows["regenerated"].round(3) > rows["published"]).mean()


def of_searches(model: str) -> pd.Series:
    """Return the error of one segment with the descent over the one with least squares, for each seed."""
    found = results("table_1_models").query(f"model == '{model}'")
    wide = found.pivot(index="seed", columns="solver", values="configuration_percent")
    return wide["gradient descent"] / wide["Levenberg-Marquardt"]


WORDS = [
    (
        "book/index.md",
        "although our networks predict the readings no better",
        lambda: worse_readings() > 0.5,
    ),
    (
        "notebooks/table_1.ipynb",
        "are mostly predicted no better",
        lambda: worse_readings() > 0.5,
    ),
    (
        "notebooks/table_1.ipynb",
        "With the two better models the search matters as well",
        lambda: (
            of_searches("network of the paper").max()
            < 1.1
            < 1.3
            < min(of_searches(name).min() for name in ("fast network", "multipole"))
        ),
    ),
    (
        "book/index.md",
        "In Table 1 our errors of the shape are on average a fifth smaller",
        lambda: 0.75 < results("table_1_bias").set_index("n_b").loc["all", "ratio"] < 0.85,
    ),
    (
        "book/index.md",
        "the error falls as in the paper if we use more sensors and evaluate where the authors' files do",
        lambda: (by_imus("as in the files").diff().dropna() < 0).all(axis=None),
    ),
    (
        "book/index.md",
        "With the rigid links that the text describes, eight sensors have a larger error than two",
        lambda: (by_imus("as described").loc[8] > by_imus("as described").loc[2]).all(),
    ),
    (
        "book/index.md",
        "If the networks that the authors released play the robot, the errors are nearer to the printed ones",
        lambda: float(HOME["home.networks_most"]) < float(HOME["home.rig_most"]),
    ),
    (
        "notebooks/table_2.ipynb",
        "Half the step lowers the errors only a little on average",
        lambda: 0.8 < (of_filter()["of_descent"] / of_filter()["of_half_step"])["simulated rig"] < 1,
    ),
    (
        "book/scorecard.md",
        "we do not obtain their three numbers",
        lambda: list(card(paper="mitchell2021", artefact="Section II-D")["verdict"]) == ["differs"] * 3,
    ),
    (
        "notebooks/table_1.ipynb",
        "One cell differs, the bend in y of segment 1 with six sensors",
        lambda: (
            card(artefact="Table 1", verdict="differs")[["row", "quantity"]].to_numpy().tolist()
            == [["n_s=6", "delta_y_1"]]
        ),
    ),
    (
        "notebooks/table_2.ipynb",
        "Our filter needs neither, nor a step size",
        lambda: (of_filter()["of_descent"] < 1).all(),
    ),
    (
        "notebooks/particle_filter.ipynb",
        "ten times the particles make it more than twice as accurate",
        lambda: (of_particles()[100] > 2 * of_particles()[1000]).all(),
    ),
    (
        "notebooks/particle_filter.ipynb",
        "our error is more than four times the published one",
        lambda: (
            of_particles()[1000] / card(quantity="rmse_position").set_index("row")["published"] > 4
        ).all(),
    ),
]


@pytest.mark.parametrize(("place", "words", "holds"), WORDS, ids=[words for _, words, _ in WORDS])
def test_sizes_in_words_are_those_of_the_tables(place, words, holds):
    texts = (
        sources(Path(place).stem, "markdown") if place.endswith(".ipynb") else [(ROOT / place).read_text()]
    )
    assert words in " ".join(" ".join(texts).split())
    assert holds()
