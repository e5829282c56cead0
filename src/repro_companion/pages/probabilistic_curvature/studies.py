"""Longer tables of the particle filter: several seeds, many process noises, many numbers of particles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from repro.errors import bad_input
from repro_companion.book.studies import Study
from repro_companion.twins.bend_curves import CURVES
from repro_companion.twins.bend_simulation import (
    BEST,
    FITS,
    GAUSS_NEWTON,
    NOISY,
    PAPER,
    PROCESS_NOISE_PI,
    WEIGHTED,
    errors,
)

SETTINGS = {setting.name: setting for setting in (PAPER, FITS, WEIGHTED, GAUSS_NEWTON, NOISY, BEST)}
"""Settings by their names."""
PARTICLES = (30, 100, 300, 1000, 3000)
"""Numbers of particles in the sweep."""


def setting_errors(names: Sequence[str], seeds: Sequence[int], steps: int | None = None) -> pd.DataFrame:
    """Errors of settings on all three curves: columns of ``errors``.

    Parameters
    ----------
    names
        Names of :data:`SETTINGS`.
    seeds
        Of the filter and of the noise of the readings.
    steps
        Number of steps; all when not given.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    return errors(_named(names), seeds, steps=steps)


def process_noise_errors(
    names: Sequence[str],
    process_noise_pi: Sequence[float],
    motions: Sequence[str] = ("random walk",),
    steps: int | None = None,
) -> pd.DataFrame:
    """Errors of settings over the process noise [pi rad], one seed: columns of ``errors``.

    Parameters
    ----------
    names
        Names of :data:`SETTINGS`.
    process_noise_pi
        Process noises [pi rad]. They share their random numbers.
    motions
        Motions in place of the setting's.
    steps
        Number of steps; all when not given.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    settings = [replace(setting, motion=motion) for setting in _named(names) for motion in motions]
    return errors(settings, process_noise_pi=process_noise_pi, steps=steps)


def particle_errors(
    names: Sequence[str],
    particles: Sequence[int],
    curves: Sequence[str] = CURVES,
    steps: int | None = None,
) -> pd.DataFrame:
    """Errors of settings over the number of particles, one seed: columns of ``errors``.

    Parameters
    ----------
    names
        Names of :data:`SETTINGS`.
    particles
        Numbers of particles in place of the setting's.
    curves
        Names of the curves.
    steps
        Number of steps; all when not given.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    settings = [replace(setting, particles=n) for setting in _named(names) for n in particles]
    return errors(settings, curves=curves, steps=steps)


def _named(names: Sequence[str]) -> list:
    unknown = [name for name in names if name not in SETTINGS]
    if unknown:
        raise bad_input("names", "the particle study", "among " + ", ".join(SETTINGS), ", ".join(unknown))
    return [SETTINGS[name] for name in names]


NOISE = {"process_noise_pi": list(PROCESS_NOISE_PI)}
STUDIES = (
    Study("particle_settings", setting_errors, {"names": list(SETTINGS), "seeds": [0, 1, 2]}),
    Study("particle_process_noise", process_noise_errors, {"names": [PAPER.name], **NOISE}),
    Study(
        "particle_sensor_noise",
        process_noise_errors,
        {"names": [BEST.name], **NOISE, "motions": ["random walk", "constant velocity"]},
    ),
    Study(
        "particle_count",
        particle_errors,
        {"names": [PAPER.name], "particles": list(PARTICLES), "curves": ["flower"]},
    ),
)
