"""The bend tests of Mitchell et al. 2021 (Fig. 9) as estimators see them: fields, and what motion capture saw.

Two readings of motion capture are carried side by side: the tilt of the body's y axis, which is up in these
exports, and the tilt of its z axis, which the authors' released code takes.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from edition1.errors import InputError, bad_input, require
from edition1_companion.recordings.mitchell2021 import FIELD, REST_S, HallTake, align, read_hall, takes
from edition1_companion.recordings.mitchell2021_capture import Capture, read_capture
from edition1_companion.recordings.mitchell2021_conventions import model_axes
from edition1_companion.recordings.mitchell2021_tables import on_readings, read_calibration, read_filtered
from edition1_companion.twins.bend_takes import write_bend_takes
from edition1_companion.twins.field_ratios import transverse_to_axial

LEAST_LOGGED = 0.9
"""Share of the readings that the authors' output must cover to be scored."""
LARGEST_LAG_OFF_S = 0.25
"""Lags that differ more than this from the median of the other takes are doubtful [s]."""
RELEASED_REST = 100
"""Readings whose mean the released code subtracts from the transverse components."""


@dataclass(frozen=True)
class BendTake:
    """One bend test on the Hall sensor's clock, where motion capture runs.

    Attributes
    ----------
    name, test, attempt
        Name, and the numbers of the test (one direction each) and of the try.
    time_s
        Times of the readings after the first of the file [s].
    field
        Readings as sent, in the axes of the model [mT].
    gain
        The sensor's gain at each reading relative to the first of the file, inferred by the loader.
    rest
        Ratios of the transverse over the axial field: median of the first two seconds of the file.
    rest_field
        Field at rest as the released code takes it: mean of the first 100 readings of the file [mT].
    truth
        ``bend_rad``, ``direction_rad`` and ``tilt_z_rad`` of motion capture at each reading, NaN where masked.
    logged
        The authors' own output at each reading, ``bend_rad, direction_rad``, in the model's axes; None where there
        is none that can be scored.
    log_share
        Share of the readings that the authors' output covers; NaN where there is none, or none that can be read.
    log_state
        ``scored``, ``none``, or why the output is not scored.
    facts
        What was found on the way, one number each; the columns of :func:`facts` of these names.
    """

    name: str
    test: int
    attempt: int
    time_s: Float[np.ndarray, " readings"]
    field: Float[Tensor, "readings 3"]
    gain: Float[np.ndarray, " readings"]
    rest: Float[Tensor, " 2"]
    rest_field: Float[Tensor, " 3"]
    truth: pd.DataFrame
    logged: pd.DataFrame | None
    log_share: float
    log_state: str
    facts: dict[str, int | float]

    @property
    def ratios(self) -> Float[Tensor, "readings 2"]:
        """Ratios of the transverse over the axial field less those at rest."""
        return transverse_to_axial(self.field) - self.rest


def take_in_words(name: str) -> str:
    """Return a take's name as text and tables have it.

    Examples
    --------
    >>> take_in_words("bend_0_try_2")
    'test 0, try 2'
    """
    return name.replace("bend_", "test ").replace("_try_", ", try ")


def bend_takes(folder: Path | None = None) -> list[BendTake]:
    """Read and align all bend tests of which a Hall file and a motion capture are found.

    Parameters
    ----------
    folder
        As for :func:`edition1_companion.recordings.mitchell2021.takes`.
    """
    return [
        _aligned(take.name, read_hall(take.hall), read_capture(take.capture), take.filtered)
        for take in takes(folder)
        if take.hall and take.capture
    ]


def recorded_or_synthetic(
    *, seed: int = 0, tests: Sequence[int] = (), duration_s: float = 24.0
) -> tuple[list[BendTake], str]:
    """Return the recorded bend tests, or where there are none synthetic ones, and a label that says which.

    Parameters
    ----------
    seed
        Of the synthetic takes.
    tests
        Numbers of the tests; all when empty.
    duration_s
        Of the synthetic movement [s].

    Raises
    ------
    InputError
        If no take is of one of the tests.
    """
    found, source = bend_takes(), "recorded"
    if not found:
        with TemporaryDirectory() as folder:
            write_bend_takes(Path(folder), seed=seed, duration_s=duration_s)
            found, source = bend_takes(Path(folder)), "synthetic"
    chosen = [take for take in found if not tests or take.test in tests]
    require(chosen, "tests", f"the {source} takes", f"among {sorted({t.test for t in found})}", list(tests))
    return chosen, source


def calibration_readings(folder: Path | None = None) -> tuple[pd.DataFrame, str]:
    """Return the calibration readings and why there are none: they are not needed, so damage costs only them.

    Parameters
    ----------
    folder
        As for :func:`edition1_companion.recordings.mitchell2021.takes`.
    """
    try:
        table = read_calibration(folder)
    except InputError as error:
        return pd.DataFrame(), str(error)
    return table, "" if len(table) else "not found"


def facts(found: Sequence[BendTake]) -> pd.DataFrame:
    """What was found of each take: a row with its facts, its peaks by both readings, and the azimuth bent to.

    Columns ``take, readings``; of the Hall file ``unreadable, drained`` (rows dropped), ``beyond_range`` (readings
    left out), ``longest_gap_s, gain_switches``; of the motion capture ``turns`` (different exchanges of markers),
    ``undone_percent, undone_above_40_percent`` (of the frames, and of those above 40 deg), ``masked_percent,
    masked_if_not_undone_percent``, and those of :func:`against_displacement`; ``lag_s, r, lag_off_s`` (less the
    median lag of the other takes); ``peak_tilt_y_deg, peak_tilt_z_deg, direction_deg``.
    """
    rows = []
    for take in found:
        bent = take.truth["direction_rad"][take.truth["bend_rad"] > np.radians(40.0)].to_numpy()
        others = [other.facts["lag_s"] for other in found if other is not take]
        rows.append(
            {"take": take.name, "readings": len(take.time_s)}
            | take.facts
            | {
                "lag_off_s": take.facts["lag_s"] - np.median(others) if others else np.nan,
                "peak_tilt_y_deg": np.degrees(take.truth["bend_rad"].max()),
                "peak_tilt_z_deg": np.degrees(take.truth["tilt_z_rad"].max()),
                "direction_deg": np.degrees(np.angle(np.exp(1j * bent).mean())) if len(bent) else np.nan,
            }
        )
    return pd.DataFrame(rows)


