from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.sensing import Recording
from surctl.marine.sensing.replay import read_readings, replay_readings, sonar_array
from tests.sensing.recording import HEADER, recorded, write

ROWS = recorded(10.0)


def read(tmp_path: Path, rows: list[str], *, header: str = HEADER, sensors: int = 4, scale: float = 1.0) -> Recording:
    return read_readings(write(tmp_path, rows, header=header), sonar_array(sensors), scale=scale)


@pytest.mark.parametrize("jitter", [0.0, 0.005, 0.009])
def test_each_reading_has_its_own_step_at_an_even_pace(tmp_path: Path, jitter: float) -> None:
    found = read(tmp_path, sorted(recorded(60.0, jitter=jitter)))
    r = found.readings
    assert found.cycle == pytest.approx(0.1, rel=2e-3) and r.dt == pytest.approx(0.05, rel=2e-3)
    assert found.crowded == 0 and int(r.fresh.sum()) == 2400
    for sensor in range(4):
        assert set(np.diff(np.flatnonzero(r.fresh[:, sensor]))) == {2}


def test_times_of_steps_are_those_of_their_rows(tmp_path: Path) -> None:
    found = read(tmp_path, ROWS)
    stamps = np.array([float(row.split(",")[0]) for row in ROWS])
    step, sensor = np.nonzero(found.readings.fresh)
    assert np.abs(found.readings.time[step] - stamps[found.readings.row[step, sensor]]).max() <= 0.0251
    samples = np.array([[float(c) for c in row.split(",")[2:7]] for row in ROWS])
    assert np.array_equal(found.readings.samples[step, sensor], samples[found.readings.row[step, sensor]])


def test_one_range_a_row_and_slow_sensors(tmp_path: Path) -> None:
    rows = [f"{0.5 * k},0,{2.0 + 0.001 * k}" for k in range(40)]
    found = read(tmp_path, rows, header="time_s,sensor,range_m", sensors=1)
    assert found.readings.samples.shape == (40, 1, 1) and found.readings.dt == pytest.approx(0.5)
    assert "0.5 s; the filter is designed for 0.1 s" in found.notes[-1]
    middling = [f"{0.13 * k},0,2.0" for k in range(40)]
    assert read(tmp_path, middling, header="time_s,sensor,range_m", sensors=1).readings.dt == pytest.approx(0.065)


