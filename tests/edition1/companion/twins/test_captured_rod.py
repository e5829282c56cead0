"""Rods of polynomial curvature against the library's segments, and the bodies of a motion capture on them."""

import numpy as np
import pytest
import torch

from edition1 import AffineCurvature, ConstantCurvature, Robot, magnet_mounts
from edition1_companion.book.project import find_project
from edition1_companion.recordings.continuum_robot import LENGTH_M, STATIONS_M, find_trials
from edition1_companion.twins.captured_rod import bend_deg, body_offsets, captured, stations
from edition1_companion.twins.curvature_series import CurvatureSeries

QUARTERS = torch.tensor([0.25, 0.5, 0.75, 1.0], dtype=torch.float64)
RECORDED = find_project().data / "recordings" / "continuum_robot"


@pytest.fixture
def trials(monkeypatch, tmp_path):
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    return {trial.name: trial for trial in find_trials(RECORDED)}


def bends(*shape, seed=0):
    return torch.as_tensor(np.random.default_rng(seed).normal(0, 0.8, shape))


@pytest.mark.parametrize("batch", [(), (1,), (3, 2)])
def test_one_term_is_an_arc(batch):
    """A turn about x leads towards -y, one about y towards x."""
    q = bends(*batch, 2)
    arc = ConstantCurvature(LENGTH_M, radius=1.0)
    there = arc.pose(torch.stack([q[..., 1], -q[..., 0], 0 * q[..., 0]], -1).unsqueeze(-2), QUARTERS)
    torch.testing.assert_close(CurvatureSeries(LENGTH_M, 1).quarters(q), there, atol=1e-12, rtol=0)


def test_two_terms_in_one_plane_are_the_affine_curvature_of_the_library():
    q = bends(5, 2)
    affine = torch.stack([q[:, 0] - q[:, 1], 2 * q[:, 1], 0 * q[:, 0], 0 * q[:, 0]], -1)
    there = AffineCurvature(LENGTH_M).pose(affine.unsqueeze(-2), QUARTERS)
    found = CurvatureSeries(LENGTH_M, 2).quarters(torch.cat([q, 0 * q], -1))
    torch.testing.assert_close(found, there, atol=2e-6, rtol=0)


def test_three_terms_are_the_limit_of_many_arcs():
    """Arcs with the mean curvature of their piece: their error falls with the square of their number."""
    q = 0.5 * bends(4, 6)
    found, off = CurvatureSeries(LENGTH_M, 3).quarters(q), []
    for n in (24, 48):
        edges = np.linspace(-1, 1, n + 1)
        integrals = np.stack([edges, edges**2 / 2, (edges**3 - edges) / 2], -1)
        mean = torch.as_tensor(np.diff(integrals, axis=0) / 2)
        about_x, about_y = (q.unflatten(-1, (2, 3)) @ mean.mT).unbind(-2)
        chain = Robot((ConstantCurvature(LENGTH_M / n, radius=1.0),) * n)
        mounts = magnet_mounts([n // 4 * k - 1 for k in (1, 2, 3, 4)], [LENGTH_M / n] * 4)
        arcs = torch.stack([about_y, -about_x, 0 * about_x], -1).flatten(-2)
        off.append(float((chain.mount_poses(arcs, mounts) - found).abs().max()))
    assert off[1] < 1e-3
    assert off[0] / off[1] == pytest.approx(4, rel=0.1)


def test_frames_are_those_that_show_all_five_bodies(trials):
    counts = {name: len(captured(trial)[0]) for name, trial in trials.items()}
    assert counts == {"slow_free_space": 159, "impulse_1": 145, "fast_contact": 122}
    for trial in trials.values():
        time_s, T = captured(trial)
        everywhere = [set(trial.readings(f"vicon{k}").time_s) for k in range(5)]
        assert set(time_s) == set.intersection(*everywhere)
        assert T.shape == (len(time_s), 5, 4, 4)
        assert set(time_s) <= set(captured(trial, whole=True)[0])


def test_stations_do_not_depend_on_the_world():
    T = CurvatureSeries(LENGTH_M, 3).quarters(bends(6, 6)).numpy()
    base = CurvatureSeries(0.3, 1).quarters(bends(6, 2, seed=1)).numpy()[:, :1]
    np.testing.assert_allclose(stations(np.concatenate([base, base @ T], axis=1)), T, atol=1e-12)


def test_offsets_of_bodies_are_found_and_taken_away():
    T = CurvatureSeries(LENGTH_M, 3).quarters(bends(20, 6)).numpy()
    offsets_m = np.random.default_rng(2).normal(0, 5e-3, (len(STATIONS_M), 3))
    seen = T.copy()
    seen[..., :3, 3] += np.einsum("nsij,sj->nsi", T[..., :3, :3], offsets_m)
    found = body_offsets(seen, position_m=1e-3, angle_rad=0.02)
    np.testing.assert_allclose(found, offsets_m, atol=1e-8)
    with_base = np.concatenate([np.broadcast_to(np.eye(4), (20, 1, 4, 4)), seen], axis=1)
    np.testing.assert_allclose(stations(with_base, found), T, atol=1e-8)


def test_bend_of_an_arc_is_its_angle():
    q = torch.tensor([[0.0, 0.0], [0.3, 0.4], [2.0, 0.0]], dtype=torch.float64)
    found = bend_deg(CurvatureSeries(LENGTH_M, 1).quarters(q).numpy())
    np.testing.assert_allclose(np.radians(found), [0, 0.5, 2], atol=1e-7)
