"""Replay of recorded readings through the range tracker: the ranges that the controller would have received.

The function `track` evaluates the tracker's CasADi expressions, so the results are the numbers that the exported law
computes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Layout
from surctl.marine.sensing.ranging.tracker import RangeTracker
from surctl.marine.sensing.sonar.array import SonarArray

__all__ = ["Readings", "Replay", "SensorSummary", "Tracked", "replay_readings", "track"]

Array = NDArray[np.float64]
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
        array: the sonar array.
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
        sensor: index of the sensor.
        readings: number of readings that arrived.
        refused: number of readings that the tracker did not accept.
        healthy: share of steps with a reliable range among the steps from the first to the last reading of the sensor.
        gaps: number of gaps; in a gap, no reading arrives for more than 1.5 times the time after which a reading is
            due.
        longest_gap: duration of the longest gap [s]; 0 without a gap.
        median_bound: median of the bound over healthy steps [m]; NaN without a healthy step.
    """

    sensor: int
    readings: int
    refused: int
    healthy: float
    gaps: int
    longest_gap: float
    median_bound: float

    def to_dict(self) -> dict[str, Any]:
        """Return the summary of the replay as plain data for JSON."""
        return {
            "sensor": self.sensor,
            "readings": self.readings,
            "refused": self.refused,
            "healthy_share": self.healthy,
            "gaps": self.gaps,
            "longest_gap_s": self.longest_gap,
            "median_bound_m": self.median_bound,
        }


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
        gaps = waits[waits > _GAP * tracker_of(r).due + 1e-9]
        bounds = t.bound[alive, sensor][healthy]
        return SensorSummary(
            sensor=sensor,
            readings=len(at),
            refused=int(np.count_nonzero(~t.accepted[at, sensor])),
            healthy=float(healthy.mean()),
            gaps=len(gaps),
            longest_gap=float(gaps.max(initial=0.0)),
            median_bound=float(np.median(bounds)) if len(bounds) else float("nan"),
        )


def replay_readings(readings: Readings) -> Replay:
    """Run the tracker over the readings, and return readings and results; no walls are known.

    Example:
        >>> from pathlib import Path
        >>> import numpy as np
        >>> from surctl.marine.sensing import read_readings, replay_readings, sonar_array
        >>> k = np.arange(40)
        >>> rows = np.column_stack((0.1 * k, 0 * k, np.where(k == 20, 0.5, 2.0 + 0.01 * (k % 2))))  # one is false
        >>> np.savetxt("log.csv", rows, delimiter=",", header="time_s,sensor,range_m", comments="")
        >>> replayed = replay_readings(read_readings(Path("log.csv"), sonar_array(1)).readings)
        >>> tracked = replayed.tracked
        >>> for k in (38, 40, 44):  # before, at and after the false reading
        ...     distance, bound = tracked.range[k, 0], tracked.bound[k, 0]
        ...     print(f"{distance:.3f} m within {bound:.3f} m, healthy: {tracked.healthy[k, 0]}")
        2.005 m within 0.051 m, healthy: True
        1.261 m within 0.802 m, healthy: False
        2.004 m within 0.051 m, healthy: True
    """
    parts = np.split(np.arange(len(readings.time)), readings.first[1:])
    tracker = tracker_of(readings)
    tracks = [
        track(
            tracker,
            readings.samples[p],
            fresh=readings.fresh[p],
            closing=readings.closing[p],
            turn=readings.turn[p],
        )
        for p in parts
    ]
    names = ("reading", "range", "bound", "healthy", "age", "accepted")
    whole = {name: np.concatenate([getattr(one, name) for one in tracks]) for name in names}
    return Replay(readings=readings, tracked=Tracked(**whole))


def tracker_of(readings: Readings) -> RangeTracker:
    """Return a tracker for the sonar array and the step of the readings."""
    return RangeTracker(array=readings.array, dt=readings.dt)


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
