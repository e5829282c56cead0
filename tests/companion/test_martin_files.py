"""Martin et al.'s released files: tables, orientations behind them, motion capture, and both evaluations."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from repro import InputError
from repro_companion.papers import martin, martin_capture, martin_files
from repro_companion.run import recordings_folder

from . import trial_files

RECORDINGS = recordings_folder()
RECORDED = (RECORDINGS / "martin2022" / martin_files.TABLES / martin_files.RIGID_FILE).is_file()
OFFSET_MM = np.array([6.0, -12.0, -38.0])
PCC_16 = martin.Case("Fig. 4", "pcc", 8, 16)
PCC_8 = martin.Case("Fig. 4", "pcc", 8, 8)


@pytest.fixture(scope="module")
def trial():
    """Its first 3,400 samples."""
    drawn = martin.draw(martin.motion(), 0)
    return replace(drawn, **{x: getattr(drawn, x)[:3400] for x in ("time_s", "orientations", "points")})


@pytest.fixture(scope="module")
def short(trial):
    """Every tenth sample."""
    parts = {name: getattr(trial, name)[::10] for name in ("time_s", "orientations", "points")}
    return replace(trial, **parts)


@pytest.fixture(scope="module")
def clock_s(trial):
    return trial_files.clock_of(len(trial.time_s)) - trial_files.clock_of(1)[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, trial):
    """The tables of a synthetic trial in the released form."""
    place = tmp_path_factory.mktemp("trial")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("REPRO_DATA_DIR", str(place))
        trial_files.write_tables(trial)
        yield place


@pytest.fixture(scope="module")
def offset_capture(folder, clock_s):
    """What the cameras would see if the chain of pcc2.csv were right but for an offset, in the authors' pairs."""
    table = 1e3 * martin_files.read_table(martin_files.place_of(martin_files.PCC_2))[:, [4, 7]]
    at = np.clip(np.arange(len(clock_s)) - 700 + 54, 0, len(table) - 1)
    return trial_files.as_recorded(table[at] + OFFSET_MM, clock_s)


@pytest.fixture(scope="module")
def recording(offset_capture):
    trial_files.write_capture(offset_capture)
    return martin_capture.recording()


@pytest.fixture
def again(recording):
    """Read the motion capture once more, beside the same tables."""

    def read():
        capture = martin_capture.read_capture(martin_files.place_of(martin_files.CAPTURE))
        return martin_capture.checked(replace(recording, capture=capture))

    return read


@pytest.fixture(scope="module")
def both_ways(recording):
    return martin_capture.both_ways(recording)


# The authors' evaluation


def test_a_known_offset_is_the_error_of_its_model(recording, both_ways):
    errors = martin_capture.authors_errors(recording)
    np.testing.assert_allclose(errors[PCC_16], np.linalg.norm(OFFSET_MM), atol=5e-3)
    assert errors.keys() == martin_capture.TABLES.keys()
    both = martin_capture.both_ways_shown(both_ways).set_index("chain")
    assert list(both.loc["PCC-extended (pcc2.csv)"])[:2] == ["40.30 (40.30)"] * 2


