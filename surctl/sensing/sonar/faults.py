"""What may be wrong with a sonar, and what then arrives of a firing.

Faults are told beforehand (`Fault`: which sensor, from when, how long) or strike by chance (`FaultChances`: a
probability per firing). One thing is wrong at a time: the first told fault that acts on the firing, else the one drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import floor, inf
from typing import Annotated, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from surctl.errors import InputError
from surctl.files import Strict
from surctl.sensing.sonar.array import SonarArray
from surctl.sensing.sonar.firing import firing_samples

__all__ = [
    "FAULT_KINDS",
    "LONGEST_DELAY",
    "Fault",
    "FaultChances",
    "FaultKind",
    "FaultState",
    "check_faults",
    "delay_firings",
    "fault_end",
    "fault_state",
    "faulty",
]

FaultKind: TypeAlias = Literal[
    "dropout", "dead", "stuck", "zero", "maximum", "spike", "second_echo", "crosstalk", "delay"
]
FAULT_KINDS: tuple[FaultKind, ...] = get_args(FaultKind)
LONGEST_DELAY = 8
"""Firings of a sensor that are remembered."""

SLACK = 1e-6
"""[s] of a fault's start and end: times are sums of steps."""

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Chance = Annotated[float, Field(ge=0, le=1)]


class Fault(Strict):
    """One fault of one sensor, from `start_s` on for `duration_s` (default: for ever; a spike: one firing).

    Kinds, by what arrives of a firing:
    `dropout` nothing. `dead` nothing, for ever. `stuck` what arrived last from this sensor, again and again (the
    maximum, when nothing ever did). `zero` 0.0. `maximum` the maximum. `spike` one wrong value, drawn evenly over the
    range. `second_echo` the echo after the next: twice the true range, beyond the maximum the maximum. `crosstalk`
    what arrived last from the sensor that fires just before. `delay` what was heard `delay_s` ago, rounded to m whole
    cycles of the sensor (halves up, at least one): nothing for m firings, then what was heard m firings ago; when it
    ends, what is under way is lost.
    """

    sensor: Annotated[int, Field(ge=0)]
    kind: FaultKind
    start_s: NotNegative = 0.0
    duration_s: Positive | None = None
    delay_s: Annotated[float, Field(ge=0.1, le=0.8)] | None = None

    @model_validator(mode="after")
    def _complete(self) -> Fault:
        if self.kind == "delay" and self.delay_s is None:
            raise ValueError("a delay needs delay_s; add 0.1 to 0.8")
        if self.kind != "delay" and self.delay_s is not None:
            raise ValueError(f'a {self.kind} fault takes no delay_s; remove it or write kind = "delay"')
        if self.kind == "dead" and self.duration_s is not None:
            raise ValueError('a dead sensor takes no duration_s; remove it or write kind = "dropout"')
        return self


class FaultChances(Strict):
    """Probability per firing, of every sensor, that a momentary fault strikes; at most one does."""

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
        """The probabilities in the order of `kinds`."""
        return tuple(getattr(self, kind) for kind in self.kinds())

    @classmethod
    @cache
    def kinds(cls) -> tuple[FaultKind, ...]:
        """The kinds that may strike by chance, in the order in which the drawn number passes them."""
        return tuple(kind for kind in FAULT_KINDS if kind in cls.model_fields)

    def strikes(self, uniform: float) -> FaultKind | None:
        """Which kind a uniform number in (0, 1) stands for, if any."""
        passed = 0.0
        for kind, chance in zip(self.kinds(), self.numbers, strict=True):
            passed += chance
            if uniform < passed:
                return kind
        return None


@dataclass(frozen=True, eq=False)
class FaultState:
    """What faults remember.

    Attributes:
        last: (n, samples) what arrived last from each sensor [m]; the maximum before anything did.
        history: (n, `LONGEST_DELAY`, samples) what each sensor heard in its last firings, newest first [m].
    """

    last: NDArray[np.float64]
    history: NDArray[np.float64]


