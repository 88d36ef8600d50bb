"""The rules of `RangeTracker`, written once for CasADi symbols and NumPy numbers (`Elementwise`).

A track is the estimated range and rate of the nearest object of a sensor. In each step, the robot's own motion moves
the track. If the new reading is plausible and agrees with the track, the reading updates the track. Otherwise the
reading is stored as a candidate; with enough evidence, the candidate becomes the track. While the readings disagree
with the track, the interval that shall contain the true range is wider.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from surctl.marine.sensing.ranging.scene import Elementwise, Rules, Step, StepInputs, Value, opened, robust, sound

__all__ = ["range_step"]

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

    The test compares the readings with the range that the known walls give or with the track (the estimate before the
    gap).

    A late reading is the range at an earlier time, `late_by` before the present. It differs from the present range by a
    shift, which is computed from the known walls or from the robot's own motion. The residual of a reading is the
    difference of the reading from the known walls' range or from the track. The regression coefficient of the residuals
    on the shift is 0 for readings without delay and 1 for late readings.
    """
    op, rules, old, state, _, scene = step
    missing = op.floor(state["since"] / rules.due + 0.5) - 1.0
    lost = missing * rules.due
    gap = op.both(scene.fired, missing > 0.5, lost <= rules.longest_delay + 0.5 * rules.dt, state["known"] > 0.5)
    late_by = op.where(gap, op.most(old["late_by"], lost), old["late_by"])
    away, wall_then = 0.0 * late_by, scene.expected + 0.0 * late_by
    for k, (shift, wall) in enumerate(zip(state["shifts"], state["walls"][1:], strict=True)):
        chosen = op.size(late_by - (k + 1) * rules.dt) < 0.5 * rules.dt
        away, wall_then = op.where(chosen, shift, away), op.where(chosen, wall, wall_then)
    late = op.both(old["late"] > 0.5, op.no(gap), op.size(away) > 0.4 * _SMALL)
    suspected = op.both(late_by > 0.0, op.no(late))
    distinct = op.size(wall_then - scene.expected) > _TELLING_WALL + scene.unsure
    by_wall = op.both(scene.wall, wall_then < rules.maximum, distinct)
    shift = op.where(by_wall, wall_then - scene.expected, away - old["absorbed"])
    residual = reading - op.where(by_wall, scene.expected, state["range"])
    spread = op.where(by_wall, _WALL_SPREAD + scene.unsure / 3.0, _TRACK_SPREAD)
    telling = op.both(suspected, op.either(by_wall, op.both(op.size(shift) > _TELLING, op.no(scene.turning))))
    gate = op.where(by_wall, _WALL_GATE + scene.unsure, _TRACK_GATE + 0.25 * op.size(shift))
    fits = op.either(op.size(residual) <= gate, op.size(residual - shift) <= gate)
    judging = op.both(sound, telling, fits, op.either(by_wall, state["votes"] < 0.5))
    # an object lies in front of the wall
    elsewhere = op.both(sound, telling, by_wall, op.no(fits))
    weight = 1.0 / (spread * spread)
    cross = op.where(judging, _FORGET * old["cross"] + residual * shift * weight, old["cross"])
    power = op.where(judging, _FORGET * old["power"] + shift * shift * weight, old["power"])
    looks = op.where(judging, old["looks"] + 1.0, old["looks"])
    decided = op.both(looks > op.where(by_wall, _LOOKS_WALL, _LOOKS) - 0.5, power >= _EVIDENCE)
    true = op.both(decided, cross < 0.5 * power)
    late = op.either(late, op.both(decided, cross >= 0.5 * power))
    afresh = op.either(gap, decided, elsewhere)
    state["cross"] = op.where(afresh, 0.0, cross)
    state["power"] = op.where(afresh, 0.0, power)
    state["looks"] = op.where(afresh, 0.0, looks)
    state["late_by"] = op.where(true, 0.0, late_by)
    state["late"] = op.where(late, 1.0, 0.0)
    state["absorbed"] = op.where(op.either(true, late, late_by <= 0.0), 0.0, old["absorbed"])
    suspected = op.both(suspected, op.no(true), op.no(late))
    return _Late(
        late_by=state["late_by"],
        late=late,
        away=op.where(state["late_by"] > 0.0, away, 0.0),
        undecided=op.both(suspected, op.size(away) > _SMALL),
        judging=op.both(judging, op.no(true), op.no(by_wall)),
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
    op: Elementwise, rules: Rules, old: Mapping[str, Value], inputs: StepInputs
) -> tuple[dict[str, Value], tuple[Value, ...]]:
    """Return the next state, and the outputs range, bound, rate, healthy, age, reading, accepted, carve.

    The class `Ranging` describes the outputs.

    Args:
        op: operations on symbols or on numbers.
        rules: parameters of the rules.
        old: value of each entry of the previous state, by name without prefix; the value of an entry with several
            columns is a list of columns.
        inputs: inputs of the step.
    """
    step = opened(op, rules, old, inputs)
    reading = robust(op, rules, inputs.samples)
    fine = sound(step, reading)
    late = _lateness(step, fine, reading)
    believed = _believed(step, late, fine, reading)
    _record(step, reading)
    return step.state, _outputs(step, late, believed)


