"""One firing of a sonar and its faults: in NumPy for a single run, and as symbols for compiled loops.

A fault is scheduled for a sensor, a start time and a duration (`Fault`), or it is random with a probability per firing
(`FaultChances`). At most one fault acts on a firing: the first scheduled fault that is active, otherwise the random
fault.

The model omits the water surface and the vertical opening of a beam: cones are planar at the robot's depth. The caller
selects the obstacles that a beam meets at the robot's depth; in the closed loop, `simulation.column` selects these
obstacles.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import floor, inf, isfinite
from typing import Annotated, Literal, NamedTuple, TypeAlias, get_args

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from surctl.errors import InputError
from surctl.files import Strict
from surctl.ir import Port
from surctl.marine.sensing.sonar.array import SonarArray
from surctl.marine.sensing.sonar.echo import echo_samples
from surctl.marine.world import Shape, Vector2, nearest_echo

__all__ = [
    "FAULT_KINDS",
    "LONGEST_DELAY",
    "SLOT",
    "Arrival",
    "Fault",
    "FaultChances",
    "FaultKind",
    "FaultState",
    "check_faults",
    "fault_ports",
    "fault_slots",
    "fault_state",
    "faulty",
    "faulty_samples",
    "fire",
    "firing_samples",
    "true_range",
]


def true_range(array: SonarArray, sensor: int, *, position: Vector2, heading: float, shapes: Iterable[Shape]) -> float:
    """Return the distance [m] from a sensor's apex to the nearest reflecting point in its cones; inf if none exists.

    Args:
        array: the sonar array.
        sensor: index of the sensor.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: all reflecting shapes of the scene, at their present positions.

    Raises:
        InputError: if the sensor does not exist, or the position or heading is not finite.

    Example:
        >>> from surctl.marine.sensing import SonarArray, true_range
        >>> from surctl.marine.world import Disc
        >>> pipe = Disc((3.0, 1.0), 0.2)
        >>> place = {"position": (1.0, 1.0), "heading": 0.0}
        >>> [true_range(SonarArray(), sensor, shapes=[pipe], **place) for sensor in (0, 2)]  # ahead, astern
        [1.53, inf]
    """
    x, y, axis = array.apex(sensor, position=position, heading=heading)
    if not isfinite(x + y):
        raise InputError("position and heading must be finite", key="position", value=(x, y, heading))
    scene, limit = list(shapes), array.incidence_limit
    return min(
        nearest_echo(scene, (x, y), axis + offset, half_angle=half, incidence_limit=limit)
        for offset, half in array.cones[sensor]
    )


def fire(
    array: SonarArray,
    sensor: int,
    *,
    position: Vector2,
    heading: float,
    shapes: Iterable[Shape],
    noise: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the raw samples (samples,) [m] of one firing in a scene of shapes.

    Args:
        array: the sonar array.
        sensor: index of the sensor.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: all reflecting shapes of the scene, at their present positions.
        noise: (samples,) standard normal numbers.

    Raises:
        InputError: if `true_range` raises InputError, or `noise` does not have the shape (samples,).

    Example:
        >>> import numpy as np
        >>> from surctl.marine.sensing import SonarArray, fire
        >>> from surctl.noise import NoiseStream
        >>> from surctl.marine.world import Disc
        >>> noise, pipe = NoiseStream(0).normals(6)[:5], Disc((3.0, 1.0), 0.2)
        >>> fire(SonarArray(), 0, position=(1.0, 1.0), heading=0.0, shapes=[pipe], noise=noise).round(3).tolist()
        [1.518, 1.553, 1.535, 1.518, 1.5]
    """
    return firing_samples(
        array, true_range(array, sensor, position=position, heading=heading, shapes=shapes), noise=noise
    )


