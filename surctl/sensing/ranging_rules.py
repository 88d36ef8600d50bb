"""The rules of `RangeTracker`, written once for symbols and numbers (`Elementwise`).

A step moves the track by the robot's own motion, takes the new reading in if it can be honest and agrees with the
track, and otherwise keeps it as a rival hypothesis until there is reason to believe it. What is not resolved widens the
interval in which the range is promised to lie.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from surctl.sensing.elementwise import Elementwise, Value

__all__ = ["Rules", "Seen", "tick"]

_TURNING = 0.05  # rad/s; below it the beam counts as still
_UNSEEN = 0.03  # rad; a beam that turned further since the last believed reading tells nothing of what it sees now
_STALE = 0.2  # rad; likewise, a reading that is near an older track is so by chance
_NOISE = 2.25e-3  # m²/s³, of the rate: an obstacle that changes its speed by 0.15 m/s within a second
_NOISE_TURNING = 0.4  # m²/s³: nearest points slide along what the beam sweeps
_RATE_VARIANCE = 0.0625  # m²/s², of a rate that is not known
_VARIANCE = 0.09  # m², largest of the range
_GATE = 4.0  # standard deviations
_GATE_LEAST, _GATE_MOST, _GATE_TURNING = 0.05, 0.10, 0.35  # m
_SLIDING = 0.04  # m in a cycle, above the noise of an expected range
_SAME = 0.06  # m, from one reading of a rival to the next, own motion taken out
_SAME_TURNING = 0.16  # m
_VOTES = 3  # readings in a row that make a rival the track
_VOTES_AFTER_FAULT = 8  # which no wall that is passed by chance gives
_MARGIN, _DEVIATIONS = 0.01, 3.5  # m and standard deviations of a healthy bound
_RIVAL = 0.04  # m, half-width of a rival
_TWICE = 0.1  # m, by which a second echo may miss twice the range
_CROSS = 0.05  # m, by which crosstalk may miss another sensor's reading
_SMALL_SHIFT, _TELLING_SHIFT, _TELLING_WALL, _BEARABLE_SHIFT = 0.025, 0.035, 0.05, 0.05  # m, if a stream is late
_TRACK_SPREAD, _WALL_SPREAD = 0.012, 0.02  # m, of residuals on the old track, and on the expected range
_EVIDENCE, _LOOKS, _LOOKS_WALL, _FORGET = 60.0, 4, 6, 0.95  # variances, readings, and what of the old evidence stays
_CAUTIOUS = 0.1  # part of the filter's gain while a stream may be late
_CALM = 0.6  # part of a surprise that stays
_SURPRISING = 2.5  # standard deviations
_NEVER = 1e6


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


class Seen(NamedTuple):
    """Inputs of a step."""

    samples: list[Value]
    fresh: Value
    closing: Value
    expected: Value
    turn: Value


class _Scene(NamedTuple):
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


class _Late(NamedTuple):
    """What a stream that may be late means at this step."""

    late_by: Value
    late: Value
    away: Value  # a late reading less the present range
    undecided: Value  # and it matters
    judging: Value  # this reading is evidence, and so not one for the track


def tick(
    op: Elementwise, rules: Rules, old: Mapping[str, Value], seen: Seen
) -> tuple[dict[str, Value], tuple[Value, ...]]:
    """Next state, and range, bound, rate, healthy, age, reading, accepted, carve.

    Args:
        op: operations of symbols or of numbers.
        rules: numbers.
        old: state by unprefixed port name; a port with columns is a list of them.
        seen: inputs.
    """
    scene = _scene(op, rules, old, seen)
    state, increment = _moved(op, rules, old, seen, scene)
    reading = _robust(op, rules, seen.samples)
    sound = _heard(op, rules, old, state, seen, scene, reading)
    late = _lateness(op, rules, old, state, scene, sound, reading)
    believed = _believed(op, rules, state, scene, late, sound, reading)
    _record(op, rules, old, state, seen, scene, reading, increment, believed)
    return state, _answer(op, rules, state, scene, late, believed)


def _scene(op: Elementwise, rules: Rules, old: Mapping[str, Value], seen: Seen) -> _Scene:
    turning = op.size(seen.turn) > _TURNING
    expected = op.least(op.most(seen.expected, 0.0), rules.maximum)
    cycle = round(rules.due / rules.dt)
    before, earlier = (old["walls"][min(k * cycle, len(old["walls"])) - 1] for k in (1, 2))
    slide = op.most(op.size(expected - before), op.size(before - earlier), 0.5 * op.size(expected - earlier))
    slide = op.where(turning, slide, 0.0)
    unsure = rules.yaw_tolerance * slide / (rules.due * op.most(op.size(seen.turn), _TURNING))
    return _Scene(
        fired=seen.fresh > 0.5,
        turning=turning,
        follow=op.both(turning, slide > _SLIDING, old["explained"] > 0.5, old["known"] > 0.5),
        raw=seen.expected,
        wall=seen.expected < rules.maximum,
        expected=expected,
        tolerance=rules.tolerance + slide + unsure,
        unsure=unsure,
        slide=slide,
    )


def _moved(
    op: Elementwise, rules: Rules, old: Mapping[str, Value], seen: Seen, scene: _Scene
) -> tuple[dict[str, Value], Value]:
    """The state a step later without a reading, and the change of range that is known."""
    dt, top = rules.dt, rules.maximum - 0.5 * rules.resolution
    state = dict(old)
    own = -seen.closing * dt
    known = op.where(scene.follow, scene.expected - old["walls"][0], op.where(old["range"] >= top, 0.0, own))
    coasting = op.both(
        op.no(scene.follow),
        old["votes"] < 0.5,
        old["doubt"] < 0.5,
        old["since"] + dt <= rules.due + 0.5 * dt,
        old["late_by"] <= 0.0,
    )
    drift = op.where(coasting, old["rate"] * dt, 0.0)
    noise = op.where(scene.turning, _NOISE_TURNING, _NOISE) * dt
    p11, p12, p22 = old["var_range"], old["covariance"], old["var_rate"]
    state["range"] = op.least(op.most(old["range"] + known + drift, 0.0), rules.maximum)
    state["var_range"] = op.least(p11 + 2.0 * dt * p12 + dt * dt * p22 + noise * dt * dt / 3.0, _VARIANCE)
    state["covariance"] = p12 + dt * p22 + 0.5 * noise * dt
    state["var_rate"] = op.least(p22 + noise, op.where(scene.turning, 16.0 * _RATE_VARIANCE, _RATE_VARIANCE))
    # a covariance matrix after its entries were capped, too
    limit = 0.99 * op.root(op.most(state["var_range"] * state["var_rate"], 0.0))
    state["covariance"] = op.least(op.most(state["covariance"], -limit), limit)
    state["rival"] = op.where(old["rival"] >= top, old["rival"], op.most(old["rival"] + own, 0.0))
    state["recent"] = [op.most(value + own, 0.0) for value in old["recent"]]
    state["since"] = op.least(old["since"] + dt, _NEVER)
    state["age"] = op.least(old["age"] + dt, _NEVER)
    state["turned"] = op.least(old["turned"] + op.size(seen.turn) * dt, _NEVER)
    state["shifts"] = [-known, *(value - known for value in old["shifts"][:-1])]
    state["walls"] = [scene.expected + 0.0 * own, *old["walls"][:-1]]
    return state, known


def _robust(op: Elementwise, rules: Rules, samples: Sequence[Value]) -> Value:
    """Mean of a firing without its smallest and its largest sample [m]; the maximum where all read it."""
    total = samples[0]
    for value in samples[1:]:
        total = total + value
    count = len(samples)
    if count >= 3:
        total, count = total - op.least(*samples) - op.most(*samples), count - 2
    nothing = op.least(*samples) >= rules.maximum - 0.5 * rules.resolution
    return op.where(nothing, rules.maximum, op.least(total / count - rules.bias, rules.maximum))


def _heard(
    op: Elementwise,
    rules: Rules,
    old: Mapping[str, Value],
    state: dict[str, Value],
    seen: Seen,
    scene: _Scene,
    reading: Value,
) -> Value:
    """Whether this firing's reading can be honest by itself; counts repetitions."""
    step = rules.resolution
    differs = 0.0
    for new, before in zip(seen.samples, old["samples"], strict=True):
        differs = differs + op.size(new - before)
    # at the ends of its range an honest sensor repeats itself
    same = op.both(differs < 0.25 * step, reading > rules.minimum + step, reading < rules.maximum - step)
    count = op.where(same, op.least(old["repeated"] + 1.0, 9.0), 0.0) if rules.repeats else 0.0 * reading
    state["repeated"] = op.where(scene.fired, count, old["repeated"])
    bearable = 0.5 if rules.one_repeat else max(rules.repeats, 1) - 0.5
    return op.both(
        scene.fired,
        state["repeated"] < bearable,
        reading >= rules.minimum - step,
        reading <= seen.expected + scene.tolerance,
    )