def _compared(step: Step, late: _Late, fine: Value, reading: Value) -> _Compared:
    op, rules, _, state, _, scene = step
    x, known = state["range"], state["known"] > 0.5
    corrected = op.where(late.late, op.least(op.most(reading - late.away, 0.0), rules.maximum), reading)
    innovation = corrected - x
    spread = op.root(op.most(state["var_range"], 0.0) + rules.sigma * rules.sigma)
    widest = op.where(scene.turning, _GATE_TURNING, _GATE_MOST)
    # smaller than the distance to a second echo
    gate = op.most(op.least(_GATE * spread, widest, 0.5 * x), _GATE_LEAST)
    off = op.size(corrected - scene.expected)
    agrees = op.both(scene.wall, off <= rules.tolerance + scene.unsure)
    closely = op.both(scene.wall, off <= 0.5 * (rules.tolerance + scene.unsure))
    agrees = op.where(state["distrust"] > 0.5, closely, agrees)
    there = op.both(known, op.either(state["turned"] <= _STALE, op.both(agrees, state["distrust"] < 0.5)))
    # readings of a candidate that cross the track by chance do not update the track
    crossing = op.both(state["votes"] > 0.5, op.size(corrected - state["candidate"]) <= _SAME)
    crosstalk = _crosstalk(step, corrected)
    foreign = op.both(crosstalk, scene.turning, op.no(agrees))
    within = op.size(innovation) <= op.where(late.judging, rules.maximum, gate)
    near = op.both(fine, there, op.no(crossing), op.no(foreign), within)
    return _Compared(corrected, innovation, agrees, crosstalk, near)


def _believed(step: Step, late: _Late, fine: Value, reading: Value) -> Value:
    """Update the track (the estimate) or the candidate by the reading; return whether the reading updated the track."""
    op, rules, _, state, _, scene = step
    new = _compared(step, late, fine, reading)
    # a known wall enters the beam
    honest = op.both(state["known"] > 0.5, op.no(new.crosstalk), state["distrust"] < 0.5)
    entered = op.both(fine, honest, scene.turning, op.no(new.near), new.agrees, new.innovation < 0.0)
    other = op.both(fine, op.no(new.near), op.no(entered))
    anew = op.either(entered, _candidate(step, new, other))
    _filtered(step, late, new, anew)
    believed = op.either(new.near, anew)
    # one repetition of a sample set is not yet a reason to reject the reading
    fair = op.either(fine, op.both(state["repeated"] > 0.5, state["repeated"] < rules.stuck))
    rejected = op.where(fair, state["rejected"], 1.0)
    too_long = op.both(scene.fired, reading > scene.longest + scene.tolerance)
    trusted = op.both(believed, op.either(new.agrees, op.both(new.near, state["turned"] <= _UNSEEN)))
    state["distrust"] = op.where(too_long, 1.0, op.where(trusted, 0.0, state["distrust"]))
    state["rejected"] = op.where(believed, 0.0, op.where(scene.fired, rejected, state["rejected"]))
    state["known"] = op.where(believed, 1.0, state["known"])
    state["explained"] = op.where(believed, op.where(new.agrees, 1.0, 0.0), state["explained"])
    state["votes"] = op.where(believed, 0.0, state["votes"])
    state["age"] = op.where(believed, 0.0, state["age"])
    state["turned"] = op.where(believed, 0.0, state["turned"])
    state["swung"] = op.where(believed, 0.0, state["swung"])
    return believed