def test_all_other_errors_by_the_recipe_in_pandas(recording):
    """The steps of the authors' notebook as a reader of it would write them, with merges and labels of rows."""
    capture = pd.read_csv(martin_files.place_of(martin_files.CAPTURE))
    mocap = pd.DataFrame({"time_sync": 10 * np.arange(len(capture))})
    for body in "47":
        x, y, z = (capture[f"{axis}{body}"] - capture[f"{axis}base"] for axis in "xyz")
        mocap = mocap.assign(**{f"x{body}": -y, f"y{body}": x, f"z{body}": z - 17.0})
    rigid = pd.read_csv(martin_files.place_of(martin_files.RIGID_FILE))
    since = pd.to_datetime(rigid["time"], format=martin_files.CLOCK)
    rigid["time_sync"] = (((since - since[0]) / pd.Timedelta("10ms")).round() * 10).astype(int)
    mocap = rigid[["time_sync"]].merge(mocap, on="time_sync", how="inner").drop(index=range(700))
    mocap = mocap.reset_index(drop=True)
    for case, (name, shift) in martin_capture.TABLES.items():
        model = pd.read_csv(martin_files.place_of(name)).drop(index=range(shift)).reset_index(drop=True)
        for k, body in enumerate("47"):
            apart = pd.DataFrame({x: mocap[f"{x}{body}"] - 1e3 * model[f".{x}{body}"] for x in "xyz"})
            error = ((apart**2).sum(axis=1, min_count=3) ** 0.5).loc[1000:8000].dropna()
            ours = martin_capture.authors_errors(recording)[case][:, k]
            assert len(ours) == len(error)
            np.testing.assert_allclose(ours, error, atol=1e-3)


def test_shifts_are_those_of_the_recipe():
    """Rows that the authors' notebook drops at the start of each table (cells 10 to 13, 16, 18)."""
    shifts = dict(martin_capture.TABLES.values())
    names = {name.rpartition("/")[2].removesuffix(".csv"): shift for name, shift in shifts.items()}
    pcc = {"pcc1": 53, "pcc2": 54, "pcc4": 54, "pcc6": 56, "pcc8": 56, "pcc16_2": 55, "pcc16_4": 51}
    assert names == pcc | {"less_imu_2": 36, "less_imu_4": 38}
    assert martin_capture.CAPTURE_LATER == 700


def test_the_check_against_the_notebook_holds_to_a_micrometre(recording, monkeypatch):
    assert not martin_capture.own_check(recording)["agree"].any()
    ours = np.percentile(martin_capture.authors_errors(recording)[PCC_8], 75, axis=0)
    for off, agree in ((0.0009, True), (0.0011, False)):
        monkeypatch.setattr(martin_capture, "THIRD_QUARTILES_MM", tuple(ours + off))
        assert martin_capture.own_check(recording)["agree"].tolist() == [agree, agree]
        assert ("They agree" in martin_capture.evaluated_in_words(recording)) == agree


def test_frames_without_markers_are_left_out_and_told(again, offset_capture):
    blind = offset_capture.copy()
    blind[5500:6500, 0] = np.nan  # M1
    path = trial_files.write_capture(blind)
    lines = path.read_text(encoding="utf-8").splitlines()
    del lines[7001:7101]  # a hundred frames
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = again()
    assert found.capture.lost == 1100
    assert "1,100 of " in martin_capture.evaluated_in_words(found)
    errors = martin_capture.authors_errors(found)[PCC_16]
    missing = np.isnan(errors).sum(axis=0)
    assert missing[0] > 2 * missing[1] > 0
    np.testing.assert_allclose(errors[np.isfinite(errors)], np.linalg.norm(OFFSET_MM), atol=5e-3)
    quantiles = martin_capture.marker_errors(found, [PCC_16])["median_mm"]
    assert np.isfinite(quantiles).all()


def test_another_length_and_noise(again, offset_capture):
    noise = np.random.default_rng(0).standard_normal(offset_capture.shape)
    trial_files.write_capture((offset_capture + noise)[:8000])
    found = again()
    errors = martin_capture.authors_errors(found)[PCC_16]
    assert 800 < len(errors) < 1200
    assert np.median(errors) == pytest.approx(np.linalg.norm(OFFSET_MM), abs=0.2)
    radius = martin_capture.hull(found).query("arc_mm >= 360")["radius_mm"]
    np.testing.assert_allclose(
        radius, np.linalg.norm(OFFSET_MM) + 0.67, atol=0.2
    )  # a quarter is above 0.67 mm