def test_a_stuck_sensor_of_one_sample_is_not_healthy_and_a_repeated_sample_is_no_fault(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    code = 4.5 / 255
    honest = code * np.round((2.0 + 0.015 * rng.normal(size=300)) / code)

    def share(ranges: np.ndarray, samples: int) -> tuple[float, int, list[str]]:
        rows = [",".join([f"{0.1 * k:g}", "0", *[f"{x:.6f}"] * samples]) for k, x in enumerate(ranges)]
        names = ["range_m"] if samples == 1 else [f"sample_{j + 1}_m" for j in range(samples)]
        found = read(tmp_path, rows, header=",".join(["time_s", "sensor", *names]), sensors=1)
        summary = replay_readings(found.readings).summary(0)
        return summary.healthy_share, summary.refused, found.notes

    said = "the samples of each reading are equal: only one sample is used"
    for samples in (1, 5):
        healthy, refused, notes = share(honest, samples)
        assert healthy > 0.98 and refused <= 3 and (said in notes) == (samples == 5)
        healthy, refused, notes = share(np.full(300, 2.0), samples)
        assert healthy < 0.05 and refused > 285
    then_stuck = np.where(np.arange(300) < 150, honest, 2.2)
    assert 0.4 < share(then_stuck, 1)[0] < 0.6


def test_motion_is_held_until_it_is_told_again(tmp_path: Path) -> None:
    rows = ["0,0,2,0.1,0.5", "0.1,0,2,0.2,0.5", "0.3,0,2,0.3,-0.5", "0.4,0,2,0.4,0", "0.5,0,2,0.5,0"]
    header = "time_s,sensor,range_m,closing_m_per_s,turn_rad_per_s"
    r = read(tmp_path, rows, header=header, sensors=1).readings
    fired = np.flatnonzero(r.fresh[:, 0])
    assert r.closing[fired, 0].tolist() == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert set(r.closing[fired[1] : fired[2], 0]) == {0.2} and set(r.turn[fired[1] : fired[2]]) == {0.5}


def test_rows_that_cannot_be_used_are_skipped_and_counted(tmp_path: Path) -> None:
    rows = list(ROWS)
    rows.insert(40, "100.5,0,nan,2,2,2,2,0,0")
    rows.insert(60, "101.0,,2,2,2,2,2,0,0")
    rows.insert(90, "100.1,0,2,2,2,2,2,0,0")  # an earlier time
    rows.insert(200, rows[199])  # the same row again
    rows.insert(300, rows[300])
    found = read(tmp_path, rows)
    assert (found.incomplete, found.back, found.rows) == (2, 1, 405)
    assert found.crowded == 2 and found.beyond == 0
    beyond = [f"{0.1 * k},0,9" for k in range(20)]
    got = read(tmp_path, beyond, header="time_s,sensor,range_m")
    assert got.beyond == 20 and got.readings.samples.max() == 4.5
    assert any("maximum" in note for note in got.notes)


def test_readings_are_divided_by_the_scale(tmp_path: Path) -> None:
    one, other = read(tmp_path, ROWS), read(tmp_path, ROWS, scale=1.02)
    heard = one.readings.fresh
    assert other.readings.samples[heard] == pytest.approx(one.readings.samples[heard] / 1.02)


PLAIN = "time_s,sensor,range_m"
REFUSED = {
    "no time": (["0,2"], "sensor,range_m", "'time_s' is missing"),
    "no sensor": (["0,2"], "time_s,range_m", "'sensor' is missing"),
    "no range": (["0,0,2"], "time_s,sensor,range", "'range_m' is missing; did you mean 'range'"),
    "centimetres": (["0,0,2"], "time_s,sensor,range_cm", "'range_m' is missing; did you mean 'range_cm'"),
    "a hole in the samples": (["0,0,2,2"], "time_s,sensor,sample_1_m,sample_3_m", "'sample_2_m' is missing"),
    "both": (["0,0,2,2"], "time_s,sensor,sample_1_m,range_m", "range_m and sample_1_m"),
    "unknown sensor": (["0,0,2", "0.1,4,2"], PLAIN, r"log\.csv:3: sensor = 4\.0: no such sensor; give 0 to 3"),
    "half a sensor": (["0,0.5,2"], PLAIN, r"log\.csv:2: sensor = 0\.5"),
    "a sensor's name": (["0,front,2"], PLAIN, r"log\.csv:2: sensor = 'front': is not a number"),
    "negative": (["0,0,2", "0.1,0,-1"], PLAIN, r"log\.csv:3: range_m = -1\.0: is below 0"),
    "text": (["0,0,2", "0.1,0,no echo"], PLAIN, r"log\.csv:3: range_m = 'no echo'"),
    "one row": (["0,0,2"], PLAIN, "two different times"),
    "one time": (["0,0,2"] * 10, PLAIN, "two different times"),
    "milliseconds": ([f"{100 * k},0,2" for k in range(9)], PLAIN, "100 s apart; give seconds"),
    "microseconds apart": ([f"{k * 1e-6},0,2" for k in range(9)], PLAIN, "1e-06 s apart"),
    "all NaN": (["nan,0,2"] * 9, PLAIN, "no complete row"),
    "backwards": (
        [f"{-0.1 * k},0,2" for k in range(90)],
        PLAIN,
        r"log\.csv:3: time_s = -0\.1: time goes back in 89 of 90",
    ),
    "one time far ahead": (
        ["0,0,2", "0.1,0,2", "1e9,0,2", *(f"{0.1 * k},0,2" for k in range(2, 60))],
        PLAIN,
        r"log\.csv:5: .*time goes back in 58",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_files_are_refused(tmp_path: Path, case: str) -> None:
    rows, header, words = REFUSED[case]
    with pytest.raises(InputError, match=words):
        read(tmp_path, rows, header=header)


def test_a_recording_of_sparse_readings_that_takes_too_many_steps_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("surctl.marine.sensing.replay._MOST_STEPS", 1000)
    rows = [f"{4.0 * (k // 40) + 0.1 * (k % 40)},0,2" for k in range(1000)]
    with pytest.raises(InputError, match=r"more than 1000 steps of 0\.05 s; split"):
        read(tmp_path, rows, header=PLAIN)
