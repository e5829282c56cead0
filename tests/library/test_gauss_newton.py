"""Gauss-Newton with priors: against SciPy, and against unknowns that are not eliminated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from repro.estimators.gauss_newton import Trial, eliminated, gauss_newton


def curved(z):
    """Readings of two parameters, and their slopes; far from the minimum a full step leads to something worse."""
    t = np.linspace(0.0, 3.0, 40)
    u = np.exp(-z[0] * t) * np.sin(2.0 * t + z[1])
    slopes = np.stack([-t * u, np.exp(-z[0] * t) * np.cos(2.0 * t + z[1])], axis=-1)
    return u, slopes


@pytest.mark.parametrize("truth", [(0.3, 0.2), (-0.4, 1.2), (2.5, -1.5)])
@pytest.mark.parametrize("std", [0.5, 3.0])
def test_the_minimum_and_its_information_are_those_of_scipy(truth, std):
    seen = (curved(np.array(truth))[0] + 0.01 * np.random.default_rng(0).normal(size=40)) / 0.01
    costs = []

    def trial(z):
        u, J = curved(z)
        r, J = seen - u / 0.01, J / 0.01

        def equations():
            costs.append(r @ r + (z / std) @ (z / std))
            return r @ r, J.T @ J, J.T @ r

        return Trial(r @ r, equations)

    fit = gauss_newton(trial, np.full(2, std**-2))
    expected = least_squares(
        lambda z: np.append(curved(z)[0] / 0.01 - seen, z / std), fit.z, xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    np.testing.assert_allclose(fit.z, expected.x, atol=1e-7)
    np.testing.assert_allclose(fit.information, expected.jac.T @ expected.jac, rtol=1e-4)
    assert (np.diff(costs) <= 1e-6).all()
    assert costs[-1] == pytest.approx(2 * expected.cost, rel=1e-6)


def test_eliminated_unknowns_give_what_all_unknowns_together_give():
    """Two rows with unknowns of their own: the information of the parameters is the inverse of their covariance."""
    rng = np.random.default_rng(1)
    K, J, r = rng.normal(size=(2, 5, 3)), rng.normal(size=(2, 5, 2)), rng.normal(size=(2, 5))
    whole = np.zeros((10, 7))
    for k in range(2):
        rows = slice(5 * k, 5 * k + 5)
        whole[rows, :3], whole[rows, 3 + 2 * k : 5 + 2 * k] = K[k], J[k]
    A, g = eliminated(K, J, r)
    np.testing.assert_allclose(np.linalg.inv(A), np.linalg.inv(whole.T @ whole)[:3, :3], rtol=1e-9)
    expected = np.linalg.lstsq(whole, r.ravel(), rcond=None)[0][:3]
    np.testing.assert_allclose(np.linalg.solve(A, g), expected, rtol=1e-9)