def _lateness(
    op: Elementwise,
    rules: Rules,
    old: Mapping[str, Value],
    state: dict[str, Value],
    scene: _Scene,
    sound: Value,
    reading: Value,
) -> _Late:
    """After a gap the stream may be late by the gap: compare it with the known walls, or with the old track.

    A late reading is the range of `late_by` ago, longer by a shift that the known walls give, or own motion. The
    residuals of the readings on the shift give the share of it that is real: 0 for a true stream, 1 for a late one.
    """
    missing = op.floor(state["since"] / rules.due + 0.5) - 1.0
    lost = missing * rules.due
    gap = op.both(scene.fired, missing > 0.5, lost <= rules.longest_delay + 0.5 * rules.dt, state["known"] > 0.5)
    late_by = op.where(gap, op.most(old["late_by"], lost), old["late_by"])
    away, wall_then = 0.0 * late_by, scene.expected + 0.0 * late_by
    for k, (shift, wall) in enumerate(zip(state["shifts"], state["walls"][1:], strict=True)):
        chosen = op.size(late_by - (k + 1) * rules.dt) < 0.5 * rules.dt
        away, wall_then = op.where(chosen, shift, away), op.where(chosen, wall, wall_then)
    late = op.both(old["late"] > 0.5, op.no(gap), op.size(away) > 0.4 * _SMALL_SHIFT)
    suspected = op.both(late_by > 0.0, op.no(late))
    told = op.size(wall_then - scene.expected) > _TELLING_WALL + scene.unsure
    by_wall = op.both(scene.wall, wall_then < rules.maximum, told)
    shift = op.where(by_wall, wall_then - scene.expected, away - old["absorbed"])
    residual = reading - op.where(by_wall, scene.expected, state["range"])
    spread = op.where(by_wall, _WALL_SPREAD + scene.unsure / 3.0, _TRACK_SPREAD)
    telling = op.both(suspected, op.either(by_wall, op.both(op.size(shift) > _TELLING_SHIFT, op.no(scene.turning))))
    gate = op.where(by_wall, _GATE_LEAST + scene.unsure, _GATE_LEAST + 0.25 * op.size(shift))
    fits = op.either(op.size(residual) <= gate, op.size(residual - shift) <= gate)
    judging = op.both(sound, telling, fits, op.either(by_wall, state["votes"] < 0.5))
    # something stands before the wall
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
        undecided=op.both(suspected, op.size(away) > _SMALL_SHIFT),
        judging=op.both(judging, op.no(true), op.no(by_wall)),
    )


