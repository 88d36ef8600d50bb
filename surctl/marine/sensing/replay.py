"""Replay of a sonar recording through the tracker: lines skipped, gaps, time steps, and filtered ranges as CSV.

The function `track` evaluates the tracker's CasADi expressions, so the results are the numbers that the exported law
computes.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, fields, replace
from math import pi
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import Layout
from surctl.marine.sensing.ranging.tracker import RangeTracker
from surctl.marine.sensing.sonar.array import SonarArray
from surctl.recorded import Recorded, read_recorded

Array = NDArray[np.float64]
_SILENCE = 5.0  # s, at least; after a longer gap of all sensors a new segment begins
_SLOWEST, _FASTEST = 10.0, 1e-3  # s, from one reading of a sensor to its next
_SURE = 20  # longest gap, in readings, whose number of missing readings is certain
_MOST_STEPS = 5_000_000


def _usual_cycle(time: Array, sensor: NDArray[np.int64], *, file: str) -> float:
    """Return the usual time between two successive readings of a sensor [s].

    Times are (rows,) [s], ascending, and `sensor` (rows,) is the index of each reading's sensor.
    """
    waits = np.concatenate([np.diff(time[sensor == i]) for i in np.unique(sensor)])
    waits = waits[waits > 0]
    if not len(waits):
        raise InputError("no sensor has readings at two different times", file=file, remedy="give a longer recording")
    cycle = _pace(time, sensor, float(np.median(waits)))
    if not _FASTEST <= cycle <= _SLOWEST:
        raise InputError(
            f"a sensor's readings are {cycle:.3g} s apart", file=file, key="time_s",
            remedy=f"give seconds; the filter needs readings {_FASTEST:g} to {_SLOWEST:g} s apart",
        )  # fmt: skip
    return cycle


def _pace(time: Array, sensor: NDArray[np.int64], median: float) -> float:
    """Return the mean time between two readings of a sensor [s].

    This time is the slope of a line fitted to the times of the readings over their number, which averages out jitter.

    A gap with an unknown number of missing readings ends a series of readings; each series has its own start time in
    the fit.
    """
    over, under = 0.0, 0.0
    for i in np.unique(sensor):
        own = time[sensor == i]
        counts = np.round(np.diff(own) / median)
        for run in np.split(np.arange(len(own)), np.flatnonzero(counts > _SURE) + 1):
            number = np.concatenate([[0.0], np.cumsum(counts[run[:-1]])])
            number -= number.mean()
            over += float(number @ (own[run] - own[run].mean()))
            under += float(number @ number)
    pace = over / under if under > 0 else median
    return pace if 0.5 * median < pace < 2.0 * median else median  # else the intervals are too uneven


def _on_steps(time: Array, dt: float, *, file: str) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return the step of each reading, and the first step and start time [s] of each segment between long gaps.

    The boundaries of the steps of `dt` [s] are placed so that jitter rarely moves a reading into a neighbouring step.
    The first reading of a segment lies in its first step. Too many steps raise `InputError`.
    """
    silence = max(_SILENCE, 20.0 * dt)
    breaks = np.flatnonzero(np.diff(time) > silence) + 1
    step = np.empty(len(time), dtype=np.int64)
    first, begin = [0], []
    shifts = np.arange(20) / 20
    for rows in np.split(np.arange(len(time)), breaks):
        phase = (time[rows] - time[rows[0]]) / dt
        # among possible placements of the steps, choose the one with nearly all readings in the middle of a step
        off = [np.percentile(np.abs((phase[:10_000] + shift) % 1.0 - 0.5), 90) for shift in shifts]
        shift = shifts[int(np.argmin(off))]
        steps = np.floor(phase + shift)
        if steps[-1] + first[-1] > _MOST_STEPS:
            raise InputError(
                f"would take more than {_MOST_STEPS} steps of {dt:.3g} s", file=file, key="time_s",
                remedy="split the recording into shorter files",
            )  # fmt: skip
        step[rows] = first[-1] + steps.astype(np.int64)
        first.append(int(step[rows[-1]]) + 1)
        begin.append(float(time[rows[0]] + (0.5 - shift) * dt))
    return step, np.array(first[:-1]), np.array(begin)


_CHUNK = 1000  # steps per call
_GAP = 1.5  # factor on the due time from one reading to the next; a longer time is a gap


