from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from surctl.marine.report import plot_sonar_replay
from surctl.marine.report.sonar_plots import plot_replay_sensor
from surctl.marine.sensing import Replay
from surctl.marine.sensing.replay import read_readings, replay_readings, sonar_array
from tests.pictures import rendered
from tests.sensing.recording import recorded, write


def replayed(folder: Path, rows: list[str], *, header: str = "", sensors: int = 4) -> Replay:
    path = write(folder, rows, header=header) if header else write(folder, rows)
    return replay_readings(read_readings(path, sonar_array(sensors)).readings)


def later(rows: list[str], by: float) -> list[str]:
    return [",".join([f"{float(r.split(',')[0]) + by:.6f}", *r.split(",")[1:]]) for r in rows]


PLAIN = "time_s,sensor,range_m"


def test_recordings_are_drawn_without_a_warning(tmp_path: Path) -> None:
    twice = replayed(tmp_path, recorded(0.5) + later(recorded(0.5), 1e4))
    rendered(plot_sonar_replay(twice, title="$\\frac{$ 潜水"))
    rendered(plot_sonar_replay(replayed(tmp_path, ["0,0,2", "0.1,0,2"], header=PLAIN, sensors=1)))
    rendered(
        plot_sonar_replay(replayed(tmp_path, [f"{0.1 * k},{k % 5},0" for k in range(10)], header=PLAIN, sensors=5))
    )


def test_a_panel_holds_samples_range_and_bound(tmp_path: Path) -> None:
    found = replayed(tmp_path, recorded(5.0))
    ax = plot_replay_sensor(found, 1)
    lines = {line.get_label(): line for line in ax.get_lines()}
    fired = found.readings.fresh[:, 1]
    assert lines["raw sample"].get_ydata() == pytest.approx(found.readings.samples[fired, 1].ravel())
    assert lines["filtered range"].get_ydata() == pytest.approx(found.tracked.range[:, 1])
    band = next(c for c in ax.collections if c.get_label() == "promised bound").get_paths()[0].vertices
    at = found.readings.time[-1]
    wanted = [found.tracked.range[-1, 1] + s * found.tracked.bound[-1, 1] for s in (-1, 1)]
    assert sorted(set(np.round(band[np.isclose(band[:, 0], at)][:, 1], 9))) == pytest.approx(wanted, abs=1e-8)


def test_no_line_spans_a_silence(tmp_path: Path) -> None:
    found = replayed(tmp_path, recorded(3.0) + later(recorded(3.0), 1e3))
    line = next(v for v in plot_replay_sensor(found, 0).get_lines() if v.get_label() == "filtered range")
    at, value = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    wide = np.flatnonzero(np.diff(at) > 1.0)
    assert len(wide) == 1
    assert np.isnan(value[wide[0]]) or np.isnan(value[wide[0] + 1])


def test_one_panel_a_sensor_and_one_file(tmp_path: Path) -> None:
    found = replayed(tmp_path, [row for row in recorded(3.0) if row.split(",")[1] != "2"])
    assert len(plot_sonar_replay(found).axes) == 3