def log_states(found: Sequence[BendTake]) -> pd.DataFrame:
    """What became of the authors' own output: ``take, share_percent`` (readings that it covers) and ``state``."""
    rows = [(take.name, 100 * take.log_share, take.log_state) for take in found]
    return pd.DataFrame(rows, columns=["take", "share_percent", "state"])


def against_displacement(capture: Capture) -> dict[str, float]:
    """Compare the y axis with the body's displacement, which exchanged markers hardly change.

    Returns
    -------
    dict
        ``off_displacement_deg``: root mean square of the tilt less a polynomial of the fifth degree in the
        horizontal displacement, fitted to the same take. ``azimuth_off_deg``: mean azimuth of the displacement less
        that of the y axis where the tilt is above 40 deg. NaN for a body that does not move, or bends less.
    """
    motion = capture.motion.dropna(subset=["bend_rad", "moved_mm"])
    moved, tilt = motion["moved_mm"].to_numpy(), np.degrees(motion["bend_rad"].to_numpy())
    off, azimuth = np.nan, np.nan
    if len(motion) and moved.max() > 0:
        powers = (moved / moved.max())[:, None] ** np.arange(1, 6)
        fitted = powers @ np.linalg.lstsq(powers, tilt, rcond=None)[0]
        off = float(np.sqrt(np.mean((tilt - fitted) ** 2)))
        turned = (motion["moved_towards_rad"] - motion["direction_rad"]).to_numpy()[tilt > 40.0]
        azimuth = float(np.degrees(np.angle(np.exp(1j * turned).mean()))) if len(turned) else np.nan
    return {"off_displacement_deg": off, "azimuth_off_deg": azimuth}


def axial_field(take: BendTake) -> pd.DataFrame:
    """Magnitude of the field along the body as sent and over the inferred gain: ``time_s, sent_mt, over_gain_mt``."""
    sent = take.field[:, 2].abs().numpy()
    return pd.DataFrame({"time_s": take.time_s, "sent_mt": sent, "over_gain_mt": sent / take.gain})


def _aligned(name: str, hall: HallTake, capture: Capture, filtered: Path | None) -> BendTake:
    numbers = re.fullmatch(r"bend_(\d+)_try_(\d+)", name)
    if not numbers:
        raise bad_input("name", "a bend test", "bend_TEST_try_TRY", name)
    aligned, lag = align(hall, capture)
    table = aligned.dropna(subset=FIELD)
    whole = model_axes(torch.from_numpy(hall.readings[FIELD].to_numpy(copy=True)))
    high = capture.motion[capture.motion["bend_rad"] > np.radians(40.0)]
    logged, share, state = _logged(filtered, hall, table["time_s"].to_numpy())
    at_rest = torch.from_numpy((hall.readings["time_s"] < REST_S).to_numpy(copy=True))
    return BendTake(
        name=name,
        test=int(numbers[1]),
        attempt=int(numbers[2]),
        time_s=table["time_s"].to_numpy(),
        field=model_axes(torch.from_numpy(table[FIELD].to_numpy(copy=True))),
        gain=table["gain"].to_numpy(),
        rest=transverse_to_axial(whole[at_rest]).nanmedian(0).values,
        rest_field=whole[:RELEASED_REST].nanmean(0),
        truth=table[["bend_rad", "direction_rad", "tilt_z_rad"]].reset_index(drop=True),
        logged=logged,
        log_share=share,
        log_state=state,
        facts={
            "unreadable": hall.unreadable,
            "drained": hall.drained,
            "beyond_range": len(aligned) - len(table),
            "longest_gap_s": hall.longest_gap_s,
            "gain_switches": hall.switches,
            "turns": capture.turns,
            "undone_percent": 100 * capture.undone / len(capture.motion),
            "undone_above_40_percent": 100 * float(high["undone"].mean()) if len(high) else 0.0,
            "masked_percent": 100 * capture.masked_share,
            "masked_if_not_undone_percent": 100 * capture.masked_if_not_undone,
            **against_displacement(capture),
            "lag_s": lag.lag_s,
            "r": lag.r,
        },
    )


def _logged(path: Path | None, hall: HallTake, time_s: np.ndarray) -> tuple[pd.DataFrame | None, float, str]:
    """Return the authors' output at the times of the readings, the share that it covers, and what became of it."""
    if path is None:
        return None, np.nan, "none"
    try:
        found = on_readings(read_filtered(path), time_s, hall.readings["time_s"].to_numpy())
    except InputError as error:
        return None, np.nan, f"refused: {error}"
    share = float(found["bend_rad"].notna().mean())
    if share < LEAST_LOGGED:
        return None, share, f"refused: covers less than {LEAST_LOGGED:.0%} of the readings"
    # Their y is not mirrored.
    turned = np.pi - found["direction_rad"].to_numpy()
    table = pd.DataFrame({"bend_rad": found["bend_rad"], "direction_rad": np.angle(np.exp(1j * turned))})
    return table, share, "scored"
