"""A step of `RangeTracker` up to the new reading: what surrounds a sensor, where its track has moved, what it heard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from surctl.sensing.ranging.elementwise import Elementwise, Value

__all__ = ["MOST_REPEATS", "Rules", "Scene", "Step", "StepInputs", "opened", "others", "robust", "sound"]

MOST_REPEATS = 9
"""Most repetitions of a sample set that are counted."""

_TURNING = 0.05  # rad/s; below it the beam counts as still
_SLIDING = 0.04  # m in a cycle, above the noise of an expected range
_NOISE = 2.25e-3  # m²/s³, of the rate: an obstacle that changes its speed by 0.15 m/s within a second
_NOISE_TURNING = 0.4  # m²/s³: nearest points slide along what the beam sweeps
_VARIANCE = 0.09  # m², largest of the range
_NEVER = 1e6  # s, rad


@dataclass(frozen=True, kw_only=True)
class Rules:
    """Numbers of the rules, SI units; see `RangeTracker`."""

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
        """Repetitions above which a sensor is stuck; none are counted where the noise cannot tell."""
        return max(self.repeats, 1) - 0.5

    @property
    def rate_variance(self) -> float:
        """Of a rate that is not known [m²/s²]."""
        return max(self.obstacle_speed, 0.05) ** 2


class StepInputs(NamedTuple):
    """Inputs of a step."""

    samples: list[Value]
    fresh: Value
    closing: Value
    expected: Value
    turn: Value
    others: list[tuple[Value, Value, Value]]
    """Of each other sensor: rate of its track [m/s], its newest reading and the one before [m]; see `others`."""


class Scene(NamedTuple):
    """What the rules share within a step: where the sensor stands with its surroundings and its stream."""

    fired: Value
    turning: Value
    follow: Value  # the beam turns, and the track is a known wall: it moves as the expected range does
    raw: Value  # the expected range as given
    wall: Value  # a known wall is in reach
    expected: Value  # held to the maximum
    tolerance: Value
    unsure: Value  # error of the expected range that the heading's brings [m]
    slide: Value  # by how much the expected range moved within a cycle, while the beam turns


class Step(NamedTuple):
    """A step in work: its state is a dictionary of its own and filled rule by rule."""

    op: Elementwise
    rules: Rules
    old: Mapping[str, Value]
    state: dict[str, Value]
    inputs: StepInputs
    scene: Scene


def opened(op: Elementwise, rules: Rules, old: Mapping[str, Value], inputs: StepInputs) -> Step:
    """The step with the state moved on, before the reading.

    Args:
        op: operations of symbols or of numbers.
        rules: numbers.
        old: state by unprefixed port name; a port with columns is a list of them.
        inputs: inputs.
    """
    scene = _scene(op, rules, old, inputs)
    return Step(op, rules, old, _moved(op, rules, old, inputs, scene), inputs, scene)


def _scene(op: Elementwise, rules: Rules, old: Mapping[str, Value], inputs: StepInputs) -> Scene:
    turning = op.size(inputs.turn) > _TURNING
    expected = op.least(op.most(inputs.expected, 0.0), rules.maximum)
    cycle = round(rules.due / rules.dt)
    before, earlier = (old["walls"][min(k * cycle, len(old["walls"])) - 1] for k in (1, 2))
    slide = op.most(op.size(expected - before), op.size(before - earlier), 0.5 * op.size(expected - earlier))
    slide = op.where(turning, slide, 0.0)
    unsure = rules.yaw_tolerance * slide / (rules.due * op.most(op.size(inputs.turn), _TURNING))
    return Scene(
        fired=inputs.fresh > 0.5,
        turning=turning,
        follow=op.both(turning, slide > _SLIDING, old["explained"] > 0.5, old["known"] > 0.5),
        raw=inputs.expected,
        wall=inputs.expected < rules.maximum,
        expected=expected,
        tolerance=rules.tolerance + 0.5 * slide + unsure,
        unsure=unsure,
        slide=slide,
    )


def _moved(
    op: Elementwise, rules: Rules, old: Mapping[str, Value], inputs: StepInputs, scene: Scene
) -> dict[str, Value]:
    """The state a step later without a reading."""
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
    # afterwards the bound grows by the obstacle's largest speed instead
    growing = old["age"] + dt <= rules.due + 0.5 * dt
    largest = op.where(scene.turning, 16.0, 1.0) * rules.rate_variance
    ahead = op.least(p11 + 2.0 * dt * p12 + dt * dt * p22 + noise * dt * dt / 3.0, _VARIANCE)
    faster = op.least(p22 + noise, largest)
    # a covariance matrix after its entries were capped, too
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
    """What each sensor is compared with, `Seen.others`: the sensors one place round, two places round, ..."""
    rate, newest, before = (
        old["rate"],
        op.where(fresh > 0.5, robust(op, rules, samples), old["reading"]),
        old["reading"],
    )
    turned = op.turned
    return [(turned(rate, k), turned(newest, k), turned(before, k)) for k in range(1, rules.sensors)]


def robust(op: Elementwise, rules: Rules, samples: list[Value]) -> Value:
    """Mean of a firing without its smallest and its largest sample [m]; the maximum where all read it."""
    total = samples[0]
    for value in samples[1:]:
        total = total + value
    count = len(samples)
    if count >= 3:
        total, count = total - op.least(*samples) - op.most(*samples), count - 2
    nothing = op.least(*samples) >= rules.maximum - 0.5 * rules.resolution
    return op.where(nothing, rules.maximum, op.least(op.most(total / count - rules.bias, 0.0), rules.maximum))


def sound(step: Step, reading: Value) -> Value:
    """Whether this firing's reading can be honest by itself; counts repetitions."""
    op, rules, old, state, inputs, scene = step
    code = rules.resolution
    differs = 0.0
    for new, before in zip(inputs.samples, old["samples"], strict=True):
        differs = differs + op.size(new - before)
    # at the ends of its range an honest sensor repeats itself
    same = op.both(differs < 0.25 * code, reading > rules.minimum + code, reading < rules.maximum - code)
    count = (
        op.where(same, op.least(old["repeated"] + 1.0, float(MOST_REPEATS)), 0.0) if rules.repeats else 0.0 * reading
    )
    state["repeated"] = op.where(scene.fired, count, old["repeated"])
    return op.both(
        scene.fired,
        state["repeated"] < (0.5 if rules.one_repeat else rules.stuck),
        reading >= rules.minimum - code,
        reading <= inputs.expected + scene.tolerance,
    )