def _believed(
    op: Elementwise, rules: Rules, state: dict[str, Value], scene: _Scene, late: _Late, sound: Value, reading: Value
) -> Value:
    """Take the reading into the track, or into the rival; whether it was believed."""
    x, known = state["range"], state["known"] > 0.5
    taken = op.where(late.late, op.least(op.most(reading - late.away, 0.0), rules.maximum), reading)
    innovation = taken - x
    spread = op.root(op.most(state["var_range"], 0.0) + rules.sigma * rules.sigma)
    widest = op.where(scene.turning, _GATE_TURNING, _GATE_MOST)
    gate = op.least(op.most(_GATE * spread, _GATE_LEAST), widest)
    off = op.size(taken - scene.expected)
    agrees = op.both(scene.wall, off <= rules.tolerance + scene.unsure)
    closely = op.both(scene.wall, off <= 0.5 * (rules.tolerance + scene.unsure))
    agrees = op.where(state["distrust"] > 0.5, closely, agrees)
    there = op.both(known, op.either(state["turned"] <= _STALE, op.both(agrees, state["distrust"] < 0.5)))
    # a stream of a rival that happens to cross the track does not become true by it
    crossing = op.both(state["votes"] > 0.5, op.size(taken - state["rival"]) <= _SAME)
    crosstalk = _crosstalk(op, rules, state, op.where(scene.fired, reading, state["heard"]), taken)
    foreign = op.both(crosstalk, scene.turning, op.no(agrees))
    near = op.both(sound, there, op.no(crossing), op.no(foreign), op.size(innovation) <= op.where(late.judging, rules.maximum, gate))
    # a known wall comes into the beam
    honest = op.both(known, op.no(crosstalk), state["distrust"] < 0.5)
    entered = op.both(sound, honest, scene.turning, op.no(near), agrees, innovation < 0.0)
    other = op.both(sound, op.no(near), op.no(entered))
    won = _rival(op, rules, state, scene, reading, taken, innovation, agrees, known, crosstalk, other)
    anew = op.either(entered, won)
    _filtered(op, rules, state, scene, late, taken, crosstalk, agrees, near, anew)
    believed = op.either(near, anew)
    # a set that repeats once is a sign, not yet a doubt
    fair = op.either(sound, op.both(state["repeated"] > 0.5, state["repeated"] < max(rules.repeats, 1) - 0.5))
    doubt = op.where(fair, state["doubt"], 1.0)
    too_long = op.both(scene.fired, reading > scene.raw + scene.tolerance)
    trusted = op.both(believed, op.either(agrees, op.both(near, state["turned"] <= _UNSEEN)))
    state["distrust"] = op.where(too_long, 1.0, op.where(trusted, 0.0, state["distrust"]))
    state["doubt"] = op.where(believed, 0.0, op.where(scene.fired, doubt, state["doubt"]))
    state["known"] = op.where(believed, 1.0, state["known"])
    state["explained"] = op.where(believed, op.where(agrees, 1.0, 0.0), state["explained"])
    state["votes"] = op.where(believed, 0.0, state["votes"])
    state["age"] = op.where(believed, 0.0, state["age"])
    state["turned"] = op.where(believed, 0.0, state["turned"])
    return believed