def _candidate(step: Step, new: _Compared, other: Value) -> Value:
    """Store a reading that is not near the track as a candidate; return whether the candidate becomes the track."""
    op, rules, _, state, _, scene = step
    corrected, outward = new.corrected, new.innovation > 0.0
    x, top = state["range"], rules.maximum - 2.0 * rules.resolution
    same = op.where(scene.turning, _SAME_TURNING, _SAME)
    goes_on = op.both(state["votes"] > 0.5, op.size(corrected - state["candidate"]) <= same)
    twice = op.both(op.size(corrected - 2.0 * x) <= _TWICE, outward)
    vanished = op.both(corrected >= top, outward)
    # a suspicion lasts for many readings, because noise may split the readings of a fault into two groups
    earlier = op.where(state["votes"] > 0.5, state["suspect"], 0.0)
    earlier = op.where(goes_on, op.most(earlier - 1.0 / _CLEARING, 0.0), earlier)
    suspicion = op.where(op.either(twice, vanished), 1.0, earlier)
    suspect = suspicion > 0.0
    # after such a turn, a narrow object has left the beam
    passed = op.size(state["swung"]) > rules.beam
    # before a track exists, two sensors may have equal readings without crosstalk, for example in a corridor
    foreign = op.both(new.crosstalk, state["known"] > 0.5)
    strange = op.either(foreign, op.both(op.no(new.agrees), state["distrust"] > 0.5))
    votes = op.where(op.both(goes_on, op.no(strange)), op.least(state["votes"] + 1.0, 9.0), 1.0)
    excused = op.either(op.both(new.agrees, op.no(twice)), passed, state["age"] > rules.hold)
    convincing = op.either(state["known"] < 0.5, op.no(suspect), op.no(outward), excused)
    needed = op.where(state["distrust"] > 0.5, _VOTES_AFTER_FAULT, _VOTES)
    won = op.both(other, votes > needed - 0.5, convincing)
    candidate = op.where(goes_on, state["candidate"] + 0.5 * (corrected - state["candidate"]), corrected)
    state["candidate"] = op.where(other, candidate, state["candidate"])
    state["votes"] = op.where(other, votes, state["votes"])
    state["suspect"] = op.where(other, suspicion, state["suspect"])
    return won


def _crosstalk(step: Step, corrected: Value) -> Value:
    # readings without an echo are not compared
    op, rules = step.op, step.rules
    match = op.size(corrected) < 0.0  # false everywhere
    for rate, newest, before in step.inputs.others:
        tolerance = _CROSS + op.size(rate) * rules.due
        for theirs in (newest, before):
            echo = theirs < rules.maximum - rules.resolution
            match = op.either(match, op.both(echo, op.size(corrected - theirs) <= tolerance))
    return match


def _filtered(step: Step, late: _Late, new: _Compared, anew: Value) -> None:
    """Update the track by the Kalman filter if the reading is near the track; if `anew` holds, start a new track."""
    op, rules, _, state, _, scene = step
    corrected, crosstalk = new.corrected, new.crosstalk
    x, u = state["range"], state["rate"]
    p11, p12, p22 = state["var_range"], state["covariance"], state["var_rate"]
    r = rules.sigma * rules.sigma
    total = p11 + r
    # a reading that may be late moves the track little, and one that equals another sensor's does not move the track
    part = op.where(crosstalk, 0.0, op.where(late.undecided, _CAUTIOUS, 1.0))
    steady = op.either(crosstalk, late.undecided, scene.follow)
    k1, k2 = p11 / total, op.where(steady, 0.0, p12 / total)
    innovation = part * (corrected - x)
    usual = op.where(scene.turning, _SURPRISING_TURNING, _SURPRISING) * op.root(total)
    surprise = op.most(_CALM * state["surprise"], op.size(corrected - x) - usual, 0.0)
    # a reading near the track confirms the track only to within their difference
    from_wall = op.where(new.agrees, op.size(corrected - scene.expected), 0.0)
    shared = op.most(op.where(anew, 0.0, op.size(corrected - x)), from_wall)
    surprise = op.where(crosstalk, op.most(surprise, shared), surprise)
    surprise = op.where(late.undecided, state["surprise"], surprise)

    def chosen(after: Value, start: Value, before: Value) -> Value:
        return op.where(anew, start, op.where(new.near, after, before))

    state["range"] = chosen(op.least(op.most(x + k1 * innovation, 0.0), rules.maximum), corrected, x)
    state["rate"] = chosen(op.where(steady, 0.0, u + k2 * innovation), 0.0, u)
    # Joseph form, which is valid for any gain
    state["var_range"] = chosen((1.0 - k1) * (1.0 - k1) * p11 + k1 * k1 * r, r, p11)
    state["covariance"] = chosen((1.0 - k1) * (p12 - k2 * p11) + k1 * k2 * r, 0.0, p12)
    state["var_rate"] = chosen(p22 - 2.0 * k2 * p12 + k2 * k2 * total, rules.rate_variance, p22)
    state["surprise"] = chosen(surprise, op.where(crosstalk, shared, 0.0), state["surprise"])
    absorbed = state["absorbed"] + part * k1 * (late.away - state["absorbed"])
    suspected = op.both(late.late_by > 0.0, op.no(late.late))
    state["absorbed"] = op.where(suspected, chosen(absorbed, late.away, state["absorbed"]), 0.0)