@dataclass(frozen=True, kw_only=True)
class Readings:
    """Raw readings from n sensors with k samples per firing, each assigned to a step of the tracker.

    Attributes:
        time: (steps,) times of the steps [s], ascending.
        samples: (steps, n, k) samples [m]; 0 if no reading arrived.
        fresh: (steps, n) whether a reading arrived since the previous step.
        row: (steps, n) index of the reading's data line in the file; -1 if no reading arrived.
        closing: (steps, n) velocity of the robot along each beam's axis [m/s].
        turn: (steps,) yaw rate of the robot [rad/s].
        first: (segments,) steps at which the tracker restarts: step 0, and the first step after each long gap.
        dt: time from step to step within a segment [s].
    """

    time: Array
    samples: Array
    fresh: NDArray[np.bool_]
    row: NDArray[np.int64]
    closing: Array
    turn: Array
    first: NDArray[np.int64]
    array: SonarArray
    dt: float


@dataclass(frozen=True, kw_only=True)
class Tracked:
    """The outputs of the tracker after each step, (steps, n) each.

    Attributes:
        reading: trimmed mean of the newest firing's samples [m], even if this firing did not update the estimate.
        range: estimated range [m].
        bound: half-width of the interval around `range` that shall contain the true range [m].
        healthy: whether the range is reliable.
        age: time since the last reading that updated the estimate [s]; NaN before the first reading.
        accepted: whether the tracker accepted the reading that arrived in the step.
    """

    reading: Array
    range: Array
    bound: Array
    healthy: NDArray[np.bool_]
    age: Array
    accepted: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class SensorSummary:
    """The summary of one sensor in a replay.

    Attributes:
        readings: number of readings that arrived.
        refused: number of readings that the tracker did not accept.
        healthy_share: share of steps with a reliable range, from the first to the last reading of the sensor.
        gaps: number of gaps; in a gap, no reading arrives for more than 1.5 times the time after which a reading is
            due.
        longest_gap_s: duration of the longest gap [s]; 0 without a gap.
        median_bound_m: median of the bound over healthy steps [m]; NaN without a healthy step.
    """

    sensor: int
    readings: int
    refused: int
    healthy_share: float
    gaps: int
    longest_gap_s: float
    median_bound_m: float


@dataclass(frozen=True, kw_only=True)
class Replay:
    """The readings of a replay, and the outputs of the tracker for these readings."""

    readings: Readings
    tracked: Tracked

    @property
    def sensors(self) -> list[int]:
        """Indices of the sensors with at least one reading."""
        return [int(i) for i in np.flatnonzero(self.readings.fresh.any(axis=0))]

    def summary(self, sensor: int) -> SensorSummary:
        """Return the summary of one sensor, whose index must be in `sensors`."""
        r, t = self.readings, self.tracked
        at = np.flatnonzero(r.fresh[:, sensor])
        alive = slice(int(at[0]), int(at[-1]) + 1)
        healthy = t.healthy[alive, sensor]
        waits = np.diff(r.time[at])
        gaps = waits[waits > _GAP * RangeTracker(array=r.array, dt=r.dt).due + 1e-9]
        bounds = t.bound[alive, sensor][healthy]
        return SensorSummary(
            sensor=sensor,
            readings=len(at),
            refused=int(np.count_nonzero(~t.accepted[at, sensor])),
            healthy_share=float(healthy.mean()),
            gaps=len(gaps),
            longest_gap_s=float(gaps.max(initial=0.0)),
            median_bound_m=float(np.median(bounds)) if len(bounds) else float("nan"),
        )


def replay_readings(readings: Readings) -> Replay:
    """Run the tracker over the readings, and return readings and results; no walls are known."""
    parts = np.split(np.arange(len(readings.time)), readings.first[1:])
    tracker = RangeTracker(array=readings.array, dt=readings.dt)
    tracks = [
        track(tracker, readings.samples[p], fresh=readings.fresh[p], closing=readings.closing[p], turn=readings.turn[p])
        for p in parts
    ]
    whole = {f.name: np.concatenate([getattr(one, f.name) for one in tracks]) for f in fields(Tracked)}
    return Replay(readings=readings, tracked=Tracked(**whole))


