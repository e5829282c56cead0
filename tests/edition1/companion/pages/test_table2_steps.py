"""The step size of the descent of Table 2 on the simulated rig."""

import numpy as np
import pytest
import torch

from edition1_companion.book.project import find_project
from edition1_companion.twins import rig_descent as table2
from edition1_companion.twins.rig_data import load_recordings
from edition1_companion.twins.rig_filter import filtered
from edition1_companion.twins.rig_map import fit_map
from edition1_companion.twins.rig_networks import rig_networks
from edition1_companion.twins.rig_twins import nominal_twin

NETWORKS = find_project().data / "networks"


@pytest.fixture(scope="module")
def nominal():
    """T2 of the nominal twin, and its committed networks of the first seed."""
    data = load_recordings("twin", trajectories=("T2", "T5"))
    return data, rig_networks(NETWORKS, (0,), twin_sha256=nominal_twin().sha256)


class TestStepSize:
    def test_published_step_is_too_long_for_the_slopes_of_the_twin(self, nominal):
        """Momentum descent on a quadratic of curvature h is stable for step * h < 2 (1 + momentum)."""
        data, _ = nominal
        sensing = table2.rig_sensing(rig_networks(NETWORKS, (0,)).double())
        q = torch.from_numpy(data.tests["T2"].q[::20])
        slopes = torch.func.vmap(torch.func.jacrev(lambda x: sensing(x[None])[0]))(q)[..., :2]
        curvature = torch.linalg.eigvalsh(2 / 3 * slopes.mT @ slopes)[:, -1]
        unstable = table2.STEP_SIZE[0] * curvature > 2 * (1 + table2.MOMENTUM)
        assert float(unstable.double().mean()) > 0.7

    def test_half_the_step_and_twice_the_iterations_do_not_jump(self, nominal):
        """So the jumps are steps that are too long, not other minima; the physics is that of the same networks."""
        data, model = nominal
        errors = {}
        for shorter in (1, 2):
            run = table2.paper_method(
                {"T2": data.tests["T2"]},
                model,
                (0,),
                mean_elongation_m=4.5e-3,
                elongations=("known",),
                shorter=shorter,
            )
            apart = 1e3 * np.abs(run.estimates["known", "T2"][:, 0] - data.tests["T2"].q)[:, :2].max(axis=1)
            errors[shorter] = (apart > 2).mean()
        assert errors[1] > 0.05
        assert errors[2] < 0.03

    def test_ours_on_the_nominal_twin_is_not_lost_either(self, nominal):
        data, _ = nominal
        part = data.tests["T2"]
        run = filtered(fit_map(data.train), part.u)
        assert 1e3 * np.abs(run.q.numpy() - part.q)[:, :2].max() < 2.0
