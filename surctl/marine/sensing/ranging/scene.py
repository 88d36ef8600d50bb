"""The first part of a `RangeTracker` step: prediction of the range estimates, and a check of the new reading.

Arithmetic and comparisons use the operators of the operands. This module contains the operations that Python cannot
overload for both CasADi symbols and NumPy arrays. Truth values come from comparisons; only `where`, `both`, `either`
and `no` take truth values as arguments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeAlias

import casadi as ca
import numpy as np

__all__ = [
    "MOST_REPEATS",
    "NUMBERS",
    "SYMBOLS",
    "Elementwise",
    "Rules",
    "Scene",
    "Step",
    "StepInputs",
    "Value",
    "opened",
    "others",
    "robust",
    "sound",
]

Value: TypeAlias = Any
"""An SX column (n, 1) or an array (..., n); a float stands for n equal numbers."""


class Elementwise(Protocol):
    """Operations on values, element by element."""

    def where(self, condition: Value, yes: Value, other: Value) -> Value:
        """Return `yes` where the condition holds, otherwise `other`; `yes` and `other` must be finite."""

    def both(self, *conditions: Value) -> Value:
        """Return a truth value: whether all conditions hold."""

    def either(self, *conditions: Value) -> Value:
        """Return a truth value: whether at least one condition holds."""

    def no(self, condition: Value) -> Value:
        """Return a truth value: whether the condition does not hold."""

    def least(self, *values: Value) -> Value:
        """Return the smallest of the values."""

    def most(self, *values: Value) -> Value:
        """Return the largest of the values."""

    def size(self, value: Value) -> Value:
        """Return the absolute value."""

    def root(self, value: Value) -> Value:
        """Return the square root of a value that is at least 0."""

    def floor(self, value: Value) -> Value:
        """Return the largest whole number that is not above the value."""

    def turned(self, value: Value, by: int) -> Value:
        """Return the elements (sensors) rotated by `by` places: new element i is old element i + by."""


class _Symbols:
    def where(self, condition: Value, yes: Value, other: Value) -> Value:
        return ca.if_else(condition, yes, other)

    def both(self, *conditions: Value) -> Value:
        result = conditions[0]
        for other in conditions[1:]:
            result = ca.logic_and(result, other)
        return result

    def either(self, *conditions: Value) -> Value:
        result = conditions[0]
        for other in conditions[1:]:
            result = ca.logic_or(result, other)
        return result

    def no(self, condition: Value) -> Value:
        return ca.logic_not(condition)

    def least(self, *values: Value) -> Value:
        result = values[0]
        for other in values[1:]:
            result = ca.fmin(result, other)
        return result

    def most(self, *values: Value) -> Value:
        result = values[0]
        for other in values[1:]:
            result = ca.fmax(result, other)
        return result

    def size(self, value: Value) -> Value:
        return ca.fabs(value)

    def root(self, value: Value) -> Value:
        return ca.sqrt(value)

    def floor(self, value: Value) -> Value:
        return ca.floor(value)

    def turned(self, value: Value, by: int) -> Value:
        return ca.vertcat(value[by:], value[:by])


class _Numbers:
    def where(self, condition: Value, yes: Value, other: Value) -> Value:
        return np.where(condition, yes, other)

    def both(self, *conditions: Value) -> Value:
        result = conditions[0]
        for other in conditions[1:]:
            result = np.logical_and(result, other)
        return result

    def either(self, *conditions: Value) -> Value:
        result = conditions[0]
        for other in conditions[1:]:
            result = np.logical_or(result, other)
        return result

    def no(self, condition: Value) -> Value:
        return np.logical_not(condition)

    def least(self, *values: Value) -> Value:
        result = values[0]
        for other in values[1:]:
            result = np.minimum(result, other)
        return result

    def most(self, *values: Value) -> Value:
        result = values[0]
        for other in values[1:]:
            result = np.maximum(result, other)
        return result

    def size(self, value: Value) -> Value:
        return np.abs(value)

    def root(self, value: Value) -> Value:
        return np.sqrt(value)

    def floor(self, value: Value) -> Value:
        return np.floor(value)

    def turned(self, value: Value, by: int) -> Value:
        return np.roll(value, -by, axis=-1)


SYMBOLS: Elementwise = _Symbols()
NUMBERS: Elementwise = _Numbers()


MOST_REPEATS = 9
"""Largest count of repetitions of a firing's samples; further repetitions are not counted."""

