"""Recorded readings through the range tracker of the law: what it would have told the controller, step by step.

The tracker is called through `Tracked`, arrays in and arrays out; its symbols are evaluated by CasADi, which gives the
numbers that the exported law computes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Layout
from surctl.sensing.ranging.tracker import RangeTracker
from surctl.sensing.sonar.array import SonarArray

__all__ = ["Readings", "Replay", "SensorSummary", "Tracked", "replay_readings", "track"]

Array = NDArray[np.float64]
_CHUNK = 1000  # steps a call
_GAP = 1.5  # of the time from one reading to the next that is due; a longer one is a gap


@dataclass(frozen=True, kw_only=True)
class Readings:
    """Raw readings on the tracker's steps; n sensors, k samples a firing.

    Attributes:
        time: (steps,) [s], ascending.
        samples: (steps, n, k) [m]; 0 where nothing arrived.
        fresh: (steps, n) whether a firing arrived since the step before.
        row: (steps, n) index of its row in the file, -1 without.
        closing: (steps, n) own velocity along each beam [m/s].
        turn: (steps,) yaw rate [rad/s].
        first: (segments,) step at which the tracker starts anew, after a long silence; 0 is the first.
        array: the sensors.
        dt: from step to step within a segment [s].
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
    """What the tracker says after each step; (steps, n) each.

    Attributes:
        reading: value of the newest firing, believed or not [m].
        range: to act on [m].
        bound: half-width about it that the true range is promised to lie in [m].
        healthy: whether the range may be believed.
        age: since the last believed reading [s]; NaN before the first.
        accepted: whether this step's reading was believed.
    """

    reading: Array
    range: Array
    bound: Array
    healthy: NDArray[np.bool_]
    age: Array
    accepted: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class SensorSummary:
    """One sensor of a replay.

    Attributes:
        sensor: index.
        readings: firings that arrived.
        refused: of these, not believed.
        healthy: share of the steps, from its first reading to its last, in which its range may be believed.
        gaps: times without a reading for more than 1.5 of what is due.
        longest_gap: [s]; 0 without a gap.
        median_bound: over healthy steps [m]; NaN without one.
    """

    sensor: int
    readings: int
    refused: int
    healthy: float
    gaps: int
    longest_gap: float
    median_bound: float

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
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
    """Readings and what became of them."""

    readings: Readings
    tracked: Tracked

    @property
    def sensors(self) -> list[int]:
        """Indices of the sensors that sent anything."""
        return [int(i) for i in np.flatnonzero(self.readings.fresh.any(axis=0))]

    def summary(self, sensor: int) -> SensorSummary:
        """Counts of one sensor, which must be one of `sensors`."""
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
    """Run the tracker over the readings; no wall is known to it.

    Example:
        >>> from pathlib import Path
        >>> import numpy as np
        >>> from surctl.sensing import read_readings, replay_readings, sonar_array
        >>> k = np.arange(40)
        >>> rows = np.column_stack((0.1 * k, 0 * k, np.where(k == 20, 0.5, 2.0 + 0.01 * (k % 2))))  # a false one
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
    """The tracker at the pace of the readings."""
    return RangeTracker(array=readings.array, dt=readings.dt)


def track(tracker: RangeTracker, samples: Array, *, fresh: NDArray[np.bool_], closing: Array, turn: Array) -> Tracked:
    """Steps of the tracker from its start: samples (steps, n, k), fresh and closing (steps, n), turn (steps,).

    Example:
        >>> import numpy as np
        >>> from surctl.sensing import RangeTracker, sonar_array, track
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
    """(state, samples (n, k), fresh (n,), closing (n,), turn) -> (state, (n, 6)), and the state's layout."""
    n, k = tracker.array.size, tracker.array.samples
    layout = Layout(tracker.ports())
    state, parts = layout.symbols("state")
    samples, fresh, closing = ca.SX.sym("samples", n, k), ca.SX.sym("fresh", n), ca.SX.sym("closing", n)
    turn = ca.SX.sym("turn")
    nothing = ca.SX(n, 1) + 2.0 * tracker.array.maximum  # beyond every reading: no wall is known
    done = tracker.update(parts, samples, fresh=fresh, closing=closing, expected=nothing, turn=turn)
    outputs = ca.horzcat(done.reading, done.range, done.bound, done.healthy, done.age, done.accepted)
    return layout, ca.Function("track", [state, samples, fresh, closing, turn], [layout.join(done.state), outputs])
