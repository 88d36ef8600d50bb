from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from surctl.ir import on_vectors
from surctl.marine.sensing import RangeTracker, Replay, Tracked, track
from surctl.marine.sensing import replay as replaying
from surctl.marine.sensing.ranging.tracker import Ranging
from surctl.marine.sensing.replay import filtered_rows, read_readings, replay_readings, sonar_array
from tests.sensing.recording import ARRAY, recorded, truth, write
from tests.sensing.test_ranging import compiled


def run(tmp_path: Path, rows: list[str]) -> Replay:
    return replay_readings(read_readings(write(tmp_path, rows), sonar_array(4, bias=ARRAY.bias)).readings)


def stepped(
    tracker: RangeTracker, samples: np.ndarray, fresh: np.ndarray, closing: np.ndarray, turn: np.ndarray
) -> Tracked:
    """The tracker, one step after another."""
    function, layout = compiled(tracker)
    step, state, found = on_vectors(function), layout.pack(), []
    expected = np.full(tracker.array.size, 2 * tracker.array.maximum)
    for k in range(len(samples)):
        state, *told = step(state, samples[k], fresh[k], closing[k], expected, turn[k])
        now = dict(zip(Ranging._fields[1:], told, strict=True))
        age = np.where(now["age"] >= 1e6, np.nan, now["age"])
        found.append((now["reading"], now["range"], now["bound"], now["healthy"] > 0.5, age, now["accepted"] > 0.5))
    reading, ranges, bound, healthy, age, accepted = (np.array(v) for v in zip(*found, strict=True))
    return Tracked(reading=reading, range=ranges, bound=bound, healthy=healthy, age=age, accepted=accepted)


@pytest.mark.parametrize("chunk", [1000, 7])
def test_a_replay_is_the_tracker_step_by_step(chunk: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replaying, "_CHUNK", chunk)
    rng = np.random.default_rng(0)
    tracker, steps = RangeTracker(), 60
    samples = np.clip(
        2.0 + 0.3 * rng.standard_normal((steps, 4, 1)) + 0.02 * rng.standard_normal((steps, 4, 5)), 0, 4.5
    )
    samples[rng.uniform(size=(steps, 4)) < 0.1] = 4.5
    fresh = rng.uniform(size=(steps, 4)) < 0.6
    closing, turn = 0.2 * rng.standard_normal((steps, 4)), 0.1 * rng.standard_normal(steps)
    got = track(tracker, samples, fresh=fresh, closing=closing, turn=turn)
    wanted = stepped(tracker, samples, fresh, closing, turn)
    for name in ("reading", "range", "bound", "healthy", "age", "accepted"):
        assert getattr(got, name).shape == (steps, 4)
        assert getattr(got, name) == pytest.approx(getattr(wanted, name), abs=1e-12, nan_ok=True), name
    assert 0 < got.accepted.sum() < fresh.sum()


def test_the_bound_holds_the_truth_and_healthy_is_the_rule(tmp_path: Path) -> None:
    found = run(tmp_path, recorded(15.0))
    r, t = found.readings, found.tracked
    assert r.dt == pytest.approx(0.05, rel=1e-3) and found.sensors == [0, 1, 2, 3]
    for sensor in range(4):
        true = np.array([truth(sensor, time - 100.0) for time in r.time])
        late = t.age[:, sensor] < np.inf
        off = np.abs(t.range[late, sensor] - true[late])
        assert np.all(off <= t.bound[late, sensor] + 0.01)  # what is seen half a step early or late
        assert t.healthy[20:, sensor].mean() > 0.95
        assert np.median(t.bound[20:, sensor]) < 0.06
        assert np.sqrt(np.mean((t.range[20:, sensor] - true[20:]) ** 2)) < 0.02


def test_motion_that_is_not_told_is_taken_for_none(tmp_path: Path) -> None:
    rows = [row.rsplit(",", 2)[0] for row in recorded(10.0)]
    header = "time_s,sensor,sample_1_m,sample_2_m,sample_3_m,sample_4_m,sample_5_m"
    found = read_readings(write(tmp_path, rows, header=header), sonar_array(4))
    assert found.still == ("closing_m_per_s", "turn_rad_per_s")
    assert not found.readings.closing.any() and not found.readings.turn.any()
    without, with_motion = replay_readings(found.readings), run(tmp_path, recorded(10.0))
    assert not np.array_equal(without.tracked.range, with_motion.tracked.range)


def test_summary_counts_gaps_and_refusals(tmp_path: Path) -> None:
    rows = [
        row for row in recorded(20.0) if not (row.split(",")[1] == "1" and 105.0 <= float(row.split(",")[0]) < 107.0)
    ]
    for k, row in enumerate(rows):
        cells = row.split(",")
        if cells[1] == "3" and 110.0 < float(cells[0]) < 110.55:
            rows[k] = ",".join([*cells[:2], *["0"] * 5, *cells[7:]])
    found = run(tmp_path, rows)
    clean, silent, zero = (found.summary(sensor) for sensor in (0, 1, 3))
    assert clean.gaps == 0 and clean.longest_gap_s == 0.0 and clean.healthy_share > 0.97
    assert silent.gaps == 1 and silent.longest_gap_s == pytest.approx(2.1, abs=0.06)
    assert silent.readings == 180 and silent.healthy_share == pytest.approx(0.9, abs=0.03)
    assert zero.refused - clean.refused >= 5 and zero.gaps == 0
    assert zero.median_bound_m < 0.06


def test_after_a_silence_the_filter_starts_anew(tmp_path: Path) -> None:
    late = [",".join([f"{float(r.split(',')[0]) + 1e6:.6f}", *r.split(",")[1:]]) for r in recorded(3.0, seed=1)]
    both = run(tmp_path, recorded(3.0) + late)
    alone = run(tmp_path, late)
    assert len(both.readings.first) == 2 and len(both.readings.time) < 140
    tail = slice(int(both.readings.first[1]), None)
    assert both.tracked.range[tail] == pytest.approx(alone.tracked.range, abs=2e-3)
    assert both.readings.time[tail] == pytest.approx(alone.readings.time, abs=0.01)
    assert np.all(np.diff(both.readings.time) > 0)


def test_rows_out_are_the_steps_and_sensors(tmp_path: Path) -> None:
    found = run(tmp_path, [row for row in recorded(3.0) if row.split(",")[1] in "01"])
    rows = list(csv.DictReader(filtered_rows(found).splitlines()))
    assert len(rows) == 2 * len(found.readings.time) and {r["sensor"] for r in rows} == {"0", "1"}
    heard = [r for r in rows if r["reading_m"]]
    assert len(heard) == found.readings.fresh.sum() == 60
    last = rows[-2]
    assert float(last["range_m"]) == pytest.approx(found.tracked.range[-1, 0], abs=1e-5)
    assert float(last["bound_m"]) == pytest.approx(found.tracked.bound[-1, 0], abs=1e-5)
    assert last["healthy"] == str(int(found.tracked.healthy[-1, 0]))
    assert rows[0]["age_s"] == "" and float(last["age_s"]) == pytest.approx(found.tracked.age[-1, 0], abs=1e-5)
