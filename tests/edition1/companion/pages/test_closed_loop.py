"""The closed loop: stepping is the batch simulation, laws of the controller, same bits, ratios by hand."""

from functools import cache

import numpy as np
import pandas as pd
import pytest

from edition1.errors import InputError
from edition1_companion.pages.closed_loop.curvature_control import (
    CurvatureController,
    Gains,
    InverseMap,
    fit_inverse,
)
from edition1_companion.pages.closed_loop.identification import Commanded, identify
from edition1_companion.pages.closed_loop.loop import (
    CONTROLLERS,
    REFERENCES,
    SKIPPED_S,
    TRAINING,
    Learned,
    LoopTrace,
    Run,
    learn,
    reference_mm,
    run_loops,
)
from edition1_companion.pages.closed_loop.rig_loop import SESSIONS, SteppedRig, sessions
from edition1_companion.pages.closed_loop.tables import loops_over_time, tracking_ratios
from edition1_companion.recordings.baaij2023 import Recording
from edition1_companion.twins.compiled_rig_filter import bank_estimate
from edition1_companion.twins.pneumatic_actuation import Chambers
from edition1_companion.twins.pneumatic_rig import record_rig
from edition1_companion.twins.rig_bank import BendBank
from edition1_companion.twins.rig_filter import filtered
from edition1_companion.twins.rig_map import BendMap, fit_map
from edition1_companion.twins.rig_motion import rig_motion
from edition1_companion.twins.rig_twins import nominal_twin
from edition1_companion.twins.sensor_board import analogue_readings, converted

TWIN = nominal_twin()
PLAIN = Gains(0.5, 2.0, False)
LATE = 8
"""Delay for which gains are tuned [readings]: 0.2 s, the lag of the segment, as a margin for a late estimate."""
GRID = (
    (0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0),
    (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0, 45.0),
)
"""Proportional and integral gains [-, 1/s] among which :func:`tune` chooses."""


@cache
def recording():
    """Forty seconds of T5: enough for maps that a test of the machinery needs; synthetic."""
    return record_rig(TWIN, "T5", seed=0, duration_s=40.0)


@cache
def learned() -> Learned:
    """As `learn`, from a short T5 that is turned by hand into a fan of all directions."""
    time_s = np.arange(12_000) / 100.0
    phase, turn = 2 * np.pi * time_s / 10.0, 2 * np.pi * time_s / 120.0
    chambers = TWIN.chambers
    torque = chambers.reference_nm * np.sin(phase)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    pressures = chambers.pressures(torque)
    motion = rig_motion(time_s, pressures, chambers, TWIN.bending, TWIN.inner)
    kept = slice(1000, None, 5)
    u = analogue_readings(TWIN.board, motion.q[kept], motion.q_magnet[kept])
    u = converted(u + 0.6 * np.random.default_rng(0).standard_normal(u.shape))
    part = Recording("toy", np.arange(len(u)), motion.q[kept], u)
    inverse = fit_inverse(chambers, pressures[kept], 1e3 * motion.q[kept, :2])
    fan = Commanded(part, float(time_s[1000]), time_s, chambers.bending_torque(pressures))
    bend_map = fit_map(part)
    return Learned(bend_map, inverse, identify(bend_map, fan, None, inverse.rest_mm))


class TestFilterInSteps:
    def test_steps_of_the_bank_are_the_filter_to_the_bit(self):
        u, bank = recording().readings_mv[400:700], BendBank(learned().bend_map)
        found, state, bends = filtered(learned().bend_map, u), bank.start(), []
        assert np.isnan(state.mean_mm).all()
        for reading in u:
            state = bank.step(state, reading)
            bends.append(state.mean_mm[:2])
        assert np.array_equal(np.array(bends), found.diagnostics["bend_mm"].numpy())
        assert not found.diagnostics["anew"].any()

    def test_variance_of_the_elongation_follows_that_of_the_bend(self):
        """Linear propagation, with the derivative of the elongation as a difference quotient."""
        g, numbers = np.random.default_rng(0), np.array([50.0, 0.1, 6.0, 5.0, 1.0, 0.3])
        mixture = (np.eye(2), np.full(3, 1 / 3), np.array([-1.0, 0.0, 1.0]), g.standard_normal((3, 2)))
        bend, known = np.array([3.0, -2.0, 0.0, 0.0]), (np.full(2, 4.0), np.array([5.0, 0.02]), numbers)
        q, C, *_ = bank_estimate(bend, *mixture, *known)
        moved = [bank_estimate(bend + d, *mixture, *known)[0] for d in 1e-5 * np.eye(4)[:2]]
        slope = np.array([(other - q)[2] / 1e-5 for other in moved])
        straight = bank_estimate(0 * bend, *mixture, *known)[1]
        assert C[2, 2] - straight[2, 2] == pytest.approx(slope @ C[:2, :2] @ slope, rel=1e-4)


