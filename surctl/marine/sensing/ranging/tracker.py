"""The robust range tracker, with its state: range to each sensor's nearest object and error bound (see `rules`).

The tracker takes a trimmed mean of the samples of each firing. For each sensor, a Kalman filter estimates range and
rate (constant velocity; Bar-Shalom, Li and Kirubarajan 2001, 6.2), with the robot's own motion as a known input. This
estimate is called the track. Additional rules (module `rules`) distinguish faulty readings from true ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from math import ceil
from typing import Any, NamedTuple

import casadi as ca

from surctl.ir import Layout, Port, each
from surctl.marine.sensing.ranging.parameters import NEVER, TrackerParameters
from surctl.marine.sensing.ranging.rules import StepInputs, others, range_step, robust


class Ranging(NamedTuple):
    """The result of a tracker step for n sensors, as SX expressions."""

    state: dict[str, Any]
    """Next state: value of each entry, by name."""
    range: Any
    """[m] present range from the apex to the nearest object; the sensor's maximum if no object is nearer."""
    bound: Any
    """[m] half-width of the interval around `range`: the tracker claims |min(true, maximum) − range| ≤ bound."""
    rate: Any
    """[m/s] rate of the range that the robot's own motion does not explain; negative if the object approaches."""
    healthy: Any
    """1 if the range is reliable, else 0; with 0, the bound covers all ranges that earlier readings allow."""
    age: Any
    """[s] time since a reading last updated the estimate."""
    reading: Any
    """[m] trimmed mean of the newest firing's samples, even if this mean did not update the estimate."""
    accepted: Any
    """1 if this step's reading may be used to mark a map, else 0."""
    carve: Any
    """[m] range up to which this step's firing may clear a map: the smallest of the last three readings, each corrected
    for the robot's motion since then; 0 if the sensor is not healthy or did not fire."""


@dataclass(frozen=True, kw_only=True)
class RangeTracker(TrackerParameters):
    """The tracker of a sonar array: in each step, it returns range, error bound and health of every sensor.

    The bound on the range covers objects that the last firing could detect. If an object enters or leaves a turning
    beam between two firings, the bound covers this object only if the object is a known wall. A sensor that reads its
    maximum in open water cannot be distinguished from a sensor that receives no echoes (see
    `analysis/10_sonar_filters`). `TrackerParameters` describes its numbers.
    """

    def ports(self, prefix: str = "") -> tuple[Port, ...]:
        """Return the entries (name, shape, initial value) of the state; initially, no sensor has an estimate."""
        return _ports(self, prefix)

    def update(
        self,
        state: Mapping[str, ca.SX],
        samples: ca.SX,
        *,
        fresh: ca.SX,
        closing: ca.SX,
        expected: ca.SX,
        turn: ca.SX,
        longest: ca.SX | None = None,
        prefix: str = "",
    ) -> Ranging:
        """Return the ranges after one step, in CasADi symbols.

        Args:
            samples: (n, k) raw samples [m]; the samples of sensors that did not fire are ignored, but must be finite.
            fresh: (n,) 1 for a sensor whose samples arrived since the last step, else 0.
            closing: (n,) the robot's velocity along each beam's axis [m/s]; a positive value shortens the range to an
                object at rest.
            expected: (n,) range [m] at which the known walls give an echo; 2·maximum without a known wall.
            turn: yaw rate of the robot [rad/s].
            longest: (n,) range [m] at which a known wall surely gives an echo; a longer reading is a fault. Default:
                `expected`.
        """
        ports, count = self.ports(), self.array.samples
        old = {p.name: state[prefix + p.name] for p in ports}
        wide = {p.name for p in ports if len(p.shape) == 2}  # ports that the rules take as lists of columns
        columns = {n: ca.horzsplit(v) if n in wide else v for n, v in old.items()}

        def newest(row: ca.SX, rest: ca.SX) -> tuple[Any]:
            return (ca.if_else(rest[0] > 0.5, robust(self, ca.vertsplit(row)), rest[1]),)

        beside = others(self, columns, *each("newest", newest, samples, ca.horzcat(fresh, old["reading"])))

        def sensor(before: ca.SX, values: ca.SX, around: ca.SX) -> tuple[Any, Any]:
            own = Layout(tuple(replace(p, shape=p.shape[1:] or (1,)) for p in ports)).split(before)
            previous = {n: ca.vertsplit(v) if n in wide else v for n, v in own.items()}
            compared = [(around[3 * k], around[3 * k + 1], around[3 * k + 2]) for k in range(len(beside))]
            fired, own_motion, walls, *far = ca.vertsplit(values[count:])
            farthest = far[0] if far else walls
            inputs = StepInputs(ca.vertsplit(values[:count]), fired, own_motion, walls, farthest, turn, compared)
            after, outputs = range_step(self, previous, inputs)
            flat = [ca.vec(ca.vertcat(*v)) if isinstance(v, list) else v for v in (after[p.name] for p in ports)]
            return ca.vertcat(*flat), ca.vertcat(*outputs)

        after, readings = each(
            "range_track",
            sensor,
            ca.horzcat(*old.values()),
            ca.horzcat(samples, fresh, closing, expected, *(() if longest is None else (longest,))),
            ca.horzcat(ca.SX.zeros(self.array.size, 0), *(value for one in beside for value in one)),
        )
        new, at = {}, 0
        for port in ports:
            width = port.shape[1] if len(port.shape) == 2 else 1
            new[prefix + port.name] = after[:, at : at + width]
            at += width
        return Ranging(new, *(readings[:, k] for k in range(readings.shape[1])))


