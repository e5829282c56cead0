"""Templates of pages (Jinja), filled by :func:`rendered`; what they show is escaped."""

from __future__ import annotations

from functools import cache
from typing import Any

import jinja2


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("edition1_companion.book", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def rendered(template: str, **content: Any) -> str:
    """Return a template of this folder with its content.

    Parameters
    ----------
    template
        Name of the file.
    content
        What it shows.
    """
    return _environment().get_template(template).render(content)
