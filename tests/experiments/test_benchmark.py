"""The references that timings are compared with compute the same thing."""

import numpy as np
import torch

from repro.experiments.benchmark import objects_per_configuration, rate
from repro.sensing.magnetic import readings
from repro.sensing.magnets import ring
from repro.simulation.robots import pcc_robot


def test_reference_by_objects_reads_the_same():
    q = 0.01 * torch.rand(3, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    ours = readings(pcc_robot(2), q, ring("published"))
    np.testing.assert_allclose(objects_per_configuration(pcc_robot(2), q, ring("published")), ours, rtol=1e-9)


def test_rate_counts_items_per_processor_second():
    calls = []

    def work():
        calls.append(1)
        return 10 * sum(range(200_000)) and 7

    assert rate(work, repeats=2) > 7
    assert len(calls) == 3