def _rival(
    op: Elementwise,
    rules: Rules,
    state: dict[str, Value],
    scene: _Scene,
    reading: Value,
    taken: Value,
    innovation: Value,
    agrees: Value,
    known: Value,
    crosstalk: Value,
    other: Value,
) -> Value:
    """Keep a reading away from the track as a rival; whether the rival has become the track."""
    x, top = state["range"], rules.maximum - 2.0 * rules.resolution
    same = op.where(scene.turning, _SAME_TURNING, _SAME)
    goes_on = op.both(state["votes"] > 0.5, op.size(taken - state["rival"]) <= same)
    twice = op.both(op.size(taken - 2.0 * x) <= _TWICE, innovation > 0.0)
    vanished = op.both(taken >= top, innovation > 0.0)
    # within one conflict a suspicion stays: noise may break a stream in two
    suspect = op.either(op.both(state["votes"] > 0.5, state["suspect"] > 0.5), twice, vanished)
    strange = op.either(crosstalk, op.both(op.no(agrees), state["distrust"] > 0.5))
    votes = op.where(op.both(goes_on, op.no(strange)), op.least(state["votes"] + 1.0, 9.0), 1.0)
    excused = op.either(op.both(agrees, op.no(twice)), state["turned"] > rules.beam, state["age"] > rules.hold)
    convincing = op.either(op.no(known), op.no(suspect), innovation < 0.0, excused)
    needed = op.where(state["distrust"] > 0.5, _VOTES_AFTER_FAULT, _VOTES)
    won = op.both(other, votes > needed - 0.5, convincing)
    rival = op.where(goes_on, state["rival"] + 0.5 * (taken - state["rival"]), taken)
    state["rival"] = op.where(other, rival, state["rival"])
    state["votes"] = op.where(other, votes, state["votes"])
    state["suspect"] = op.where(other, op.where(suspect, 1.0, 0.0), state["suspect"])
    return won


