"""A test whether a sensor delivers late readings after a gap, based on known walls or on the robot's own motion."""

from __future__ import annotations

from typing import NamedTuple

from surctl.marine.sensing.ranging.elementwise import Value
from surctl.marine.sensing.ranging.scene import Step

__all__ = ["Late", "lateness"]

_SMALL, _TELLING, _TELLING_WALL = 0.025, 0.035, 0.05  # m, least shift that matters, and that can show a delay
_TRACK_SPREAD, _WALL_SPREAD = 0.012, 0.02  # m, standard deviation of residuals from the old track and expected range
_TRACK_GATE = _WALL_GATE = 0.05  # m
_EVIDENCE, _LOOKS, _LOOKS_WALL = 60.0, 4, 6  # needed for a decision: sum of shift²/variance, numbers of readings
_FORGET = 0.95  # factor on the old evidence at each new reading


class Late(NamedTuple):
    """The result of the test for late readings at one step."""

    late_by: Value
    late: Value
    away: Value  # a late reading minus the present range
    undecided: Value  # the test has no decision yet, and the shift is large enough to matter
    judging: Value  # this reading is evidence for the test and does not update the track


def lateness(step: Step, sound: Value, reading: Value) -> Late:
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
    return Late(
        late_by=state["late_by"],
        late=late,
        away=op.where(state["late_by"] > 0.0, away, 0.0),
        undecided=op.both(suspected, op.size(away) > _SMALL),
        judging=op.both(judging, op.no(true), op.no(by_wall)),
    )
