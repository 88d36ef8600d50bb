"""Rules of the range tracker: which readings are believed, suspected, late, stuck or crosstalk; error bound, health.

A track is the estimated range and rate of the nearest object of a sensor. In each step, the robot's own motion moves
the track. If the new reading is plausible and agrees with the track, the reading updates the track. Otherwise the
reading is stored as a candidate; with enough evidence, the candidate becomes the track. While the readings disagree
with the track, the interval that shall contain the true range is wider.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import add
from typing import Any, NamedTuple, TypeAlias

import casadi as ca

from surctl.ir import picked, tabulated
from surctl.marine.sensing.ranging.parameters import MOST_REPEATS, NEVER, TrackerParameters

Value: TypeAlias = Any
"""An SX of one sensor, or a column (n, 1) of n sensors; a float stands for n equal numbers."""


def _both(*conditions: Value) -> Value:
    return reduce(ca.logic_and, conditions)


def _either(*conditions: Value) -> Value:
    return reduce(ca.logic_or, conditions)


def _least(*values: Value) -> Value:
    return reduce(ca.fmin, values)


def _most(*values: Value) -> Value:
    return reduce(ca.fmax, values)


_TURNING = 0.05  # rad/s; at a lower rate the beam counts as not turning
_SLIDING = 0.04  # m per cycle, above the noise of an expected range
_NOISE = 2.25e-3  # m²/s³, noise of the rate, for an obstacle that changes its speed by 0.15 m/s within a second
_NOISE_TURNING = 0.4  # m²/s³, noise of the rate while turning: the nearest point slides along objects
_VARIANCE = 0.09  # m², largest variance of the range


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

    tracker: TrackerParameters
    old: Mapping[str, Value]
    state: dict[str, Value]
    inputs: StepInputs
    scene: Scene


def opened(tracker: TrackerParameters, old: Mapping[str, Value], inputs: StepInputs) -> Step:
    """Return the tracker step after the prediction of the state to the present, and before the use of the new reading.

    `old` has each entry of the previous state by name without prefix, with a list of columns for several ones.
    """
    scene = _scene(tracker, old, inputs)
    return Step(tracker, old, _moved(tracker, old, inputs, scene), inputs, scene)


def _scene(tracker: TrackerParameters, old: Mapping[str, Value], inputs: StepInputs) -> Scene:
    turning = ca.fabs(inputs.turn) > _TURNING
    expected = _least(_most(inputs.expected, 0.0), tracker.array.maximum)
    same = inputs.longest is inputs.expected
    ceiling = expected if same else _least(_most(inputs.longest, 0.0), tracker.array.maximum)
    cycle = round(tracker.due / tracker.dt)
    before, earlier = (old["walls"][min(k * cycle, len(old["walls"])) - 1] for k in (1, 2))
    slide = _most(ca.fabs(expected - before), ca.fabs(before - earlier), 0.5 * ca.fabs(expected - earlier))
    slide = ca.if_else(turning, slide, 0.0)
    unsure = tracker.yaw_tolerance * slide / (tracker.due * _most(ca.fabs(inputs.turn), _TURNING))
    return Scene(
        fired=inputs.fresh > 0.5,
        turning=turning,
        follow=_both(turning, slide > _SLIDING, old["explained"] > 0.5, old["known"] > 0.5),
        longest=inputs.longest,
        ceiling=ceiling,
        wall=inputs.expected < tracker.array.maximum,
        expected=expected,
        tolerance=tracker.tolerance + 0.5 * slide + unsure,
        unsure=unsure,
        slide=slide,
    )


def _moved(tracker: TrackerParameters, old: Mapping[str, Value], inputs: StepInputs, scene: Scene) -> dict[str, Value]:
    # without a new reading
    dt, top = tracker.dt, tracker.array.maximum - 0.5 * tracker.array.resolution
    state = dict(old)
    own = -inputs.closing * dt
    known = ca.if_else(scene.follow, scene.expected - old["walls"][0], ca.if_else(old["range"] >= top, 0.0, own))
    coasting = _both(
        ca.logic_not(scene.follow),
        old["votes"] < 0.5,
        old["rejected"] < 0.5,
        old["since"] + dt <= tracker.due + 0.5 * dt,
        old["late_by"] <= 0.0,
    )
    drift = ca.if_else(coasting, old["rate"] * dt, 0.0)
    noise = ca.if_else(scene.turning, _NOISE_TURNING, _NOISE) * dt
    p11, p12, p22 = old["var_range"], old["covariance"], old["var_rate"]
    state["range"] = _least(_most(old["range"] + known + drift, 0.0), tracker.array.maximum)
    # when a reading is overdue, the bound grows with the obstacle's largest speed instead
    growing = old["age"] + dt <= tracker.due + 0.5 * dt
    largest = ca.if_else(scene.turning, 16.0, 1.0) * tracker.rate_variance
    ahead = _least(p11 + 2.0 * dt * p12 + dt * dt * p22 + noise * dt * dt / 3.0, _VARIANCE)
    faster = _least(p22 + noise, largest)
    # keeps the covariance matrix positive definite after its entries were limited
    limit = 0.99 * ca.sqrt(_most(ahead * faster, 0.0))
    covariance = _least(_most(p12 + dt * p22 + 0.5 * noise * dt, -limit), limit)
    state["var_range"] = ca.if_else(growing, ahead, p11)
    state["covariance"] = ca.if_else(growing, covariance, p12)
    state["var_rate"] = ca.if_else(growing, faster, p22)
    state["candidate"] = ca.if_else(old["candidate"] >= top, old["candidate"], _most(old["candidate"] + own, 0.0))
    state["recent"] = [_most(value + own, 0.0) for value in old["recent"]]
    state["since"] = _least(old["since"] + dt, NEVER)
    state["age"] = _least(old["age"] + dt, NEVER)
    state["turned"] = _least(old["turned"] + ca.fabs(inputs.turn) * dt, NEVER)
    state["swung"] = _least(_most(old["swung"] + inputs.turn * dt, -NEVER), NEVER)
    state["shifts"] = [-known, *(value - known for value in old["shifts"][:-1])]
    state["walls"] = [scene.expected + 0.0 * own, *old["walls"][:-1]]
    return state


def others(tracker: TrackerParameters, old: Mapping[str, Value], newest: Value) -> list[tuple[Value, Value, Value]]:
    """Return `StepInputs.others` for all sensors; the entries for sensor i describe sensors i + 1, i + 2, …"""

    def turned(value: Value, k: int) -> Value:
        return ca.vertcat(value[k:], value[:k])

    rate, before = old["rate"], old["reading"]
    return [(turned(rate, k), turned(newest, k), turned(before, k)) for k in range(1, tracker.array.size)]


def robust(tracker: TrackerParameters, samples: list[Value]) -> Value:
    """Return the mean [m] of a firing's samples without the smallest and the largest sample.

    If all samples equal the maximum, the result is the maximum.
    """
    total, count = reduce(add, samples), len(samples)
    if count >= 3:
        total, count = total - _least(*samples) - _most(*samples), count - 2
    nothing = _least(*samples) >= tracker.array.maximum - 0.5 * tracker.array.resolution
    return ca.if_else(
        nothing, tracker.array.maximum, _least(_most(total / count - tracker.array.bias, 0.0), tracker.array.maximum)
    )


def sound(step: Step, reading: Value) -> Value:
    """Return whether the reading of this firing is plausible by itself, and count repetitions of the same samples."""
    tracker, old, state, inputs, scene = step
    code = tracker.array.resolution
    differs = 0.0
    for new, before in zip(inputs.samples, old["samples"], strict=True):
        differs = differs + ca.fabs(new - before)
    # at the ends of its range, a working sensor also repeats its samples
    same = _both(differs < 0.25 * code, reading > tracker.array.minimum + code, reading < tracker.array.maximum - code)
    count = (
        ca.if_else(same, _least(old["repeated"] + 1.0, float(MOST_REPEATS)), 0.0) if tracker.repeats else 0.0 * reading
    )
    state["repeated"] = ca.if_else(scene.fired, count, old["repeated"])
    return _both(
        scene.fired,
        state["repeated"] < (0.5 if tracker.one_repeat else tracker.stuck),
        reading >= tracker.array.minimum - code,
        reading <= inputs.longest + scene.tolerance,
    )


_SMALL, _TELLING, _TELLING_WALL = 0.025, 0.035, 0.05  # m, least shift that matters, and that can show a delay
_TRACK_SPREAD, _WALL_SPREAD = 0.012, 0.02  # m, standard deviation of residuals from the old track and expected range
_TRACK_GATE = _WALL_GATE = 0.05  # m
_EVIDENCE, _LOOKS, _LOOKS_WALL = 60.0, 4, 6  # needed for a decision: sum of shift²/variance, numbers of readings
_FORGET = 0.95  # factor on the old evidence at each new reading


class _Late(NamedTuple):
    """The result of the test for late readings at one step."""

    late_by: Value
    late: Value
    away: Value  # a late reading minus the present range
    undecided: Value  # the test has no decision yet, and the shift is large enough to matter
    judging: Value  # this reading is evidence for the test and does not update the track


def _lateness(step: Step, sound: Value, reading: Value) -> _Late:
    """Test whether readings after a gap are late by the duration of the gap.

    A late reading is the range at an earlier time, `late_by` before the present. It differs from the present range by a
    shift, which is computed from the known walls or from the robot's own motion. The regression coefficient on the
    shift, of the difference of the readings from the known walls' range or from the track (the estimate before the
    gap), is 0 for readings without delay and 1 for late readings.
    """
    tracker, old, state, _, scene = step
    missing = ca.floor(state["since"] / tracker.due + 0.5) - 1.0
    lost = missing * tracker.due
    gap = _both(scene.fired, missing > 0.5, lost <= tracker.longest_delay + 0.5 * tracker.dt, state["known"] > 0.5)
    late_by = ca.if_else(gap, _most(old["late_by"], lost), old["late_by"])
    ago: Value = late_by / tracker.dt + 0.5
    history = zip(state["shifts"], state["walls"][1:], strict=True)
    then = picked("earlier", tabulated(history), ago - 1.0)
    then = ca.if_else(_both(ago >= 1.0, ago < 1.0 + len(state["shifts"])), then, ca.vertcat(0.0, scene.expected))
    away, wall_then = then[0], then[1]
    late = _both(old["late"] > 0.5, ca.logic_not(gap), ca.fabs(away) > 0.4 * _SMALL)
    suspected = _both(late_by > 0.0, ca.logic_not(late))
    distinct = ca.fabs(wall_then - scene.expected) > _TELLING_WALL + scene.unsure
    by_wall = _both(scene.wall, wall_then < tracker.array.maximum, distinct)
    shift = ca.if_else(by_wall, wall_then - scene.expected, away - old["absorbed"])
    residual = reading - ca.if_else(by_wall, scene.expected, state["range"])
    spread = ca.if_else(by_wall, _WALL_SPREAD + scene.unsure / 3.0, _TRACK_SPREAD)
    telling = _both(suspected, _either(by_wall, _both(ca.fabs(shift) > _TELLING, ca.logic_not(scene.turning))))
    gate = ca.if_else(by_wall, _WALL_GATE + scene.unsure, _TRACK_GATE + 0.25 * ca.fabs(shift))
    fits = _either(ca.fabs(residual) <= gate, ca.fabs(residual - shift) <= gate)
    judging = _both(sound, telling, fits, _either(by_wall, state["votes"] < 0.5))
    # an object lies in front of the wall
    elsewhere = _both(sound, telling, by_wall, ca.logic_not(fits))
    weight = 1.0 / (spread * spread)
    cross = ca.if_else(judging, _FORGET * old["cross"] + residual * shift * weight, old["cross"])
    power = ca.if_else(judging, _FORGET * old["power"] + shift * shift * weight, old["power"])
    looks = ca.if_else(judging, old["looks"] + 1.0, old["looks"])
    decided = _both(looks > ca.if_else(by_wall, _LOOKS_WALL, _LOOKS) - 0.5, power >= _EVIDENCE)
    true = _both(decided, cross < 0.5 * power)
    late = _either(late, _both(decided, cross >= 0.5 * power))
    afresh = _either(gap, decided, elsewhere)
    state["cross"] = ca.if_else(afresh, 0.0, cross)
    state["power"] = ca.if_else(afresh, 0.0, power)
    state["looks"] = ca.if_else(afresh, 0.0, looks)
    state["late_by"] = ca.if_else(true, 0.0, late_by)
    state["late"] = ca.if_else(late, 1.0, 0.0)
    state["absorbed"] = ca.if_else(_either(true, late, late_by <= 0.0), 0.0, old["absorbed"])
    suspected = _both(suspected, ca.logic_not(true), ca.logic_not(late))
    return _Late(
        late_by=state["late_by"],
        late=late,
        away=ca.if_else(state["late_by"] > 0.0, away, 0.0),
        undecided=_both(suspected, ca.fabs(away) > _SMALL),
        judging=_both(judging, ca.logic_not(true), ca.logic_not(by_wall)),
    )


_UNSEEN = 0.03  # rad; after a larger turn since the track's last reading, the track does not describe the present beam
_STALE = 0.2  # rad; after a larger turn since the track's last reading, a reading is near the track only by chance
_GATE = 4.0  # standard deviations
_GATE_LEAST, _GATE_MOST, _GATE_TURNING = 0.05, 0.10, 0.35  # m
_SAME, _SAME_TURNING = 0.06, 0.16  # m, largest difference of consecutive readings of a candidate, without own motion
_VOTES = 3  # consecutive readings after which a candidate becomes the track
_CLEARING = 16  # consecutive readings of a candidate without suspicion that end the suspicion of an earlier reading
_VOTES_AFTER_FAULT = 8  # more readings than a wall gives that the beam passes by chance
_MARGIN, _DEVIATIONS = 0.015, 3.5  # m and standard deviations in the bound of a healthy sensor
_CANDIDATE = 0.04  # m, half-width of the interval around a candidate
_TWICE = 0.1  # m, largest difference between a second echo and twice the range
_CROSS = 0.05  # m, largest difference between crosstalk and the other sensor's reading
_BEARABLE = 0.05  # m, largest shift of a possibly late stream with which a sensor is healthy
_CAUTIOUS = 0.1  # factor on the innovation while a stream may be late
_CALM = 0.6  # part of a surprise that remains after the next reading
_SURPRISING, _SURPRISING_TURNING = 2.5, 0.5  # standard deviations; a larger innovation is a surprise


class _Compared(NamedTuple):
    # comparison of a reading with the track, the known walls and the other sensors
    corrected: Value  # [m], the reading; if it is late, minus its shift
    innovation: Value  # [m], difference from the track
    agrees: Value  # whether the reading agrees with the known walls
    crosstalk: Value  # whether the reading equals another sensor's reading
    near: Value  # whether the reading belongs to the track


def range_step(
    tracker: TrackerParameters, old: Mapping[str, Value], inputs: StepInputs
) -> tuple[dict[str, Value], tuple[Value, ...]]:
    """Return the next state, and the outputs range, bound, rate, healthy, age, reading, accepted, carve of `Ranging`.

    `old` is as for `opened`.
    """
    step = opened(tracker, old, inputs)
    reading = robust(tracker, inputs.samples)
    fine = sound(step, reading)
    late = _lateness(step, fine, reading)
    believed = _believed(step, late, fine, reading)
    _record(step, reading)
    return step.state, _outputs(step, late, believed)


def _compared(step: Step, late: _Late, fine: Value, reading: Value) -> _Compared:
    tracker, _, state, _, scene = step
    x, known = state["range"], state["known"] > 0.5
    corrected = ca.if_else(late.late, _least(_most(reading - late.away, 0.0), tracker.array.maximum), reading)
    innovation = corrected - x
    spread = ca.sqrt(_most(state["var_range"], 0.0) + tracker.sigma * tracker.sigma)
    widest = ca.if_else(scene.turning, _GATE_TURNING, _GATE_MOST)
    # smaller than the distance to a second echo
    gate = _most(_least(_GATE * spread, widest, 0.5 * x), _GATE_LEAST)
    off = ca.fabs(corrected - scene.expected)
    agrees = _both(scene.wall, off <= tracker.tolerance + scene.unsure)
    closely = _both(scene.wall, off <= 0.5 * (tracker.tolerance + scene.unsure))
    agrees = ca.if_else(state["distrust"] > 0.5, closely, agrees)
    there = _both(known, _either(state["turned"] <= _STALE, _both(agrees, state["distrust"] < 0.5)))
    # readings of a candidate that cross the track by chance do not update the track
    crossing = _both(state["votes"] > 0.5, ca.fabs(corrected - state["candidate"]) <= _SAME)
    crosstalk = _crosstalk(step, corrected)
    foreign = _both(crosstalk, scene.turning, ca.logic_not(agrees))
    within = ca.fabs(innovation) <= ca.if_else(late.judging, tracker.array.maximum, gate)
    near = _both(fine, there, ca.logic_not(crossing), ca.logic_not(foreign), within)
    return _Compared(corrected, innovation, agrees, crosstalk, near)


def _believed(step: Step, late: _Late, fine: Value, reading: Value) -> Value:
    """Update the track (the estimate) or the candidate by the reading; return whether the reading updated the track."""
    tracker, _, state, _, scene = step
    new = _compared(step, late, fine, reading)
    # a known wall enters the beam
    honest = _both(state["known"] > 0.5, ca.logic_not(new.crosstalk), state["distrust"] < 0.5)
    entered = _both(fine, honest, scene.turning, ca.logic_not(new.near), new.agrees, new.innovation < 0.0)
    other = _both(fine, ca.logic_not(new.near), ca.logic_not(entered))
    anew = _either(entered, _candidate(step, new, other))
    _filtered(step, late, new, anew)
    believed = _either(new.near, anew)
    # one repetition of a sample set is not yet a reason to reject the reading
    fair = _either(fine, _both(state["repeated"] > 0.5, state["repeated"] < tracker.stuck))
    rejected = ca.if_else(fair, state["rejected"], 1.0)
    too_long = _both(scene.fired, reading > scene.longest + scene.tolerance)
    trusted = _both(believed, _either(new.agrees, _both(new.near, state["turned"] <= _UNSEEN)))
    state["distrust"] = ca.if_else(too_long, 1.0, ca.if_else(trusted, 0.0, state["distrust"]))
    state["rejected"] = ca.if_else(believed, 0.0, ca.if_else(scene.fired, rejected, state["rejected"]))
    state["known"] = ca.if_else(believed, 1.0, state["known"])
    state["explained"] = ca.if_else(believed, ca.if_else(new.agrees, 1.0, 0.0), state["explained"])
    state["votes"] = ca.if_else(believed, 0.0, state["votes"])
    state["age"] = ca.if_else(believed, 0.0, state["age"])
    state["turned"] = ca.if_else(believed, 0.0, state["turned"])
    state["swung"] = ca.if_else(believed, 0.0, state["swung"])
    return believed


def _candidate(step: Step, new: _Compared, other: Value) -> Value:
    """Store a reading that is not near the track as a candidate; return whether the candidate becomes the track."""
    tracker, _, state, _, scene = step
    corrected, outward = new.corrected, new.innovation > 0.0
    x, top = state["range"], tracker.array.maximum - 2.0 * tracker.array.resolution
    same = ca.if_else(scene.turning, _SAME_TURNING, _SAME)
    goes_on = _both(state["votes"] > 0.5, ca.fabs(corrected - state["candidate"]) <= same)
    twice = _both(ca.fabs(corrected - 2.0 * x) <= _TWICE, outward)
    vanished = _both(corrected >= top, outward)
    # a suspicion lasts for many readings, because noise may split the readings of a fault into two groups
    earlier = ca.if_else(state["votes"] > 0.5, state["suspect"], 0.0)
    earlier = ca.if_else(goes_on, _most(earlier - 1.0 / _CLEARING, 0.0), earlier)
    suspicion = ca.if_else(_either(twice, vanished), 1.0, earlier)
    suspect = suspicion > 0.0
    # after such a turn, a narrow object has left the beam
    passed = ca.fabs(state["swung"]) > tracker.array.beam_angle
    # before a track exists, two sensors may have equal readings without crosstalk, for example in a corridor
    foreign = _both(new.crosstalk, state["known"] > 0.5)
    strange = _either(foreign, _both(ca.logic_not(new.agrees), state["distrust"] > 0.5))
    votes = ca.if_else(_both(goes_on, ca.logic_not(strange)), _least(state["votes"] + 1.0, 9.0), 1.0)
    excused = _either(_both(new.agrees, ca.logic_not(twice)), passed, state["age"] > tracker.hold)
    convincing = _either(state["known"] < 0.5, ca.logic_not(suspect), ca.logic_not(outward), excused)
    needed = ca.if_else(state["distrust"] > 0.5, _VOTES_AFTER_FAULT, _VOTES)
    won = _both(other, votes > needed - 0.5, convincing)
    candidate = ca.if_else(goes_on, state["candidate"] + 0.5 * (corrected - state["candidate"]), corrected)
    state["candidate"] = ca.if_else(other, candidate, state["candidate"])
    state["votes"] = ca.if_else(other, votes, state["votes"])
    state["suspect"] = ca.if_else(other, suspicion, state["suspect"])
    return won


def _crosstalk(step: Step, corrected: Value) -> Value:
    # readings without an echo are not compared
    match = ca.fabs(corrected) < 0.0  # false everywhere
    for rate, newest, before in step.inputs.others:
        tolerance = _CROSS + ca.fabs(rate) * step.tracker.due
        for theirs in (newest, before):
            echo = theirs < step.tracker.array.maximum - step.tracker.array.resolution
            match = _either(match, _both(echo, ca.fabs(corrected - theirs) <= tolerance))
    return match


def _filtered(step: Step, late: _Late, new: _Compared, anew: Value) -> None:
    """Update the track by the Kalman filter if the reading is near the track; if `anew` holds, start a new track."""
    tracker, _, state, _, scene = step
    corrected, crosstalk = new.corrected, new.crosstalk
    x, u = state["range"], state["rate"]
    p11, p12, p22 = state["var_range"], state["covariance"], state["var_rate"]
    r = tracker.sigma * tracker.sigma
    total = p11 + r
    # a reading that may be late moves the track little, and one that equals another sensor's does not move the track
    part = ca.if_else(crosstalk, 0.0, ca.if_else(late.undecided, _CAUTIOUS, 1.0))
    steady = _either(crosstalk, late.undecided, scene.follow)
    k1, k2 = p11 / total, ca.if_else(steady, 0.0, p12 / total)
    innovation = part * (corrected - x)
    usual = ca.if_else(scene.turning, _SURPRISING_TURNING, _SURPRISING) * ca.sqrt(total)
    surprise = _most(_CALM * state["surprise"], ca.fabs(corrected - x) - usual, 0.0)
    # a reading near the track confirms the track only to within their difference
    from_wall = ca.if_else(new.agrees, ca.fabs(corrected - scene.expected), 0.0)
    shared = _most(ca.if_else(anew, 0.0, ca.fabs(corrected - x)), from_wall)
    surprise = ca.if_else(crosstalk, _most(surprise, shared), surprise)
    surprise = ca.if_else(late.undecided, state["surprise"], surprise)

    def chosen(after: Value, start: Value, before: Value) -> Value:
        return ca.if_else(anew, start, ca.if_else(new.near, after, before))

    state["range"] = chosen(_least(_most(x + k1 * innovation, 0.0), tracker.array.maximum), corrected, x)
    state["rate"] = chosen(ca.if_else(steady, 0.0, u + k2 * innovation), 0.0, u)
    # Joseph form, which is valid for any gain
    state["var_range"] = chosen((1.0 - k1) * (1.0 - k1) * p11 + k1 * k1 * r, r, p11)
    state["covariance"] = chosen((1.0 - k1) * (p12 - k2 * p11) + k1 * k2 * r, 0.0, p12)
    state["var_rate"] = chosen(p22 - 2.0 * k2 * p12 + k2 * k2 * total, tracker.rate_variance, p22)
    state["surprise"] = chosen(surprise, ca.if_else(crosstalk, shared, 0.0), state["surprise"])
    absorbed = state["absorbed"] + part * k1 * (late.away - state["absorbed"])
    suspected = _both(late.late_by > 0.0, ca.logic_not(late.late))
    state["absorbed"] = ca.if_else(suspected, chosen(absorbed, late.away, state["absorbed"]), 0.0)


def _record(step: Step, reading: Value) -> None:
    # later steps compare their readings with the stored ones
    _, old, state, inputs, scene = step
    state["reading"] = ca.if_else(scene.fired, reading, old["reading"])
    state["since"] = ca.if_else(scene.fired, 0.0, state["since"])
    pairs = zip(inputs.samples, old["samples"], strict=True)
    state["samples"] = [ca.if_else(scene.fired, new, before) for new, before in pairs]
    moved = state["recent"]
    state["recent"] = [
        ca.if_else(scene.fired, new, previous) for new, previous in zip([reading, *moved], moved, strict=False)
    ]


def _outputs(step: Step, late: _Late, believed: Value) -> tuple[Value, ...]:
    # range, bound, rate, healthy, age, reading, accepted, carve
    tracker, _, state, _, scene = step
    x, far = state["range"], tracker.array.maximum
    overdue = state["since"] > tracker.due + 0.5 * tracker.dt
    blind = _both(scene.turning, late.late_by > tracker.due + 0.5 * tracker.dt)
    away = ca.fabs(late.away) + ca.fabs(state["rate"]) * late.late_by
    away = away + ca.if_else(late.late_by > 0.0, scene.slide, 0.0)
    healthy = _both(
        state["known"] > 0.5,
        ca.logic_not(overdue),
        state["repeated"] < tracker.stuck,
        state["votes"] < 0.5,
        state["rejected"] < 0.5,
        ca.logic_not(late.late),
        ca.logic_not(blind),
        ca.fabs(late.away) <= _BEARABLE,
    )
    half_width = _MARGIN + _DEVIATIONS * ca.sqrt(_most(state["var_range"], 0.0)) + state["surprise"] + away
    sliding = ca.if_else(scene.follow, 0.03 + scene.unsure, 0.01 + ca.fabs(state["rate"]) * tracker.dt)
    half_width = half_width + ca.if_else(_both(scene.turning, state["since"] > 0.0), sliding, 0.0)
    by_wall = _both(scene.turning, scene.wall, state["explained"] > 0.5)
    half_width = half_width + ca.if_else(by_wall, ca.fabs(x - scene.expected), 0.0)
    half_width = half_width + tracker.obstacle_speed * _most(state["age"] - tracker.due, 0.0)
    low, high = x - half_width, x + half_width
    # a known wall that the turning beam may have met since the last firing
    meets = _both(scene.turning, state["since"] > 0.0)
    low = ca.if_else(meets, _least(low, scene.expected - 0.03 - scene.unsure), low)
    contested = state["votes"] > 0.5
    low = ca.if_else(contested, _least(low, state["candidate"] - _CANDIDATE), low)
    high = ca.if_else(contested, _most(high, state["candidate"] + _CANDIDATE), high)
    lost = _both(ca.logic_not(healthy), _either(state["turned"] > _UNSEEN, blind, _both(scene.turning, late.late)))
    anything = _either(state["known"] < 0.5, lost)
    at_minimum = (
        state["reading"] <= tracker.array.minimum + 1.5 * tracker.array.resolution
    )  # all ranges below give the same reading
    low = ca.if_else(_either(anything, at_minimum), 0.0, _most(low, 0.0))
    ceiling = _least(scene.ceiling + scene.tolerance, far)
    high = _least(ca.if_else(anything, far, high), ceiling)
    # if the track lies beyond a known wall, the interval ends at the wall
    low = ca.if_else(low > ceiling, _most(ceiling - 2.0 * scene.tolerance, 0.0), low)
    accepted = _both(believed, healthy)
    nearest = _least(*state["recent"])
    return (
        0.5 * (low + high),
        0.5 * (high - low),
        state["rate"] + 0.0,
        ca.if_else(healthy, 1.0, 0.0),
        state["age"] + 0.0,
        state["reading"] + 0.0,
        ca.if_else(accepted, 1.0, 0.0),
        ca.if_else(accepted, nearest, 0.0),
    )
