"""The filter of the rig leaves a bend that it has lost, says where it is in doubt, and else does what it did."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from twin_of_the_rig import recorded

from edition1.estimation.consistency import WINDOW, Status
from edition1_companion.recordings.rig_robot import RIG_RATE_HZ
from edition1_companion.twins.rig_bank import BendBank
from edition1_companion.twins.rig_filter import LASTING, filtered
from edition1_companion.twins.rig_map import BendMap, fit_map
from edition1_companion.twins.rig_twins import random_twin


@cache
def lost_rig():
    """SYNTHETIC rig on which false bends explain the readings well enough to be kept for seconds."""
    return recorded(("T1", "T3", "T5"), random_twin(9))


@dataclass(frozen=True)
class Run:
    """What the filter finds on a recording."""

    q: np.ndarray
    status: np.ndarray
    anew: np.ndarray


def watched(bend_map: BendMap, u: np.ndarray) -> Run:
    found = filtered(bend_map, u)
    return Run(found.q.numpy(), *(found.diagnostics[name].numpy() for name in ("status", "anew")))


def bends_mm(bend_map: BendMap, u: np.ndarray) -> np.ndarray:
    """Bend, reading by reading, where nothing watches."""
    bank, found = BendBank(bend_map), []
    state = bank.start()
    for reading in u:
        state = bank.step(state, reading)
        found.append(state.mean_mm[:2])
    return np.array(found)


def apart_mm(bend_mm: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.hypot(*(bend_mm - 1e3 * truth[:, :2]).T)


def test_a_wrong_start_is_left_within_a_second_and_is_kept_where_nothing_watches():
    train, tests = lost_rig()
    bend_map, part = fit_map(train), tests["T1"]
    u, truth = part.u[:240].copy(), part.q[:240]
    u[0] = bend_map(np.array([[3.63, -6.43]]))[0]  # of a bend that is 4.5 mm off
    run = watched(bend_map, u)
    alone = bends_mm(bend_map, u)
    assert apart_mm(alone, truth)[4:].min() > 8.0
    found = apart_mm(1e3 * run.q[:, :2], truth)
    first = int(np.argmax(run.anew > 0))
    assert LASTING - 1 <= first < 40
    assert np.array_equal(run.q[:first, :2], 1e-3 * alone[:first])
    assert found[first:].max() < 1.0
    # It says so: at the new start, and for as long as a monitor calls one new.
    assert (run.status[first : first + WINDOW] == Status.SUSPICIOUS).all()
    assert (run.status[first + WINDOW :] == Status.CONSISTENT).all()
    assert (run.anew[first:] == 1).all()


def test_a_bend_that_fast_motion_loses_is_found_again_from_past_readings_alone():
    train, tests = lost_rig()
    bend_map, part = fit_map(train), tests["T3"]
    run, alone = watched(bend_map, part.u), bends_mm(bend_map, part.u)
    assert run.anew[-1] >= 1
    lost = (apart_mm(1e3 * run.q[:, :2], part.q) > 5).mean(), (apart_mm(alone, part.q) > 5).mean()
    assert lost[0] < 0.1 < 0.4 < lost[1]
    first = int(np.argmax(run.anew > 0))
    half = watched(bend_map, part.u[: first + 100])
    for name in ("status", "anew"):
        assert np.array_equal(getattr(half, name), getattr(run, name)[: first + 100])
    np.testing.assert_allclose(half.q, run.q[: first + 100], rtol=0, atol=1e-12)


def test_where_no_start_explains_the_readings_it_goes_on_and_says_so():
    """One sensor is 60 mV off, six times the widest bias, and no bend makes up for it."""
    train, tests = lost_rig()
    bend_map, part = fit_map(train), tests["T5"]
    u = part.u[:400].copy()
    u[200:, 1] += 60.0
    run = watched(bend_map, u)
    assert (run.status[:200] == Status.CONSISTENT).all()
    assert (run.status[200 + LASTING - 1 :] == Status.SUSPICIOUS).mean() > 0.9
    assert (run.anew == 0).all()
    np.testing.assert_allclose(1e3 * run.q[:, :2], bends_mm(bend_map, u), rtol=0, atol=1e-12)


def test_on_the_twin_of_the_page_it_is_never_started_anew():
    train, tests = recorded()
    bend_map = fit_map(train)
    for name, part in tests.items():
        run = watched(bend_map, part.u[: round(15 * RIG_RATE_HZ)])
        assert (run.status == Status.CONSISTENT).all(), name
        assert (run.anew == 0).all(), name