def track(tracker: RangeTracker, samples: Array, *, fresh: NDArray[np.bool_], closing: Array, turn: Array) -> Tracked:
    """Run the tracker from its initial state on samples (steps, n, k), fresh and closing (steps, n), turn (steps,).

    Example:
        >>> import numpy as np
        >>> from surctl.marine.sensing import RangeTracker, sonar_array, track
        >>> tracker = RangeTracker(array=sonar_array(1, samples=1))
        >>> k, still = np.arange(60), np.zeros((60, 1))
        >>> samples, fresh = 2.0 + 0.01 * (k[:, None, None] % 4 > 1), k[:, None] % 2 == 0
        >>> tracked = track(tracker, samples, fresh=fresh, closing=still, turn=still[:, 0])
        >>> tracked.range[-1].round(3).tolist(), tracked.bound[-1].round(3).tolist()
        ([2.005], [0.054])
        >>> tracked.healthy[[0, -1], 0].tolist()
        [False, True]
    """
    steps, n, k = samples.shape
    layout, step = _function(tracker)
    many = step.mapaccum(_CHUNK)
    state = layout.pack()
    outputs = []
    for begin in range(0, steps, _CHUNK):
        part = slice(begin, min(begin + _CHUNK, steps))
        length = part.stop - part.start
        run = many if length == _CHUNK else step.mapaccum(length)
        flat_samples = samples[part].transpose(1, 0, 2).reshape(n, length * k)
        states, result = run(state, flat_samples, fresh[part].T.astype(float), closing[part].T, turn[part][None])
        state = np.array(states)[:, -1]
        outputs.append(np.array(result).reshape(n, length, 6).transpose(1, 0, 2))
    result = np.concatenate(outputs)
    reading, ranges, bound, healthy, age, accepted = np.moveaxis(result, -1, 0)
    never = layout.port("age").default
    return Tracked(
        reading=reading,
        range=ranges,
        bound=bound,
        healthy=healthy > 0.5,
        age=np.where(age >= never, np.nan, age),
        accepted=accepted > 0.5,
    )


def _function(tracker: RangeTracker) -> tuple[Layout, ca.Function]:
    # (state, samples, fresh, closing, turn) -> (state, outputs (n, 6))
    n, k = tracker.array.size, tracker.array.samples
    layout = Layout(tracker.ports())
    state, parts = layout.symbols("state")
    samples, fresh, closing = ca.SX.sym("samples", n, k), ca.SX.sym("fresh", n), ca.SX.sym("closing", n)
    turn = ca.SX.sym("turn")
    nothing = ca.SX(n, 1) + 2.0 * tracker.array.maximum  # beyond every reading: no known wall
    done = tracker.update(parts, samples, fresh=fresh, closing=closing, expected=nothing, turn=turn)
    outputs = ca.horzcat(done.reading, done.range, done.bound, done.healthy, done.age, done.accepted)
    return layout, ca.Function("track", [state, samples, fresh, closing, turn], [layout.join(done.state), outputs])


_CYCLE = SonarArray().cycle_limit  # s


_BACK = 0.05  # share of lines whose time may go back
_MOTION = ("closing_m_per_s", "turn_rad_per_s")


@dataclass(frozen=True, kw_only=True)
class Recording:
    """The readings of a recording, and how many lines of its file were skipped or changed.

    Attributes:
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
    The file replaces `samples` and `firing_period` of the array, and all readings are divided by `scale`.
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
    cycle = _usual_cycle(time, sensor, file=table.name)
    dt = cycle / 2 if cycle <= 1.5 * _CYCLE else cycle  # a reading is due after one or two whole steps
    array = replace(array, samples=samples.shape[1], firing_period=min(cycle, _CYCLE) / array.size)
    step, first, begin = _on_steps(time, dt, file=table.name)
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
    """
    r, t, sensors = replayed.readings, replayed.tracked, replayed.sensors
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("time_s", "sensor", "reading_m", "range_m", "bound_m", "healthy", "age_s"))
    for begin in range(0, len(r.time), 100_000):
        part = np.ix_(range(begin, min(begin + 100_000, len(r.time))), sensors)
        time, sensor = np.broadcast_arrays(np.char.mod("%.6f", r.time[part[0]]), part[1])
        reading, ranges, bound, age = (np.char.mod("%.5f", v[part]) for v in (t.reading, t.range, t.bound, t.age))
        reading, age = np.where(r.fresh[part], reading, ""), np.where(np.isfinite(t.age[part]), age, "")
        columns = (time, sensor, reading, ranges, bound, t.healthy[part].astype(int), age)
        writer.writerows(zip(*(column.ravel().tolist() for column in columns), strict=True))
    return out.getvalue()


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
