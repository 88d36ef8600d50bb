"""Recorded sonar readings from a CSV file, and filtered ranges as CSV text."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.sensing.replay.pacing import on_steps, usual_cycle
from surctl.marine.sensing.replay.tracked import Readings, Replay
from surctl.marine.sensing.sonar.array import SonarArray
from surctl.recorded import Recorded, read_recorded

__all__ = ["Recording", "filtered_rows", "read_readings", "sonar_array"]

_CYCLE = SonarArray().cycle_limit  # s

Array = NDArray[np.float64]
_BACK = 0.05  # share of lines whose time may go back
_MOTION = ("closing_m_per_s", "turn_rad_per_s")


@dataclass(frozen=True, kw_only=True)
class Recording:
    """The readings of a recording, and how many lines of its file were skipped or changed.

    Attributes:
        readings: the readings, each assigned to a step of the tracker.
        name: printable name of the file.
        rows: number of data lines in the file.
        incomplete: number of lines skipped because a number is missing, NaN or infinite.
        back: number of lines skipped because their time is before the time of an earlier line.
        crowded: number of lines skipped because a later reading of the same sensor is assigned to the same step.
        beyond: number of lines with a sample above the sensor's maximum; the maximum replaces this sample.
        cycle: usual time from one reading of a sensor to its next reading [s].
        still: names of the columns for the robot's motion that the file does not contain; the replay uses 0 for these
            motions.
        single: whether the samples of every reading are equal to each other; then only one sample per reading is used.
    """

    readings: Readings
    name: str
    rows: int
    incomplete: int
    back: int
    crowded: int
    beyond: int
    cycle: float
    still: tuple[str, ...]
    single: bool

    @property
    def notes(self) -> list[str]:
        """Notes for the user on skipped and changed lines of the file, one sentence per note."""
        counts = (
            (self.incomplete, "rows skipped because a number is missing, NaN or infinite"),
            (self.back, "rows skipped because time goes back"),
            (self.crowded, "rows skipped because a later reading of the same sensor is in the same step"),
            (self.beyond, "rows with a sample beyond the sensor's maximum, which was limited to the maximum"),
            (len(self.readings.first) - 1, "gaps of all sensors after which the filter was restarted"),
        )
        said = [f"{text}: {count}" for count, text in counts if count]
        said += [f"no column {name}: taken as 0" for name in self.still]
        if self.single:
            said.append("the samples of each reading are equal: only one sample is used")
        if not _CYCLE / 2 <= self.cycle <= 1.5 * _CYCLE:
            said.append(f"each sensor reads every {self.cycle:.3g} s; the filter is designed for {_CYCLE:g} s")
        return said


def sonar_array(sensors: int, **numbers: float | int) -> SonarArray:
    """Return an array of evenly spaced sensors that fire one after another; `numbers` are attributes of `SonarArray`.

    Example:
        >>> from surctl.marine.sensing import sonar_array
        >>> array = sonar_array(6, maximum=3.0)
        >>> [round(angle, 3) for angle in array.azimuths], round(array.firing_period, 4), array.maximum
        ([0.0, 1.047, 2.094, 3.142, 4.189, 5.236], 0.0167, 3.0)
    """
    return replace(
        SonarArray(
            azimuths=tuple(2.0 * pi * i / sensors for i in range(sensors)),
            order=tuple(range(sensors)),
            firing_period=_CYCLE / sensors,
        ),
        **numbers,  # type: ignore[arg-type]
    )


def read_readings(path: Path, array: SonarArray, *, scale: float = 1.0) -> Recording:
    """Read a recording of sonar readings from a CSV file.

    The file has the columns `time_s`, `sensor` (0-based), and `sample_1_m`, `sample_2_m`, … or one column `range_m`.
    Optional columns are `closing_m_per_s` (velocity of the robot along the sensor's beam) and `turn_rad_per_s` (yaw
    rate). The step is half the usual time between two readings of a sensor; each reading is assigned to the nearest
    step. Lines with a missing, NaN or infinite number, and lines whose time goes back, are skipped and counted.

    Args:
        path: the file.
        array: the sonar array; the file replaces its `samples` and `firing_period`.
        scale: scale factor of the sensor; the readings are divided by this factor.

    Raises:
        InputError: if `read_recorded` raises InputError, a column is missing, a sensor does not exist, a sample is
            below 0, time goes back in more than 5 % of the lines, there are too few lines, or the cycle time is
            impossible.

    Example:
        >>> from pathlib import Path
        >>> import numpy as np
        >>> from surctl.marine.sensing import read_readings, sonar_array
        >>> k = np.arange(40)
        >>> rows = np.column_stack((0.1 * k, 0 * k, 2.0 - 0.01 * k))
        >>> np.savetxt("log.csv", rows, delimiter=",", header="time_s,sensor,range_m", comments="")
        >>> recording = read_readings(Path("log.csv"), sonar_array(1))
        >>> recording.rows, round(recording.cycle, 3), recording.notes
        (40, 0.1, ['no column closing_m_per_s: taken as 0', 'no column turn_rad_per_s: taken as 0'])
    """
    table = read_recorded(path)
    sample_columns = _sample_columns(table)
    table.need(["time_s", "sensor", *sample_columns])
    motion = [name for name in _MOTION if name in table.columns]
    columns = {name: table.numbers(name) for name in ("time_s", "sensor", *sample_columns, *motion)}
    good = np.flatnonzero(np.isfinite(np.stack(list(columns.values()))).all(axis=0))
    incomplete = len(table.lines) - len(good)
    good, back = _forward(table, columns["time_s"], good)
    sensor = _sensors(table, columns["sensor"], good, array)
    samples = np.stack([columns[name][good] for name in sample_columns], axis=1)
    low = np.argwhere(samples < 0)
    if len(low):
        row, column = low[0]
        raise InputError(
            "is below 0", file=table.at(good[row]), key=sample_columns[column], value=float(samples[row, column]),
            remedy="give a distance, or leave the cell empty if there is no reading",
        )  # fmt: skip
    single = len(sample_columns) > 1 and bool((samples == samples[:, :1]).all())
    if single:  # one value written several times would look like a stuck sensor
        samples = samples[:, :1]
    samples = samples / scale
    beyond = int(np.count_nonzero((samples > array.maximum + array.resolution).any(axis=1)))
    time = columns["time_s"][good]
    cycle = usual_cycle(time, sensor, file=table.name)
    dt = cycle / 2 if cycle <= 1.5 * _CYCLE else cycle  # a reading is due after one or two whole steps
    array = replace(array, samples=samples.shape[1], firing_period=min(cycle, _CYCLE) / array.size)
    step, first, begin = on_steps(time, dt, file=table.name)
    still = tuple(name for name in _MOTION if name not in columns)
    closing, turn = (columns[name][good] if name in columns else np.zeros(len(good)) for name in _MOTION)
    count = int(step[-1]) + 1
    row = np.full((count, array.size), -1)
    row[step, sensor] = np.arange(len(good))  # the last reading of a step remains
    fresh = row >= 0
    stepped = np.zeros((count, array.size, array.samples))
    stepped[fresh] = np.minimum(samples, array.maximum)[row[fresh]]
    segment = np.searchsorted(first, np.arange(count), side="right") - 1
    return Recording(
        readings=Readings(
            time=begin[segment] + dt * (np.arange(count) - first[segment]),
            samples=stepped,
            fresh=fresh,
            row=np.where(fresh, good[row], -1),
            closing=_held(closing, row),
            turn=_held(turn, row.max(axis=1)[:, None])[:, 0],
            first=first,
            array=array,
            dt=dt,
        ),
        name=table.name, rows=len(table.lines), incomplete=incomplete, back=back,
        crowded=len(good) - int(fresh.sum()), beyond=beyond, cycle=cycle, still=still, single=single,
    )  # fmt: skip


def filtered_rows(replayed: Replay) -> str:
    """Return CSV text with a line for each step and each sensor with readings.

    The column `reading_m` is empty if no reading arrived in the step.

    Example:
        >>> from pathlib import Path
        >>> import numpy as np
        >>> from surctl.marine.sensing import filtered_rows, read_readings, replay_readings, sonar_array
        >>> k = np.arange(40)
        >>> rows = np.column_stack((0.1 * k, 0 * k, 2.0 - 0.01 * k))  # closing speed 0.1 m/s
        >>> np.savetxt("log.csv", rows, delimiter=",", header="time_s,sensor,range_m", comments="")
        >>> lines = filtered_rows(replay_readings(read_readings(Path("log.csv"), sonar_array(1)).readings)).splitlines()
        >>> for line in (lines[0], lines[-1]):
        ...     print(line)
        time_s,sensor,reading_m,range_m,bound_m,healthy,age_s
        3.900000,0,1.60890,1.60890,0.05054,1,0.00000
    """
    r = replayed.readings
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("time_s", "sensor", "reading_m", "range_m", "bound_m", "healthy", "age_s"))
    sensors = replayed.sensors
    clock = np.char.mod("%.6f", r.time)
    for begin in range(0, len(r.time), 100_000):
        part = slice(begin, begin + 100_000)
        rows = {i: _text_rows(replayed, part, i) for i in sensors}
        for k, now in enumerate(clock[part].tolist()):
            writer.writerows((now, i, *rows[i][k]) for i in sensors)
    return out.getvalue()


def _text_rows(replayed: Replay, part: slice, sensor: int) -> list[tuple[str, ...]]:
    t, fresh = replayed.tracked, replayed.readings.fresh[part, sensor]
    reading, ranges, bound, age = (np.char.mod("%.5f", v[part, sensor]) for v in (t.reading, t.range, t.bound, t.age))
    cells = (
        np.where(fresh, reading, ""),
        ranges,
        bound,
        np.where(t.healthy[part, sensor], "1", "0"),
        np.where(np.isfinite(t.age[part, sensor]), age, ""),
    )
    return list(zip(*(c.tolist() for c in cells), strict=True))


def _sample_columns(table: Recorded) -> list[str]:
    # `range_m`, or `sample_1_m`, `sample_2_m`, … without gaps in the numbers
    samples = [name for name in table.columns if name.startswith("sample_") and name.endswith("_m")]
    if "range_m" in table.columns:
        if samples:
            raise InputError(f"has range_m and {samples[0]}", file=table.name, remedy="give only one of them")
        return ["range_m"]
    if not samples:
        table.need(["time_s", "sensor", "range_m"])
    return [f"sample_{k}_m" for k in range(1, len(samples) + 1)]


def _forward(table: Recorded, time: Array, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], int]:
    """Return the lines whose time is not before the time of an earlier line, and how many other lines there are."""
    if not len(rows):
        raise InputError("has no complete row", file=table.name, remedy="give a number in every cell of a row")
    before = np.maximum.accumulate(time[rows])
    goes_back = time[rows] < before
    count = int(np.count_nonzero(goes_back))
    if count > _BACK * len(rows):
        first = int(np.argmax(goes_back))
        raise InputError(
            f"time goes back in {count} of {len(rows)} rows", file=table.at(rows[first]), key="time_s",
            value=float(time[rows[first]]), remedy="sort the file by time_s, or correct the wrong time above this line",
        )  # fmt: skip
    return rows[~goes_back], count


def _sensors(table: Recorded, values: Array, rows: NDArray[np.intp], array: SonarArray) -> NDArray[np.int64]:
    sensors = values[rows]
    wrong = np.flatnonzero((sensors != np.floor(sensors)) | (sensors < 0) | (sensors >= array.size))
    if len(wrong):
        raise InputError(
            "no such sensor", file=table.at(rows[wrong[0]]), key="sensor", value=float(sensors[wrong[0]]),
            remedy=f"give 0 to {array.size - 1}, or set the number of sensors with --sensors",
        )  # fmt: skip
    return sensors.astype(np.int64)


def _held(values: Array, row: NDArray[np.int64]) -> Array:
    """Return `values` (rows,) at the indices `row` (steps, n).

    Index −1 repeats the sensor's previous value; before the first value, the result is 0.
    """
    newest = np.maximum.accumulate(row, axis=0)
    held: Array = np.where(newest >= 0, values[np.maximum(newest, 0)], 0.0)
    return held
