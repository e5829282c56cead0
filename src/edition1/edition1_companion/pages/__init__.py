"""A module or folder for each notebook, which nothing else imports."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edition1_companion.book.studies import Study


def all_studies() -> tuple[Study, ...]:
    """The studies of all pages, those of a page in its module ``studies``."""
    pages = sorted(path.parent.name for path in Path(__file__).parent.glob("*/studies.py"))
    return tuple(s for page in pages for s in import_module(f"{__name__}.{page}.studies").STUDIES)
