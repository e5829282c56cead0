"""Magnets in a soft block over five chips: where it is touched, by an own model."""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.distance import cdist

import repro

DATA = Path(__file__).parents[2] / "recordings/eflesh"
MIDDLE, EDGE = np.array([289.0, -100.0, 143.0]), np.array([16.0, 16.0, 3.0])
PLACE, SHARE = np.array([3.0, 3.0, 10.0]), 1e-3  # chosen on the first 80 %


class Ridge:
    """Kernel ridge: readings at a place of the probe [mm], and their slopes."""

    def __init__(self, q, u):
        self.q, self.mean = q / PLACE, u.mean(axis=0)
        K = np.exp(-cdist(self.q, self.q, "sqeuclidean") / 2) + SHARE * np.eye(len(q))
        self.weights = np.linalg.solve(K, u - self.mean)

    def __call__(self, q):
        return self.linearise(q)[0].reshape(*np.shape(q)[:-1], -1)

    def linearise(self, q):
        x = np.atleast_2d(q) / PLACE
        k = np.exp(-cdist(x, self.q, "sqeuclidean") / 2)
        u, J = k @ self.weights, []
        for a in range(3):
            J.append(k @ (self.q[:, [a]] * self.weights) - x[:, [a]] * u)
        return u + self.mean, np.stack(J, axis=-1) / PLACE


table, n = pd.read_csv(DATA / "contacts.csv"), 3844  # four of five sweeps teach
u, q = table.filter(like="uT").to_numpy() / 1e3, table[["x_mm", "y_mm", "z_mm"]]
q, fourth = q.to_numpy() - MIDDLE, slice(2883, n)  # it tells the errors of the model
off = Ridge(q[:2883], u[:2883])(q[fourth]) - u[fourth]
u = u @ (white := np.linalg.inv(np.linalg.cholesky(off.T @ off / len(off))).T)
method = repro.LevenbergMarquardt(Ridge(q[:n], u[:n]), -EDGE, EDGE, noise=1.0)
start = q[cdist(u[n:], u[:n]).argmin(axis=1)]  # contacts jump: a start for each
found = repro.track(method, u[None, n:], q0=start.clip(-0.99 * EDGE, 0.99 * EDGE))
other = pd.read_csv(DATA / "pressed.csv").filter(like="uT").to_numpy()[:50] / 1e3
alarm = repro.track(method, other @ white, q0=[0.0, 0.0, 0.0])
error = (found.q[0] - q[n:])[:, :2]
judged = {"contact": (error, found.covariance[0, :, :2, :2])}
figures = dict(zip(("x_rms_mm", "y_rms_mm"), np.sqrt((error**2).mean(axis=0))))
figures["consistent_percent"] = 100 * (found.status == "consistent").mean()
figures["alarms_of_another_percent"] = 100 * (alarm.status != "consistent").mean()
print(pd.Series(figures).round(3).to_string())
