"""The font of formulas, cut out of a larger one by ``make vendor``; ``_static/vendor/manifest.json`` names both."""

from __future__ import annotations

import subprocess
import sys
import tarfile
from pathlib import Path

from fontTools import subset

PACKAGE = "@fontsource/stix-two-math@5.3.0"
ORIGINAL = "package/files/stix-two-math-latin-400-normal.woff"
FONT = Path(__file__).resolve().parents[1] / "_static" / "vendor" / "stix-two-math" / "formulas.woff"
CHARACTERS = {
    "keyboard, degrees, times, accents": "20-7E A0-B1 B4 B7 D7 F7 2C6 2C7 2D8-2DC 20D7",
    "i and j without their dots": "131 237 1D6A4 1D6A5",
    "Greek": "391-3A9 3B1-3C9 3D1 3D5 3D6 3F0 3F1 3F5",
    "dashes, dots, primes, bars, and what is not seen": "2013 2014 2016 2026 2032-2034 2057 2061-2064",
    "script, blackboard, Planck": "2102 210B 210E 2110 2112 2113 2115 211B 2119 211A 211D 2124",
    "arrows": "2190-2199 21A6 21D0 21D2 21D4 27F5-27F7",
    "operators": "2200-220C 220F-221E 2220 2223-222E 2295-2299 22A4 22A5 22C5 22EE-22F1",
    "relations": "2234 223C 2243 2245 2248 2250-2254 2260-2265 226A 226B 2282-2287 2A7D 2A7E",
    "brackets, and braces below": "2308-230B 23DE 23DF 27E8 27E9",
    "bold, italic and bold italic letters": "1D400-1D49B 1D6A8-1D755 1D7CE-1D7D7",
    "the other capitals in script, and sans serif": "1D49C-1D4B5 1D5A0-1D5D3",
}
"""Which characters it keeps, in hexadecimal: more than the pages use, and the larger forms of each."""


def write_font(folder: Path) -> None:
    """Fetch the original into a folder, and write what formulas need of it, with its licence."""
    folder.mkdir(parents=True, exist_ok=True)
    command = ["npm", "pack", "--silent", "--pack-destination", str(folder), PACKAGE]
    name = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.split()[-1]
    FONT.parent.mkdir(parents=True, exist_ok=True)
    with tarfile.open(folder / name) as package:
        (folder / "original.woff").write_bytes(package.extractfile(ORIGINAL).read())
        (FONT.parent / "LICENSE").write_bytes(package.extractfile("package/LICENSE").read())
    options = subset.Options(layout_features=[], hinting=False, flavor="woff", recalc_timestamp=False)
    font = subset.load_font(str(folder / "original.woff"), options)
    cutter = subset.Subsetter(options)
    cutter.populate(unicodes=subset.parse_unicodes(" ".join(CHARACTERS.values())))
    cutter.subset(font)
    subset.save_font(font, str(FONT), options)


if __name__ == "__main__":
    write_font(Path(sys.argv[1]))
