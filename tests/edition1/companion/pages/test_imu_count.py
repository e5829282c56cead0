"""Curves that keep their limits, errors below their bounds, and a rule that is the bound's leading term."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from short_arm import short_arm

from edition1.errors import InputError
from edition1.estimation.orientations import tangents
from edition1_companion.pages.how_many_imus.curves import STEPS, arm_curves, random_curves
from edition1_companion.pages.how_many_imus.errors import (
    ARCS,
    BOUNDS,
    END,
    MIDDLE,
    MODELS,
    PCC,
    SPLINE,
    SUB_LINKS,
    below_bounds,
    errors_by_count,
    needed,
    perfect_sensors,
    placed,
    rule,
)
from edition1_companion.pages.how_many_imus.needed import imus_needed

LIMITS = {"curvature": 8.0, "slope": 60.0}


@pytest.fixture(scope="module")
def arm():
    return short_arm()


@pytest.fixture(scope="module")
def curves():
    return random_curves(30, length_m=0.64, **LIMITS, seed=0)


class TestCurves:
    def test_one_limit_is_used_up(self, curves):
        share = np.stack([curves.curvature / LIMITS["curvature"], curves.slope / LIMITS["slope"]])
        np.testing.assert_allclose(share.max(axis=0), 1)

    def test_curvature_is_what_the_frames_turn(self, curves):
        frames = curves.frames[:5]
        before, after = (Rotation.from_quat(x.reshape(-1, 4)) for x in (frames[:, :-1], frames[:, 1:]))
        rates = (before.inv() * after).as_rotvec().reshape(5, STEPS, 3) * STEPS / 0.64
        np.testing.assert_allclose(
            np.linalg.norm(rates, axis=-1).max(axis=1), curves.curvature[:5], rtol=1e-6
        )
        np.testing.assert_allclose(rates[..., 2], 0, atol=1e-9)  # no twist

    def test_points_are_the_integral_of_the_tangents(self, curves):
        d = tangents(curves.frames)
        trapezoid = (d[:, 1:] + d[:, :-1]) / 2 * 0.64 / STEPS
        np.testing.assert_allclose(curves.points[:, 1:], np.cumsum(trapezoid, axis=1), atol=1e-6)

    def test_arm_is_the_simulated_one(self, arm):
        found = arm_curves(arm, count=20)
        rows = np.linspace(0, len(arm.time_s) - 1, 20).round().astype(int)
        steps = np.round(0.08 * np.arange(1, 9) / 0.64 * STEPS).astype(int)
        # The arm stretches by up to 0.6 %.
        apart = np.linalg.norm(found.points[:, steps] - arm.positions[rows][:, 3:32:4], axis=-1)
        assert apart.max() < 4e-3
        true = tangents(arm.orientations[rows, 1:])
        angle = np.degrees(np.arccos(np.clip((tangents(found.frames[:, steps]) * true).sum(-1), -1, 1)))
        assert np.median(angle) < 0.5
        assert angle.max() < 3  # shear, and the spline between points 20 mm apart

    def test_limits_that_cannot_be_met(self, arm):
        with pytest.raises(
            InputError, match=r"Input slope of random_curves must be above zero; instead received 0\."
        ):
            random_curves(2, length_m=0.64, curvature=1.0, slope=0.0, seed=0)
        with pytest.raises(
            InputError, match=r"Input length_m of arm_curves must be above 0 and up to 0\.66 m"
        ):
            arm_curves(arm, length_m=0.7)


class TestPlaced:
    @pytest.mark.parametrize("model", MODELS)
    @pytest.mark.parametrize("crowding", [1.0, 1.4])
    def test_links_end_where_they_should(self, model, crowding):
        made = placed(model, 5, 0.64, crowding)
        ends = 0.64 * (np.arange(1, 6) / 5) ** crowding
        np.testing.assert_allclose(np.cumsum(made.link_lengths), ends, atol=0.64 / STEPS)
        if model == MIDDLE:
            middles = np.cumsum(made.link_lengths) - np.array(made.link_lengths) / 2
            np.testing.assert_allclose(made.arcs, middles, atol=0.64 / STEPS)
        else:
            np.testing.assert_allclose(made.arcs[-5:], ends, atol=0.64 / STEPS)

    def test_too_many(self):
        message = r"Input n_imus of placed must be 1 or more, with links of 2 steps at least; instead received 1000\."
        with pytest.raises(InputError, match=message):
            placed(PCC, 1000, 0.64)
        with pytest.raises(InputError, match=r"Input model of placed must be one of rigid-body"):
            placed("chain", 4, 0.64)


class TestErrors:
    @pytest.mark.parametrize("n", [2, 4, 8, 16])
    def test_no_error_is_above_its_bound(self, curves, arm, n):
        for some in (curves, arm_curves(arm, count=40)):
            table = below_bounds(some, n)
            assert (table["above"] == 0).all()
            assert set(table["model"]) == set(BOUNDS)
        assert errors_by_count(curves, [n])["within"].all()

    def test_orders(self, curves):
        table = errors_by_count(curves, [8, 16]).pivot_table(
            index="model", columns="n_imus", values="median_mm"
        )
        order = np.log2(table[8] / table[16])
        assert order[END] == pytest.approx(1, abs=0.1)
        assert order[[MIDDLE, PCC, ARCS]].to_numpy() == pytest.approx([2, 2, 2], abs=0.15)
        assert order[SPLINE] > 3

    def test_sensor_errors_add_as_the_rule_says(self):
        straight = random_curves(2000, length_m=0.64, curvature=1e-6, slope=1.0, seed=1)
        sigma = np.radians(1.0)
        table = errors_by_count(straight, [4, 16], sensor_rad=float(sigma), seed=2).set_index(
            ["model", "n_imus"]
        )
        # The distance across has a Rayleigh distribution, whose median is sqrt(ln 2) times its root mean square.
        for n in (4, 16):
            expected = 640 * sigma * np.sqrt(2 / n) * np.sqrt(np.log(2))
            assert table.loc[(END, n), "median_mm"] == pytest.approx(expected, rel=0.05)

    def test_same_seed_same_bits(self, curves):
        first, second = (errors_by_count(curves, [4], sensor_rad=0.1, seed=3) for _ in range(2))
        assert first.equals(second)


class TestRule:
    @pytest.mark.parametrize("model", [MIDDLE, PCC, ARCS])
    def test_is_the_bound_for_short_links(self, model):
        by_rule = rule(model, 0.64, 1e-5, **LIMITS)
        by_bound = imus_needed(BOUNDS[model], 0.64, 1e-5, **LIMITS, sub_links=SUB_LINKS)
        assert by_rule == pytest.approx(by_bound, rel=0.02)

    def test_table(self, curves):
        table = needed(curves, [0.01, 0.04]).set_index(["model", "tolerance_mm"])
        assert table.loc[(END, 10.0), "by_rule"] == np.ceil(8 * 0.64**2 / 0.02)
        for model in (MIDDLE, PCC, ARCS):
            line = table.loc[(model, 10.0)]
            assert line["by_curves"] <= line["by_bound"]
        assert table["by_curves"].xs(SPLINE)[10.0] <= table["by_curves"].xs(PCC)[10.0]

    def test_no_rule_and_no_tolerance(self, curves):
        with pytest.raises(InputError, match="Input model of rule must be one of"):
            rule(SPLINE, 0.64, 0.01, **LIMITS)
        with pytest.raises(InputError, match=r"Input tolerances_m of needed must be above zero \[m\]"):
            needed(curves, [0.0])


def test_targets_with_perfect_sensors(arm):
    table = perfect_sensors(arm).set_index("model")[["m1_ratio", "m2_ratio"]]
    assert (table.loc[SPLINE] <= 0.5).all()
    assert (table.loc[ARCS] <= 1.0).all()
    rigid = [name for name in table.index if name.startswith("rigid")]
    assert (1 / table.loc[rigid] <= 0.7).all(axis=None)
