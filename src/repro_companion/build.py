"""Build the book: run the notebooks whose inputs changed, compute the scorecard, make the pages and the site.

``python -m repro_companion.build`` is what ``make book`` runs, and with the name of a notebook ``make page P=NAME``.
"""

from __future__ import annotations

import ast
import fcntl
import html
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import CodeType

import pandas as pd

from repro_companion import run as tool
from repro_companion.run import InputError, Parameter, Point, Record, RunFailed
from repro_companion.scorecard import beside, scorecard, write
from repro_companion.scorecard_page import write_pages
from repro_companion.show import rendered, show

LONGEST = 60
"""Rows of a table that a page shows in full; of a longer one it has the file."""


@contextmanager
def alone(root: Path) -> Iterator[None]:
    """Keep other builds of this folder out: two would move each other's pages and tables."""
    path = root / ".cache" / "book" / "lock"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RunFailed(
                "Another `make book` or `make page` is at work in this folder. Run this again when it has ended."
            ) from None
        yield


def build(root: Path, jobs: int) -> str:
    """Build the book; return what was done, in a sentence."""
    executed, results = root / "book" / "notebooks", results_folder(root)
    notebooks = {path.stem: path for path in sorted((root / "notebooks").glob("*.ipynb"))}
    for leftover in executed.glob("*"):
        if leftover.name.partition(".")[0] not in notebooks:
            shutil.rmtree(leftover) if leftover.is_dir() else leftover.unlink()
    inputs = tool.inputs_of(root)
    points = [page_point(root, path, inputs) for path in notebooks.values()]
    due = [point for point in points if not point.finished]
    run_pages(due, jobs)
    keep_told_apart(executed, results, notebooks)
    done, key = root / ".cache" / "book" / "site", site_key(root)
    done.parent.mkdir(parents=True, exist_ok=True)
    seconds = 0.0
    if not (root / "book/_build/html/index.html").is_file() or not done.is_file() or done.read_text() != key:
        done.unlink(missing_ok=True)
        write_pages(root, *write_scorecard(root, results)[1:])
        seconds = build_site(root, root / "book" / "_build" / "html", "-W", "-n", "--keep-going")
        done.write_text(site_key(root))
    current = f"{len(notebooks) - len(due)} of {len(notebooks)} notebooks were up to date"
    return f"{current}; the site {f'was built in {seconds:.0f} s' if seconds else 'was too'}."


def build_page(root: Path, name: str) -> str:
    """Run one notebook if it is due and build its page alone; return where that lies."""
    notebook = root / "notebooks" / f"{name}.ipynb"
    tool.require(notebook.is_file(), "P", "make page", "the name of a notebook, such as table_1", name)
    point = page_point(root, notebook, tool.inputs_of(root))
    run_pages([] if point.finished else [point], 1)
    contents = root / ".cache" / "book" / "page.yml"
    contents.parent.mkdir(parents=True, exist_ok=True)
    contents.write_text(
        f"format: jb-book\nroot: notebooks/{name}\nchapters:\n- file: bibliography\n", encoding="utf-8"
    )
    # The page shows what its paper claims beside the numbers of this run.
    write_pages(root, *write_scorecard(root, results_folder(root))[1:])
    site = root / "book" / "_build" / "page"
    seconds = build_site(root, site, "--toc", str(contents))
    page = site / "notebooks" / f"{name}.html"
    return f"{tool.shown(page)}  ({seconds:.1f} s; links to other pages lead nowhere here)"


def results_folder(root: Path) -> Path:
    """Return where the book's tables lie: those without recordings are committed, the others are not."""
    return root / "results" / ("with_recordings" if tool.recordings() else "")


def page_point(root: Path, notebook: Path, inputs: str) -> Point:
    """Return a page of the book as something to run, with the notebook's own parameters."""
    return Point(
        notebook=notebook,
        parameters={},
        key=tool.key_of(notebook, {}, inputs),
        output=root / "book" / "notebooks" / notebook.name,
        results=results_folder(root),
        root=root,
    )


def run_pages(points: Sequence[Point], jobs: int) -> None:
    """Run pages, several at once; say why some failed. One that shows a warning fails, and runs again."""
    if points:
        # In a process of its own: who only asks whether the book is up to date need not wait for its imports.
        subprocess.run([sys.executable, "-m", "repro_companion.kernels"], check=False)

    def one(point: Point) -> str:
        name = point.notebook.stem
        print(f"{name}: started\n", end="", flush=True)  # in one piece: others write too
        said, seconds = tool.run_point(point)
        print(f"{name}: {'failed after' if said else 'done in'} {seconds:.1f} s\n", end="", flush=True)
        if not said and (warned := warnings_of(point.output)):
            tool.record_path(point.output).unlink()
            said = f"{name}.ipynb shows a warning: {warned}"
        return said

    with ThreadPoolExecutor(max(1, jobs)) as pool:
        failures = [said for said in pool.map(one, points) if said]
    if failures:
        raise RunFailed("\n".join(failures))


