"""The compiled chain against the vectorised one, the straight pose included."""

import numpy as np
import pytest
from edition1.errors import InputError
from edition1.estimation.imu_models import pcc_extended
from edition1.estimation.imu_selection import Selection
from edition1.kernels import _chain as compiled_chain
from edition1_companion.recordings.martin2022_models import MARKERS, selection
from scipy.spatial.transform import Rotation

POINTS = np.array([0.6, 0.0, 0.04, 0.08, 0.3, 0.36, 0.61, 0.64, 0.36])

BOTH = (pcc_extended, compiled_chain.pcc_extended)


def arm(n):
    return selection("pcc", 8) if n == 2 else Selection(tuple(range(9)), *_arcs(), sub_links=n)


def _arcs():
    return tuple(np.arange(9) * 0.08), (0.08,) * 8


def walk(spread, samples=200, seed=0):
    """Orientations from base to tip that turn by random rotation vectors."""
    turns = spread * np.random.default_rng(seed).standard_normal((samples, 9, 3))
    links = [Rotation.from_rotvec(turns[:, 0])]
    for k in range(1, 9):
        links.append(Rotation.from_rotvec(turns[:, k]) * links[-1])
    return np.stack([link.as_quat() for link in links], axis=1)


@pytest.mark.parametrize("n", [1, 2, 3, 6, 8])
@pytest.mark.parametrize("spread", [0.0, 1e-160, 1e-12, 1e-8, 1e-4, 0.3, 3.0])
def test_equals_the_vectorised_chain(n, spread):
    q = walk(spread)
    q[::2, 3] *= -1  # the same orientation
    both = [chain(q, arm(n), POINTS) for chain in BOTH]
    np.testing.assert_allclose(both[1], both[0], rtol=0, atol=1e-13)


def test_straight_and_opposite():
    upright = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (1, 9, 4)).copy()
    found = compiled_chain.pcc_extended(upright, arm(2), POINTS)
    np.testing.assert_allclose(found[0], POINTS[:, None] * [0.0, 0.0, 1.0], atol=1e-16)
    upright[0, 4:] = [1.0, 0.0, 0.0, 0.0]  # turned over
    both = [chain(upright, arm(2), POINTS) for chain in BOTH]
    np.testing.assert_allclose(both[1], both[0], rtol=0, atol=1e-13)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2), (0,)])
def test_leading_dimensions(shape):
    q = walk(0.2, int(np.prod(shape))).reshape(*shape, 9, 4)
    found = compiled_chain.pcc_extended(q, arm(2), MARKERS)
    assert found.shape == (*shape, 2, 3)
    np.testing.assert_allclose(found, pcc_extended(q, arm(2), MARKERS), atol=1e-14)


def test_layout_precision_and_rounding_of_the_input():
    q = np.asfortranarray(1.0005 * walk(0.2))
    np.testing.assert_allclose(
        compiled_chain.pcc_extended(q, arm(2), MARKERS), pcc_extended(q, arm(2), MARKERS), atol=1e-14
    )
    single = q.astype(np.float32)
    np.testing.assert_allclose(
        compiled_chain.pcc_extended(single, arm(2), 0.64), pcc_extended(single, arm(2), 0.64), atol=1e-14
    )


@pytest.mark.parametrize(
    "spoil",
    [
        lambda q: np.where(np.arange(9)[:, None] == 5, np.nan, q),
        lambda q: 1.01 * q,
        lambda q: q[:, :4],
    ],
)
def test_bad_orientations_have_the_same_message(spoil):
    messages = []
    for chain in BOTH:
        with pytest.raises(InputError) as caught:
            chain(spoil(walk(0.2)), arm(2), MARKERS)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


def test_other_bad_input():
    with pytest.raises(InputError, match="must be distances between 0 and 0.64 m"):
        compiled_chain.pcc_extended(walk(0.2), arm(2), [0.7])
    with pytest.raises(InputError, match="must be one with links between IMUs"):
        compiled_chain.pcc_extended(walk(0.2)[:, :8], selection("rigid", 8), MARKERS)
