"""The twin that drifts for 45 minutes: what each drift does to its readings."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from edition1.errors import InputError
from edition1.sensing.magnetic import readings
from edition1_companion.pages.forty_five_minutes.twin import (
    EARTH,
    ELONGATION_M,
    FAST_TILT,
    IMUS,
    MINUTES,
    NOISE_MT,
    RATE_HZ,
    RING,
    ROBOT,
    Sizes,
    draw_twin,
)

STILL = Sizes(warming_k=0.0, offset_mt=0.0, gain=0.0, heading_rad=0.0, tilt_rad=0.0, iron_a_m2=0.0)


@pytest.fixture(scope="module")
def calm():
    return draw_twin(7, minutes=6.0, sizes=STILL)


def test_without_drift_sensors_read_magpylib_and_white_noise(calm):
    residual = calm.hall_mt - readings(ROBOT, calm.q, RING, earth_mt=EARTH)
    assert float(residual.std()) == pytest.approx(NOISE_MT, rel=0.03)
    assert float(residual.mean(0).abs().max()) < 4 * NOISE_MT / len(residual) ** 0.5


def test_without_drift_imus_err_by_the_tilt_of_motion_alone(calm):
    true = Rotation.from_matrix(ROBOT.mount_poses(calm.q, IMUS)[..., :3, :3].reshape(-1, 3, 3).numpy())
    off = (Rotation.from_rotvec(calm.imus.reshape(-1, 3).numpy()) * true.inv()).as_rotvec().reshape(-1, 3, 3)
    across, about = off[..., :2].std(), off[..., 2].std()
    assert across == pytest.approx(FAST_TILT[0], rel=0.15)
    assert about < 0.1 * across


def test_the_motion_stays_in_its_box_and_is_smooth(calm):
    q = calm.q.unflatten(-1, (3, 3))
    assert float(q[..., 2].min()) >= 0
    assert float(q[..., 2].max()) <= 2 * ELONGATION_M
    assert float(q[..., :2].std()) > 5e-3
    assert float(calm.q.diff(dim=0).std()) < 0.4 * float(calm.q.std())


@pytest.mark.parametrize(
    ("size", "kind"),
    [
        ("offset_mt", "offset"),
        ("gain", "gain"),
        ("heading_rad", "heading"),
        ("tilt_rad", "tilt"),
        ("warming_k", "moment"),
    ],
)
def test_each_size_moves_its_own_part_which_is_known_at_the_start(size, kind, calm):
    moved = draw_twin(7, minutes=6.0, sizes=replace(STILL, **{size: getattr(Sizes(), size)}))
    for name, value in moved.errors.items():
        still = calm.errors[name]
        np.testing.assert_array_equal(value[0], still[0])
        assert (np.abs(value - still).max() > 0) == (name == kind)
    torch.testing.assert_close(moved.q, calm.q, rtol=0, atol=0)


def test_walks_end_with_their_sizes_and_magnets_with_their_temperature():
    ends = [draw_twin(seed, minutes=6.0).errors for seed in range(12)]
    grown = (6 / MINUTES) ** 0.5  # of a random walk
    for kind, size in (("offset", Sizes().offset_mt), ("heading", Sizes().heading_rad)):
        last = np.concatenate([end[kind][-1] for end in ends])
        assert last.std() == pytest.approx(grown * size, rel=0.3)
    warm = Sizes().remanence_per_k * Sizes().warming_k * (6 * 60 - 1 / RATE_HZ) / (60 * MINUTES)
    np.testing.assert_allclose(ends[0]["moment"][-1], warm, rtol=1e-9)


def test_iron_disturbs_its_minute_only(calm):
    iron = draw_twin(7, minutes=6.0, sizes=replace(STILL, iron_a_m2=1.0))
    inside = (iron.time_s > iron.iron_s[0]) & (iron.time_s < iron.iron_s[1])
    change = (iron.hall_mt - calm.hall_mt).abs().amax(1).numpy()
    assert change[~inside].max() == 0
    assert change[inside].max() > 20 * NOISE_MT
    assert iron.iron_s[1] - iron.iron_s[0] == pytest.approx(Sizes().iron_s)


def test_a_seed_is_a_twin(calm):
    torch.testing.assert_close(draw_twin(7, minutes=6.0, sizes=STILL).hall_mt, calm.hall_mt, rtol=0, atol=0)
    assert float((draw_twin(8, minutes=6.0, sizes=STILL).hall_mt - calm.hall_mt).abs().max()) > NOISE_MT
    with pytest.raises(
        InputError, match="Input minutes of draw_twin must be at least 6; instead received 5.0"
    ):
        draw_twin(0, minutes=5.0)