def warnings_of(executed: Path) -> str:
    """Return what the cells of an executed notebook wrote to standard error."""
    cells = json.loads(executed.read_text(encoding="utf-8"))["cells"]
    outputs = (output for cell in cells for output in cell.get("outputs", []))
    return "".join("".join(one["text"]) for one in outputs if one.get("name") == "stderr").strip()


def keep_told_apart(executed: Path, results: Path, notebooks: Iterable[str]) -> None:
    """Remove tables that no page wrote; refuse one that two pages wrote, which then both run again."""
    writers: dict[str, list[str]] = {}
    for name in notebooks:
        record = tool.read_record(executed / f"{name}.ipynb") or {"results": {}}
        for table in record["results"]:
            writers.setdefault(table, []).append(name)
    for table, names in writers.items():
        if len(names) > 1:
            for name in names:
                tool.record_path(executed / f"{name}.ipynb").unlink()
            raise RunFailed(f"The table {table} is written by more than one notebook: {', '.join(names)}.")
    for table in results.glob("*.csv"):
        if table.name not in writers and table.name != "scorecard.csv":
            table.unlink()


def write_scorecard(root: Path, results: Path) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Compare the tables with every printed number; return what was written, and both states that the site shows.

    The state without the authors' files is always that of ``results/``, whose tables are committed.
    """
    results.mkdir(parents=True, exist_ok=True)
    folders = results, root / "results", root / "data" / "studies"
    here, without, studies = (sorted(folder.glob("*.rows.csv")) for folder in folders)
    published = root / "data/published/published.csv"
    real = scorecard(published, without, studies, here)
    card = beside(scorecard(published, here), real)
    write(card, results / "scorecard.csv")
    return card, scorecard(published, without), real


# The page of a notebook


def page_of(executed: Record, root: Path, name: str) -> Record:
    """Return an executed notebook, as JSON holds it, as the page shows it; called when Sphinx reads it."""
    place = root / "book" / "notebooks" / f"{name}.ipynb"
    record = tool.read_record(place)
    parameters = tool.declared(place)
    cells, first, unseen = [], [], set(parameters)
    for cell in executed["cells"]:
        about = dict(cell["metadata"])
        tags = set(about.get("tags", []))
        cell = {**cell, "metadata": about}
        # A figure that depends on what there is to show brings its own caption.
        captions = [
            out["metadata"]["caption"]
            for out in cell.get("outputs", [])
            if out.get("metadata", {}).get("caption")
        ]
        if captions:
            look = about["mystnb"]
            about["mystnb"] = {**look, "figure": {**look["figure"], "caption": captions[0]}}
        if "first" in tags and cell.get("outputs"):
            shown = {"tags": ["remove-input"], "mystnb": about.pop("mystnb", {})}
            first.append({**cell, "id": f"{cell['id']}-first", "source": "# moved", "metadata": shown})
            cell["outputs"] = []
        hidden = tags & {"parameters", "injected-parameters"}
        silent = (
            cell["cell_type"] == "code" and not cell["outputs"] and tags & {"remove-input", "remove-cell"}
        )
        if hidden or silent:
            about["tags"] = sorted(tags | {"remove-cell"})
        if cell["cell_type"] == "code" and not tags & UNREAD:
            used = unseen & names_in("".join(cell["source"]))
            cells += [_values(parameters, record, used, cell["id"])] if used else []
            unseen -= used
        cells.append(cell)
    texts = record and (
        _numbers(record, root, name),
        _parameters(parameters, record, name),
        rendered("fold_provenance.md", record=record, name=name),
    )
    folds = [
        {"cell_type": "markdown", "id": f"fold-{number}", "metadata": {}, "source": text}
        for number, text in enumerate(filter(None, texts or ()))
    ]
    generated = root / "book" / "generated" / f"claims_{name}.md"
    claimed = generated.read_text(encoding="utf-8") if generated.is_file() else ""
    claims = [{"cell_type": "markdown", "id": "claims", "metadata": {}, "source": claimed}] if claimed else []
    return {**executed, "cells": [*cells[:1], *first, *claims, *cells[1:], *folds]}


UNREAD = {"parameters", "injected-parameters", "remove-input", "remove-cell", "hide-input"}
"""Tags of cells whose code a reader does not see at once."""


def names_in(source: str) -> set[str]:
    """Return the names that code looks up outside of its functions, without those of attributes."""
    codes = [compile(source, "cell", "exec")]
    for code in codes:
        codes += [part for part in code.co_consts if isinstance(part, CodeType)]
    named = {node.id for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Name)}
    return named.intersection(name for code in codes for name in code.co_names)


def _values(parameters: Mapping[str, Parameter], record: Record | None, used: set[str], owner: str) -> Record:
    """Return a grey line with the values of the parameters that a cell is the first to use."""
    run_with = record["parameters"] if record else {}
    values = [
        f"{name} = {run_with[name]!r}" if name in run_with else f"{name} = {one.default}"
        for name, one in parameters.items()
        if name in used
    ]
    line = f'<p class="parameter-values">Parameters: <code>{html.escape(", ".join(values))}</code></p>'
    return {"cell_type": "markdown", "id": f"values-{owner}", "metadata": {}, "source": line}


def _numbers(record: Record, root: Path, name: str) -> str:
    """Return the fold with all tables of a page, each with its file."""
    results, page, tables = results_folder(root), root / "book" / "notebooks", []
    for file in record["results"]:
        table = pd.read_csv(results / file, keep_default_na=False, na_values=[""])
        open_ = len(table) <= LONGEST and not file.endswith(".rows.csv")
        shown = re.sub(r"\n\s*\n", "\n", show(table).to_html()) if open_ else ""
        tables.append((file, os.path.relpath(results / file, page), len(table), shown))
    return rendered("fold_numbers.md", tables=tables) if tables else ""


def _parameters(parameters: Mapping[str, Parameter], record: Record, name: str) -> str:
    """Return the fold with the parameters and the command that repeats the page with others."""
    if not parameters:
        return ""
    here = {
        one.name: tool.typed(record["parameters"].get(one.name, one.default)) for one in parameters.values()
    }
    example = parameters.get("fast") or next(iter(parameters.values()))
    value = "true" if example.kind == "bool" else example.default.strip("\"'")
    chosen = f"{example.name} {shlex.quote(value)}"
    return rendered("fold_parameters.md", parameters=parameters.values(), here=here, name=name, chosen=chosen)


# The site


def site_key(root: Path) -> str:
    """Return a hash of all that the site shows."""
    top = [path for path in sorted(root.iterdir()) if path.suffix in (".md", ".cff", ".toml")]
    folders = [
        tool.digests(root / name, ["_build", "generated"]) for name in ("book", "results", "data", "src")
    ]
    return tool.combined([list(map(tool.digest, top)), folders])


def build_site(root: Path, place: Path, *options: str) -> float:
    """Build the book with jupyter-book, elsewhere first, and put it in its place; return the seconds."""
    clock = time.monotonic()
    cache = root / ".cache" / "book"
    # From nothing: Sphinx warns only of pages that it reads, so a second attempt after a failure would pass.
    fresh = cache / f"fresh-{place.name}"
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    # Beside the interpreter, which in an environment is a link: its target has other programs beside it.
    done = subprocess.run(
        [
            Path(sys.executable).with_name("jupyter-book"),
            "build",
            root / "book",
            "--path-output",
            fresh,
            *options,
        ],
        cwd=root,
        env=os.environ | {"NO_COLOR": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        check=False,
    )
    built, log = fresh / "_build" / "html", cache / "site.log"
    if done.returncode or not (built / "index.html").is_file():
        log.write_text(done.stdout, encoding="utf-8")
        lines = [
            line for line in done.stdout.splitlines() if re.search(r"WARNING|ERROR|CRITICAL|Error", line)
        ]
        said = "\n".join(lines or done.stdout.splitlines()[-20:])
        raise RunFailed(
            f"{said}\njupyter-book ended with {done.returncode}; the site was not replaced."
            f" All it said: {tool.shown(log)}"
        )
    shutil.rmtree(place, ignore_errors=True)
    place.parent.mkdir(parents=True, exist_ok=True)
    shutil.move(built, place)  # it may lie on another disk
    shutil.rmtree(fresh)
    return time.monotonic() - clock


def main(names: Sequence[str]) -> int:
    """Build the book, or the pages named; return 0, 1 on failure or 2 for wrong input."""
    tool.stop_on_termination()
    try:
        root, asked = tool.project_folder(), os.environ.get("JOBS") or str(os.cpu_count() or 1)
        jobs = int(asked) if asked.isdecimal() else 0
        tool.require(jobs > 0, "JOBS", "the build", "a whole number of 1 or more", asked)
        with alone(root):
            for name in names:
                print(build_page(root, name))
            if not names:
                print(build(root, jobs))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except (RunFailed, ValueError) as failure:
        print(failure, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