def test_rows_of_the_recording_are_comparable(recording, both_ways):
    table = martin_capture.marker_errors(recording, martin.cases((2, 4, 8), (8, 16, 32, 48, 64)))
    rows = martin_capture.scorecard_rows(table, both_ways)
    assert len(rows) == 43
    error = rows["quantity"].isin(["median", "q3"])
    assert error.sum() == rows.loc[error, "comparable"].sum() == 41
    assert rows.loc[rows["quantity"] == "time", ["setting", "comparable"]].values.tolist() == [
        ["benchmark", False]
    ]
    assert rows.loc[error, "setting"].str.startswith(martin_capture.AUTHORS).all()
    keyed = rows.set_index(["artefact", "row", "quantity"])
    own = keyed.loc[("Table II", "M1 PCC-extended", "median")]
    assert own["regenerated"] == pytest.approx(np.linalg.norm(OFFSET_MM) / 3.6, abs=1e-3)
    assert keyed.loc[("Fig. 4", "M1 PCC-extended 16 segments and more", "q3"), "note"].startswith(
        "mean of 16, 32, 48, 64"
    )


def test_numbers_without_a_table_stay_those_of_the_simulation(recording, both_ways):
    lost = "elephant/pcc/pcc4.csv", "elephant/pcc/pcc6.csv"
    fewer = replace(recording, tables={k: v for k, v in recording.tables.items() if k not in lost})
    table = martin_capture.marker_errors(fewer, martin.cases((2, 4, 8), (8, 16, 32, 48, 64)))
    rows = martin_capture.scorecard_rows(table, both_ways)
    other = rows[~rows["comparable"].astype(bool) & (rows["quantity"] != "time")]
    assert other[["artefact", "setting"]].to_numpy().tolist() == [["Fig. 4", "synthetic"]]


# Other forms


def change(path, to):
    path.write_text("\n".join(to(path.read_text(encoding="utf-8").splitlines())) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda lines: [lines[0].replace("x7", "x8"), *lines[1:]], "Input columns of mocap_base_and_2"),
        (lambda lines: [f"time{line}" for line in lines], "Input columns of mocap_base_and_2"),
        (lambda lines: [], "Input file of mocap_base_and_2"),
        (lambda lines: [*lines[:9], lines[9].replace("900.0", "lost"), *lines[10:]], "words in line 10"),
        (lambda lines: lines[::2], "must be one later in each row, without sub-frames: 100 rows a second; instead"),
        (lambda lines: lines[:600], "Input rows of mocap_base_and_2"),
        (lambda lines: lines[:4001], r"Input length of \S+ must be 5\d s or longer; instead received 40 s"),
    ],
)  # fmt: skip
def test_captures_of_another_form_are_refused_in_words(again, offset_capture, damage, message):
    change(trial_files.write_capture(offset_capture), damage)
    with pytest.raises(InputError, match=message):
        again()


def test_metres_are_no_millimetres(again, offset_capture):
    path = trial_files.write_capture(offset_capture)
    table = pd.read_csv(path)
    table.iloc[:, 2:] /= 1e3
    table.rename(columns=lambda name: "" if name.startswith("Unnamed") else name).to_csv(path, index=False)
    with pytest.raises(
        InputError, match="must be in mm, as of an arm of 660 mm; instead received medians of 0"
    ):
        again()


@pytest.mark.parametrize("rate", [50, 200])
def test_another_rate_shows_in_the_heights(again, offset_capture, rate):
    times = np.arange(0, len(offset_capture) - 1, 100 / rate)
    flat = offset_capture.reshape(len(offset_capture), -1).T
    other = np.stack([np.interp(times, np.arange(len(offset_capture)), x) for x in flat], axis=-1)
    trial_files.write_capture(other.reshape(-1, 2, 3))
    with pytest.raises(InputError, match=f"must be 100 rows a second; instead received .* at {rate} Hz"):
        again()


