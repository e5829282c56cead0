"""Write the gallery of robots: `book/gallery.md` and its pictures, from the files in `data/robots/gallery`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from repro import LevenbergMarquardt, Robot, load_robot, simulated_readings, track
from repro_board.emulate import course
from repro_companion.show import number

ROOT = Path(__file__).resolve().parents[1]
FILES = ROOT / "data" / "robots" / "gallery"
TITLES = {
    "mlx90393_arm": "A soft arm with MLX90393 chips",
    "tlv493d_arm": "A soft arm with TLV493D chips",
    "tmag5273_arm": "Two segments with TMAG5273 chips",
    "lis3mdl_arm": "A soft arm with LIS3MDL chips",
    "mmc5983_arm": "A soft arm with MMC5983MA chips",
    "bno055_arm": "Two segments with BNO055 chips",
    "finger": "A finger with one magnet",
    "ball_joint": "A ball joint",
    "free_magnet": "A free magnet",
    "hanging_arm": "A hanging arm",
}
SHORT = {
    name: re.sub(r"^(A|Two) (soft arm with |segments with )?| chips$| with one magnet$", "", title)
    for name, title in TITLES.items()
}
STRIP = "\n".join(
    f"[![{title}](gallery/{name}.png) {SHORT[name]}](#robot-{name})" for name, title in TITLES.items()
)
HEAD = f"""# Gallery of robots

```{{index}} ! gallery of robots, MLX90393, ! TLV493D, ! TMAG5273, ! LIS3MDL, ! MMC5983MA, BNO055
```

Ten robots to start from. Copy the file that is nearest to yours, change its numbers, and ask `repro check`.
The files lie in `data/robots/gallery`, and [Robot file](robot_file.md) explains every key.

{{.strip}}
{STRIP}

The pictures are in mm: blue in the middle of the bounds, orange moved. Magnets have a red north pole, and arrows show
the axes of chips and IMUs. A click leads to the file.

{{.as-cards}}
| robot | chips | noise | median ± [mm] | worst ± [mm] | blind ± [mm] | tracked [mm] |
|---|---|---|---|---|---|---|
"""
FOOT = """
`repro check` states each ± of the tip, for a calibrated robot: the *median* of random shapes, the bound for all but
the *worst* twentieth of them, and *blind*, without readings. *Tracked* is the median error on synthetic readings.
Magpylib computes the fields of the robot as it is drawn, we add the noise and round to the step of the chip, and
least squares tracks ten seconds of a smooth motion. A robot that is built is not as drawn, so calibrate yours first.

The noise of every chip is a **placeholder**, because we have measured none: hold your robot still and take the
standard deviation of what you read. Ranges and steps come from makers or drivers, which the files name. Do not
compare chips by the table, because the arms differ, and so do the noises that we assumed.

::::{grid} 1 1 2 2
:gutter: 3
"""


def tip_error(robot: Robot, seed: int = 0) -> float:
    """Return the median error of the tip [mm] that least squares has on ten seconds of synthetic readings."""
    times = np.arange(0.0, 10.0, 1 / (robot.rate_hz or 50.0))
    truth = course(robot, times, seed=seed)
    noise = np.asarray(robot.noise) * np.random.default_rng(seed).standard_normal(
        (len(times), robot.n_readings)
    )
    readings = simulated_readings(robot, truth, robot.earth) + noise
    step = robot.resolution
    readings = np.where(step > 0, step * np.round(readings / np.where(step > 0, step, 1.0)), readings)
    readings = np.where(robot.missing(readings) > 0, np.nan, readings)
    found = track(LevenbergMarquardt(robot), readings, times=times).q
    off = np.linalg.norm((robot.tip(found) - robot.tip(truth))[:, :3, 3], axis=-1)
    return float(1e3 * np.nanmedian(off))


def results(name: str) -> tuple[str, str]:
    """Return what a check says of a robot, and its row of the table [mm]."""
    robot = load_robot(FILES / f"{name}.toml")
    said, _, sizes = robot.check().verdict.partition(":")
    chips, noise, of_reading = [], [], np.asarray(robot.noise)
    if robot.sensors:
        chips.append(f"{len(robot.sensors)} × 3 axes")
        noise.append(f"{1e3 * of_reading[0]:.3g} µT")
    if robot.imus:
        chips.append(f"{len(robot.imus)} IMU{'s' if len(robot.imus) > 1 else ''}")
        noise.append(f"{np.degrees(of_reading[-1]):.2g}°")
    millimetres = [*map(float, re.findall(r"±([\d.]+) mm", sizes)), tip_error(robot)]
    cells = [f"[{TITLES[name]}](#robot-{name})", ", ".join(chips), ", ".join(noise)]
    cells += [number(value, 2) for value in millimetres]
    return f"{said}.", f"| {' | '.join(cells)} |\n"


def card(name: str, said: str) -> str:
    """Return the part of the page about one robot."""
    text = (FILES / f"{name}.toml").read_text(encoding="utf-8")
    return f"""
:::{{grid-item-card}} {TITLES[name]}
(robot-{name})=
```{{image}} gallery/{name}.png
:alt: {TITLES[name]}, in the middle of its bounds and moved, in mm
:width: 100%
```

`repro check {name}.toml`: *{said}* {{download}}`Download the file <../data/robots/gallery/{name}.toml>`

```{{dropdown}} {name}.toml
~~~toml
{text}~~~
```
:::
"""


def draw(name: str, path: Path) -> None:
    """Write the picture of a robot in the middle of its bounds and moved."""
    robot = load_robot(FILES / f"{name}.toml")
    lower, upper = np.asarray(robot.lower), np.asarray(robot.upper)
    figure = plt.figure(figsize=(3.9, 3.4))
    axes: Any = figure.add_axes((0.0, 0.06, 0.96, 0.94), projection="3d")
    robot.plot([lower + share * (upper - lower) for share in (0.5, 0.85)], axes=axes)
    axes.get_legend().remove()
    if name == "hanging_arm":
        axes.invert_zaxis()  # the base is above: half a turn about y
        axes.invert_xaxis()
    axes.set(xlabel="x", ylabel="y", zlabel="z")
    axes.locator_params(nbins=4)
    ends = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
    axes.set_box_aspect(abs(np.diff(ends)[:, 0]), zoom=0.86)  # room for the numbers
    figure.savefig(path, dpi=150, metadata={"Software": None})
    plt.close(figure)


def main() -> None:
    """Write the page and the pictures."""
    mpl.use("agg")
    pictures = ROOT / "book" / "gallery"
    pictures.mkdir(exist_ok=True)
    for name in TITLES:
        draw(name, pictures / f"{name}.png")
    found = {name: results(name) for name in TITLES}
    rows = "".join(row for _, row in found.values())
    cards = "".join(card(name, said) for name, (said, _) in found.items())
    (ROOT / "book" / "gallery.md").write_text(f"{HEAD}{rows}{FOOT}{cards}::::\n", encoding="utf-8")


if __name__ == "__main__":
    main()