def _record(step: Step, reading: Value) -> None:
    # later steps compare their readings with the stored ones
    op, _, old, state, inputs, scene = step
    state["reading"] = op.where(scene.fired, reading, old["reading"])
    state["since"] = op.where(scene.fired, 0.0, state["since"])
    pairs = zip(inputs.samples, old["samples"], strict=True)
    state["samples"] = [op.where(scene.fired, new, before) for new, before in pairs]
    moved = state["recent"]
    state["recent"] = [
        op.where(scene.fired, new, previous) for new, previous in zip([reading, *moved], moved, strict=False)
    ]


def _outputs(step: Step, late: _Late, believed: Value) -> tuple[Value, ...]:
    # range, bound, rate, healthy, age, reading, accepted, carve
    op, rules, _, state, _, scene = step
    x, far = state["range"], rules.maximum
    overdue = state["since"] > rules.due + 0.5 * rules.dt
    blind = op.both(scene.turning, late.late_by > rules.due + 0.5 * rules.dt)
    away = op.size(late.away) + op.size(state["rate"]) * late.late_by
    away = away + op.where(late.late_by > 0.0, scene.slide, 0.0)
    healthy = op.both(
        state["known"] > 0.5,
        op.no(overdue),
        state["repeated"] < rules.stuck,
        state["votes"] < 0.5,
        state["rejected"] < 0.5,
        op.no(late.late),
        op.no(blind),
        op.size(late.away) <= _BEARABLE,
    )
    half_width = _MARGIN + _DEVIATIONS * op.root(op.most(state["var_range"], 0.0)) + state["surprise"] + away
    sliding = op.where(scene.follow, 0.03 + scene.unsure, 0.01 + op.size(state["rate"]) * rules.dt)
    half_width = half_width + op.where(op.both(scene.turning, state["since"] > 0.0), sliding, 0.0)
    by_wall = op.both(scene.turning, scene.wall, state["explained"] > 0.5)
    half_width = half_width + op.where(by_wall, op.size(x - scene.expected), 0.0)
    half_width = half_width + rules.obstacle_speed * op.most(state["age"] - rules.due, 0.0)
    low, high = x - half_width, x + half_width
    # a known wall that the turning beam may have met since the last firing
    meets = op.both(scene.turning, state["since"] > 0.0)
    low = op.where(meets, op.least(low, scene.expected - 0.03 - scene.unsure), low)
    contested = state["votes"] > 0.5
    low = op.where(contested, op.least(low, state["candidate"] - _CANDIDATE), low)
    high = op.where(contested, op.most(high, state["candidate"] + _CANDIDATE), high)
    lost = op.both(op.no(healthy), op.either(state["turned"] > _UNSEEN, blind, op.both(scene.turning, late.late)))
    anything = op.either(state["known"] < 0.5, lost)
    at_minimum = state["reading"] <= rules.minimum + 1.5 * rules.resolution  # all ranges below give the same reading
    low = op.where(op.either(anything, at_minimum), 0.0, op.most(low, 0.0))
    ceiling = op.least(scene.ceiling + scene.tolerance, far)
    high = op.least(op.where(anything, far, high), ceiling)
    # if the track lies beyond a known wall, the interval ends at the wall
    low = op.where(low > ceiling, op.most(ceiling - 2.0 * scene.tolerance, 0.0), low)
    accepted = op.both(believed, healthy)
    nearest = op.least(*state["recent"])
    return (
        0.5 * (low + high),
        0.5 * (high - low),
        state["rate"] + 0.0,
        op.where(healthy, 1.0, 0.0),
        state["age"] + 0.0,
        state["reading"] + 0.0,
        op.where(accepted, 1.0, 0.0),
        op.where(accepted, nearest, 0.0),
    )
