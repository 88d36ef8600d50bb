"""A robust range for each sensor: what stands how far away, with a bound that holds, whatever a sensor does.

Per firing a trimmed mean of the samples; per sensor a Kalman filter of range and rate (constant velocity; Bar-Shalom,
Li and Kirubarajan 2001, 6.2) into which the robot's own motion goes as a known input; around it rules that tell a
faulty stream from a true one. The rules (`rules`) are written once and run on CasADi symbols, as part of the
exported law, and on NumPy arrays, for recorded readings and for many runs at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from math import ceil, erf, isfinite, log, sqrt
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir import Layout, Port, each
from surctl.sensing.ranging.elementwise import NUMBERS, SYMBOLS
from surctl.sensing.ranging.rules import range_step
from surctl.sensing.ranging.scene import MOST_REPEATS, Rules, StepInputs, others
from surctl.sensing.sonar.array import SonarArray

__all__ = ["RangeTracker", "Ranging"]

_NEVER = 1e6  # s, and rad: longer than any run
_REPEAT = 0.01  # largest chance of two equal honest sets at which one repetition counts as a sign


class Ranging(NamedTuple):
    """What a tick gives: SX expressions of `RangeTracker.update`, arrays of `RangeTracker.step`; (n,) each."""

    state: dict[str, Any]
    """Next state, keyed as the ports are named."""
    range: Any
    """[m] from the apex to the nearest thing, now; beyond the sensor's maximum it is the maximum."""
    bound: Any
    """[m] half-width: |min(true, maximum) − range| ≤ bound is promised."""
    rate: Any
    """[m/s] change of range that the robot's own motion does not explain; negative: it approaches."""
    healthy: Any
    """1 when the range may be believed, else 0: then the bound covers what the last believed readings allow."""
    age: Any
    """[s] since the last believed reading."""
    reading: Any
    """[m] robust value of the newest firing, believed or not."""
    accepted: Any
    """1 where this step's reading may be used to mark a map, else 0."""
    carve: Any
    """[m] up to which a map may be cleared by this step's firing: the smallest of the last three robust readings, each
    moved by own motion; 0 when not healthy or without a firing."""