def test_an_unmeasured_place_is_no_recording(folder, offset_capture):
    path = trial_files.write_capture(offset_capture)
    path.rename(path.with_suffix(".aside"))
    assert martin_capture.recording() is None
    assert "missing: the raw quaternions, the motion capture. Not the" in martin_files.files_in_words()
    path.with_suffix(".aside").rename(path)


# Our alignment


def test_clocks_and_frame_are_found_on_the_first_minute_and_judged_on_the_rest(recording, clock_s):
    """The cameras see the chain of the text 12.3 s later, in a turned frame; after 75 s M2 is off by 3, 4, 12 mm."""
    lag_s, made = 12.3, martin.arm("pcc")
    q = recording.orientations
    there = 1e3 * martin.shape(q, made, martin.MARKERS)
    turned = there @ Rotation.from_euler("z", 30, degrees=True).as_matrix().T + np.array([5.0, -9.0, 20.0])
    turned[clock_s[: len(q)] > 75, 1] += [3.0, 4.0, 12.0]
    capture_s = np.arange(0, clock_s[-1] + lag_s, 0.01)
    flat = [np.interp(capture_s - lag_s, clock_s[: len(q)], x) for x in turned.reshape(len(q), -1).T]
    points = 1e-3 * np.stack(flat, axis=-1).reshape(-1, 2, 3)
    found = replace(recording, capture=martin_capture.Capture(points, 0))
    chain = next(c for c in martin_capture.chains() if c.name == "PCC-extended, of the text")
    error = martin_capture.aligned_errors(found.aligned, chain)
    late = found.aligned.time_s - found.aligned.time_s[0] >= 76
    assert np.median(error[-late.sum() :, 0]) < 1.0
    assert np.median(error[-late.sum() :, 1]) == pytest.approx(13.0, abs=0.5)


def test_the_black_arm_passes_through_the_markers(recording):
    rows = recording.as_evaluated
    there = martin_capture.through_markers(rows, 7, np.array([0.0, *martin.MARKERS, 0.64]))
    np.testing.assert_allclose(there[1:3], rows.points[7], atol=1e-12)
    np.testing.assert_allclose(there[0], 0, atol=1e-12)
    around = martin_capture.hull(recording)
    assert list(around["mode"].unique()) == ["low", "middle", "high"]
    np.testing.assert_allclose(
        around.loc[around["arc_mm"] >= 360, "radius_mm"], np.linalg.norm(OFFSET_MM), atol=0.01
    )
    rigid, extended = np.zeros((2, len(rows.points), 3, 3))
    extended[[7, 9], -1, 0], points = [1.0, 2.0], rows.points.copy()
    points[9, 1] = np.nan  # where a marker is lost the models are not compared with the arm
    joints, arm = martin_capture.farthest_apart(recording, replace(rows, points=points), rigid, extended)
    assert joints["PCC-extended"][-1, 0] == 1.0
    np.testing.assert_allclose(arm[[0, 9, 15]], [[0, 0, 0], *rows.points[7, :2]], atol=1e-12)


def quaternion_messages(trial, clock_s):
    """What the eight IMUs sent, one after the other; their y axis is along the arm."""
    raw = Rotation.from_quat(trial.orientations[:, 1:].reshape(-1, 4)) * Rotation.from_euler(
        "x", 90, degrees=True
    )
    x, y, z, w = raw.as_quat().T
    times = (clock_s[:, None] + 1e-3 * np.arange(8)).ravel()
    columns = {"time": trial_files.times_of(times), ".ID": np.tile(range(8), len(clock_s))}
    return pd.DataFrame(columns | {".w": w, ".x": x, ".y": y, ".z": z})


