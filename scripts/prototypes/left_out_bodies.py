"""Prototype of a status for ``fit_shape``: in a shape that fits badly, the body at fault is left out and counted.

A shape does not fit if its chi-square is above what chance gives once in 1e8 rows, in units of what is typical.
Then every body is left out in turn. If one of these fits passes, and its chi-square is the smallest, that body is
left out.
"""

from __future__ import annotations

import numpy as np

import repro

RARE = 18.4


def limit(dof):
    """Return the chi-square that good readings exceed once in 1e8 rows."""
    return dof + 2 * RARE + 2 * np.sqrt(dof * RARE)


def fit(robot, poses, **options):
    """Return poses without what was left out, status and body of every row (-1: none), and the typical chi-square."""
    poses = np.array(poses)
    found = repro.fit_shape(robot, poses, **options)
    typical = max(1.0, float(np.median(found.chi2 / np.maximum(found.dof, 1))))
    status = np.full(len(poses), "consistent", dtype=object)
    body = np.full(len(poses), -1)
    bad = np.flatnonzero(found.chi2 > typical * limit(found.dof))
    if len(bad):
        tried = []
        for k in range(poses.shape[1]):
            without = poses[bad].copy()
            without[:, k] = np.nan
            again = repro.fit_shape(robot, without, **options)
            tried.append(again.chi2 / (typical * limit(again.dof)))
        tried = np.array(tried)
        k = tried.argmin(0)
        fits = tried.min(0) < 1
        status[bad] = np.where(fits, "left out", "inconsistent")
        body[bad] = np.where(fits, k, -1)
        poses[bad[fits], k[fits]] = np.nan
        poses[bad[~fits]] = np.nan
    return poses, status, body, typical
