"""The references that timings are compared with compute the same thing."""

import numpy as np
import torch

from repro.estimation.imu_models import pcc_extended
from repro.estimation.imu_selection import selection
from repro.estimation.orientations import exponential
from repro.experiments.benchmark import chain_by_equations, objects_per_configuration, rate
from repro.sensing.magnetic import readings
from repro.sensing.magnets import ring
from repro.simulation.robots import pcc_robot


def test_reference_by_objects_reads_the_same():
    q = 0.01 * torch.rand(3, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    ours = readings(pcc_robot(2), q, ring("published"))
    np.testing.assert_allclose(objects_per_configuration(pcc_robot(2), q, ring("published")), ours, rtol=1e-9)


def test_reference_chain_has_the_same_joints():
    arm = selection("pcc", 4)
    turns = 0.2 * np.random.default_rng(0).standard_normal((3, 5, 3))
    q = exponential(np.cumsum(turns, axis=1))
    arcs = np.arange(1, 17) * 0.04
    np.testing.assert_allclose(chain_by_equations(q, arm)[:, 1:], pcc_extended(q, arm, arcs), atol=1e-12)


def test_rate_counts_items_per_processor_second():
    calls = []

    def work():
        calls.append(1)
        return 10 * sum(range(200_000)) and 7

    assert rate(work, repeats=2) > 7
    assert len(calls) == 3