_TURNING = 0.05  # rad/s; at a lower rate the beam counts as not turning
_SLIDING = 0.04  # m per cycle, above the noise of an expected range
_NOISE = 2.25e-3  # m²/s³, noise of the rate, for an obstacle that changes its speed by 0.15 m/s within a second
_NOISE_TURNING = 0.4  # m²/s³, noise of the rate while turning: the nearest point slides along objects
_VARIANCE = 0.09  # m², largest variance of the range
_NEVER = 1e6  # s, rad


@dataclass(frozen=True, kw_only=True)
class Rules:
    """The parameters of the tracker's rules in SI units; see `RangeTracker`."""

    dt: float
    due: float
    minimum: float
    maximum: float
    resolution: float
    bias: float
    sigma: float
    beam: float
    sensors: int
    obstacle_speed: float
    tolerance: float
    yaw_tolerance: float
    longest_delay: float
    hold: float
    repeats: int
    one_repeat: bool

    @property
    def stuck(self) -> float:
        """Number of repetitions of a firing's samples above which a sensor counts as stuck."""
        return max(self.repeats, 1) - 0.5

    @property
    def rate_variance(self) -> float:
        """Variance of the rate of the range [m²/s²] before any estimate of the rate."""
        return max(self.obstacle_speed, 0.05) ** 2


class StepInputs(NamedTuple):
    """The inputs of a tracker step."""

    samples: list[Value]
    fresh: Value
    closing: Value
    expected: Value
    longest: Value
    turn: Value
    others: list[tuple[Value, Value, Value]]
    """For each other sensor: rate of the estimated range [m/s], newest and previous reading [m]; see `others`."""


class Scene(NamedTuple):
    """Values that all rules use in a step: motion of the beam, and range that the known walls give, with tolerances."""

    fired: Value
    turning: Value
    follow: Value  # the beam turns and the track is a known wall, so the track moves with the expected range
    longest: Value  # range at which a known wall surely answers, not limited
    ceiling: Value  # the same, limited to the maximum
    wall: Value  # a known wall is within the maximum range
    expected: Value  # expected range, limited to the maximum
    tolerance: Value
    unsure: Value  # error of the expected range due to the error of the heading [m]
    slide: Value  # change of the expected range within a cycle while the beam turns [m]


class Step(NamedTuple):
    """A tracker step in progress; the rules, one after another, change `state`, which begins as a copy of `old`."""

    op: Elementwise
    rules: Rules
    old: Mapping[str, Value]
    state: dict[str, Value]
    inputs: StepInputs
    scene: Scene


def opened(op: Elementwise, rules: Rules, old: Mapping[str, Value], inputs: StepInputs) -> Step:
    """Return the tracker step after the prediction of the state to the present, and before the use of the new reading.

    Args:
        op: operations on symbols or on numbers.
        rules: parameters of the rules.
        old: value of each entry of the previous state, by name without prefix; the value of an entry with several
            columns is a list of columns.
        inputs: inputs of the step.
    """
    scene = _scene(op, rules, old, inputs)
    return Step(op, rules, old, _moved(op, rules, old, inputs, scene), inputs, scene)


def _scene(op: Elementwise, rules: Rules, old: Mapping[str, Value], inputs: StepInputs) -> Scene:
    turning = op.size(inputs.turn) > _TURNING
    expected = op.least(op.most(inputs.expected, 0.0), rules.maximum)
    same = inputs.longest is inputs.expected
    ceiling = expected if same else op.least(op.most(inputs.longest, 0.0), rules.maximum)
    cycle = round(rules.due / rules.dt)
    before, earlier = (old["walls"][min(k * cycle, len(old["walls"])) - 1] for k in (1, 2))
    slide = op.most(op.size(expected - before), op.size(before - earlier), 0.5 * op.size(expected - earlier))
    slide = op.where(turning, slide, 0.0)
    unsure = rules.yaw_tolerance * slide / (rules.due * op.most(op.size(inputs.turn), _TURNING))
    return Scene(
        fired=inputs.fresh > 0.5,
        turning=turning,
        follow=op.both(turning, slide > _SLIDING, old["explained"] > 0.5, old["known"] > 0.5),
        longest=inputs.longest,
        ceiling=ceiling,
        wall=inputs.expected < rules.maximum,
        expected=expected,
        tolerance=rules.tolerance + 0.5 * slide + unsure,
        unsure=unsure,
        slide=slide,
    )