def firing_samples(array: SonarArray, distance: float, *, noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the raw samples (samples,) [m] of a firing whose echo comes from `distance`, in order of time.

    Each sample is scale · distance + bias + noise, limited to [lowest, maximum] and rounded to the nearest conversion
    step (for example, the minimum of 0.2 m gives the nearest code, 0.194 m). Without an echo within the maximum, every
    sample is the maximum.

    Args:
        array: the sonar array.
        distance: true range [m]; inf if there is no echo.
        noise: (samples,) standard normal numbers.

    Raises:
        InputError: if `noise` does not have the shape (samples,).

    Example:
        >>> import numpy as np
        >>> from surctl.marine.sensing import SonarArray, firing_samples
        >>> array, exact = SonarArray(), np.zeros(5)
        >>> [firing_samples(array, distance, noise=exact)[0].round(3).tolist() for distance in (0.05, 1.53, np.inf)]
        [0.194, 1.535, 4.5]
    """
    if np.shape(noise) != (array.samples,):
        raise InputError(f"has shape {np.shape(noise)}", key="noise", remedy=f"give ({array.samples},)")
    if distance > array.maximum:
        return np.full(array.samples, array.maximum)
    reading = np.clip(array.scale * distance + array.bias + array.noise_sd * noise, array.lowest, array.maximum)
    top = array.top_code
    codes: NDArray[np.float64] = np.floor(reading * top / array.maximum + 0.5)
    return codes * array.maximum / top


FaultKind: TypeAlias = Literal[
    "dropout", "dead", "stuck", "zero", "maximum", "spike", "second_echo", "crosstalk", "delay"
]
FAULT_KINDS: tuple[FaultKind, ...] = get_args(FaultKind)
LONGEST_DELAY = 8
"""Largest delay of a fault, in firings of its sensor."""

_SLACK = 1e-6
"""Tolerance [s] for the start and end of a fault, because times are rounded sums of control periods."""

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Chance = Annotated[float, Field(ge=0, le=1)]


class Fault(Strict):
    """One fault of one sensor, which acts from `start_s` on for `duration_s`.

    Without `duration_s`, a spike acts on one firing, and any other fault acts for ever.

    The kind of the fault decides which samples arrive from a firing. `dropout`: no samples. `dead`: no samples, for
    ever. `stuck`: the samples that arrived last from this sensor, repeated (the maximum, if none ever arrived). `zero`:
    0.0. `maximum`: the maximum. `spike`: one wrong value, drawn uniformly over the range. `second_echo`: twice the true
    range, limited to the maximum. `crosstalk`: the samples that arrived last from the sensor that fires just before.
    `delay`: the samples of the sensor's firing m firings ago, where m is `delay_s` divided by the sensor's cycle time,
    rounded to a whole number (halves up) of at least 1. In the first m firings of a delay, no samples arrive. When the
    delay ends, the samples that have not yet arrived are lost.
    """

    sensor: Annotated[int, Field(ge=0)]
    kind: FaultKind
    start_s: NotNegative = 0.0
    duration_s: Positive | None = None
    delay_s: Annotated[float, Field(ge=0.1, le=0.8)] | None = None

    @model_validator(mode="after")
    def _complete(self) -> Fault:
        if self.kind == "delay" and self.delay_s is None:
            raise ValueError("a delay fault needs delay_s; give 0.1 to 0.8 s")
        if self.kind != "delay" and self.delay_s is not None:
            raise ValueError(f'a {self.kind} fault takes no delay_s; remove it or write kind = "delay"')
        if self.kind == "dead" and self.duration_s is not None:
            raise ValueError('a dead sensor takes no duration_s; remove it or write kind = "dropout"')
        return self


class FaultChances(Strict):
    """Probabilities per firing of momentary random faults, equal for all sensors; at most one of them occurs."""

    dropout: Chance = 0.0
    zero: Chance = 0.0
    maximum: Chance = 0.0
    spike: Chance = 0.0
    second_echo: Chance = 0.0
    crosstalk: Chance = 0.0

    @model_validator(mode="after")
    def _at_most_certain(self) -> FaultChances:
        total = sum(self.numbers)
        if total > 1.0 + 1e-12:
            raise ValueError(f"the chances of one firing add up to {total:g}; they may not exceed 1")
        return self

    @property
    def numbers(self) -> tuple[float, ...]:
        """The probabilities of the random faults, in the order of `kinds`."""
        return tuple(getattr(self, kind) for kind in self.kinds())

    @classmethod
    @cache
    def kinds(cls) -> tuple[FaultKind, ...]:
        """Return the kinds of random faults, in the order in which a uniform number selects among them."""
        return tuple(kind for kind in FAULT_KINDS if kind in cls.model_fields)

    def strikes(self, uniform: float) -> FaultKind | None:
        """Return the kind of random fault that a uniform random number in (0, 1) selects; None if no fault occurs."""
        passed = 0.0
        for kind, chance in zip(self.kinds(), self.numbers, strict=True):
            passed += chance
            if uniform < passed:
                return kind
        return None


@dataclass(frozen=True, eq=False)
class FaultState:
    """The samples of earlier firings; under some faults, these samples arrive again.

    Attributes:
        last: (n, samples) samples that arrived last from each sensor [m]; the maximum until samples arrive.
        history: (n, `LONGEST_DELAY`, samples) fault-free samples of each sensor's last firings, newest first [m].
    """

    last: NDArray[np.float64]
    history: NDArray[np.float64]


def fault_state(array: SonarArray) -> FaultState:
    """Return the fault state before the first firing.

    Example:
        >>> from surctl.marine.sensing import SonarArray, fault_state
        >>> state = fault_state(SonarArray())
        >>> state.last.shape, state.history.shape, float(state.last.min())  # m: as if nothing were in range
        ((4, 5), (4, 8, 5), 4.5)
    """
    n, samples = array.size, array.samples
    return FaultState(np.full((n, samples), array.maximum), np.full((n, LONGEST_DELAY, samples), array.maximum))


def check_faults(array: SonarArray, faults: Sequence[Fault], chances: FaultChances | None = None) -> None:
    """Raise InputError if a fault is impossible: unknown sensor, too long a delay, or crosstalk with a single sensor.

    Example:
        >>> from surctl.marine.sensing import Fault, SonarArray, check_faults
        >>> check_faults(SonarArray(), [Fault(sensor=4, kind="dead")])
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: faults.0.sensor = 4: no such sensor; give 0 to 3
    """
    if chances is not None and chances.crosstalk > 0 and array.size == 1:
        raise InputError("crosstalk needs at least two sensors", key="chances.crosstalk", value=chances.crosstalk)
    for k, fault in enumerate(faults):
        if fault.sensor >= array.size:
            remedy = f"give 0 to {array.size - 1}"
            raise InputError("no such sensor", key=f"faults.{k}.sensor", value=fault.sensor, remedy=remedy)
        if fault.kind == "crosstalk" and array.size == 1:
            raise InputError("crosstalk needs at least two sensors", key=f"faults.{k}.kind", value=fault.kind)
        if _delay_firings(array, fault) > LONGEST_DELAY:
            raise InputError(
                f"is longer than {LONGEST_DELAY} cycles of {array.cycle:g} s",
                key=f"faults.{k}.delay_s",
                value=fault.delay_s,
                remedy=f"give at most {LONGEST_DELAY * array.cycle:g} s",
            )


def _delay_firings(array: SonarArray, fault: Fault) -> int:
    """Return the delay of a fault as a number m of firings of its sensor; 0 if the fault is not a delay."""
    return 0 if fault.delay_s is None else max(1, floor(fault.delay_s / array.cycle + 0.5 + 1e-9))


def _fault_end(array: SonarArray, fault: Fault) -> float:
    """Return the time at which a fault ends [s]; inf if the fault never ends."""
    if fault.duration_s is None:
        return fault.start_s + array.cycle if fault.kind == "spike" else inf
    return fault.start_s + fault.duration_s


def faulty(
    array: SonarArray,
    state: FaultState,
    sensor: int,
    *,
    time: float,
    distance: float,
    noise: NDArray[np.float64],
    faults: Sequence[Fault] = (),
    chances: FaultChances | None = None,
    uniforms: Sequence[float] | NDArray[np.float64] = (0.5, 0.5),
) -> tuple[NDArray[np.float64] | None, FaultState]:
    """Return the samples (samples,) [m] that arrive from a firing, or None if none arrive, and the next fault state.

    If no fault acts on the firing, the samples are those of `firing_samples` for `distance`. The function assumes that
    every sensor fires once per cycle.

    Args:
        array: the sonar array.
        state: fault state, from `fault_state` or from the result for the previous firing.
        sensor: index of the sensor that fires.
        time: time of the firing [s].
        distance: range to the nearest reflecting point [m], from `true_range`.
        noise: (samples,) standard normal numbers.
        faults: scheduled faults, checked by `check_faults`; if several faults are active at a firing, the first fault
            in the sequence acts.
        chances: probabilities of random faults, which may occur if no scheduled fault is active.
        uniforms: two numbers in (0, 1); the first selects the random fault, the second gives the value of a spike.

    Raises:
        InputError: if `noise` does not have the shape (samples,).

    Example:
        >>> import numpy as np
        >>> from surctl.marine.sensing import Fault, SonarArray, fault_state, faulty
        >>> array, faults = SonarArray(), [Fault(sensor=0, kind="second_echo", start_s=1.0)]
        >>> for time in (0.5, 1.5):
        ...     firing = {"time": time, "distance": 1.0, "noise": np.zeros(5)}
        ...     samples, _ = faulty(array, fault_state(array), 0, faults=faults, **firing)
        ...     print(samples.round(3).tolist())
        [1.006, 1.006, 1.006, 1.006, 1.006]
        [1.994, 1.994, 1.994, 1.994, 1.994]
    """
    own = firing_samples(array, distance, noise=noise)
    active = next((f for f in faults if f.sensor == sensor and _acts(array, f, time)), None)
    kind = active.kind if active else chances.strikes(uniforms[0]) if chances else None
    samples: NDArray[np.float64] | None = own
    if kind in ("dropout", "dead"):
        samples = None
    elif kind == "stuck":
        samples = state.last[sensor]
    elif kind == "zero":
        samples = np.zeros(array.samples)
    elif kind == "maximum":
        samples = np.full(array.samples, array.maximum)
    elif kind == "spike":
        samples = np.full(array.samples, _spike(array, uniforms[1]))
    elif kind == "second_echo":
        samples = firing_samples(array, 2.0 * distance, noise=noise)
    elif kind == "crosstalk":
        samples = state.last[array.order[array.order.index(sensor) - 1]]
    elif kind == "delay" and active is not None:
        m = _delay_firings(array, active)
        began = time - m * array.cycle >= active.start_s - _SLACK
        samples = state.history[sensor, m - 1] if began else None
    last, history = state.last.copy(), state.history.copy()
    history[sensor] = np.vstack((own, history[sensor, :-1]))
    if samples is not None:
        last[sensor] = samples
    return samples, FaultState(last, history)


def _acts(array: SonarArray, fault: Fault, time: float) -> bool:
    return fault.start_s - _SLACK <= time < _fault_end(array, fault) - _SLACK


def _spike(array: SonarArray, uniform: float) -> float:
    # from the lowest reading to the maximum, rounded to a conversion step
    value, top = array.lowest + uniform * (array.maximum - array.lowest), array.top_code
    return floor(value * top / array.maximum + 0.5) * array.maximum / top


SLOT = 5
"""Number of values that describe one fault: code of kind (0: none), sensor, start [s], end [s], delay [firings]."""

_NEVER = 1e30  # s


class Arrival(NamedTuple):
    """The result of `faulty_samples`, as CasADi SX expressions."""

    samples: ca.SX
    """(samples, 1) samples of the firing [m]; if none arrive, the samples that arrived last from the sensor."""
    arrived: ca.SX
    """1 if samples arrive, else 0."""
    state: dict[str, ca.SX]
    """Next state: value of each entry, by name."""


def fault_slots(array: SonarArray, faults: Sequence[Fault], count: int) -> NDArray[np.float64]:
    """Return the faults as an array (count, SLOT), one fault per row in the given order; unused rows are 0.

    Raises:
        InputError: if there are more than `count` faults, or a fault is impossible for the array.

    Example:
        >>> from surctl.marine.sensing import Fault, SonarArray, fault_slots
        >>> fault = Fault(sensor=1, kind="dropout", start_s=2.0, duration_s=0.5)
        >>> fault_slots(SonarArray(), [fault], 2).tolist()  # kind, sensor, start, end, delay
        [[1.0, 1.0, 2.0, 2.5, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0]]
    """
    if len(faults) > count:
        raise InputError(
            f"{len(faults)} are given, but at most {count} are possible", key="faults", remedy="give fewer"
        )
    check_faults(array, faults)
    slots = np.zeros((count, SLOT))
    for k, fault in enumerate(faults):
        end = min(_fault_end(array, fault), _NEVER)
        slots[k] = _code(fault.kind), fault.sensor, fault.start_s, end, _delay_firings(array, fault)
    return slots


def fault_ports(array: SonarArray, *, delays: bool, prefix: str = "") -> tuple[Port, ...]:
    """Return the entries (name, shape, initial value) of the fault state.

    The state consists of the samples that arrived last from each sensor and, with `delays`, of earlier samples. Each
    row of the earlier samples holds the samples of the last `LONGEST_DELAY` firings of one sensor, newest firing first.

    Example:
        >>> from surctl.marine.sensing import SonarArray, fault_ports
        >>> [(port.name, port.shape) for port in fault_ports(SonarArray(), delays=True)]  # 5 samples of 8 firings
        [('last', (4, 5)), ('history', (4, 40))]
    """
    n, samples, far = array.size, array.samples, array.maximum
    last = Port(f"{prefix}last", (n, samples), "m", "samples that arrived last from each sonar", far)
    if not delays:
        return (last,)
    meaning = "fault-free samples of each sonar's last firings, newest first"
    return (last, Port(f"{prefix}history", (n, LONGEST_DELAY * samples), "m", meaning, far))


def faulty_samples(
    array: SonarArray,
    state: Mapping[str, ca.SX],
    sensor: ca.SX,
    *,
    time: ca.SX,
    distance: ca.SX,
    noise: ca.SX,
    slots: ca.SX,
    chances: ca.SX,
    uniforms: ca.SX,
    delays: bool,
    prefix: str = "",
) -> Arrival:
    """Return the samples that arrive from one firing, and the next fault state; see `faulty`.

    Args:
        array: the sonar array.
        state: value of each entry of `fault_ports`, by name.
        sensor: index of the sensor that fires.
        time: time of the firing [s].
        distance: range to the nearest reflecting point [m], from `echo_range`.
        noise: (samples, 1) standard normal numbers.
        slots: (k, SLOT) scheduled faults from `fault_slots`; k may be 0.
        chances: (6, 1) probabilities of random faults, from `FaultChances.numbers`.
        uniforms: (2, 1) uniform numbers in (0, 1): the first selects the random fault, the second gives the value of a
            spike.
        delays: whether the state holds the samples of earlier firings; if not, no scheduled fault may be a delay.
        prefix: prefix of the names of the state's entries.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Layout
        >>> from surctl.marine.sensing import Fault, SonarArray, fault_ports, fault_slots, faulty_samples
        >>> array, time = SonarArray(samples=1), ca.SX.sym("time")
        >>> layout = Layout(fault_ports(array, delays=False))
        >>> slots = ca.SX(fault_slots(array, [Fault(sensor=0, kind="zero", start_s=1.0)], 1))
        >>> random = {"noise": ca.SX(0.0), "chances": ca.SX.zeros(6), "uniforms": ca.SX([0.5, 0.5])}
        >>> flat, state = layout.symbols()
        >>> one = {"distance": ca.SX(1.0), "slots": slots, "delays": False}
        >>> arrival = faulty_samples(array, state, ca.SX(0), time=time, **one, **random)
        >>> samples = ca.Function("samples", [flat, time], [arrival.samples])
        >>> samples(layout.pack(), 0.5), samples(layout.pack(), 1.5)
        (DM(1.00588), DM(0))
    """
    own = echo_samples(array, distance, noise=noise)
    last = state[f"{prefix}last"]
    kind, late, start = _active_fault(slots, sensor, time)
    kind = ca.if_else(kind > 0, kind, _struck(chances, uniforms[0]))
    before = [array.order[array.order.index(i) - 1] for i in range(array.size)]
    mine = _row(sensor, [last[i, :].T for i in range(array.size)])
    choices: dict[FaultKind, ca.SX | float] = {
        "stuck": mine,
        "zero": 0.0,
        "maximum": array.maximum,
        "spike": _spike_symbols(array, uniforms[1]),
        "second_echo": echo_samples(array, 2.0 * distance, noise=noise),
        "crosstalk": _row(sensor, [last[i, :].T for i in before]),
    }
    samples = own
    for name, value in choices.items():
        samples = ca.if_else(kind == _code(name), value, samples)
    lost = ca.logic_or(kind == _code("dropout"), kind == _code("dead"))
    after = {}
    if delays:
        rows = [state[f"{prefix}history"][i, :].T for i in range(array.size)]
        delayed = kind == _code("delay")
        waiting = time - late * array.cycle < start - _SLACK
        lost = ca.logic_or(lost, ca.logic_and(delayed, waiting))
        history = _row(sensor, rows)
        old = [history[k * array.samples : (k + 1) * array.samples] for k in range(LONGEST_DELAY)]
        samples = ca.if_else(delayed, _row(late - 1, old), samples)
        shifted = ca.vertcat(own, history[: -array.samples])
        after[f"{prefix}history"] = ca.vertcat(*(ca.if_else(sensor == i, shifted, row).T for i, row in enumerate(rows)))
    samples = ca.if_else(lost, mine, samples)
    after[f"{prefix}last"] = ca.vertcat(*(ca.if_else(sensor == i, samples.T, last[i, :]) for i in range(array.size)))
    return Arrival(samples, ca.logic_not(lost), after)


def _active_fault(slots: ca.SX, sensor: ca.SX, time: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    # code, delay and start; code 0 if no fault is active
    kind, late, start = ca.SX(0), ca.SX(0), ca.SX(0)
    for k in reversed(range(slots.shape[0])):
        code, whose, begin, end, firings = (slots[k, j] for j in range(SLOT))
        acts = ca.logic_and(whose == sensor, ca.logic_and(time >= begin - _SLACK, time < end - _SLACK))
        kind, late, start = (ca.if_else(acts, new, old) for new, old in ((code, kind), (firings, late), (begin, start)))
    return kind, late, start


def _struck(chances: ca.SX, uniform: ca.SX) -> ca.SX:
    # code 0 if no fault occurs
    passed, code, below = ca.SX(0), ca.SX(0), ca.SX(0)
    for k, kind in enumerate(FaultChances.kinds()):
        passed = passed + chances[k]
        now = uniform < passed
        code = ca.if_else(ca.logic_and(now, ca.logic_not(below)), _code(kind), code)
        below = now
    return code


def _spike_symbols(array: SonarArray, uniform: ca.SX) -> ca.SX:
    value, top = array.lowest + uniform * (array.maximum - array.lowest), float(array.top_code)
    return ca.floor(value * top / array.maximum + 0.5) * array.maximum / top


def _row(index: ca.SX, rows: Sequence[ca.SX]) -> ca.SX:
    selected = rows[0]
    for k, row in enumerate(rows[1:], 1):
        selected = ca.if_else(index == k, row, selected)
    return selected


def _code(kind: FaultKind) -> int:
    return 1 + FAULT_KINDS.index(kind)