def fault_state(array: SonarArray) -> FaultState:
    """The state before the first firing.

    Example:
        >>> from surctl.sensing import SonarArray, fault_state
        >>> state = fault_state(SonarArray())
        >>> state.last.shape, state.history.shape, float(state.last.min())  # m: as if nothing were in range
        ((4, 5), (4, 8, 5), 4.5)
    """
    n, samples = array.size, array.samples
    return FaultState(np.full((n, samples), array.maximum), np.full((n, LONGEST_DELAY, samples), array.maximum))


def check_faults(array: SonarArray, faults: Sequence[Fault], chances: FaultChances | None = None) -> None:
    """InputError for a fault that this array cannot have: an unknown sensor, too long a delay, crosstalk of one.

    Example:
        >>> from surctl.sensing import Fault, SonarArray, check_faults
        >>> check_faults(SonarArray(), [Fault(sensor=4, kind="dead")])
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: faults.0.sensor = 4: no such sensor; give 0 to 3
    """
    if chances is not None and chances.crosstalk > 0 and array.size == 1:
        raise InputError("a single sensor hears no other", key="chances.crosstalk", value=chances.crosstalk)
    for k, fault in enumerate(faults):
        if fault.sensor >= array.size:
            remedy = f"give 0 to {array.size - 1}"
            raise InputError("no such sensor", key=f"faults.{k}.sensor", value=fault.sensor, remedy=remedy)
        if fault.kind == "crosstalk" and array.size == 1:
            raise InputError("a single sensor hears no other", key=f"faults.{k}.kind", value=fault.kind)
        if delay_firings(array, fault) > LONGEST_DELAY:
            raise InputError(
                f"is longer than {LONGEST_DELAY} cycles of {array.cycle:g} s",
                key=f"faults.{k}.delay_s",
                value=fault.delay_s,
                remedy=f"at most {LONGEST_DELAY * array.cycle:g} s",
            )


def delay_firings(array: SonarArray, fault: Fault) -> int:
    """m: a fault's delay in firings of its sensor, 0 for the other kinds."""
    return 0 if fault.delay_s is None else max(1, floor(fault.delay_s / array.cycle + 0.5 + 1e-9))


def fault_end(array: SonarArray, fault: Fault) -> float:
    """When a fault is over [s]; inf when never."""
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
    """What arrives of a firing, (samples,) [m], or None for nothing, and the next state.

    Without a fault it is `firing_samples` of the distance. Every sensor is taken to fire once a cycle.

    Args:
        array: the array.
        state: of `fault_state`, or of the firing before.
        sensor: that fires.
        time: of the firing [s].
        distance: `true_range` [m].
        noise: (samples,) standard normal numbers.
        faults: told beforehand, checked by `check_faults`; of several that act on a firing the first counts.
        chances: what strikes by chance where none of them acts.
        uniforms: two numbers in (0, 1): which chance strikes, and the value of a spike, told or not.

    Raises:
        InputError: noise of another shape.

    Example:
        >>> import numpy as np
        >>> from surctl.sensing import Fault, SonarArray, fault_state, faulty
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
        m = delay_firings(array, active)
        began = time - m * array.cycle >= active.start_s - SLACK
        samples = state.history[sensor, m - 1] if began else None
    last, history = state.last.copy(), state.history.copy()
    history[sensor] = np.vstack((own, history[sensor, :-1]))
    if samples is not None:
        last[sensor] = samples
    return samples, FaultState(last, history)


def _acts(array: SonarArray, fault: Fault, time: float) -> bool:
    return fault.start_s - SLACK <= time < fault_end(array, fault) - SLACK


def _spike(array: SonarArray, uniform: float) -> float:
    """A value between the lowest reading and the maximum, on a conversion step."""
    value, top = array.lowest + uniform * (array.maximum - array.lowest), array.top_code
    return floor(value * top / array.maximum + 0.5) * array.maximum / top