def _crosstalk(op: Elementwise, rules: Rules, state: Mapping[str, Value], newest: Value, taken: Value) -> Value:
    """Whether the value is what another sensor heard; all may see nothing."""
    found = taken < 0.0
    for k in range(1, rules.sensors):
        reach = _CROSS + op.size(op.turned(state["rate"], k)) * rules.due
        for heard in (newest, state["heard"]):
            theirs = op.turned(heard, k)
            echo = theirs < rules.maximum - rules.resolution
            found = op.either(found, op.both(echo, op.size(taken - theirs) <= reach))
    return found


def _filtered(
    op: Elementwise,
    rules: Rules,
    state: dict[str, Value],
    scene: _Scene,
    late: _Late,
    taken: Value,
    crosstalk: Value,
    agrees: Value,
    near: Value,
    anew: Value,
) -> None:
    """Kalman update where the reading is near the track; a new track where it starts anew."""
    x, u = state["range"], state["rate"]
    p11, p12, p22 = state["var_range"], state["covariance"], state["var_rate"]
    r = rules.sigma * rules.sigma
    total = p11 + r
    # what may be late carries the track along little, and what is also another sensor's reading not at all
    part = op.where(crosstalk, 0.0, op.where(late.undecided, _CAUTIOUS, 1.0))
    steady = op.either(crosstalk, late.undecided, scene.follow)
    k1, k2 = p11 / total, op.where(steady, 0.0, p12 / total)
    innovation = part * (taken - x)
    surprise = op.most(_CALM * state["surprise"], op.size(taken - x) - _SURPRISING * op.root(total), 0.0)
    # it only bears the track out, as well as it agrees with it
    shared = op.most(op.where(anew, 0.0, op.size(taken - x)), op.where(agrees, op.size(taken - scene.expected), 0.0))
    surprise = op.where(crosstalk, op.most(surprise, shared), surprise)
    surprise = op.where(late.undecided, state["surprise"], surprise)

    def chosen(after: Value, start: Value, before: Value) -> Value:
        return op.where(anew, start, op.where(near, after, before))

    state["range"] = chosen(op.least(op.most(x + k1 * innovation, 0.0), rules.maximum), taken, x)
    state["rate"] = chosen(op.where(steady, 0.0, u + k2 * innovation), 0.0, u)
    # the form that holds for any gain
    state["var_range"] = chosen((1.0 - k1) * (1.0 - k1) * p11 + k1 * k1 * r, r, p11)
    state["covariance"] = chosen((1.0 - k1) * (p12 - k2 * p11) + k1 * k2 * r, 0.0, p12)
    state["var_rate"] = chosen(p22 - 2.0 * k2 * p12 + k2 * k2 * total, _RATE_VARIANCE, p22)
    state["surprise"] = chosen(surprise, op.where(crosstalk, shared, 0.0), state["surprise"])
    absorbed = state["absorbed"] + part * k1 * (late.away - state["absorbed"])
    suspected = op.both(late.late_by > 0.0, op.no(late.late))
    state["absorbed"] = op.where(suspected, chosen(absorbed, late.away, state["absorbed"]), 0.0)


