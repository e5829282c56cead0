"""Ours with lag and command: closed forms, Table 2 as its limit, NEES on its own model, what is told."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
import torch
from linear_rig import ACROSS, linear_map, segment

from edition1.estimation.base import track
from edition1_companion.pages.closed_loop.filter import CommandAlone, LoopFilter
from edition1_companion.pages.closed_loop.identification import (
    HELD_S,
    JUMPS_S,
    REACH,
    STATIC_DEGREE,
    SWEEP_S,
    Commanded,
    experiment_torque,
    identify,
)
from edition1_companion.pages.closed_loop.loop import CONTROLLERS, ESTIMATORS, Run, learn, run_loops
from edition1_companion.pages.closed_loop.rig_loop import SESSIONS
from edition1_companion.pages.closed_loop.tables import (
    lag_by_recording,
    ratio_of_estimators,
    ratio_ranges,
    tracking_ratios,
)
from edition1_companion.recordings.baaij2023 import Recording
from edition1_companion.twins.rig_bank import OursConfig
from edition1_companion.twins.rig_filter import BendFilter
from edition1_companion.twins.rig_map import monomials
from edition1_companion.twins.rig_twins import nominal_twin

TWIN = nominal_twin()


def commands(steps: int, rng: np.random.Generator) -> np.ndarray:
    """Torque over the reference, held over 40 Hz: jumps in the disc every second, and a slow circle."""
    turn = 2 * np.pi * np.arange(steps) / 160.0
    jumps = rng.uniform(-0.3, 0.3, (steps // 40 + 1, 2))[np.arange(steps) // 40]
    return 0.5 * np.column_stack([np.cos(turn), np.sin(turn)]) + jumps


def started(method):
    return method.init(torch.zeros(3).double())


def stepped(method, state, reading_mv, torque, following):
    u = torch.from_numpy(np.concatenate([reading_mv, torque, following]))
    return method.step(state, u, 0.0)


def bend_mm(estimate):
    return estimate.diagnostics["bend_mm"].numpy()


class TestLimits:
    def test_without_lag_and_command_it_is_the_filter_of_table_2_to_the_bit(self):
        g, bend_map = np.random.default_rng(0), linear_map()
        still = segment(across=np.zeros((2, 3)))
        ours, plain = LoopFilter(bend_map, still, follows=False), BendFilter(bend_map)
        a, b = started(ours), started(plain)
        for torque in commands(60, g):
            u = bend_map(g.uniform(-4.0, 4.0, (1, 2)))[0]
            (a, one), (b, two) = stepped(ours, a, u, torque, torque), plain.step(b, torch.from_numpy(u), 0.0)
            for name in ("states", "moments", "log_weights", "mean_mm", "covariance_mm2", "weights"):
                assert np.array_equal(getattr(a.members[0].bank, name), getattr(b.members[0].bank, name))
            assert torch.equal(one.q, two.q)
            assert torch.equal(one.covariance, two.covariance)

    def test_command_alone_is_the_step_response(self):
        method = CommandAlone(linear_map(), segment())
        state, torque = started(method), np.array([0.5, -0.2])
        for _ in range(16):
            state, estimate = stepped(method, state, np.zeros(3), torque, torque)
        expected = 7.0 * torque * (1.0 - np.exp(-16 / 40.0 / 0.2))
        np.testing.assert_allclose(bend_mm(estimate), expected, rtol=1e-12)

    def test_readings_as_expected_leave_the_bend_where_the_command_says(self):
        """A rest of nothing: the filter stays at f(s), with readings that have the lag in them."""
        bend_map, known, g = linear_map(), segment(), np.random.default_rng(1)
        ours = LoopFilter(bend_map, known, follows=True, rest_mm=1e-6)
        alone = CommandAlone(bend_map, known)
        state, command = started(ours), started(alone)
        for torque in commands(200, g):
            command, expected = stepped(alone, command, np.zeros(3), torque, torque)
            x, s = bend_mm(expected)[None], command.members[0][None]
            lag = known.lag_mv(s, (torque - s[0])[None] / known.lag_s, x)
            state, estimate = stepped(ours, state, (bend_map(x) + lag)[0], torque, torque)
        np.testing.assert_allclose(bend_mm(estimate), x[0], atol=0.02)

    def test_members_of_a_batch_have_commands_of_their_own(self):
        ours, bend_map, g = (
            LoopFilter(linear_map(), segment(), follows=True),
            linear_map(),
            np.random.default_rng(2),
        )
        rows = np.stack(
            [np.column_stack([bend_map(2 * s), s, s]) for s in (commands(9, g), commands(9, g))], 1
        )
        both = track(ours, torch.from_numpy(rows), torch.zeros(2, 3).double())
        for k in range(2):
            alone = track(ours, torch.from_numpy(rows[:, k]), torch.zeros(3).double())
            torch.testing.assert_close(both.q[:, k], alone.q, rtol=0, atol=0)
        assert not torch.equal(both.q[:, 0], both.q[:, 1])


class TestOwnModel:
    @pytest.mark.parametrize("share", [0.0, 0.3])
    def test_covariance_is_right_on_data_of_its_own_model(self, share):
        """NEES of the bend, two degrees of freedom, over 15 runs; the error of a lag fades as the filter has it."""
        bend_map, known, g = linear_map(), segment(share=share), np.random.default_rng(3)
        ours, dt, biases = LoopFilter(bend_map, known, follows=True), 1.0 / 40.0, OursConfig().biases()
        kept, slow = np.exp(-dt / known.apart_s), np.exp(-dt / bend_map.error_s)
        faded = np.exp(-dt / known.lag_s)
        prior = np.exp(-0.5 * (biases / 4.0) ** 2)
        squares = []
        for _ in range(15):
            c = g.choice(biases, p=prior / prior.sum())
            rest, error = 0.5 * g.standard_normal(2), 0.5 * g.standard_normal(3)
            alone, state = CommandAlone(bend_map, known), started(ours)
            command, size = started(alone), np.zeros(3)
            sent = commands(81, g)
            for tick, (torque, following) in enumerate(pairwise(sent)):
                command, expected = stepped(alone, command, np.zeros(3), torque, torque)
                rest = kept * rest + 0.5 * np.sqrt(1 - kept**2) * g.standard_normal(2)
                error = slow * error + 0.5 * np.sqrt(1 - slow**2) * g.standard_normal(3)
                x, s = bend_mm(expected) + rest, command.members[0][None]
                lag = known.lag_mv(s, (torque - s[0])[None] / known.lag_s, x[None])[0]
                ahead = known.lag_mv(s, (following - s[0])[None] / known.lag_s, x[None])[0]
                size = np.maximum(np.maximum(np.abs(lag), np.abs(ahead)), faded * size)
                noise = np.hypot(0.6, share * size) * g.standard_normal(3)
                u = bend_map(x[None])[0] + lag + c + error + noise
                state, estimate = stepped(ours, state, u, torque, following)
                if tick >= 40:
                    apart = bend_mm(estimate) - x
                    squares.append(apart @ np.linalg.solve(state.members[0].bank.covariance_mm2, apart))
        assert 1.5 < np.mean(squares) < 2.6

    def test_a_command_that_takes_effect_early_is_no_bend(self):
        """The reading at which a jump is sent has a part of its lag already; without a warning it is all bend."""
        bend_map, known = linear_map(), segment(share=0.3)
        ours, alone = LoopFilter(bend_map, known, follows=True), CommandAlone(bend_map, known)
        before, jump = np.array([0.5, 0.0]), np.array([-0.2, 0.4])
        state, command = started(ours), started(alone)
        for _ in range(80):
            command, expected = stepped(alone, command, np.zeros(3), before, before)
            state, _ = stepped(ours, state, bend_map(bend_mm(expected)[None])[0], before, before)
        x, s = bend_mm(expected), command.members[0][None]
        early = 0.25 * known.lag_mv(s, (jump - s[0])[None] / known.lag_s, x[None])[0]
        reading = bend_map(x[None])[0] + early
        told, surprised = (
            bend_mm(stepped(ours, state, reading, before, following)[1]) for following in (jump, before)
        )
        assert np.linalg.norm(surprised - x) > 0.5
        assert np.linalg.norm(told - x) < 0.1 * np.linalg.norm(surprised - x)

    def test_knowing_the_lag_and_the_command_helps_on_such_data(self):
        bend_map, known, g = linear_map(), segment(), np.random.default_rng(4)
        methods = [
            LoopFilter(bend_map, segment(across=np.zeros((2, 3))), follows=False),
            LoopFilter(bend_map, known, follows=False),
            LoopFilter(bend_map, known, follows=True),
        ]
        states, alone = [started(m) for m in methods], CommandAlone(bend_map, known)
        command, squares = started(alone), np.zeros(3)
        for torque in commands(400, g):
            command, expected = stepped(alone, command, np.zeros(3), torque, torque)
            x, s = bend_mm(expected), command.members[0][None]
            lag = known.lag_mv(s, (torque - s[0])[None] / known.lag_s, x[None])[0]
            u = bend_map(x[None])[0] + lag + 0.6 * g.standard_normal(3)
            found = [stepped(m, state, u, torque, torque) for m, state in zip(methods, states, strict=True)]
            states = [state for state, _ in found]
            squares += [((bend_mm(estimate) - x) ** 2).sum() for _, estimate in found]
        assert squares[2] < 0.5 * squares[1] < 0.25 * squares[0]


class TestIdentification:
    def made(self) -> Commanded:
        """A recording by the model itself, without noise."""
        time_s = np.arange(13_000) / 100.0
        torque_nm = experiment_torque(time_s - 5.0, TWIN.chambers, seed=0)
        torque = TWIN.chambers.bending_torque(TWIN.chambers.pressures(torque_nm))
        frames, known = np.arange(4000), segment()
        empty = Recording("made", frames, np.zeros((4000, 3)), np.zeros((4000, 3)))
        part = Commanded(empty, 6.0, time_s, torque)
        s, rate = part.lagged(known.lag_s)
        bend = known.bend_mm(s)
        q = 1e-3 * np.column_stack([bend, np.zeros(4000)])
        u = linear_map()(bend) + known.lag_mv(s, rate, bend) + 0.7
        return replace(part, recording=Recording("made", frames, q, u))

    def test_numbers_of_the_model_are_found(self):
        found, known = identify(linear_map(), self.made(), None, np.zeros(2)), segment()
        assert found.lag_s == known.lag_s
        assert found.centre == known.centre
        np.testing.assert_allclose(found.static, known.static, atol=1e-8)
        np.testing.assert_allclose(found.across, ACROSS, atol=1e-8)
        assert found.share < 1e-6
        assert found.apart_mm < 1e-8
        np.testing.assert_allclose(found.error_mv, 0.5)  # never below that of the map

    def test_a_jump_is_followed_as_a_first_order_lag_does(self):
        part = replace(self.made(), torque=np.tile([0.0, 0.4], (13_000, 1)), start_s=0.0)
        s, rate = part.lagged(0.2)
        gone = np.exp(-(part.recording.time_s + 0.01) / 0.2)  # the first sample is already one step on
        np.testing.assert_allclose(s[::2, 1], 0.4 * (1 - gone[::2]), atol=1e-12)
        np.testing.assert_allclose(rate[::2, 1], 2.0 * gone[::2], atol=1e-11)
        assert not s[:, 0].any()

    def test_static_map_and_its_inverse_have_one_degree(self):
        assert monomials(np.ones((1, 2)), STATIC_DEGREE).shape[1] == len(segment().static)


class TestExperiment:
    def test_torques_stay_in_their_disc_and_end(self):
        time_s = np.arange(-100, 13_000) / 100.0
        torque = experiment_torque(time_s, TWIN.chambers, seed=5) / TWIN.chambers.reference_nm
        size = np.linalg.norm(torque, axis=1)
        assert 0.8 * REACH < size.max() <= REACH + 1e-12
        assert not size[time_s < 0].any()
        assert not size[time_s >= SWEEP_S + JUMPS_S].any()
        pressures = TWIN.chambers.pressures(torque * TWIN.chambers.reference_nm)
        assert pressures.min() >= 0.0
        assert pressures.max() <= TWIN.chambers.peak_mbar

    def test_jumps_are_held_as_long_as_they_say(self):
        time_s = np.arange(6000, 12_000) / 100.0
        torque = experiment_torque(time_s, TWIN.chambers, seed=5)
        at = np.flatnonzero(np.abs(np.diff(torque, axis=0)).max(axis=1) > 0)
        held = np.diff(at) / 100.0
        assert held.min() > HELD_S[0] - 0.02
        assert held.max() < HELD_S[1] + 0.02

    def test_sequence_is_one_sided_towards_its_bend(self):
        """A torque that bends towards +x is the first component, turned."""
        chambers = TWIN.chambers
        pressures = chambers.pressures(chambers.reference_nm * np.array([[0.0, 0.5], [-0.25, 0.0]]))
        np.testing.assert_allclose(chambers.bending_torque(pressures), [[0.5, 0.0], [0.0, 0.25]], atol=1e-12)


class TestTwin:
    def test_t5_does_not_tell_the_lag_and_the_experiment_does(self):
        table = lag_by_recording().set_index("recording")
        assert table.loc["T5.train", "own_%"] < 10.0
        assert table.loc["T5.train", "turning_mm/s"] < 0.05 * table.loc["experiment", "turning_mm/s"]
        other = table.loc["second experiment"]
        assert other["own_%"] > 90.0
        assert other["left_with_lag_mV"] < 0.4 * other["left_mV"]

    def test_lag_of_the_segment_is_near_that_of_the_twin(self):
        """Hysteresis is another delay: the time found is a little longer."""
        found = learn(TWIN).segment.lag_s
        assert TWIN.bending.lag_s <= found < 1.2 * TWIN.bending.lag_s

    def test_estimators_in_a_loop(self):
        gains = CONTROLLERS["PI"]
        runs = [Run("raised cosine", gains, SESSIONS[1], 1000, e) for e in ESTIMATORS]
        known = learn(TWIN)
        trace = run_loops(TWIN, known, runs, duration_s=5.05)
        again = run_loops(TWIN, known, runs[2:3], duration_s=5.05)
        np.testing.assert_allclose(again.bend_mm[:, 0], trace.bend_mm[:, 2], atol=1e-9)
        assert len(np.unique(trace.fed_back_mm[-1, :, 0])) == 4
        other = run_loops(TWIN, known, [replace(runs[3], seed=7)], duration_s=5.05)
        np.testing.assert_allclose(other.bend_mm[:, 0], trace.bend_mm[:, 3], atol=1e-9)  # no reading enters


@cache
def errors() -> pd.DataFrame:
    """Two rows for each of two estimators, by hand."""
    base = {
        "controller": "PI",
        "session": SESSIONS[1],
        "reference": "step",
        "estimate_mm": 0.2,
        "offset_mm": 0.1,
    }
    rows = [
        base | {"estimator": e, "seed": k, "tracking_mm": w * (1 + 0.1 * k), "tracking_truth_mm": 2.0}
        for e, w in (("readings", 6.0), ("lag and command", 2.0))
        for k in range(2)
    ]
    return pd.DataFrame(rows)


class TestTables:
    def test_ratios_by_estimator_by_hand(self):
        table = tracking_ratios(errors(), "estimator", draws=100)
        assert table.columns[0] == "estimator"
        np.testing.assert_allclose(table["ratio"], [3.15, 1.05])
        assert table["met"].tolist() == [False, True]

    def test_estimators_stand_beside_each_other(self):
        wide = ratio_of_estimators(tracking_ratios(errors(), "estimator", draws=100))
        assert wide.columns.tolist()[-2:] == ["readings", "lag and command"]
        np.testing.assert_allclose(wide.iloc[0, -2:].astype(float), [3.15, 1.05])
        assert wide.loc[0, "truth_mm"] == 2.0

    def test_worst_by_twin(self):
        others = pd.concat(
            [errors(), errors().assign(reference="circle", tracking_mm=2.4)], ignore_index=True
        )
        table = ratio_ranges(errors().iloc[:0].assign(rig=""), others.assign(twin=7))
        assert table["rig"].tolist() == ["random twin 7"] * 2
        np.testing.assert_allclose(table["smallest"], [1.2, 1.05])
        np.testing.assert_allclose(table["largest"], [3.15, 1.2])
        assert table["met"].tolist() == [1, 2]
        assert table["references"].tolist() == [2, 2]

    def test_rigs_stand_below_each_other(self):
        table = ratio_ranges(errors().assign(rig="softer"), errors().assign(twin=7))
        assert table["rig"].tolist() == ["softer", "softer", "random twin 7", "random twin 7"]
