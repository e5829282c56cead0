"""The folders of a project: where notebooks, book, data and results lie."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from edition1.errors import bad_input
from edition1_companion.recordings.sources import recordings_are_here


@dataclass(frozen=True)
class Project:
    """A folder with a ``pyproject.toml`` that has a table ``tool.repro``, and the places in it."""

    root: Path
    """The folder itself, absolute."""

    @property
    def notebooks(self) -> Path:
        """The notebooks, without outputs."""
        return self.root / "notebooks"

    @property
    def book(self) -> Path:
        """The sources of the site."""
        return self.root / "book"

    @property
    def executed(self) -> Path:
        """The executed notebooks that are pages of the site."""
        return self.book / "notebooks"

    @property
    def results(self) -> Path:
        """The tables that the book's notebooks wrote: those without recordings are committed, the others ignored."""
        folder = self.root / "results"
        return folder / "with_recordings" if recordings_are_here() else folder

    @property
    def data(self) -> Path:
        """Published numbers, trained networks and manifests."""
        return self.root / "data"

    @property
    def published(self) -> Path:
        """Every number that the papers print."""
        return self.data / "published" / "published.csv"

    @property
    def sources(self) -> Path:
        """The folder of the packages of the first edition."""
        return self.root / "src" / "edition1"

    @property
    def cache(self) -> Path:
        """What builds remember; may be deleted at any time."""
        return self.root / ".cache" / "book"

    def owner_of(self, path: Path) -> str | None:
        """Return which of ``book``, ``notebooks`` and ``results`` a path lies in, or None."""
        resolved = path.resolve()
        for folder in (self.book, self.notebooks, self.root / "results"):
            if resolved.is_relative_to(folder.resolve()):
                return folder.name
        return None


def find_project(start: Path | None = None) -> Project:
    """Return the project around a folder.

    Parameters
    ----------
    start
        Where to start; the current folder by default. The nearest folder at or above it whose
        ``pyproject.toml`` has a table ``tool.repro`` is the project; without one, the project is the checkout
        that the package runs from.

    Raises
    ------
    InputError
        If there is neither: the package came as a wheel, which has no notebooks, book, data or results.
    """
    here = (start or Path.cwd()).absolute()
    for folder in (here, *here.parents, Path(__file__).resolve().parents[4]):
        if _is_project(folder):
            return Project(folder)
    raise bad_input("current folder", "repro", "inside a checkout of the project, for it needs one", here)


def _is_project(folder: Path) -> bool:
    file = folder / "pyproject.toml"
    if not file.is_file():
        return False
    try:
        return "repro" in tomllib.loads(file.read_text(encoding="utf-8")).get("tool", {})
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        return False


def runs_folder(project: Project | None = None) -> Path:
    """Return the folder for runs of one's own: ``runs/`` below the current folder.

    A reader who works inside ``notebooks/``, ``book/`` or ``results/`` gets ``runs/`` of the project, so that
    nothing of theirs mixes with the book's.
    """
    here = Path.cwd()
    project = project or find_project()
    return (project.root if project.owner_of(here) else here) / "runs"


def shown(path: Path) -> str:
    """Return a path as it is told to a reader: relative to the current folder where it lies below it."""
    path, here = path.absolute(), Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)