class TestSteppedRig:
    @pytest.mark.parametrize("name", ["T3", "T0"])
    def test_open_loop_is_the_recorded_motion(self, name):
        motion = record_rig(TWIN, name, seed=1, duration_s=8.0).motion
        rig = SteppedRig(TWIN)
        state, steps = rig.init(1).motion, []
        for pressures in motion.pressures_mbar[1:]:
            state, *shapes = rig.move(state, pressures[None])
            steps.append(np.concatenate(shapes))
        found = np.array(steps)
        assert np.ptp(motion.q_magnet[:, 1]) > 3e-3
        np.testing.assert_allclose(found[:, 0], motion.q[:-1], rtol=0, atol=1e-15)
        # The last central difference of the batch is one-sided: it is left out.
        np.testing.assert_allclose(found[:, 1], motion.q_magnet[:-1], rtol=0, atol=1e-15)

    def test_held_pressures_give_the_readings_of_the_batch(self):
        """Commands at 40 Hz, samples at 100 Hz: readings between two samples are their means, as in a recording."""
        g, ticks = np.random.default_rng(0), 400
        torque = np.cumsum(1e-3 * g.standard_normal((ticks, 2)), axis=0)
        commands = TWIN.chambers.pressures(np.clip(torque, -0.03, 0.03))
        rig, found = SteppedRig(TWIN), []
        state = rig.init(2)
        for command in commands:
            state, *shapes = rig.step(state, np.stack([command, commands[0]]))
            found.append([shape[0] for shape in shapes])
        time_s = np.arange(round(2.5 * ticks)) / 100.0
        # A command holds after its own time until the next one's, that included; before all the chambers are empty.
        holding = np.maximum(np.ceil(time_s * 40.0 - 1e-9).astype(int) - 1, 0)
        pressures = np.where((time_s > 0)[:, None], commands[holding], 0.0)
        motion = rig_motion(time_s, pressures, TWIN.chambers, TWIN.bending, TWIN.inner)
        _, q, q_magnet = motion.at(np.arange(ticks - 1) / 40.0)
        steps = np.array(found)[:-1]
        np.testing.assert_allclose(steps[:, 0], q, rtol=0, atol=1e-14)
        np.testing.assert_allclose(steps[:, 1], q_magnet, rtol=0, atol=1e-14)
        u = analogue_readings(TWIN.board, q, q_magnet)
        batch = analogue_readings(TWIN.board, *np.array(found)[:-1].swapaxes(0, 1))
        np.testing.assert_allclose(batch, u, atol=1e-9)

    def test_a_command_shows_after_its_reading_only(self):
        rig = SteppedRig(TWIN)
        state = rig.init(1)
        for _ in range(200):
            state, *_ = rig.step(state, np.full((1, 3), 225.0))
        push = TWIN.chambers.pressures(np.array([[0.02, 0.02]]))
        (_, *still), (_, *pushed) = rig.step(state, np.full((1, 3), 225.0)), rig.step(state, push)
        np.testing.assert_array_equal(still[0], pushed[0])
        # The magnet's lag looks one sample ahead: without torque there is no direction that could turn.
        np.testing.assert_allclose(still[1], pushed[1], atol=1e-12)


class TestSessions:
    def test_as_trained_has_neither_bias_nor_gain_and_the_same_noise(self):
        drawn = sessions(TWIN, SESSIONS, [7, 7], 50)
        assert not drawn.bias_mv[0].any()
        assert not drawn.gain[0].any()
        assert drawn.bias_mv[1].any()
        assert drawn.gain[1].any()
        assert np.array_equal(drawn.disturbance_mv[:, 0], drawn.disturbance_mv[:, 1])

    def test_spreads_are_those_of_the_twin(self):
        n = 600
        drawn = sessions(TWIN, ["another"] * n, range(n), 2)
        common = TWIN.bias_mv[:-1]
        assert drawn.bias_mv.mean() == pytest.approx(np.mean(common), abs=0.2)
        apart = np.abs(drawn.bias_mv.mean(axis=1)[:, None] - common).min(axis=1)
        assert apart.max() < 4 * TWIN.bias_scatter_mv / 3**0.5
        assert drawn.gain.std() == pytest.approx(TWIN.gain_scatter, rel=0.1)
        white = np.hypot(TWIN.board.noise_mv, TWIN.board.inflated_noise_mv)
        assert np.diff(drawn.disturbance_mv, axis=0).std() / 2**0.5 == pytest.approx(white, rel=0.1)

    def test_unknown_kind_is_refused(self):
        with pytest.raises(InputError, match="Input kinds of sessions must be among as trained, another"):
            sessions(TWIN, ["noisy"], [0], 10)


