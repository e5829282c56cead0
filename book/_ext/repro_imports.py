"""A picture of the imports between the rooms of the project, drawn from its sources at every build."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

from sphinx.application import Sphinx

ROOMS = (
    ("edition1_companion.cli",),
    ("edition1_companion.pages",),
    ("edition1_companion.book.after",),
    ("edition1_companion.book", "edition1_companion.twins"),
    ("edition1_companion.recordings",),
    ("edition1_live",),
    ("edition1.robot_file",),
    ("edition1.estimation", "edition1.kernels"),
    ("edition1.sensing",),
    ("edition1.kinematics",),
    ("edition1.se3",),
)
"""From those that use to those that are used; folders in one room use each other."""
STEP, LEFT, WIDTH = 30, 250, 500
"""Height of a line, where the arcs begin, and width of the picture."""
TEXT = "Rooms of the project from top to bottom, and an arc from each to every room whose modules it imports"


def room_of(module: str) -> int | None:
    """Return the room of a module; none for those that everything uses (errors, files)."""
    found = {
        name: k
        for k, names in enumerate(ROOMS)
        for name in names
        if f"{module}.".startswith(f"{name}.") or module.startswith(f"{name}_")
    }
    return found[max(found, key=len)] if found else None


def imports(sources: Path) -> Counter[tuple[int, int]]:
    """Count the imports of modules between rooms."""
    counts: Counter[tuple[int, int]] = Counter()
    for path in sorted(sources.rglob("*.py")):
        parts = path.relative_to(sources).with_suffix("").parts
        own = room_of(".".join(parts[:-1] if parts[-1] == "__init__" else parts))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                used = {
                    room_of(f"{node.module}.{alias.name}") for alias in node.names
                }  # a name may be a module
                counts.update((own, room) for room in used - {None, own} if own is not None)
    return counts


def picture(counts: Counter[tuple[int, int]]) -> str:
    """Return an SVG: arcs that go down on the right; one that went up would be on the left, in red."""
    height = STEP * len(ROOMS)
    up = sum(a > b for a, b in counts)
    said = f"{TEXT}. {'No arc goes' if not up else f'{up} arcs go'} up."
    lines = [
        f'<svg class="imports" role="img" aria-label="{said}" viewBox="0 0 {WIDTH} {height}" '
        f'style="width:100%;max-width:{WIDTH}px;height:auto" xmlns="http://www.w3.org/2000/svg">'
    ]
    labels = [", ".join((names[0], *(name.rpartition(".")[2] for name in names[1:]))) for names in ROOMS]
    for k, room in enumerate(labels):
        y = STEP * (k + 0.5)
        lines.append(
            f'<text x="{LEFT - 12}" y="{y + 5}" text-anchor="end" font-size="15" fill="currentColor">{room}</text>'
            f'<circle cx="{LEFT}" cy="{y}" r="4" fill="currentColor"/>'
        )
    for (a, b), n in sorted(counts.items()):
        first, last = STEP * (a + 0.5), STEP * (b + 0.5)
        side, colour = (1, "#2a7fbf") if first < last else (-1, "#c02020")
        bulge = LEFT + side * 0.85 * abs(last - first)
        thick = 0.8 + 0.35 * n**0.5
        named = f"{labels[a]} imports {labels[b]}: {n}"
        lines.append(
            f'<path d="M {LEFT} {first} C {bulge} {first}, {bulge} {last}, {LEFT} {last}" fill="none" '
            f'stroke="{colour}" stroke-opacity="0.6" stroke-width="{thick:.1f}"><title>{named}</title></path>'
        )
    return "\n".join([*lines, "</svg>", ""])


def setup(app: Sphinx) -> dict[str, object]:
    """Register the extension; the picture is written here, before pages include it."""
    book = Path(app.srcdir)
    path, text = book / "generated" / "imports.html", picture(imports(book.parent / "src" / "edition1"))
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
