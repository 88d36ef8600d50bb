"""Faults of a sonar, and the samples that arrive from a firing when a fault acts on it.

A fault is scheduled for a sensor, a start time and a duration (`Fault`), or it is random with a probability per firing
(`FaultChances`). At most one fault acts on a firing: the first scheduled fault that is active, otherwise the random
fault.
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
from surctl.marine.sensing.sonar.array import SonarArray
from surctl.marine.sensing.sonar.firing import firing_samples

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
"""Largest delay of a fault, in firings of its sensor."""

SLACK = 1e-6
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
        if delay_firings(array, fault) > LONGEST_DELAY:
            raise InputError(
                f"is longer than {LONGEST_DELAY} cycles of {array.cycle:g} s",
                key=f"faults.{k}.delay_s",
                value=fault.delay_s,
                remedy=f"give at most {LONGEST_DELAY * array.cycle:g} s",
            )


def delay_firings(array: SonarArray, fault: Fault) -> int:
    """Return the delay of a fault as a number m of firings of its sensor; 0 if the fault is not a delay."""
    return 0 if fault.delay_s is None else max(1, floor(fault.delay_s / array.cycle + 0.5 + 1e-9))


def fault_end(array: SonarArray, fault: Fault) -> float:
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
    # from the lowest reading to the maximum, rounded to a conversion step
    value, top = array.lowest + uniform * (array.maximum - array.lowest), array.top_code
    return floor(value * top / array.maximum + 0.5) * array.maximum / top