class TestController:
    def inverse(self) -> InverseMap:
        """Linear: 10 mm for the reference torque, at rest in zero."""
        bend = np.stack(np.meshgrid(*[np.linspace(-9.0, 9.0, 19)] * 2), axis=-1).reshape(-1, 2)
        chambers = TWIN.chambers
        torque = chambers.reference_nm * np.column_stack([-bend[:, 1], bend[:, 0]]) / 10.0
        return fit_inverse(chambers, chambers.pressures(torque), bend)

    def test_map_is_found_where_it_is_linear(self):
        bend = np.array([[2.0, -3.0], [0.0, 0.0]])
        np.testing.assert_allclose(self.inverse()(bend), bend / 10.0, atol=1e-12)

    def test_pressures_stay_in_their_range_and_keep_their_mean(self):
        controller = CurvatureController(TWIN.chambers, self.inverse(), [PLAIN] * 50)
        torque = np.random.default_rng(1).uniform(-1.2, 1.2, (50, 2))
        pressures, beyond = controller.bounded(torque)
        assert beyond.any()
        assert not beyond.all()
        assert pressures.min() >= -1e-9
        assert pressures.max() <= TWIN.chambers.peak_mbar + 1e-9
        np.testing.assert_allclose(pressures.mean(axis=1), TWIN.chambers.offset_mbar)
        found = TWIN.chambers.torque(pressures)
        wanted = np.column_stack([-torque[:, 1], torque[:, 0]])
        np.testing.assert_allclose(found[:, 0] * wanted[:, 1], found[:, 1] * wanted[:, 0], atol=1e-12)
        np.testing.assert_allclose(found[~beyond], TWIN.chambers.reference_nm * wanted[~beyond])

    def test_integral_does_not_wind_up(self):
        """A reference that no pressure reaches: the integral stays as it is while the command is at its bound."""
        controller = CurvatureController(TWIN.chambers, self.inverse(), [Gains(0.5, 2.0, True)])
        state, far, bend = controller.init(), np.array([[40.0, 0.0]]), np.array([[9.0, 0.0]])
        for _ in range(400):
            state, _ = controller.step(state, far, bend)
        assert state.bounded.all()
        assert not state.integral_mm.any()
        state, _ = controller.step(state, np.zeros((1, 2)), np.zeros((1, 2)))
        assert not state.bounded.any()

    def test_loop_returns_from_its_bound_at_once(self):
        """After 10 s at a reference out of reach, the way back takes as long as after 1 s."""
        inverse, rig = learned().inverse, SteppedRig(TWIN)
        late = []
        for held in (40, 400):
            controller = CurvatureController(TWIN.chambers, inverse, [PLAIN])
            control, state = controller.init(), rig.init(1)
            pressures = np.full((1, 3), TWIN.chambers.offset_mbar)
            for tick in range(held + 200):
                state, q, _ = rig.step(state, pressures)
                bend = 1e3 * q[:, :2]
                wanted = np.array([[20.0, 0.0]]) if tick < held else inverse.rest_mm[None]
                control, pressures = controller.step(control, wanted, bend)
                if tick == held + 80:
                    late.append(float(np.abs(bend - inverse.rest_mm).max()))
        assert late[1] < late[0] + 0.2
        assert late[1] < 1.0