def _moved(
    op: Elementwise, rules: Rules, old: Mapping[str, Value], inputs: StepInputs, scene: Scene
) -> dict[str, Value]:
    # without a new reading
    dt, top = rules.dt, rules.maximum - 0.5 * rules.resolution
    state = dict(old)
    own = -inputs.closing * dt
    known = op.where(scene.follow, scene.expected - old["walls"][0], op.where(old["range"] >= top, 0.0, own))
    coasting = op.both(
        op.no(scene.follow),
        old["votes"] < 0.5,
        old["rejected"] < 0.5,
        old["since"] + dt <= rules.due + 0.5 * dt,
        old["late_by"] <= 0.0,
    )
    drift = op.where(coasting, old["rate"] * dt, 0.0)
    noise = op.where(scene.turning, _NOISE_TURNING, _NOISE) * dt
    p11, p12, p22 = old["var_range"], old["covariance"], old["var_rate"]
    state["range"] = op.least(op.most(old["range"] + known + drift, 0.0), rules.maximum)
    # when a reading is overdue, the bound grows with the obstacle's largest speed instead
    growing = old["age"] + dt <= rules.due + 0.5 * dt
    largest = op.where(scene.turning, 16.0, 1.0) * rules.rate_variance
    ahead = op.least(p11 + 2.0 * dt * p12 + dt * dt * p22 + noise * dt * dt / 3.0, _VARIANCE)
    faster = op.least(p22 + noise, largest)
    # keeps the covariance matrix positive definite after its entries were limited
    limit = 0.99 * op.root(op.most(ahead * faster, 0.0))
    both = op.least(op.most(p12 + dt * p22 + 0.5 * noise * dt, -limit), limit)
    state["var_range"] = op.where(growing, ahead, p11)
    state["covariance"] = op.where(growing, both, p12)
    state["var_rate"] = op.where(growing, faster, p22)
    state["candidate"] = op.where(old["candidate"] >= top, old["candidate"], op.most(old["candidate"] + own, 0.0))
    state["recent"] = [op.most(value + own, 0.0) for value in old["recent"]]
    state["since"] = op.least(old["since"] + dt, _NEVER)
    state["age"] = op.least(old["age"] + dt, _NEVER)
    state["turned"] = op.least(old["turned"] + op.size(inputs.turn) * dt, _NEVER)
    state["swung"] = op.least(op.most(old["swung"] + inputs.turn * dt, -_NEVER), _NEVER)
    state["shifts"] = [-known, *(value - known for value in old["shifts"][:-1])]
    state["walls"] = [scene.expected + 0.0 * own, *old["walls"][:-1]]
    return state


def others(
    op: Elementwise, rules: Rules, old: Mapping[str, Value], samples: list[Value], fresh: Value
) -> list[tuple[Value, Value, Value]]:
    """Return `StepInputs.others` for all sensors; the entries for sensor i describe sensors i + 1, i + 2, …"""
    rate, newest, before = (
        old["rate"],
        op.where(fresh > 0.5, robust(op, rules, samples), old["reading"]),
        old["reading"],
    )
    turned = op.turned
    return [(turned(rate, k), turned(newest, k), turned(before, k)) for k in range(1, rules.sensors)]


def robust(op: Elementwise, rules: Rules, samples: list[Value]) -> Value:
    """Return the mean [m] of a firing's samples without the smallest and the largest sample.

    If all samples equal the maximum, the result is the maximum.
    """
    total = samples[0]
    for value in samples[1:]:
        total = total + value
    count = len(samples)
    if count >= 3:
        total, count = total - op.least(*samples) - op.most(*samples), count - 2
    nothing = op.least(*samples) >= rules.maximum - 0.5 * rules.resolution
    return op.where(nothing, rules.maximum, op.least(op.most(total / count - rules.bias, 0.0), rules.maximum))


def sound(step: Step, reading: Value) -> Value:
    """Return whether the reading of this firing is plausible by itself, and count repetitions of the same samples."""
    op, rules, old, state, inputs, scene = step
    code = rules.resolution
    differs = 0.0
    for new, before in zip(inputs.samples, old["samples"], strict=True):
        differs = differs + op.size(new - before)
    # at the ends of its range, a working sensor also repeats its samples
    same = op.both(differs < 0.25 * code, reading > rules.minimum + code, reading < rules.maximum - code)
    count = (
        op.where(same, op.least(old["repeated"] + 1.0, float(MOST_REPEATS)), 0.0) if rules.repeats else 0.0 * reading
    )
    state["repeated"] = op.where(scene.fired, count, old["repeated"])
    return op.both(
        scene.fired,
        state["repeated"] < (0.5 if rules.one_repeat else rules.stuck),
        reading >= rules.minimum - code,
        reading <= inputs.longest + scene.tolerance,
    )
