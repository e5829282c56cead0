"""Names of tables in the letters of the notation page."""

from __future__ import annotations

import re

_LETTERS = {"n_b": "n_b", "n_s": "n_s", "n_e": "n_e", "d_s_r": "d_{s,r}", "psi_s": r"\psi"}
_UNITS = {"deg": "°", "mm": " mm", "": ""}
_COORDINATES = {
    "delta_x": (r"\Delta", "x"),
    "delta_y": (r"\Delta", "y"),
    "delta_L": (r"\delta L", ""),
    "kappa_0": (r"\kappa", "0"),
    "kappa_1": (r"\kappa", "1"),
    "phi": (r"\phi", ""),
}
_PLAIN = {"delta_x": "Δx", "delta_y": "Δy", "delta_L": "δL", "kappa_0": "κ₀", "kappa_1": "κ₁", "phi": "φ"}
_LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def in_symbols(name: str) -> str:
    """Return the name of a robot or of a row of a table with the letters of the notation page.

    Parameters
    ----------
    name
        As in tables of results, such as ``n_b=3, n_s=9``; what is no letter stays as it is.

    Examples
    --------
    >>> in_symbols("d_s_r=16mm")
    '$d_{s,r} = 16$ mm'
    >>> in_symbols("LM, n_b = 3")
    'LM, $n_b = 3$'
    """
    pattern = rf"\b({'|'.join(_LETTERS)}) ?= ?(\(.*?\)|[0-9.]+)(deg|mm|)"
    return re.sub(pattern, lambda found: f"${_LETTERS[found[1]]} = {found[2]}${_UNITS[found[3]]}", name)


def coordinate_symbol(name: str) -> str:
    r"""Return a coordinate of a configuration with the letters of the notation page.

    Parameters
    ----------
    name
        As in tables of results, alone or with the number of its segment.

    Raises
    ------
    KeyError
        If there is no such coordinate.

    Examples
    --------
    >>> print(coordinate_symbol("delta_x"), coordinate_symbol("delta_L_2"))
    $\Delta_{x}$ $\delta L_{2}$
    """
    name, segment = (name, "") if name in _COORDINATES else name.rsplit("_", 1)
    letter, index = _COORDINATES[name]
    if index.isdigit() and segment:
        index += ","
    return f"${letter}_{{{index}{segment}}}$" if index + segment else f"${letter}$"


def plain_symbol(name: str) -> str:
    """Return a coordinate or a reading in letters that need no typesetting; what is neither stays as it is.

    Parameters
    ----------
    name
        As in tables of results, alone or with the number of its segment or sensor.

    Examples
    --------
    >>> plain_symbol("delta_x_1"), plain_symbol("kappa_0"), plain_symbol("u_12"), plain_symbol("IMU 3")
    ('Δx₁', 'κ₀', 'u₁₂', 'IMU 3')
    """
    stem, _, index = (name, "", "") if name in _PLAIN else name.rpartition("_")
    if not (stem in _PLAIN or len(stem) == 1) or not (index + "0").isdigit():
        return name
    comma = "," if stem.startswith("kappa") and index else ""
    return _PLAIN.get(stem, stem) + comma + index.translate(_LOWERED)