@dataclass(frozen=True, kw_only=True)
class RangeTracker:
    """Filter, bound and health of every sensor of an array, as one step with explicit state.

    The bound holds for what the last firing could see. What enters or leaves a turning beam between two firings is in
    it only where the walls are known, and a sensor that reads its maximum in open water cannot be told from one that
    sees nothing (study 10).

    Attributes:
        array: the sensors.
        dt: period of the steps [s].
        obstacle_speed: largest speed of what is tracked [m/s]; the bound grows with it while nothing is believed.
        tolerance: by which an honest reading may exceed the expected range, and agree with it [m]: noise, and error
            of the own position.
        yaw_tolerance: error of the own heading that the bound allows for while the beam turns [rad].
        longest_delay: of a stream that comes late after a gap [s].
        hold: how long an echo that went out of sight without reason is kept [s] when the beam does not turn
            (default: for ever, because a fault may last as long).
    """

    array: SonarArray = field(default_factory=SonarArray)
    dt: float = 0.05
    obstacle_speed: float = 0.25
    tolerance: float = 0.1
    yaw_tolerance: float = 0.03
    longest_delay: float = 0.8
    hold: float = _NEVER

    def __post_init__(self) -> None:
        """Check the values; InputError names the wrong one."""
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

    @property
    def due(self) -> float:
        """Time from one arrival to the next [s]: the array's cycle, in whole steps."""
        return self.dt * ceil(self.array.cycle / self.dt - 1e-9)

    @property
    def repeats(self) -> int:
        """Repetitions of a sample set after which a sensor counts as stuck; 0 when the noise cannot tell.

        An honest sensor gives a set of codes twice with at most the chance p that two sets agree at the likeliest
        place of the range between two steps; r repetitions are asked for such that p^r < 1e-4.
        """
        chance = _chance_of_equal_sets(self.array)
        needed = ceil(log(1e-4) / log(min(max(chance, 1e-12), 0.999)))
        return needed if needed <= MOST_REPEATS else 0

    def ports(self, prefix: str = "") -> tuple[Port, ...]:
        """The state; it starts with nothing heard and no sensor believed."""
        n, far = self.array.size, self.array.maximum
        delays = self._delays

        def port(name: str, unit: str, meaning: str, default: float = 0.0, *, width: int = 0) -> Port:
            return Port(f"{prefix}{name}", (n, width) if width else (n,), unit, meaning, default)

        return (
            port("range", "m", "range of the track", far),
            port("rate", "m/s", "its rate that own motion does not explain"),
            port("var_range", "m^2", "variance of the range", 1.0),
            port("covariance", "m^2/s", "of range and rate"),
            port("var_rate", "m^2/s^2", "variance of the rate", 0.0625),
            port("surprise", "m", "by how much innovations exceeded their spread"),
            port("known", "1", "1 once a track exists"),
            port("explained", "1", "1 while the track agrees with the expected range"),
            port("rejected", "1", "1 while the last arrival was not believed"),
            port("distrust", "1", "1 since a reading beyond a known wall, until one is honest again"),
            port("since", "s", "time since the last arrival", _NEVER),
            port("age", "s", "time since the last believed reading", _NEVER),
            port("turned", "rad", "beam's turn since the last believed reading", _NEVER),
            port("swung", "rad", "the same with its sign"),
            port("candidate", "m", "range of a second hypothesis", far),
            port("votes", "1", "readings in a row that agree with it"),
            port("suspect", "1", "1 while it looks like a fault"),
            port("late_by", "s", "delay that the last gap may have left"),
            port("late", "1", "1 when the stream is found late"),
            port("absorbed", "m", "part of the delay's shift that the track took in"),
            port("cross", "m^2", "evidence of delay: residual times shift"),
            port("power", "m^2", "evidence of delay: shift squared"),
            port("looks", "1", "readings in that evidence"),
            port("repeated", "1", "equal sample sets in a row"),
            port("reading", "m", "robust value of the last firing", far),
            port("recent", "m", "last three robust values moved by own motion, newest first", width=3),
            port("samples", "m", "samples of the last firing", -1.0, width=self.array.samples),
            port("shifts", "m", "predicted range 1, 2, ... steps ago less the present one", width=delays),
            port("walls", "m", "expected range 1, 2, ... steps ago", far, width=delays + 1),
        )

    def update(
        self,
        state: Mapping[str, ca.SX],
        samples: ca.SX,
        *,
        fresh: ca.SX,
        closing: ca.SX,
        expected: ca.SX,
        turn: ca.SX,
        prefix: str = "",
    ) -> Ranging:
        """One step, in symbols.

        Args:
            state: by port name, shapes of `ports(prefix)`.
            samples: (n, k) raw samples [m]; rows of sensors that did not fire are ignored (but must be finite).
            fresh: (n,) 1 where a firing arrived since the last step, else 0.
            closing: (n,) own velocity along each beam's axis [m/s]; positive shortens a range to what stands still.
            expected: (n,) range [m] at which the known walls would give an echo; 2·maximum: none.
            turn: yaw rate [rad/s].
            prefix: of the names of the state.
        """
        ports, count = self.ports(), self.array.samples
        old = {p.name: state[prefix + p.name] for p in ports}
        wide = {p.name for p in ports if len(p.shape) == 2}  # what the rules take as a list of columns
        columns = {n: ca.horzsplit(v) if n in wide else v for n, v in old.items()}
        beside = others(SYMBOLS, self.rules(), columns, [samples[:, j] for j in range(count)], fresh)

        def sensor(before: ca.SX, values: ca.SX, around: ca.SX) -> tuple[ca.SX, ca.SX]:
            own = Layout(tuple(replace(p, shape=p.shape[1:] or (1,)) for p in ports)).split(before)
            previous = {n: ca.vertsplit(v) if n in wide else v for n, v in own.items()}
            compared = [(around[3 * k], around[3 * k + 1], around[3 * k + 2]) for k in range(len(beside))]
            fired, own_motion, walls = ca.vertsplit(values[count:])
            inputs = StepInputs(ca.vertsplit(values[:count]), fired, own_motion, walls, turn, compared)
            after, outputs = range_step(SYMBOLS, self.rules(), previous, inputs)
            flat = [ca.vec(ca.vertcat(*v)) if isinstance(v, list) else v for v in (after[p.name] for p in ports)]
            return _column(flat), _column(outputs)

        after, readings = each(
            "range_track",
            sensor,
            ca.horzcat(*old.values()),
            ca.horzcat(samples, fresh, closing, expected),
            ca.horzcat(ca.SX.zeros(self.array.size, 0), *(value for one in beside for value in one)),
        )
        new, at = {}, 0
        for port in ports:
            width = port.shape[1] if len(port.shape) == 2 else 1
            new[prefix + port.name] = after[:, at : at + width]
            at += width
        return Ranging(new, *(readings[:, k] for k in range(readings.shape[1])))

    def step(
        self,
        state: Mapping[str, NDArray[np.float64]],
        samples: NDArray[np.float64],
        *,
        fresh: ArrayLike,
        closing: ArrayLike,
        expected: ArrayLike,
        turn: ArrayLike,
        prefix: str = "",
    ) -> Ranging:
        """One step, in numbers; leading axes (runs) are free.

        Args:
            state: by port name, each (..., *port.shape); `start` gives the first.
            samples: (..., n, k) [m].
            fresh: (..., n).
            closing: (..., n) [m/s]; 0 where the own motion is not known.
            expected: (..., n) [m]; 2·maximum where no wall is known.
            turn: (...) [rad/s].
            prefix: of the names of the state.
        """
        old = {
            port.name.removeprefix(prefix): (
                [state[port.name][..., j] for j in range(port.shape[1])] if len(port.shape) == 2 else state[port.name]
            )
            for port in self.ports(prefix)
        }
        columns = [samples[..., j] for j in range(self.array.samples)]
        fired, own, walls, beside = (np.asarray(v, dtype=float) for v in (fresh, closing, expected, turn))
        compared = others(NUMBERS, self.rules(), old, columns, fired)
        after, outputs = range_step(
            NUMBERS, self.rules(), old, StepInputs(columns, fired, own, walls, beside[..., None], compared)
        )
        lead = samples.shape[:-1]
        new = {
            prefix + name: np.stack([np.broadcast_to(c, lead) for c in v], axis=-1)
            if isinstance(v, list)
            else np.broadcast_to(v, lead).astype(float)
            for name, v in after.items()
        }
        return Ranging(new, *(np.broadcast_to(v, lead).astype(float) for v in outputs))

    def start(self, runs: tuple[int, ...] = (), *, prefix: str = "") -> dict[str, NDArray[np.float64]]:
        """The state before the first step, for `step`: each (*runs, *port.shape)."""
        return {port.name: np.full((*runs, *port.shape), port.default) for port in self.ports(prefix)}

    def rules(self) -> Rules:
        """The numbers of the rules."""
        a = self.array
        spread = sqrt(a.noise_sd**2 + a.resolution**2 / 12.0)
        # noise that is small against a step does not dither it, and a mean of equal codes keeps their error
        sigma = max(1.1 * spread / sqrt(a.samples), a.resolution / sqrt(12.0))
        return Rules(
            dt=self.dt,
            due=self.due,
            minimum=a.minimum,
            maximum=a.maximum,
            resolution=a.resolution,
            bias=a.bias,
            sigma=sigma,
            beam=a.beam_angle,
            sensors=a.size,
            obstacle_speed=self.obstacle_speed,
            tolerance=self.tolerance,
            yaw_tolerance=self.yaw_tolerance,
            longest_delay=self.longest_delay,
            hold=self.hold,
            repeats=self.repeats,
            one_repeat=self.repeats > 0 and _chance_of_equal_sets(a) < _REPEAT,
        )

    @property
    def _delays(self) -> int:
        return max(round(self.due / self.dt), ceil(self.longest_delay / self.dt - 1e-9))


def _column(parts: Iterable[Any]) -> ca.SX:
    whole: ca.SX = ca.vertcat(*parts)
    return whole


@cache
def _chance_of_equal_sets(array: SonarArray) -> float:
    """Largest chance that two firings at one range give equal samples."""
    if array.noise_sd == 0.0:
        return 1.0
    largest = 0.0
    for offset in np.linspace(0.0, 0.5, 11):
        edges = (np.arange(-400, 402) - 0.5 - offset) * array.resolution / (array.noise_sd * sqrt(2.0))
        below = np.array([0.5 * (1.0 + erf(edge)) for edge in edges])
        largest = max(largest, float(np.sum(np.diff(below) ** 2)))
    return largest**array.samples
