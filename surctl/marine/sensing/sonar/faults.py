"""Faults of a sonar: kinds, schedule, chances, refusals; the samples of a faulty firing in CasADi symbols.

A fault is scheduled for a sensor, a start time and a duration (`Fault`), or it is random with a probability per firing
(`FaultChances`). At most one fault acts on a firing: the first scheduled fault that is active, otherwise the random
fault.

The model omits the water surface and the vertical opening of a beam: cones are planar at the robot's depth. The caller
selects the obstacles that a beam meets at the robot's depth; in the closed loop, `Body.beside` selects these
obstacles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from math import floor, inf
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


def check_faults(array: SonarArray, faults: Sequence[Fault], chances: FaultChances | None = None) -> None:
    """Raise InputError if a fault is impossible: unknown sensor, too long a delay, crosstalk with a single sensor."""
    if chances is not None and chances.crosstalk > 0 and array.size == 1:
        raise InputError("crosstalk needs at least two sensors", key="chances.crosstalk", value=chances.crosstalk)
    for k, fault in enumerate(faults):
        if fault.sensor >= array.size:
            remedy = f"give 0 to {array.size - 1}"
            raise InputError("no such sensor", key=f"faults.{k}.sensor", value=fault.sensor, remedy=remedy)
        if fault.kind == "crosstalk" and array.size == 1:
            raise InputError("crosstalk needs at least two sensors", key=f"faults.{k}.kind", value=fault.kind)
        if _delay_firings(array, fault) > LONGEST_DELAY:
            problem = f"is longer than {LONGEST_DELAY} cycles of {array.cycle:g} s"
            remedy = f"give at most {LONGEST_DELAY * array.cycle:g} s"
            raise InputError(problem, key=f"faults.{k}.delay_s", value=fault.delay_s, remedy=remedy)


def _delay_firings(array: SonarArray, fault: Fault) -> int:
    """Return the delay of a fault as a number m of firings of its sensor; 0 if the fault is not a delay."""
    return 0 if fault.delay_s is None else max(1, floor(fault.delay_s / array.cycle + 0.5 + 1e-9))


def _fault_end(array: SonarArray, fault: Fault) -> float:
    """Return the time at which a fault ends [s]; inf if the fault never ends."""
    if fault.duration_s is None:
        return fault.start_s + array.cycle if fault.kind == "spike" else inf
    return fault.start_s + fault.duration_s


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
    """Return the faults as an array (count, SLOT), one fault per row in the given order; unused rows are 0."""
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
    """Return the samples that arrive from one firing, and the next fault state.

    Args:
        state: value of each entry of `fault_ports`, by name.
        distance: range to the nearest reflecting point [m], from `echo_range`.
        noise: (samples, 1) standard normal numbers.
        slots: (k, SLOT) scheduled faults from `fault_slots`; k may be 0.
        chances: (6, 1) probabilities of random faults, from `FaultChances.numbers`.
        uniforms: (2, 1) uniform numbers in (0, 1): the first selects the random fault, the second gives the value of a
            spike.
        delays: whether the state holds the samples of earlier firings; if not, no scheduled fault may be a delay.
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
