# The stubs of pandas know less than the library does.
# pyright: reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false
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

from repro.errors import bad_input
from repro.recordings.mitchell2021 import FIELD, REST_S, Take, align, read_filtered, read_hall, takes
from repro.recordings.optitrack import read_capture
from repro.sensing.field_ratios import model_axes, ratios
from repro.simulation.bend_takes import write_bend_takes

LARGEST_MASKED = 0.1
"""Share of masked frames above which a take is listed apart."""
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
        is none.
    facts
        What was found on the way: ``masked_share, lag_s, r, gain_switches``, and ``left_out``, readings beyond the
        sensor's range.
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
    facts: dict[str, float]

    @property
    def apart(self) -> bool:
        """Whether so many frames are masked that the take is listed apart."""
        return self.facts["masked_share"] > LARGEST_MASKED

    @property
    def ratios(self) -> Float[Tensor, "readings 2"]:
        """Ratios of the transverse over the axial field less those at rest."""
        return ratios(self.field) - self.rest


def bend_takes(folder: Path | None = None) -> list[BendTake]:
    """Read and align all bend tests of which a Hall file and a motion capture are found.

    Parameters
    ----------
    folder
        As for :func:`repro.recordings.mitchell2021.takes`.
    """
    return [_aligned(take) for take in takes(folder) if take.hall and take.capture]


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
    if not chosen:
        raise bad_input(
            "tests", f"the {source} takes", f"among {sorted({t.test for t in found})}", list(tests)
        )
    return chosen, source


def facts(found: Sequence[BendTake]) -> pd.DataFrame:
    """What was found of each take: a row with its facts, its peaks by both readings, and the azimuth bent to.

    Columns ``take, readings, masked_percent, lag_s, r, gain_switches, peak_tilt_y_deg, peak_tilt_z_deg,
    direction_deg, apart``.
    """
    rows = []
    for take in found:
        bent = take.truth["direction_rad"][take.truth["bend_rad"] > np.radians(40.0)]
        rows.append(
            {
                "take": take.name,
                "readings": len(take.time_s),
                "masked_percent": 100 * take.facts["masked_share"],
                "lag_s": take.facts["lag_s"],
                "r": take.facts["r"],
                "gain_switches": take.facts["gain_switches"],
                "peak_tilt_y_deg": np.degrees(take.truth["bend_rad"].max()),
                "peak_tilt_z_deg": np.degrees(take.truth["tilt_z_rad"].max()),
                "direction_deg": np.degrees(np.angle(np.exp(1j * bent.to_numpy()).mean()))
                if len(bent)
                else np.nan,
                "apart": take.apart,
            }
        )
    return pd.DataFrame(rows)


def axial_field(take: BendTake) -> pd.DataFrame:
    """Magnitude of the field along the body as sent and over the inferred gain: ``time_s, sent_mt, over_gain_mt``."""
    sent = take.field[:, 2].abs().numpy()
    return pd.DataFrame({"time_s": take.time_s, "sent_mt": sent, "over_gain_mt": sent / take.gain})


def _aligned(take: Take) -> BendTake:
    if take.hall is None or take.capture is None:
        raise bad_input("take", "a bend test", "one with a Hall file and a motion capture", take.name)
    numbers = re.fullmatch(r"bend_(\d+)_try_(\d+)", take.name)
    if not numbers:
        raise bad_input("name", "a bend test", "bend_TEST_try_TRY", take.name)
    hall, capture = read_hall(take.hall), read_capture(take.capture)
    aligned, lag = align(hall, capture)
    table = aligned.dropna(subset=FIELD)
    whole = model_axes(torch.from_numpy(hall.readings[FIELD].to_numpy(copy=True)))
    at_rest = torch.from_numpy((hall.readings["time_s"] < REST_S).to_numpy(copy=True))
    return BendTake(
        name=take.name,
        test=int(numbers[1]),
        attempt=int(numbers[2]),
        time_s=table["time_s"].to_numpy(),
        field=model_axes(torch.from_numpy(table[FIELD].to_numpy(copy=True))),
        gain=table["gain"].to_numpy(),
        rest=ratios(whole[at_rest]).nanmedian(0).values,
        rest_field=whole[:RELEASED_REST].nanmean(0),
        truth=table[["bend_rad", "direction_rad", "tilt_z_rad"]].reset_index(drop=True),
        logged=_logged(take.filtered, hall.drained, table["time_s"]) if take.filtered else None,
        facts={
            "masked_share": capture.masked_share,
            "lag_s": lag.lag_s,
            "r": lag.r,
            "gain_switches": hall.switches,
            "left_out": len(aligned) - len(table),
        },
    )


def _logged(path: Path, drained: int, time_s: pd.Series) -> pd.DataFrame:
    """The authors' output at the times of the readings; it has a row for every row of the Hall file but the first."""
    table = read_filtered(path)
    clock = table.assign(time_s=table["time_s"] - table["time_s"].iloc[drained - 1])
    found = pd.merge_asof(time_s.to_frame(), clock, on="time_s", direction="nearest", tolerance=1e-3)
    # Their y is not mirrored.
    turned = np.pi - found["direction_rad"].to_numpy()
    return pd.DataFrame({"bend_rad": found["bend_rad"], "direction_rad": np.angle(np.exp(1j * turned))})
