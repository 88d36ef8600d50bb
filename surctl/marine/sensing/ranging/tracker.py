"""The robust range tracker, which estimates the range to each sensor's nearest object and a bound on the error.

The tracker takes a trimmed mean of the samples of each firing. For each sensor, a Kalman filter estimates range and
rate (constant velocity; Bar-Shalom, Li and Kirubarajan 2001, 6.2), with the robot's own motion as a known input. This
estimate is called the track. Additional rules (module `rules`) distinguish faulty readings from true ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from math import ceil, erf, isfinite, log, sqrt
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.ir import Layout, Port, each
from surctl.marine.sensing.ranging.rules import MOST_REPEATS, StepInputs, others, range_step
from surctl.marine.sensing.sonar.array import SonarArray

__all__ = ["RangeTracker", "Ranging"]

_NEVER = 1e6  # s, and rad: longer than any run
_REPEAT = 0.01  # if a working sensor repeats a sample set more rarely than this, one repetition is suspicious


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
class RangeTracker:
    """The tracker of a sonar array: in each step, it returns range, error bound and health of every sensor.

    The bound on the range covers objects that the last firing could detect. If an object enters or leaves a turning
    beam between two firings, the bound covers this object only if the object is a known wall. A sensor that reads its
    maximum in open water cannot be distinguished from a sensor that receives no echoes (see
    `analysis/10_sonar_filters`).

    Attributes:
        array: the sonar array.
        dt: period of the steps [s].
        obstacle_speed: largest speed of an obstacle [m/s]; the bound grows at this speed while readings are overdue.
        tolerance: largest difference [m] between a reading and the range of a known wall at which the two agree; a
            reading that exceeds the wall's range by more is a fault. `tolerance` covers noise and the error of the
            robot's own position.
        yaw_tolerance: error of the robot's own heading that the bound covers while the beam turns [rad].
        longest_delay: longest delay of readings after a gap that the tracker considers [s].
        hold: time [s] for which the tracker keeps an echo that vanished without explanation while the beam does not
            turn (default: for ever, because a fault may never end).
    """

    array: SonarArray = field(default_factory=SonarArray)
    dt: float = 0.05
    obstacle_speed: float = 0.25
    tolerance: float = 0.1
    yaw_tolerance: float = 0.03
    longest_delay: float = 0.8
    hold: float = _NEVER

    def __post_init__(self) -> None:
        """Check the values; raise an InputError that names an invalid value."""
        for name, unit in (
            ("dt", "s"),
            ("tolerance", "m"),
            ("yaw_tolerance", "rad"),
            ("longest_delay", "s"),
            ("hold", "s"),
        ):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise InputError("must be greater than 0", key=f"tracker.{name}", value=value, remedy=f"give {unit}")
        if not (isfinite(self.obstacle_speed) and self.obstacle_speed >= 0):
            raise InputError(
                "must be at least 0", key="tracker.obstacle_speed", value=self.obstacle_speed, remedy="give m/s"
            )

    @cached_property
    def due(self) -> float:
        """Time between two arrivals of a sensor's samples [s]: the array's cycle time, rounded up to whole steps."""
        return self.dt * ceil(self.array.cycle / self.dt - 1e-9)

    @cached_property
    def repeats(self) -> int:
        """Number of repetitions of the same samples after which a sensor counts as stuck; 0 if the noise is too small.

        Two successive firings of a working sensor give the same samples with a probability of at most p; the
        probability is p if the range lies at the worst position between two conversion steps. The number r of
        repetitions satisfies p^r < 1e-4.
        """
        chance = _chance_of_equal_sets(self.array)
        needed = ceil(log(1e-4) / log(min(max(chance, 1e-12), 0.999)))
        return needed if needed <= MOST_REPEATS else 0

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
            state: value of each entry of `ports(prefix)`, by name.
            samples: (n, k) raw samples [m]; the samples of sensors that did not fire are ignored, but must be finite.
            fresh: (n,) 1 for a sensor whose samples arrived since the last step, else 0.
            closing: (n,) the robot's velocity along each beam's axis [m/s]; a positive value shortens the range to an
                object at rest.
            expected: (n,) range [m] at which the known walls give an echo; 2·maximum without a known wall.
            turn: yaw rate of the robot [rad/s].
            longest: (n,) range [m] at which a known wall surely gives an echo; a longer reading is a fault. Default:
                `expected`.
            prefix: prefix of the names of the state's entries.
        """
        ports, count = self.ports(), self.array.samples
        old = {p.name: state[prefix + p.name] for p in ports}
        wide = {p.name for p in ports if len(p.shape) == 2}  # ports that the rules take as lists of columns
        columns = {n: ca.horzsplit(v) if n in wide else v for n, v in old.items()}
        beside = others(self, columns, [samples[:, j] for j in range(count)], fresh)

        def sensor(before: ca.SX, values: ca.SX, around: ca.SX) -> tuple[ca.SX, ca.SX]:
            own = Layout(tuple(replace(p, shape=p.shape[1:] or (1,)) for p in ports)).split(before)
            previous = {n: ca.vertsplit(v) if n in wide else v for n, v in own.items()}
            compared = [(around[3 * k], around[3 * k + 1], around[3 * k + 2]) for k in range(len(beside))]
            fired, own_motion, walls, *far = ca.vertsplit(values[count:])
            farthest = far[0] if far else walls
            inputs = StepInputs(ca.vertsplit(values[:count]), fired, own_motion, walls, farthest, turn, compared)
            after, outputs = range_step(self, previous, inputs)
            flat = [ca.vec(ca.vertcat(*v)) if isinstance(v, list) else v for v in (after[p.name] for p in ports)]
            return _column(flat), _column(outputs)

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

    @cached_property
    def sigma(self) -> float:
        """Standard deviation of the mean of a firing's samples [m]."""
        a = self.array
        spread = sqrt(a.noise_sd**2 + a.resolution**2 / 12.0)
        # noise much smaller than a conversion step does not dither it: a mean of equal codes keeps the rounding error
        return max(1.1 * spread / sqrt(a.samples), a.resolution / sqrt(12.0))

    @cached_property
    def one_repeat(self) -> bool:
        """Whether one repetition of the same samples is suspicious."""
        return self.repeats > 0 and _chance_of_equal_sets(self.array) < _REPEAT

    @property
    def stuck(self) -> float:
        """Number of repetitions of a firing's samples above which a sensor counts as stuck."""
        return max(self.repeats, 1) - 0.5

    @property
    def rate_variance(self) -> float:
        """Variance of the rate of the range [m²/s²] before any estimate of the rate."""
        return max(self.obstacle_speed, 0.05) ** 2

    @property
    def _delays(self) -> int:
        return max(round(self.due / self.dt), ceil(self.longest_delay / self.dt - 1e-9))


@cache
def _ports(tracker: RangeTracker, prefix: str) -> tuple[Port, ...]:
    n, far = tracker.array.size, tracker.array.maximum
    delays = tracker._delays

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
        port("since", "s", "time since the last arrival", _NEVER),
        port("age", "s", "time since a reading last updated the track", _NEVER),
        port("turned", "rad", "sum of the beam's turns since a reading last updated the track", _NEVER),
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


def _column(parts: Iterable[Any]) -> ca.SX:
    whole: ca.SX = ca.vertcat(*parts)
    return whole


@cache
def _chance_of_equal_sets(array: SonarArray) -> float:
    # at the same range
    if array.noise_sd == 0.0:
        return 1.0
    largest = 0.0
    for offset in np.linspace(0.0, 0.5, 11):
        edges = (np.arange(-400, 402) - 0.5 - offset) * array.resolution / (array.noise_sd * sqrt(2.0))
        below = np.array([0.5 * (1.0 + erf(edge)) for edge in edges])
        largest = max(largest, float(np.sum(np.diff(below) ** 2)))
    return largest**array.samples
