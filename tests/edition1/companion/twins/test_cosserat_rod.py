"""The rod against beam theory: bending with shear, compression under its own weight, buckling under it."""

from dataclasses import replace

import numpy as np
import pytest
from edition1.errors import InputError
from edition1_companion.twins.cosserat_rod import Rod, Stick, simulate_rod

BARE = Rod(length_m=0.2, imu_arcs_m=(), elements=10)
AREA = np.pi * BARE.radius_m**2
CRITICAL_M = (7.837 * BARE.bending_stiffness / (BARE.density * AREA * 9.81)) ** (1 / 3)


def resting_hand(x, z):
    return lambda time_s: np.tile([x, 0.0, z], (len(time_s), 1))


def test_a_cantilever_bends_as_a_beam_with_shear():
    """Timoshenko: deflection = P (l^3 / 3EI + l / kGA); bending starts half an element above the base."""
    rod = replace(BARE, gravity=0.0)
    motion = simulate_rod(rod, Stick(resting_hand(0.01, 0.2), 0.2, 20.0), duration_s=1.5, rate_hz=4.0)
    deflection = motion.nodes[-1, -1, 0]
    assert deflection == pytest.approx(motion.nodes[-2, -1, 0], rel=1e-5)  # it has come to rest
    force = 20.0 * (0.01 - deflection)
    length, shear_stiffness = 0.2 - 0.2 / 10 / 2, 27 / 28 * rod.youngs_modulus_pa / 3 * AREA
    expected = force * (length**3 / (3 * rod.bending_stiffness) + length / shear_stiffness)
    assert deflection == pytest.approx(expected, rel=5e-3)  # elements of 20 mm
    assert np.abs(motion.nodes[..., 1]).max() < 1e-12


def test_an_upright_rod_sinks_under_its_weight_and_stays_straight():
    motion = simulate_rod(BARE, Stick(resting_hand(0.0, 0.2), 0.2, 0.0), duration_s=1.0, rate_hz=2.0)
    weight = BARE.density * AREA * 0.2 * 9.81
    expected = weight * 0.2 / (2 * BARE.youngs_modulus_pa * AREA)
    assert 0.2 - motion.nodes[-1, -1, 2] == pytest.approx(expected, rel=0.01)
    lengths = np.linalg.norm(np.diff(motion.nodes, axis=1), axis=-1)
    strain = lengths * BARE.elements / BARE.length_m - 1.0
    assert strain[-1].mean() == pytest.approx(-expected / 0.2, rel=0.01)
    assert np.abs(motion.nodes[..., :2]).max() == 0.0


@pytest.mark.parametrize(("share", "topples"), [(0.85, False), (1.25, True)])
def test_it_topples_above_the_length_of_self_buckling(share, topples):
    """Greenhill: a heavy column stands up to (7.837 EI / q)^(1/3), here 0.369 m; the arm has 0.66 m."""
    length = share * CRITICAL_M
    rod = replace(BARE, length_m=length, translational_damping=0.05)
    push = Stick(resting_hand(0.1, length), length, 0.02, 0.0)  # 2 mN sideways
    motion = simulate_rod(rod, push, duration_s=3.5, rate_hz=2.0)
    assert (motion.nodes[-1, -1, 2] < 0.5 * length) == topples
    assert (motion.nodes[-1, -1, 0] > 0.01) == topples
    assert abs(CRITICAL_M - 0.369) < 5e-4


def test_imus_add_their_weight():
    def sunk(rod):
        motion = simulate_rod(rod, Stick(resting_hand(0.0, 0.2), 0.2, 0.0), duration_s=1.0, rate_hz=1.0)
        return 0.2 - motion.nodes[-1, -1, 2]

    extra = sunk(replace(BARE, imu_arcs_m=(0.0753,), imu_mass_kg=0.05)) - sunk(BARE)
    assert extra == pytest.approx(0.05 * 9.81 * 0.0753 / (BARE.youngs_modulus_pa * AREA), rel=0.02)


def test_same_bits_again_and_frames_along_the_rod():
    def swing():
        moving = Stick(lambda t: np.stack([0.3 * t, 0.2 * t**2, 0.2 - 0 * t], axis=-1), 0.15)
        return simulate_rod(BARE, moving, duration_s=0.4, rate_hz=50.0)

    motion, again = swing(), swing()
    np.testing.assert_array_equal(motion.nodes, again.nodes)
    np.testing.assert_array_equal(motion.frames, again.frames)
    np.testing.assert_allclose(motion.time_s, np.arange(21) * 0.02, atol=1e-12)

    arcs, step = np.array([0.05, 0.1, 0.15]), 1e-4
    tangents = motion.positions(arcs + step) - motion.positions(arcs - step)
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    x, y, z, w = np.moveaxis(motion.orientations(arcs), -1, 0)
    along = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x**2 + y**2)], axis=-1)
    assert np.degrees(np.arccos(along[-1, :, 2])).max() > 20  # well bent
    off = np.degrees(np.linalg.norm(along - tangents, axis=-1))
    assert off.max() < 1.5  # shear, and elements of 20 mm
    np.testing.assert_array_equal(
        motion.orientations(np.zeros(1))[:, 0], np.tile([0.0, 0.0, 0.0, 1.0], (21, 1))
    )


def test_bad_input():
    still = resting_hand(0.0, 0.2)
    with pytest.raises(
        InputError,
        match=r"Input stick of simulate_rod must be on the rod of 0.2 m; instead received 0.3 m\.",
    ):
        simulate_rod(BARE, Stick(still, 0.3), duration_s=1.0, rate_hz=10.0)
    with pytest.raises(InputError, match="Input rate_hz of simulate_rod must be "):
        simulate_rod(BARE, Stick(still, 0.1), duration_s=1.0, rate_hz=1e4)
    with pytest.raises(InputError, match="Input dt_s of simulate_rod must be short enough for a stable rod"):
        simulate_rod(BARE, Stick(resting_hand(0.1, 0.1), 0.2), duration_s=0.5, rate_hz=10.0, dt_s=1e-3)