def _record(
    op: Elementwise,
    rules: Rules,
    old: Mapping[str, Value],
    state: dict[str, Value],
    seen: Seen,
    scene: _Scene,
    reading: Value,
    increment: Value,
    believed: Value,
) -> None:
    """What later steps compare with."""
    state["heard"] = op.where(scene.fired, reading, old["heard"])
    state["since"] = op.where(scene.fired, 0.0, state["since"])
    state["samples"] = [
        op.where(scene.fired, new, before) for new, before in zip(seen.samples, old["samples"], strict=True)
    ]
    first, second, third = state["recent"]
    state["recent"] = [
        op.where(scene.fired, reading, first),
        op.where(scene.fired, first, second),
        op.where(scene.fired, second, third),
    ]


def _answer(
    op: Elementwise, rules: Rules, state: Mapping[str, Value], scene: _Scene, late: _Late, believed: Value
) -> tuple[Value, ...]:
    """Range, bound, rate, healthy, age, reading, accepted, carve."""
    x, far = state["range"], rules.maximum
    overdue = state["since"] > rules.due + 0.5 * rules.dt
    blind = op.both(scene.turning, late.late_by > rules.due + 0.5 * rules.dt)
    away = op.size(late.away) + op.size(state["rate"]) * late.late_by
    away = away + op.where(late.late_by > 0.0, scene.slide, 0.0)
    healthy = op.both(
        state["known"] > 0.5,
        op.no(overdue),
        state["repeated"] < max(rules.repeats, 1) - 0.5,
        state["votes"] < 0.5,
        state["doubt"] < 0.5,
        op.no(late.late),
        op.no(blind),
        op.size(late.away) <= _BEARABLE_SHIFT,
    )
    reach = _MARGIN + _DEVIATIONS * op.root(op.most(state["var_range"], 0.0)) + state["surprise"] + away
    sliding = op.where(scene.follow, 0.03 + scene.unsure, 0.01 + op.size(state["rate"]) * rules.dt)
    reach = reach + op.where(op.both(scene.turning, state["since"] > 0.0), sliding, 0.0)
    by_wall = op.both(scene.turning, scene.wall, state["explained"] > 0.5)
    reach = reach + op.where(by_wall, op.size(x - scene.expected), 0.0)
    reach = reach + rules.obstacle_speed * op.most(state["age"] - rules.due, 0.0)
    low, high = x - reach, x + reach
    # a known wall that the turning beam may have met since the last firing
    meets = op.both(scene.turning, state["since"] > 0.0)
    low = op.where(meets, op.least(low, scene.expected - 0.03 - scene.unsure), low)
    rivalled = state["votes"] > 0.5
    low = op.where(rivalled, op.least(low, state["rival"] - _RIVAL), low)
    high = op.where(rivalled, op.most(high, state["rival"] + _RIVAL), high)
    lost = op.both(op.no(healthy), op.either(state["turned"] > _UNSEEN, blind, op.both(scene.turning, late.late)))
    anything = op.either(state["known"] < 0.5, lost)
    at_minimum = state["heard"] <= rules.minimum + 1.5 * rules.resolution  # it reads the same from there down to 0
    low = op.where(op.either(anything, at_minimum), 0.0, op.most(low, 0.0))
    ceiling = op.least(scene.expected + scene.tolerance, far)
    high = op.least(op.where(anything, far, high), ceiling)
    # a track beyond what the walls allow: the wall itself
    low = op.where(low > ceiling, op.most(ceiling - 2.0 * scene.tolerance, 0.0), low)
    accepted = op.both(believed, healthy)
    nearest = op.least(*state["recent"])
    return (
        0.5 * (low + high),
        0.5 * (high - low),
        state["rate"] + 0.0,
        op.where(healthy, 1.0, 0.0),
        state["age"] + 0.0,
        state["heard"] + 0.0,
        op.where(accepted, 1.0, 0.0),
        op.where(accepted, nearest, 0.0),
    )