class TestLoop:
    def test_reference_is_reached_and_stays_without_an_error(self):
        """The integral leaves nothing of the hysteresis; a step of the reference, the true bend fed back."""
        gains = [Gains(0.5, 2.0, forward) for forward in (False, True)]
        trace = run_loops(TWIN, learned(), [Run("step", g, "truth") for g in gains], duration_s=10.0)
        last = np.searchsorted(trace.time_s, 4.9)
        assert np.abs(trace.bend_mm[last] - [2.5, 0.0]).max() < 0.02
        assert np.abs(trace.bend_mm[-1] - [6.5, 0.0]).max() < 0.05
        assert np.array_equal(trace.bend_mm, trace.fed_back_mm)

    def test_same_seed_same_bits_and_runs_do_not_touch_each_other(self):
        runs = [Run("circle", PLAIN, "another", 3), Run("circle", PLAIN, "as trained", 4)]
        both = run_loops(TWIN, learned(), runs, duration_s=5.5)
        again = run_loops(TWIN, learned(), runs, duration_s=5.5)
        for name in ("bend_mm", "fed_back_mm", "bounded"):
            assert np.array_equal(getattr(both, name), getattr(again, name))
        one = run_loops(TWIN, learned(), runs[1:], duration_s=5.5)
        np.testing.assert_allclose(one.bend_mm[:, 0], both.bend_mm[:, 1], atol=1e-6)
        assert not np.array_equal(both.bend_mm[:, 0], both.bend_mm[:, 1])

    def test_late_feedback_is_late_by_its_readings(self):
        trace = run_loops(TWIN, learned(), [Run("circle", PLAIN, "truth", late=8)], duration_s=6.0)
        assert np.array_equal(trace.fed_back_mm[8:], trace.bend_mm[:-8])

    def test_references_begin_in_reach(self):
        time_s = np.arange(0.0, 40.0, 0.025)
        inverse = learned().inverse
        for name in (*REFERENCES, TRAINING):
            wanted = reference_mm(name, time_s)
            torque = inverse(wanted)
            assert np.abs(torque).max() < 1.0
            assert (wanted > inverse.lower).all()
            assert (wanted < inverse.upper).all()

    def test_wrong_input_is_refused(self):
        with pytest.raises(InputError, match="Input duration_s of run_loops must be above 5"):
            run_loops(TWIN, learned(), [Run("step", PLAIN, "truth")], duration_s=5.0)
        with pytest.raises(InputError, match="Input controller of loops_over_time must be one of PI"):
            loops_over_time(controller="MPC", session="another", seed=0, duration_s=6.0)


def rms_mm(trace: LoopTrace):
    """Tracking error of each run [mm]: root mean square of the distance after the time that is not judged."""
    apart = (trace.reference_mm - trace.bend_mm)[trace.time_s >= SKIPPED_S]
    return np.sqrt((apart**2).sum(axis=-1).mean(axis=0))


def tune(learned: Learned, *, feed_forward: bool, late: int = LATE) -> Gains:
    """Gains for the training reference with the true bend fed back late: half of the best ones of :data:`GRID`.

    Half, so that the loop stays stable when the rig is twice as soft as the one that was tuned.
    """
    grid = [Gains(p, i, feed_forward) for p in GRID[0] for i in GRID[1]]
    doubled = [Gains(2 * g.proportional, 2 * g.integral_per_s, feed_forward) for g in grid]
    runs = [Run(TRAINING, g, "truth", late=late) for g in doubled]
    return grid[int(rms_mm(run_loops(TWIN, learned, runs, duration_s=20.0)).argmin())]


class TestTuning:
    def test_frozen_gains_are_those_of_the_training_reference(self):
        """T5 of the twin is recorded for this; the true bend is fed back, no reading enters."""
        known = learn(TWIN)
        assert isinstance(known.bend_map, BendMap)
        assert tune(known, feed_forward=False) == CONTROLLERS["PI"]
        assert tune(known, feed_forward=True) == CONTROLLERS["PI and feed-forward"]
        assert tune(known, feed_forward=True, late=0) == CONTROLLERS["without margin"]
        runs = [Run(TRAINING, g, "truth", late=LATE) for g in (PLAIN, Gains(2 * GRID[0][-1], 2.0, False))]
        calm, wild = rms_mm(run_loops(TWIN, known, runs, duration_s=10.0))
        assert wild > 2 * calm


class TestRatios:
    def table(self):
        rows = [
            {"estimator": "lag", "controller": c, "session": s, "reference": r, "seed": k}
            | {"tracking_mm": 1.0 + 0.1 * k, "tracking_truth_mm": 1.0, "estimate_mm": 0.3, "offset_mm": 0.1}
            for c in ("PI", "without margin")
            for s in SESSIONS
            for r in REFERENCES
            for k in range(3)
        ]
        return pd.DataFrame(rows)

    def test_means_intervals_and_target_by_hand(self):
        table = tracking_ratios(self.table(), "estimator", draws=500)
        assert len(table) == 2 * 2 * 3
        assert table["ratio"].to_numpy() == pytest.approx(np.full(12, 1.1))
        assert table["worst"].to_numpy() == pytest.approx(np.full(12, 1.2))
        assert (table["low"] >= 1.0).all()
        assert (table["high"] <= 1.2).all()
        assert table["met"].all()
        assert (table["seeds"] == 3).all()


def test_chambers_have_the_same_room_up_and_down():
    chambers = Chambers()
    assert chambers.peak_mbar == 2 * chambers.offset_mbar
