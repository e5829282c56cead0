"""Write the gallery of robots: `book/gallery.md` and its pictures, from the files in `data/robots/gallery`."""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

from repro import LevenbergMarquardt, Robot, load_robot, simulated_readings, track
from repro_board.emulate import course

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
HEAD = """# Gallery of robots

```{index} ! gallery of robots, MLX90393, ! TLV493D, ! TMAG5273, ! LIS3MDL, ! MMC5983MA, BNO055
```

Ten robots to start from. Copy the file that is nearest to yours, change its numbers, and ask `repro check`.
The files lie in `data/robots/gallery`, and [Robot file](robot_file.md) explains every key.

We took ranges and steps of the chips from their makers or drivers, which the files name. We have no measured
noise of any of them, so each noise is a placeholder: hold your robot still and take the standard deviation of
what you read. The errors are of synthetic readings. Magpylib computes the fields of the robot as it is drawn,
we add the noise of the file and round to the step of the chip, and least squares tracks ten seconds of a
smooth motion. A robot that is built is not as drawn, so calibrate yours first. Do not compare chips by this table,
because the arms differ, and so do the noises that we assumed.

The table has the ± of the tip from the last line of `repro check`: the *median* of random shapes, the bound for all
but the *worst* twentieth of them, and *blind*, without readings. *Tracked* is the median error (synthetic).

{.as-cards}
| robot | median [mm] | worst [mm] | blind [mm] | tracked [mm] |
|---|---|---|---|---|
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
    numbers = [*re.findall(r"±([\d.]+) mm", sizes), f"{tip_error(robot):.2g}"]
    return f"{said}.", " | ".join([f"| {TITLES[name]}", *numbers]) + " |\n"


def section(name: str, said: str) -> str:
    """Return the part of the page about one robot."""
    text = (FILES / f"{name}.toml").read_text(encoding="utf-8")
    return f"""
## {TITLES[name]}

```{{image}} gallery/{name}.png
:alt: {TITLES[name]}, in the middle of its bounds and moved, in mm
:width: 360px
```

`repro check {name}.toml`: *{said}* {{download}}`Download the file <../data/robots/gallery/{name}.toml>`

```{{dropdown}} {name}.toml
~~~toml
{text}~~~
```
"""


def main() -> None:
    """Write the page and the pictures."""
    mpl.use("agg")
    pictures = ROOT / "book" / "gallery"
    pictures.mkdir(exist_ok=True)
    for name in TITLES:
        robot = load_robot(FILES / f"{name}.toml")
        lower, upper = np.asarray(robot.lower), np.asarray(robot.upper)
        axes = robot.plot(
            [lower + share * (upper - lower) for share in (0.5, 0.85)], labels=["middle", "moved"]
        )
        if name == "hanging_arm":
            axes.invert_zaxis()  # the base is above: half a turn about y
            axes.invert_xaxis()
        axes.figure.savefig(pictures / f"{name}.png", dpi=70, metadata={"Software": None})
        plt.close(axes.figure)
    found = {name: results(name) for name in TITLES}
    page = HEAD + "".join(row for _, row in found.values())
    page += "".join(section(name, said) for name, (said, _) in found.items())
    (ROOT / "book" / "gallery.md").write_text(re.sub(r"\n{3,}", "\n\n", page), encoding="utf-8")


if __name__ == "__main__":
    main()
