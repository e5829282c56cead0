"""A figure in frames with a slider: what a method does, one step after the other.

A :class:`FrameStrip` displays itself as a still with a text for readers who do not see it. On the book's pages
``book/_static/frame_strip.js`` puts the frames in its place: one drawing, of which each frame shows a part.
"""

from __future__ import annotations

import base64
import html
import io
import json
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import ParamSpec

import matplotlib.pyplot as plt
from edition1.errors import require
from edition1_live.view.still import small_png
from edition1_live.view.style import STYLE
from matplotlib.artist import Artist
from matplotlib.figure import Figure

P = ParamSpec("P")


@dataclass(frozen=True)
class Frame:
    """What happens in a frame, in a line, and what is seen in it alone or in some frames only."""

    says: str
    artists: Sequence[Artist]


@dataclass(frozen=True, repr=False)
class FrameStrip:
    """Frames of one figure. What belongs to no frame is seen in all; what belongs to several is drawn once.

    Parameters
    ----------
    figure
        With all that any frame shows.
    frames
        In their order.
    alt
        What the still shows, for readers who do not see it.
    still
        Number of the frame that is shown first, and alone without scripts; counted from the end when negative.
    """

    figure: Figure
    frames: Sequence[Frame]
    alt: str
    still: int = -1

    def __post_init__(self) -> None:
        count = len(self.frames)
        require(count > 1, "frames", "FrameStrip", "at least two", count)
        require(-count <= self.still < count, "still", "FrameStrip", "the number of a frame", self.still)

    def svg(self, shown: Iterable[int]) -> str:
        """Draw these frames on each other; the group of an artist is named after all its frames, ``f-2-3--7``."""
        self._show(shown)
        stream = io.StringIO()
        # the style also fixes the names inside an SVG, which are random otherwise
        with plt.style.context(STYLE):
            self.figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
        return re.sub(r' (d|x|y)="([^"]*)"', _shortened, stream.getvalue())

    def _show(self, shown: Iterable[int]) -> None:
        shown, frames_of = set(shown), {}
        for k, frame in enumerate(self.frames):
            for artist in frame.artists:
                frames_of.setdefault(artist, []).append(k)
        for number, (artist, frames) in enumerate(frames_of.items()):
            artist.set_gid(f"f-{'-'.join(map(str, frames))}--{number}")
            artist.set_visible(not shown.isdisjoint(frames))

    def to_html(self) -> str:
        """Return the still with the frames beside it; the script puts itself in the place of the still."""
        still, count = self.still % len(self.frames), len(self.frames)
        data = {
            "frames": [frame.says for frame in self.frames],
            "still": still,
            "svg": self.svg(range(count)),
        }
        # "</script>" within a text must not end the element
        text = json.dumps(data, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
        self._show([still])
        with plt.style.context(STYLE):
            picture = base64.b64encode(small_png(self.figure)).decode("ascii")
        width = round(96 * self.figure.get_figwidth())  # that of the drawing on the screen
        return (
            '<div class="frame-strip">'
            f'<img src="data:image/png;base64,{picture}" alt="{html.escape(self.alt)}" width="{width}">'
            f'<script type="application/json">{text}</script></div>'
        )

    def _repr_html_(self) -> str:
        return self.to_html()

    def __repr__(self) -> str:
        return f"FrameStrip of {len(self.frames)} frames: {self.alt}"


def _shortened(attribute: re.Match[str]) -> str:
    """A tenth of a point is as good as exact on any screen; a dot is written once."""
    numbers = re.sub(r"(\.\d)\d+", r"\1", attribute[2])
    dots = re.sub(r"M ([\d.]+ [\d.]+) \nL \1 \n", r"M\1h0", numbers)  # lines without length
    return f' {attribute[1]}="{dots}"'


def page_strip(draw: Callable[P, FrameStrip]) -> Callable[P, FrameStrip]:
    """Draw in the companion's style, and close the figure: what a notebook shows is the strip."""

    @wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> FrameStrip:
        with plt.style.context(STYLE):
            strip = draw(*args, **kwargs)
            strip.figure.draw_without_rendering()  # once for all frames, so that nothing moves from one to the next
        strip.figure.set_layout_engine("none")
        plt.close(strip.figure)
        return strip

    return styled
