"""The style of the figures: one palette that colour-blind readers can tell apart, letters, units."""

from __future__ import annotations

import re
from itertools import combinations
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb, to_rgba
from matplotlib.figure import Figure

import edition1_companion
from edition1_live.view.style import MAGNET, SENSOR, STYLE, WIDTH_IN, page_figure, wrapped_panels
from edition1_live.view.symbols import coordinate_symbol, in_symbols

CYCLE = mpl.rc_params_from_file(STYLE, use_default_template=False)["axes.prop_cycle"]
PALETTE = [to_hex(colour).upper() for colour in CYCLE.by_key()["color"]]
"""Colours of the style file."""
DRAWING = sorted(Path(edition1_companion.__file__).parent.glob("pages/*/figures.py"))

SEEN_WITH = {
    "normal vision": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
}
"""Linear RGB as it is seen: Machado, Oliveira and Fernandes 2009, severity 1.0."""

RGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


@page_figure
def drawn_line() -> Figure:
    figure, panel = plt.subplots()
    panel.plot(np.linspace(0, 1, 7), np.linspace(0, 1, 7) ** 2)
    panel.set_title("third")
    return figure


def lab(colour: str, seen_with: str) -> np.ndarray:
    """Return CIELAB of a colour as it is seen; its white is that of sRGB."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    t = RGB_TO_XYZ @ np.clip(SEEN_WITH[seen_with] @ linear, 0, 1) / RGB_TO_XYZ.sum(1)
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def test_lab_of_white_and_grey():
    np.testing.assert_allclose(lab("white", "normal vision"), [100, 0, 0], atol=1e-9)
    np.testing.assert_allclose(lab("#777777", "deuteranopia")[1:], 0, atol=0.05)


@pytest.mark.parametrize("seen_with", SEEN_WITH)
def test_colours_can_be_told_apart(seen_with):
    """Every two are further apart than four times what is just visible, which is about 2.3 in CIELAB."""
    assert len(PALETTE) == 7
    apart = {
        (a, b): np.linalg.norm(lab(a, seen_with) - lab(b, seen_with)) for a, b in combinations(PALETTE, 2)
    }
    assert min(apart.values()) > 10.0, min(apart, key=apart.__getitem__)


@pytest.mark.parametrize("path", DRAWING, ids=lambda p: p.parent.name)
def test_figures_have_the_colours_of_the_style(path):
    """Colours that are not greys are those of the palette."""
    named = set(re.findall(r"#[0-9A-Fa-f]{6}\b", path.read_text("utf-8")))
    coloured = {colour.upper() for colour in named if len({colour[1:3], colour[3:5], colour[5:]}) > 1}
    assert coloured <= set(PALETTE)
    assert {MAGNET, SENSOR} <= set(PALETTE)


def test_ground_is_transparent_and_text_is_text():
    """A page shows its own ground, light or dark; a coordinate of a path has two digits after the point."""
    figure = drawn_line()
    assert to_rgba(figure.get_facecolor())[3] == to_rgba(figure.axes[0].get_facecolor())[3] == 0
    svg = figure._repr_mimebundle_()["image/svg+xml"]  # pyright: ignore[reportAttributeAccessIssue]
    assert re.search(r"<text[^>]*>third</text>", svg)
    assert re.findall(r' d="[^"]*\.\d{3}', svg) == []


def test_panels_wrap_and_the_lowest_have_numbers():
    figure, panels = wrapped_panels(3, 2, 1.0, sharex=True)
    assert (len(panels), len(figure.axes), figure.get_size_inches().tolist()) == (3, 3, [WIDTH_IN, 2.0])
    assert [panel.xaxis.get_tick_params()["labelbottom"] for panel in panels] == [False, True, True]
    assert len(wrapped_panels(1, 2, 1.0)[1]) == 1
    plt.close("all")


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("n_b=3, n_s=9", "$n_b = 3$, $n_s = 9$"),
        ("psi_s=10deg", r"$\psi = 10$°"),
        ("d_s_r=16mm", "$d_{s,r} = 16$ mm"),
        ("n_e=(1,0,0)", "$n_e = (1,0,0)$"),
        ("affine, n_s=9\nflower", "affine, $n_s = 9$\nflower"),
        ("training set, more segments: 1.40", "training set, more segments: 1.40"),
    ],
)
def test_letters_are_those_of_the_notation_page(name, written):
    assert in_symbols(name) == written


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("delta_x", r"$\Delta_{x}$"),
        ("delta_y_3", r"$\Delta_{y3}$"),
        ("delta_L", r"$\delta L$"),
        ("delta_L_1", r"$\delta L_{1}$"),
        ("kappa_0", r"$\kappa_{0}$"),
        ("kappa_1_2", r"$\kappa_{1,2}$"),
        ("phi_2", r"$\phi_{2}$"),
    ],
)
def test_coordinates_have_the_letters_of_the_notation_page(name, written):
    assert coordinate_symbol(name) == written


def test_unknown_coordinate_has_no_letter():
    with pytest.raises(KeyError):
        coordinate_symbol("theta_1")
