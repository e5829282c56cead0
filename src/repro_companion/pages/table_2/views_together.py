"""Several 3-D views as one output of a notebook's cell, side by side where there is room."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import dataclass

from repro.errors import bad_input
from repro_live.view.shape_view import ShapeView


@dataclass(frozen=True, repr=False)
class ShapeViews:
    """Views, each below its title; displays itself in a notebook and in the book.

    Parameters
    ----------
    views
        By title.

    Raises
    ------
    InputError
        If there is none.
    """

    views: Mapping[str, ShapeView]

    def __post_init__(self) -> None:
        if not self.views:
            raise bad_input("views", "ShapeViews", "at least one", "none")

    def to_html(self) -> str:
        """Return the views as groups named by their titles; the viewer's style puts them side by side."""
        groups = (
            f'<div role="group" aria-label="{html.escape(title)}">'
            f"<p><strong>{html.escape(title)}</strong></p>{view.to_html()}</div>"
            for title, view in self.views.items()
        )
        return f'<div class="shape-views">{"".join(groups)}</div>'

    def _repr_html_(self) -> str:
        return self.to_html()

    def __repr__(self) -> str:
        return "\n".join(f"{title}: {view!r}" for title, view in self.views.items())
