"""Longer tables of the particle filter: several seeds, many process noises, many numbers of particles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from edition1_companion.book.studies import Study
from edition1_companion.pages.probabilistic_curvature.simulation import (
    BEST,
    FITS,
    GAUSS_NEWTON,
    NOISY,
    PAPER,
    PROCESS_NOISE_PI,
    WEIGHTED,
    errors_by_curve,
)
from edition1_companion.twins.bend_curves import CURVES

SETTINGS = {setting.name: setting for setting in (PAPER, FITS, WEIGHTED, GAUSS_NEWTON, NOISY, BEST)}
"""Settings by their names."""


def setting_errors(
    names: Sequence[str],
    *,
    seeds: Sequence[int] = (0,),
    process_noise_pi: Sequence[float] | None = None,
    motions: Sequence[str] = (),
    particles: Sequence[int] = (),
    curves: Sequence[str] = CURVES,
    steps: int | None = None,
) -> pd.DataFrame:
    """Errors of settings: columns of ``errors_by_curve``.

    Parameters
    ----------
    names
        Names of :data:`SETTINGS`.
    seeds
        Of the filter and of the noise of the readings.
    process_noise_pi
        Process noises [pi rad] in place of the setting's. They share their random numbers.
    motions, particles
        Motions, or numbers of particles, in place of the setting's.
    curves
        Names of the curves.
    steps
        Number of steps; all when not given.
    """
    settings = [SETTINGS[name] for name in names]
    if motions:
        settings = [replace(setting, motion=motion) for setting in settings for motion in motions]
    if particles:
        settings = [replace(setting, particles=n) for setting in settings for n in particles]
    return errors_by_curve(settings, seeds, process_noise_pi=process_noise_pi, curves=curves, steps=steps)


NOISE = {"process_noise_pi": list(PROCESS_NOISE_PI)}
MOTIONS = {"motions": ["random walk", "constant velocity"]}
COUNTS = {"particles": [30, 100, 300, 1000, 3000], "curves": ["flower"]}
STUDIES = tuple(
    Study(name, setting_errors, settings)
    for name, settings in (
        ("particle_settings", {"names": list(SETTINGS), "seeds": [0, 1, 2]}),
        ("particle_process_noise", {"names": [PAPER.name], **NOISE}),
        ("particle_sensor_noise", {"names": [BEST.name], **NOISE, **MOTIONS}),
        ("particle_count", {"names": [PAPER.name], **COUNTS}),
    )
)
