"""Sentences that pages make of tables, by hand: which of several is named, and which number stands where."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from repro_companion.papers import (
    baaij,
    emulated,
    failure,
    loop,
    martin,
    martin_capture,
    martin_files,
    mitchell,
    mitchell_files,
    mitchell_takes,
    others,
    table_2,
    toronto,
    wandering,
)

LOOPS = pd.DataFrame({
    "estimator": [loop.ALONE, loop.FILTER, loop.INFORMED, "truth", "truth, one sample late"] * 4,
    "session": np.repeat([*loop.ARMS] * 2, 5), "controller": np.repeat([*loop.CONTROLLERS], 10),
    "tracking_mm": [4.0, 2, 3, 1, 1, 4.4, 5, 4.3, 1, 1, 6, 8, 7, 5, 5.5, 9, 6, 8, 5, 5.5],
})  # fmt: skip
NOISES = pd.DataFrame({
    "session": np.repeat([*loop.ARMS], 2), "noise_mt": [0.02, 0.001] * 2, loop.ALONE: [9, 4.0, 9, 5],
    loop.FILTER: [9, 2, 9, 8.0], loop.INFORMED: [9, 2.5, 9, 3],
})  # fmt: skip
ROBOTS = {
    "eflesh": {"x_rms_mm": 0.4, "a_covered_percent": 99.0},
    "hall_joint": {"cycle_1_sample_rms_deg": 3.0, "a_covered_percent": 84.0},
    "toronto": {
        "slow_free_space_rms_mm": 5.0,
        "slow_free_space_source_filter_mm": 6.0,
        "impulse_1_rms_mm": 13.26,
        "impulse_1_source_filter_mm": 12.0,
        "a_covered_percent": 95.0,
    },
}
SOUND = {
    x: ROBOTS[x] | {"a_covered_percent": 91.0, "cycle_1_sample_rms_deg": 1.0}
    for x in ("eflesh", "hall_joint")
}
CHIPS = pd.DataFrame(
    [
        [4, "none", 0.5, 0.6, 0, np.nan, np.nan, np.nan], [4, emulated.SILENT, 1, 2, 0, np.nan, np.nan, np.nan],
        [4, "reads zero", 3, 2, 98, 0.2, 2, 1.8], [4, "stuck", 2, 2, 94, 0.5, 23, 1.7],
        [2, emulated.SILENT, 62, 50, 0, np.nan, np.nan, np.nan], [2, "stuck", 50, 49, 85, 1, 90, 5],
    ],
    columns=["sensors", "failure", "error", "std", "named", "late_s", "before_mm", "before_std_mm"],
)  # fmt: skip
RANGES = pd.DataFrame({"step": ["published", "half"] * 2, "chaotic": [True, False, True, True]})
RIG = pd.DataFrame({"row": table_2.row_name("T3"), "unit": ["%", "mV", "mV"], "error": [1.0, 7.5, 8.5]})
ALARMS = pd.DataFrame({
    "scenario": ["stuck", "drift 2 uT/s", "magnet near", "magnet near", "an hour without a fault", "stuck"],
    "robot": ["two_segments"] * 5 + ["four_chips"],
    "estimator": ["kalman", "levenberg_marquardt"] * 2 + ["kalman"] * 2, "alarm_soon": [999, 98, 0, 0, 0, 0],
    "large": [1000, 100, 100, 100, 1, 100], "first_right": [90, 97, 0, 0, 0, 0], "some": [100, 100, 7, 0, 0, 100],
    "ended": [100, 100, 0, 0, 0, 0], "trials": [100, 100, 20, 20, 1, 100], "alarms": [5, 5, 5, 5, 2, 9],
    "wrong": [1, 1, 80, 90, 0, 1], "unseen": [1, 1, 30, 40, 0, 1], "readings": 100,
})  # fmt: skip
GAIN = pd.DataFrame({"ratio": [0.5, 0.1], "ratio_low": [0.4, 0.05], "ratio_high": [0.6, 0.2]})
CLOUDS = pd.DataFrame({
    "unknowns": [3, 6, 9], "effective": [50.0, 4.0, 2.0], "1000": [1.0, 7.0, 9.0], "least squares": [0.1, 0.2, 0.3],
})  # fmt: skip
RIGID = pd.DataFrame({
    "model": "rigid", "evaluation": [martin.SAME_POINT, martin.SAME_POINT, martin.DESCRIBED, martin.DESCRIBED],
    "n_imus": 8, "marker": ["M1", "M2"] * 2, "median_mm": 1e3 * np.array(martin.MARKERS * 2) * [0.1, 0.2, 0.3, 0.4],
})  # fmt: skip
FLOORS = pd.DataFrame({
    "given": ["tip", "tip", "tip", "bodies"], "model": ["one arc", "one arc", "two arcs", "one arc"],
    "error_mm": [0.1 * 1e3 * toronto.LENGTH, 0.2 * 1e3 * toronto.LENGTH, 3.0, 1.0],
})  # fmt: skip
HITS = pd.Series({
    (name, setting, who): 10.0 * k + 100 * (setting == "raw") + 5 * (who == "smoother")
    for k, name in enumerate(toronto.SAME, 1)
    for setting in ("raw", "calibrated") for who in ("smoother", "released window")
})  # fmt: skip
SLOWS = pd.Series(
    {(toronto.CHOOSING, "raw", "smoother"): 3.0, (toronto.CHOOSING, "raw", "released window"): 4.0}
)
ATTEMPTS = pd.DataFrame(
    [[False, 3, 3, 1, 0], [True, 2, 3, 1, 7]], columns=["frozen", *mitchell_files.BULB, "light_-1"]
)
ROWS_OF_TABLE_1 = pd.DataFrame({
    "row": ["n_b=1", "n_b=2", "n_b=3", "n_s=9", "n_b=3"], "quantity": ["e_u"] * 4 + ["delta_x"], "weak": "false",
    "verdict": "reproduced", "published": ["0.015", "0.012", "0.02", "0.012", "1"],
    "regenerated": ["0.0156", "0.0124", "0.011", "0.3", "9"],
})  # fmt: skip
RATIOS = pd.DataFrame({"cells": [9, 1], "below": [8, 1], "ratio": [2.0, 0.5]})
PRINT = pd.DataFrame([
    ["length [mm]", "9 ± 1", "1 ± 1", "differs"], ["a [%]", "5.4 ± 0.3", "5.1 ± 0.2", "reproduced"],
    ["b [%]", "4.0 ± 1.0", "4.2", "weak (reproduced)"], ["c [%]", "7 ± 2", "6 ± 3", "reproduced"],
], columns=["error of", "published", "regenerated", "verdict"])  # fmt: skip
BOTH = pd.DataFrame({
    "chain": ["first", "second", "third", martin.BEST], "ours_median_m1_mm": 8.0, "ours_q3_m2_mm": 9.0,
    "authors_median_m2_mm": 7.0, "ours_median_m2_mm": [1.0, 2.0, 3.0, 0.456],
})  # fmt: skip
GAINS = pd.DataFrame({
    "mode": ["all"] * 4 + ["buckling", "all"], "point": ["markers"] * 5 + ["tip"], "draws": [6, 7, 6, 6, 99, 99],
    "method": [martin.BASELINE, martin.BEST, "exact arcs + frame", "other", martin.BEST, martin.BEST],
    "median_mm": [20.0, 0.5, 10.0, 70.0, 80.0, 90.0],
})  # fmt: skip
FAILED = pd.DataFrame(
    [
        (member, run, part, quantity, error + 50 * (part == "before"))
        for member, run, errors in ((0, "all sensors", (1, 2, 3)), (0, "failure", (2, 5, 3)),
                                    (1, "all sensors", (1, 4, 3)), (1, "failure", (1, 4, 3)))
        for quantity, error in zip(("delta_x_1", "delta_y_1", "delta_L_1"), errors, strict=True)
        for part in ("before", "after")
    ],
    columns=["member", "run", "part", "quantity", "error_percent"],
)  # fmt: skip
COSTS = pd.DataFrame({
    "after_percent": [2.5, 3.5], "all_sensors_percent": [1.5, 2.5], "before_percent": 9.0,
    "authors_before_percent": 8.0, "authors_after_percent": [4.0, 3.8],
})  # fmt: skip
# Against *z* the paper's filter has the same error in the first take only: half a degree is not the same.
TAKES = pd.DataFrame({
    "take": ["a", "b", "c"] * 4, "length_mm": [13] * 9 + [15] * 3,
    "method": np.repeat([mitchell_takes.COMPARED[i][0] for i in (1, 0, 2, 0)], 3),
    "calibration": np.repeat([mitchell_takes.COMPARED[i][1] for i in (1, 0, 2, 0)], 3),
    "name": np.repeat(["not calibrated", "filter", "calibrated", "filter, 15 mm"], 3),
    "rmse_deg": [70.0] * 3 + [10, 4, 6] + [1, 2, 3] + [80] * 3,
    "rmse_tilt_z_deg": [70.0] * 3 + [9.6, 4.5, 2] + [7, 8, 9] + [81] * 3,
})  # fmt: skip
MARKERS = pd.DataFrame({
    "undone_above_40_percent": [62, 30, 31], "off_displacement_deg": [0.5, 0.2, 9], "undone": [1000, 200, 34],
    "frames": [5000, 4000, 1000],
})  # fmt: skip
TRACKERS = pd.DataFrame({
    "setting": ["raw"] * 2 + ["calibrated"] * 4, "tracker": ["tip"] * 4 + ["base"] * 2,
    "part": ["position_mm", "rotation_deg"] * 3, "rms": [9.0, 9, 1.2, 0.8, 9, 9],
})  # fmt: skip
# Per estimator: raw and calibrated, two trials each; inflated is better once, and the same once.
CHOICE = pd.DataFrame({
    "model": np.repeat(["white", "inflated", "estimated"], 8), "estimator": (["smoother"] * 4 + ["filter"] * 4) * 3,
    "setting": (["raw"] * 2 + ["calibrated"] * 2) * 6, "trial": ["hit", "shaken"] * 12,
    "rmse_mm": [5.0, 5, 5, 5, 9, 9, 9, 9, 6, 4, 5, 6, 1, 1, 1, 1, *[0.0] * 8],
})  # fmt: skip
SLOW = pd.Series({"white": 5.0, "inflated": 7.0, "estimated": 6.0})
OFF = pd.Series({
    (trial, setting, estimator): mm + 100 * (setting == "raw") + 200 * (estimator == "filter")
    for trial, mm in zip((toronto.CHOOSING, *toronto.SAME), (3.0, 5.0, 7.6), strict=True)
    for setting in ("raw", "calibrated") for estimator in ("filter", "smoother")
}).rename_axis(["trial", "setting", "estimator"])  # fmt: skip
BANDS = pd.DataFrame({
    "model": ["white"] * 4 + ["inflated"], "ellipsoids": ["as stated", "widened"] * 2 + ["widened"],
    "trial": [toronto.CHOOSING] * 2 + ["hit"] * 3, "positions": [100, 100, 300, 300, 900],
    "covered_percent": [10, 90, 30, 80, 1], "shortest_mm": [0.2, 5.0, 0.4, 8.0, 0.001],
    "longest_mm": [4.0, 30.0, 3.0, 20.0, 900.0],
})  # fmt: skip


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        # One of four estimators loses least by its ratio, and another one tracks best; order by the high gain.
        (lambda: loop.softer_in_words(LOOPS),
         "least squares loses least: its tracking error grows from 4.00 to 4.40 mm, but the Kalman filter with "
         "command tracks best (4.30 mm)."),
        (lambda: loop.in_words(NOISES),
         "sensors, 0.001 mT (the first row), the bend is then 2.50 mm off its reference, "
         "against 4.00 mm with least squares"),
        (lambda: loop.in_words(NOISES), "if the arm bends a fifth further (8.0 mm)"),
        (lambda: others.in_short({x: others.Found({"cases": ["a"]}, own, {}) for x, own in ROBOTS.items()}),
         "The public names were enough for all robots. Where a source states an error of the same task, "
         "ours is smaller for eFlesh, and larger for the Hall joint. On the continuum robot our filter has a smaller "
         "error than the source's in the slow trial, on which we chose its noise. In the other trial, when the arm "
         "is hit, we have 13.3 mm against 12.0 mm. Do not"),
        (lambda: others.in_short({x: others.Found({"cases": ["a"]}, own, {}) for x, own in SOUND.items()}),
         "evaluations, 2 cover between 85 and 95 %, none less and none more"),
        (lambda: others.in_short({x: others.Found({"cases": ["a"]}, own, {}) for x, own in ROBOTS.items()}),
         "In 3 evaluations, 1 covers between 85 and 95 %, 1 less and 1 more, and the worst covers 84 %."),
        (lambda: others.in_short({x: others.Found({"cases": ["a"]}, ROBOTS[x], {}) for x in [*ROBOTS][:2]}),
         "and larger for the Hall joint. Do not trust"),
        (lambda: table_2.why_lost(RANGES, RIG, lambda q: np.zeros((len(q), 3)), 1.0),
         "decides 2 of the 2 errors of the bend at the published step, and 1 at half of it"),
        (lambda: failure.alarms_in_words(ALARMS), "(for the drift within five) in at least 98 % of the trials"),
        (lambda: failure.alarms_in_words(ALARMS), "the right one in at least 90 % of the trials"),
        (lambda: failure.alarms_in_words(ALARMS), "One second after the fault the alarm had ended in all trials."),
        (lambda: failure.alarms_in_words(ALARMS), "had an alarm in 2 readings."),
        (lambda: failure.alarms_in_words(ALARMS),
         "The tip is off in 80 to 90 % of the readings, in 30 to 40 % without an alarm. The Kalman filter then "
         "blames a sensor in 7 of 20 trials, and least squares in none."),
        (lambda: baaij.affine_gain_in_words(GAIN, 9), "a factor of 10 compared with nominal"),
        (lambda: baaij.affine_gain_in_words(GAIN, 9), "(95 % interval over 9 robots: 5 to 20)"),
        (lambda: emulated.cases_in_words(pd.DataFrame({"median": [14.6, 0.123, 0.456]}), 32, [2.0, 4.56]),
         "a tip error of 15 mm. After a calibration in 32 exact poses the error is 0.12 mm; in poses known to 1 mm, "
         "as you may have them, 2.0 to 4.6 mm."),
        (lambda: emulated.failures_in_words(CHIPS),
         "from 0.50 to at most 3.0 mm. But the monitor takes 0.5 s to name the chip (*stuck*), and until then the "
         "error reaches 23 mm at a stated ± of 1.7 mm. If one of two chips fails, the rest does "
         "not determine the shape: the median error grows to 62 mm at most, and a median ± of 49 mm or "
         "more says so. The monitor names a chip that goes on sending in 85 to 98 % of the time."),
        (lambda: emulated.failures_in_words(CHIPS.assign(before_mm=np.nan)), "at most 3.0 mm. If one of two chips"),
        (lambda: mitchell.segments_in_words(CLOUDS), "worth at most 4.0 particles. Its tip error is 7.0 to 9.0 mm,"),
        (lambda: mitchell.segments_in_words(CLOUDS), "the error of least squares is 0.20 to 0.30 mm."),
        (lambda: mitchell_takes.bulb_in_words(ATTEMPTS, False), "finds 2, 3, 1 events, and 7 in the trial run."),
        (lambda: mitchell_takes.bulb_in_words(ATTEMPTS, False), "it finds these in 1 of 2 settings."),
        (lambda: mitchell.segments_in_words(CLOUDS.assign(effective=[50.0, 1.49, 1.0])), "worth a single one. Its"),
        (lambda: mitchell.segments_in_words(CLOUDS.assign(effective=[1.0, 1.51, 1.0])), "at most 1.5 particles"),
        (lambda: martin.below_table_ii(RIGID),
         "With the rigid links of the text the medians are 30.0 % (M1) and 40.0 % (M2)."),
        (lambda: martin_files.tables_in_words(pd.DataFrame({
            "source": "recorded", "largest_um": [0.5, 1.0, 1.1], "half_turns": [3, 0, 4]})),
         "2 of 3 tables follow to a micrometre in every point of every row. We left out 4 rows"),
        (lambda: toronto.floors_in_words(FLOORS), "or 10 to 20 % of its length, although it knows where the tip is."),
        (lambda: toronto.raw_in_words(HITS.combine_first(SLOWS)),
         "On raw readings our smoother is worse than the authors' own sliding window when the arm is hit (115 mm "
         "against 110 mm), and better in the slow trial, on which we chose its settings (3 mm against 4 mm)."),
        (lambda: wandering.of_columns(pd.DataFrame({"method": ["fused"], "nees": [16.0]})),
         "16 means errors about 4 times as large as stated"),
        # Rounded as in print only the first of three is larger; n_s=9 is a row printed again.
        (lambda: baaij.in_words(ROWS_OF_TABLE_1, RATIOS),
         "**0.50 times the published ones** in the geometric mean. Those of the readings are larger than published "
         "in 1 of 3 rows."),
        (lambda: baaij.affine_agreement(PRINT),
         "Our errors agree with the published ones. For b the agreement says little, because an error of zero would "
         "agree, too."),
        # A weak number that differs is said once, and not to agree.
        (lambda: baaij.affine_agreement(PRINT.replace({
            "weak (reproduced)": "weak (differs)", "reproduced": "weak (reproduced)"})),
         "Our errors agree with the published ones, except for b. For a and c the agreement says little"),
        (lambda: baaij.affine_agreement(PRINT.iloc[1:].assign(verdict="better")),
         "None of our errors agrees with the published ones."),
        (lambda: martin_capture.both_ways_in_words(SimpleNamespace(sensors=(0, 1, "the tables")), BOTH),
         "orientations are those of the tables. Aligned, the median error at M2 is 2.00 mm with the chain of "
         "`pcc2.csv`, and 0.46 mm with exact arcs"),
        (lambda: martin.calibration_in_words(GAINS, 30, True),
         "Over both markers and 7 synthetic draws the median error falls from 20 mm to 0.50 mm, with 30 parameters: "
         "six of the frame, and three of each of the 8 IMUs between base and M2. The frame alone brings it to 10 mm. "
         "Our synthetic sensors err"),
        (lambda: martin.calibration_in_words(GAINS, 30, False), "the authors' trial. *Not calibrated* has no frame"),
        (lambda: failure.cost_in_words(FAILED, COSTS),
         "**Our 2 trainings cannot tell whether the failure costs accuracy.** The mean error is 3.0 % with the "
         "failure and 2.0 % without it, and it grows with 1 of our 2 networks. On average it changes by +0.7 "
         "percentage points, with a standard error of 0.7; we speak of a loss only beyond three standard errors. "
         "The bend in y suffers most, from 3.0 to 4.5 %. The networks that the authors released have 3.9 %"),
        # The means change by 4/3 and 1, so by 7/6 with a standard error of 1/6.
        (lambda: failure.cost_in_words(FAILED.assign(error_percent=FAILED["error_percent"] + 3 * (
            (FAILED["member"] == 1) & (FAILED["run"] == "failure") & (FAILED["quantity"] == "delta_x_1"))), COSTS),
         "**The failure costs accuracy.** The mean error is 3.0 % with the failure and 2.0 % without it, and it "
         "grows with 2 of our 2 networks. On average it changes by +1.2 percentage points, with a standard error of "
         "0.2; we speak of a loss only"),
        (lambda: failure.cost_in_words(FAILED[FAILED["member"] == 0], COSTS.assign(all_sensors_percent=3.04)),
         "**One training cannot tell whether the failure costs accuracy.** The mean error is 3.0 % with and without "
         "the failure, and it grows with 1 of our 1 network. The bend in y suffers most, from 2.0 to 5.0 %."),
        (lambda: mitchell_takes.errors_in_words(TAKES),
         "**Which method is closer to motion capture depends on what we call the bend.** If it is the tilt of the "
         "body's *y* axis, the ratios, calibrated on other recordings, have an error of 2.0°, and the paper's filter "
         "with the released settings has 6.0°. If it is the tilt of *z*, as in the released code, the ratios, "
         "still calibrated on *y*, have "
         "8.0° and the filter has 4.5°."),
        (lambda: mitchell_takes.errors_in_words(TAKES),
         "With an arc of 15 mm the filter comes to 80° for *y* and 81° for *z* without any calibration; we explain "
         "below why. All these are medians over 3 of the 12 recorded takes."),
        (lambda: mitchell_takes.errors_in_words(TAKES),
         "In 1 of the takes the choice hardly matters to the filter. There the ratios have an error of 1.0° and the "
         "filter 10°."),
        (lambda: mitchell_takes.errors_in_words(TAKES[TAKES["take"] != "a"]),
         "which favours our ratios.\n```"),
        (lambda: mitchell_takes.errors_in_words(TAKES.replace({"rmse_tilt_z_deg": {4.5: 8.5, 2: 9}})),
         "**Against either tilt of the body the ratios came closer to motion capture.** If it is"),
        (lambda: mitchell_takes.exchanged_in_words(MARKERS),
         "In 1,234 of 10,000 frames markers were exchanged, and we turned the body back. In 2 takes this"),
        (lambda: mitchell_takes.exchanged_in_words(MARKERS),
         "It is, within 0.5° (root mean square, median over the takes)."),
        (lambda: toronto.choice_in_words(TRACKERS, SLOW, CHOICE),
         "tip's tracker is wrong by 1.2 mm and 0.8° along and about each axis. The slow trial chooses *white* with "
         "5.0 mm, and *inflated* has 7.0 mm and *estimated* has 6.0 mm. By our smoother alone, "
         "*inflated* would be better than *white* in 1 of 4 cases (raw or calibrated, by trial)."),
        (lambda: toronto.choice_in_words(TRACKERS, SLOW - [0, 0, 3], CHOICE),
         "The slow trial chooses *estimated* with 3.0 mm, and *white* has 5.0 mm and *inflated* has 7.0 mm. By"),
        (lambda: toronto.sure_in_words(OFF, BANDS, "white", 0.9),
         "off by 3 mm along the arm in the slow trial, on which we chose its settings, and by 5 to 8 mm in the others"
         ". The ellipsoids of filter and smoother should cover 90 % of the positions. In the other trials they cover "
         "30 % as stated, with semi-axes of 0.4 to 3 mm. If we widen them until they cover 90 % in the slow trial, "
         "they cover 80 % in the others, with semi-axes of 8 to 20 mm."),
    ],
)  # fmt: skip
def test_a_sentence_says_what_its_table_has(sentence, words):
    assert words in sentence()