@cache
def _ports(tracker: RangeTracker, prefix: str) -> tuple[Port, ...]:
    n, far = tracker.array.size, tracker.array.maximum
    delays = max(round(tracker.due / tracker.dt), ceil(tracker.longest_delay / tracker.dt - 1e-9))

    def port(name: str, unit: str, meaning: str, default: float = 0.0, *, width: int = 0) -> Port:
        return Port(f"{prefix}{name}", (n, width) if width else (n,), unit, meaning, default)

    return (
        port("range", "m", "range of the track", far),
        port("rate", "m/s", "rate of the track that own motion does not explain"),
        port("var_range", "m^2", "variance of the range", 1.0),
        port("covariance", "m^2/s", "covariance of range and rate"),
        port("var_rate", "m^2/s^2", "variance of the rate", 0.0625),
        port("surprise", "m", "excess of recent innovations over their standard deviations"),
        port("known", "1", "1 once a track exists"),
        port("explained", "1", "1 while the track agrees with the expected range"),
        port("rejected", "1", "1 while the last reading is rejected as a fault"),
        port("distrust", "1", "1 after a reading beyond a known wall, until the readings are reliable again"),
        port("since", "s", "time since the last arrival", NEVER),
        port("age", "s", "time since a reading last updated the track", NEVER),
        port("turned", "rad", "sum of the beam's turns since a reading last updated the track", NEVER),
        port("swung", "rad", "signed turn of the beam since a reading last updated the track"),
        port("candidate", "m", "range of a candidate for another track", far),
        port("votes", "1", "number of consecutive readings that agree with the candidate"),
        port("suspect", "1", "1 if the last reading of the candidate looks like a fault; less after others"),
        port("late_by", "s", "possible delay of the readings after the last gap"),
        port("late", "1", "1 if the readings are found to be late"),
        port("absorbed", "m", "part of the delay's shift that is already in the track"),
        port("cross", "m^2", "evidence of delay: residual times shift"),
        port("power", "m^2", "evidence of delay: shift squared"),
        port("looks", "1", "number of readings in the evidence of delay"),
        port("repeated", "1", "number of consecutive equal sample sets"),
        port("reading", "m", "trimmed mean of the last firing", far),
        port("recent", "m", "last three readings moved by own motion, newest first", width=3),
        port("samples", "m", "samples of the last firing", -1.0, width=tracker.array.samples),
        port("shifts", "m", "predicted range 1, 2, ... steps ago minus the present one", width=delays),
        port("walls", "m", "expected range 1, 2, ... steps ago", far, width=delays + 1),
    )