def test_raw_quaternions_are_read_in_the_inferred_form(recording, trial, clock_s):
    path = martin_files.place_of(martin_files.QUATERNIONS)
    path.parent.mkdir(parents=True, exist_ok=True)
    messages = quaternion_messages(replace(trial, orientations=trial.orientations[:1500]), clock_s[:1500])
    messages.loc[40:47, [".w", ".x", ".y", ".z"]] = 0.0  # one round that an IMU did not answer
    sized = messages.copy()  # a twentieth too small or too large is no orientation, and a smaller error one
    sized.loc[80:95, [".w", ".x", ".y", ".z"]] = np.repeat([[0.94, 0, 0, 0], [0, 0, 0, 1.06]], 8, axis=0)
    sized.loc[96:111, [".w", ".x", ".y", ".z"]] *= np.repeat([[0.96], [1.04]], 8, axis=0)
    found = []
    for table in (messages.drop(range(80, 96)), sized):
        table.to_csv(path, index=False)
        found.append(martin_files.read_quaternions(path))
    np.testing.assert_array_equal(found[1][0], found[0][0])
    np.testing.assert_allclose(found[1][1], found[0][1], rtol=0, atol=1e-9)
    messages.iloc[np.r_[0:80, 81, 80, 82 : len(messages)]].to_csv(path, index=False)  # two of them exchanged
    times, q = martin_files.read_quaternions(path)
    own = np.searchsorted(clock_s, times + times[0], side="right") - 1
    off = Rotation.from_quat(q[:, 8]) * Rotation.from_quat(trial.orientations[own, 8]).inv()
    assert np.median(off.magnitude()) < 1e-3
    assert replace(recording).sensors[2] == "the raw quaternions"
    messages.rename(columns={".w": ".q0"}).to_csv(path, index=False)
    with pytest.raises(InputError, match=r"no \.w"):
        martin_files.read_quaternions(path)
    assert (
        replace(recording).sensors[2].startswith("the tables, because the raw quaternions have another form")
    )
    path.unlink()


# The released tables


def test_next_imu_closed_form():
    """Quarter turns about x, from frames that are turned about the arm in different ways."""
    before = trial_files.turned_about([0, 0, 1.0], 0.0, 1.0, 3.0)
    quarter = Rotation.from_rotvec([np.pi / 2, 0, 0])
    after = quarter * Rotation.from_quat(before)
    halfway = (Rotation.from_rotvec([np.pi / 4, 0, 0]) * Rotation.from_quat(before)).apply(martin.UP)
    found = martin_files.next_imu(before, halfway, after.apply(martin.UP))
    np.testing.assert_allclose((Rotation.from_quat(found) * after.inv()).magnitude(), 0, atol=1e-12)


def test_products_are_turns_one_after_the_other():
    a, b = Rotation.random(20, rng=0), Rotation.random(20, rng=1)
    found = Rotation.from_quat(martin.product(a.as_quat(), b.as_quat()))
    np.testing.assert_allclose((found * (a * b).inv()).magnitude(), 0, atol=1e-12)


def test_orientations_follow_from_synthetic_tables(short):
    tables = martin_files.synthetic_tables(short)
    q = martin_files.trial_orientations(tables)
    assert len(q) == len(short.time_s)
    between = Rotation.from_quat(q.reshape(-1, 4)).inv() * Rotation.from_quat(
        short.orientations.reshape(-1, 4)
    )
    off = np.degrees(between.magnitude()).reshape(-1, 9)
    assert np.median(off) < 1e-3
    files = martin_files.compared(tables, q, "synthetic")
    assert list(files["later"]) == [0] + [martin_files.LATER] * 9
    assert set(files.loc[files["largest_um"] > 1, "file"]) <= {f"fly/pcc16/pcc16_{n}.csv" for n in (2, 4)}
    assert files["median_um"].max() < 0.1


