"""Running one notebook with papermill: whole or not at all, with a record of what it was made from.

``python -m edition1_companion.book.runner NOTEBOOK OUTPUT RESULTS FAILED [PARAMETERS]``, with parameters as JSON, is how
a page of the book and a point of a sweep are run in a process of their own.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edition1.errors import InputError, bad_input, require
from edition1_companion.book.digests import file_digest, tree_digests
from edition1_companion.book.points import one_thread
from edition1_companion.book.project import Project, find_project, runs_folder, shown
from edition1_companion.book.provenance import (
    Record,
    make_record,
    read_inputs,
    read_record,
    record_path,
    write_record,
)
from edition1_companion.book.termination import stop_on_termination
from edition1_companion.book.values import fill
from edition1_companion.recordings.sources import data_dir

if TYPE_CHECKING:
    from nbformat import NotebookNode


class NotebookFailed(Exception):
    """A notebook stopped before its end. The message names the failing cell and the partial notebook."""


def read_notebook(path: Path) -> NotebookNode:
    """Read a notebook.

    Parameters
    ----------
    path
        A file of notebook format 4.

    Raises
    ------
    InputError
        If there is no such file, or it is no notebook.
    """
    import nbformat

    require(path.is_file(), "notebook", "repro run", "an existing file", path)
    try:
        return nbformat.read(path, as_version=4)
    except RecursionError as error:
        raise bad_input(
            "notebook", "repro run", "a Jupyter notebook", f"{path} (nested too deeply)"
        ) from error
    except (ValueError, AttributeError, KeyError, TypeError, nbformat.ValidationError) as error:
        raise bad_input("notebook", "repro run", "a Jupyter notebook", f"{path} ({error})") from error


def default_output(notebook: Path, key: str, project: Project) -> Path:
    """Return where a run goes when no output is named: ``runs/<name>-<8 digits of the key>/<name>.ipynb``."""
    return runs_folder(project) / f"{notebook.stem}-{key[:8]}" / f"{notebook.stem}.ipynb"


def check_output(notebook: Path, output: Path, project: Project) -> None:
    """Refuse an output that would overwrite the notebook itself or anything of the book.

    Raises
    ------
    InputError
        If the output is no ``.ipynb``, is a folder, is the notebook, or lies in ``book/``, ``notebooks/`` or
        ``results/`` of the project.
    """
    if output.suffix != ".ipynb" or output.is_dir():
        raise bad_input("output", "repro run", "a file name that ends in .ipynb", output)
    if output.resolve() == notebook.resolve():
        raise bad_input("output", "repro run", "another file than the notebook", output)
    if owner := project.owner_of(output):
        raise bad_input("output", "repro run", f"outside {owner}/, which belongs to the book", output)


def run_notebook(
    notebook: Path,
    parameters: Mapping[str, Any],
    output: Path,
    results: Path,
    *,
    project: Project,
    failed: Path | None = None,
    progress: bool = False,
) -> Record:
    """Run a notebook; its output and tables appear when it has finished, and replace those of an earlier run.

    Parameters
    ----------
    notebook
        What to run; it is not changed.
    parameters
        Values that differ from the notebook's own, already of the declared types.
    output
        The executed notebook.
    results
        Folder of the tables. The record ``<name of output>.provenance.json`` lies beside the output.
    project
        Whose package, data and lock the record names.
    failed
        Where the partial notebook is kept on failure; ``<name>.failed.ipynb`` beside the output by default.
    progress
        Whether to draw a progress bar.

    Returns
    -------
    Record
        What the run was made from and what it made.

    Raises
    ------
    NotebookFailed
        If a cell raised an error or the kernel died. Earlier outputs and tables stay as they were.
    InputError
        If the notebook is missing or no notebook, or its text names a result that no cell gave.
    """
    import papermill
    from traitlets.config import Config

    read_notebook(notebook)
    failed = failed or output.with_name(f"{output.stem}.failed.ipynb")
    inputs = read_inputs(project)
    started, clock = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), time.monotonic()
    output.parent.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=f".{output.stem}-", dir=output.parent))
    try:
        partial, tables = staging / output.name, staging / "tables"
        # A kernel on TCP ports dies where another program takes one of them first. Paths of sockets must be
        # short (104 characters on macOS), hence a folder of their own.
        with (
            changed_environment(_kernel_environment(tables)),
            tempfile.TemporaryDirectory(prefix="repro-") as sockets,
        ):
            try:
                papermill.execute_notebook(
                    _literal(notebook),
                    _literal(partial),
                    dict(parameters),
                    kernel_name="python3",
                    language="python",
                    progress_bar=progress,
                    # All is written by then, and a kernel that ends itself closes sockets its threads still use:
                    # now and then it prints the errors of that.
                    shutdown_kernel="immediate",
                    config=Config(KernelManager={"transport": "ipc", "ip": f"{sockets}/kernel"}),
                )
            except BaseException as error:
                message = _keep_partial(notebook, partial, failed, error)
                # An interruption stays one, for whoever waits for it.
                if not isinstance(error, Exception):
                    print(message, file=sys.stderr)
                    raise
                raise NotebookFailed(message) from error
        _finish(partial, notebook, output)
        if results == project.results:
            from edition1_companion.book.thinning import thin  # its import of pandas takes a second

            thin(tables, project.data / "thinned.csv")
        record = make_record(
            project,
            notebook,
            parameters,
            inputs,
            started=started,
            seconds=time.monotonic() - clock,
            results=tree_digests(tables),
            executed=file_digest(partial),
        )
        _publish(record, tables, results, partial, output)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    failed.unlink(missing_ok=True)
    return record


def _literal(path: Path) -> str:
    # papermill formats paths: braces are doubled to stand for themselves
    return str(path.absolute()).replace("{", "{{").replace("}", "}}")


def _kernel_environment(tables: Path) -> dict[str, str]:
    folders = {"REPRO_RESULTS_DIR": str(tables.absolute()), "REPRO_DATA_DIR": str(data_dir())}
    # The debugger of ipykernel warns at every start about modules that Python has frozen.
    return {**one_thread(), **folders, "PYDEVD_DISABLE_FILE_VALIDATION": "1"}


@contextlib.contextmanager
def changed_environment(changes: Mapping[str, str]) -> Iterator[None]:
    """Change the environment, which the kernel inherits, and change it back."""
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _keep_partial(notebook: Path, partial: Path, failed: Path, error: BaseException) -> str:
    """Keep the partial notebook and return a message that says where it is and which cell failed."""
    if not partial.is_file():
        return f"{shown(notebook)} failed before its first cell: {_describe(error)}"
    _finish(partial, notebook, failed, complete=False)
    failed.parent.mkdir(parents=True, exist_ok=True)
    partial.replace(failed)
    number, head = _last_cell_begun(failed)
    said = f"{shown(notebook)} failed in code cell {number}: {head}\n  {_describe(error)}"
    return f"{said}\n  The partial notebook is {shown(failed)}"


def _describe(error: BaseException) -> str:
    # papermill's own error prints a page; its name and value are what the cell raised
    name, value = getattr(error, "ename", type(error).__name__), getattr(error, "evalue", str(error))
    return f"{name}: {value}".strip().removesuffix(":")


def _last_cell_begun(path: Path) -> tuple[int, str]:
    """Return number, as in ``In [number]``, and first line of the last code cell that was begun."""
    begun = [
        cell.source
        for cell in read_notebook(path).cells
        if cell.cell_type == "code" and cell.metadata.get("papermill", {}).get("start_time")
    ]
    return len(begun), begun[-1].strip().partition("\n")[0] if begun else "(none was begun)"


def _finish(path: Path, notebook: Path, output: Path, *, complete: bool = True) -> None:
    """Replace the absolute paths that papermill notes in a notebook by names, and fill a complete one's text."""
    import nbformat

    content = nbformat.read(path, as_version=4)
    content.metadata.papermill.update(input_path=notebook.name, output_path=output.name)
    if complete:
        fill(content, notebook.name)
    nbformat.write(content, path)


def _publish(record: Record, tables: Path, results: Path, partial: Path, output: Path) -> None:
    """Move tables and executed notebook to their places, and drop tables that only the earlier run wrote."""
    place = record_path(output)
    earlier = read_record(place)
    # Without a record nothing counts as finished: an interruption between here and its writing is noticed.
    place.unlink(missing_ok=True)
    for name in set(earlier.results if earlier else ()) - set(record.results):
        (results / name).unlink(missing_ok=True)
    for name in record.results:
        (results / name).parent.mkdir(parents=True, exist_ok=True)
        (tables / name).replace(results / name)
    partial.replace(output)
    write_record(record, place)


def main(arguments: list[str]) -> int:
    """Run one notebook; return 0, or 1 after saying why it failed."""
    stop_on_termination()
    notebook, output, results, failed = map(Path, arguments[:4])
    parameters, project = json.loads("".join(arguments[4:]) or "{}"), find_project()
    try:
        run_notebook(notebook, parameters, output, results, project=project, failed=failed)
    except (NotebookFailed, InputError) as failure:
        print(failure)  # libraries write to standard error
        return 1
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
