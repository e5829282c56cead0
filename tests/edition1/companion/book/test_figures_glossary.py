"""The sketch of the trajectories is what the code draws, and the paths have the shapes that their names say."""

import numpy as np
import pytest
from edition1_companion.book.after.figures_glossary import SKETCH, experiment_path, simulated_path, sketch
from edition1_companion.book.project import find_project
from edition1_companion.twins.pneumatic_actuation import TRAJECTORIES


def test_the_committed_sketch_is_current():
    assert (find_project().book / SKETCH).read_text(encoding="utf-8") == sketch()


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_paths_stay_within_reach(name):
    path = experiment_path(name)
    assert 0.5 < np.abs(path).max() <= 1.0001


def test_shapes():
    """A line is one-dimensional, a lobe stays on one side of its axis, a lemniscate crosses its middle."""
    line, lobe, eight = (simulated_path(name) for name in ("T1", "T2", "T3"))
    assert np.linalg.matrix_rank(line, tol=1e-9) == 1
    assert lobe[:, 1].min() > -1e-9
    assert np.linalg.norm(eight[len(eight) // 4 : 3 * len(eight) // 4], axis=1).min() < 0.02
    assert np.linalg.matrix_rank(experiment_path("T1"), tol=1e-9) == 1
    turns = np.unwrap(np.arctan2(*experiment_path("T4")[1:].T))
    assert abs(turns[-1] - turns[0]) > 4 * np.pi
