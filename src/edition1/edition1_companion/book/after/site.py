"""Building the site with jupyter-book, when anything that it shows has changed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from edition1.errors import require
from edition1.files import write_whole
from edition1_companion.book.digests import combined_digest, file_digest, tree_digests
from edition1_companion.book.project import Project, shown

# Written among the sources while building, which would change their hash; all of it follows from the rest.
_WRITTEN_BY_SPHINX = ("_build", "generated")
_PAGES_AT_THE_TOP = {".md", ".cff", ".toml", ".lock"}


class SiteFailed(Exception):
    """The site could not be built. The message holds the output of jupyter-book."""


def site_key(project: Project) -> str:
    """Return a hash of all that the site shows: pages, executed notebooks, results, data and docstrings."""
    top = sorted(
        path for path in project.root.iterdir() if path.suffix in _PAGES_AT_THE_TOP and path.is_file()
    )
    return combined_digest(
        [
            {path.name: file_digest(path) for path in top},
            tree_digests(project.book, leave_out=_WRITTEN_BY_SPHINX),
            tree_digests(project.results),
            tree_digests(project.data),
            tree_digests(project.sources),
        ]
    )


def build_site(project: Project) -> float | None:
    """Build the site unless it is up to date.

    Parameters
    ----------
    project
        Its ``book/`` is built to ``book/_build/html``.

    Returns
    -------
    float or None
        Seconds that it took; None where there was nothing to do.

    Raises
    ------
    SiteFailed
        If jupyter-book fails or warns. The earlier site stays, and counts as out of date.
    InputError
        If jupyter-book is not installed beside the interpreter.
    """
    key, done = site_key(project), project.cache / "site"
    site = project.book / "_build" / "html"
    if (site / "index.html").is_file() and done.is_file() and done.read_text(encoding="utf-8").strip() == key:
        return None
    done.unlink(missing_ok=True)
    started = time.monotonic()
    # Always from nothing, and elsewhere: Sphinx warns only about pages that it reads anew, so that a second
    # attempt after a failed one would pass; and readers never meet a site that is half built.
    fresh = project.cache / "fresh"
    shutil.rmtree(fresh, ignore_errors=True)
    _run_jupyter_book(project, fresh)
    _replace_folder(fresh / "_build" / "html", site, aside=project.cache / "replaced")
    shutil.rmtree(fresh, ignore_errors=True)
    write_whole(done, key + "\n")
    return time.monotonic() - started


def _run_jupyter_book(project: Project, fresh: Path) -> None:
    # Not resolved: the interpreter of an environment is a link, and its programs lie beside the link.
    program = Path(sys.executable).with_name("jupyter-book")
    require(program.is_file(), "jupyter-book", "the build", "installed beside the interpreter", program)
    fresh.mkdir(parents=True)
    command = [program, "build", project.book, "--path-output", fresh, "-W", "-n", "--keep-going"]
    environment = {**os.environ, "NO_COLOR": "1"}
    done = subprocess.run(
        list(map(str, command)),
        cwd=project.root,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        check=False,
    )
    if done.returncode or not (fresh / "_build" / "html" / "index.html").is_file():
        log = project.cache / "site.log"
        write_whole(log, done.stdout)
        lines = [x for x in done.stdout.splitlines() if "WARNING" in x or "ERROR" in x or "Error" in x]
        raise SiteFailed(
            "\n".join(lines or done.stdout.splitlines()[-20:])
            + f"\njupyter-book ended with {done.returncode}; the site was not replaced. All it said: {shown(log)}"
        )


def _replace_folder(new: Path, place: Path, aside: Path) -> None:
    shutil.rmtree(aside, ignore_errors=True)
    place.parent.mkdir(parents=True, exist_ok=True)
    if place.exists():
        place.replace(aside)
    new.replace(place)
    shutil.rmtree(aside, ignore_errors=True)