@pytest.mark.parametrize(
    ("name", "change", "at_least_um"),
    [
        (martin_files.PCC_2, {"interpolation": "midpoints"}, 1e3),
        (martin_files.PCC_1, {"base_turn": (0.0, 0.0, 0.0, 1.0)}, 1e3),
    ],
)
def test_other_settings_do_not_give_the_tables(short, monkeypatch, name, change, at_least_um):
    tables = martin_files.synthetic_tables(short)
    q, chains = martin_files.trial_orientations(tables), martin_files.released_chains()
    chains[name] = chains[name]._replace(arm=replace(chains[name].arm, **change))
    monkeypatch.setattr(martin_files, "released_chains", lambda: chains)
    files = martin_files.compared({name: tables[name]}, q, "synthetic")
    assert files["median_um"].item() > at_least_um


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda table: table.drop(columns=".y7"), r"must be time, .ID_0 … .z7; instead received no .y7"),
        (lambda table: table[:999], "Input rows of rigid.csv must be 1000 or more; instead received 999"),
        (lambda table: table.assign(**{".z7": 1e3 * table[".z7"]}), "Input points of rigid.csv must be in metres"),
        (lambda table: table.assign(**{".x4": ["?", *table[".x4"][1:]]}), "be numbers; instead .* none in line 2"),
        (lambda table: table.assign(time=table["time"].str[:10]), "Input time of rigid.csv must be yyyy/mm/dd/HH"),
    ],
)  # fmt: skip
def test_tables_of_another_form_are_refused_in_words(folder, damage, message, tmp_path, monkeypatch):
    table = pd.read_csv(martin_files.place_of(martin_files.RIGID_FILE))
    monkeypatch.setenv("REPRO_DATA_DIR", str(tmp_path))
    path = martin_files.place_of(martin_files.RIGID_FILE)
    path.parent.mkdir(parents=True)
    damage(table).to_csv(path, index=False)
    assert martin_files.unlike_released() == [f"{martin_files.TABLES}/{martin_files.RIGID_FILE}"]
    with pytest.raises(InputError, match=message):
        [martin_files.read_table(path), martin_files.read_clock(path)]


def test_a_last_line_that_was_not_written_to_its_end_is_left_out(folder, tmp_path):
    path = martin_files.place_of(martin_files.RIGID_FILE)
    cut = tmp_path / path.name
    cut.write_text(path.read_text(encoding="utf-8")[:-200], encoding="utf-8")
    whole = martin_files.read_table(path)
    np.testing.assert_array_equal(martin_files.read_table(cut), whole[:-1])


@pytest.mark.skipif(not RECORDED, reason="the authors' files are not here")
def test_released_tables_to_a_micrometre(monkeypatch):
    monkeypatch.setenv("REPRO_DATA_DIR", str(RECORDINGS))
    tables = martin_files.recorded_tables()
    q = martin_files.trial_orientations(tables)
    assert len(q) == 8515
    files = martin_files.compared(tables, q, "recorded").set_index("file")
    other = files.drop([name for name in files.index if "pcc16" in name])
    assert other["largest_um"].max() <= 1
    assert other["half_turns"].max() == 3
    assert files.loc[martin_files.PCC_16_2, "largest_um"] < 11
    assert files.loc[martin_files.PCC_16_2, "same_percent"] > 99.5
    # Nothing was said of the sensor's steps of 2^-14; the orientations of IMU #1 are on them.
    own = martin.product(q[:, 1], np.array([1, 0, 0, 1]) / 2**0.5)  # its y axis points along the arm
    closest = np.full(len(own), np.inf)
    for size in 2**14 + np.arange(-3.0, 3.01, 0.1):
        whole = np.round(own * size)
        whole /= np.linalg.norm(whole, axis=-1, keepdims=True)
        closest = np.minimum(closest, np.linalg.norm(whole - own, axis=-1))
    assert closest.max() < 3e-7


def test_points_that_a_model_did_not_give_are_left_out(folder):
    points = martin_files.read_table(martin_files.place_of(martin_files.PCC_16_2))
    assert np.isfinite(points).all(axis=-1).all(axis=0).tolist() == [k in (0, 4, 7) for k in range(8)]
