"""Reader of the claim of a braking certificate; it rejects missing or unknown keys and numbers that are not decimal."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected, listed, record
from surctl.certcheck.region_claim import number, two

__all__ = ["ASSUMES", "LAW", "MOST_NUMBERS", "PLACES", "STOPPING", "BrakingClaim", "GuardedLaw", "read_claim"]

ASSUMES = (
    "there is one obstacle or wall at a time; it is convex, does not rotate and never approaches faster than stated",
    "the lighter one of the masses in surge and sway is within mass_kg, the heavier one at most mass_ratio times as "
    "large; drag acts along the velocity, or axis by axis at any heading, as stated",
    "thrust follows its command with a first-order lag of at most lag_s and never exceeds most_n",
    "while the vehicle brakes, the commanded thrust is delivered up to brake_n against the direction that was latched "
    "at the last decision without braking; no thrust across that direction is commanded, or at most side_n if "
    "mass_ratio is above 1; and the hull turns no faster than stated",
    "range and own speed are measured with no more than the stated age and errors; a decision holds for one period",
    "own speed is at most fastest_m_per_s, ahead and astern, while the vehicle brakes too; across the latched "
    "direction, the true and the commanded speed are at most sideways_m_per_s",
    "law: the speed that it wants is at most cap_m_per_s; thrust that its velocity loop commanded against an obstacle "
    "does not act towards the obstacle within the lag, because its direction and the hull turn too little for that",
    "law: its input gives the stated approach speed of the obstacles; its velocity bounds are consistent; across the "
    "latched direction, no axis reaches its limit and no thruster saturates, so that the braking thrust is not scaled "
    "down; its retreat speed is not limited (it is limited before marks of the sonar map)",
    "at the start the clearance is at least the braking distance",
)
"""Assumptions of the claim; a certificate repeats the assumptions word for word."""

Pair = tuple[Fraction, Fraction]

PLACES = {
    "mass": "vehicle.mass_kg", "ratio": "vehicle.mass_ratio", "linear": "vehicle.linear_drag",
    "quadratic": "vehicle.quadratic_drag", "drag": "vehicle.drag", "brake": "vehicle.brake_n",
    "most": "vehicle.most_n", "side": "vehicle.side_n", "lag": "vehicle.lag_s",
    "obstacles": "encounter.obstacles_m_per_s", "current": "encounter.current_m_per_s",
    "disturbance": "encounter.disturbance_n", "sideways": "encounter.sideways_m_per_s",
    "turn": "encounter.turn_rad_per_s", "fastest": "encounter.fastest_m_per_s", "period": "watch.period_s",
    "age": "watch.age_s", "range_error": "watch.range_error_m", "speed_error": "watch.speed_error_m_per_s",
    "speeds": "table.speeds_m_per_s", "needed": "table.needed_m", "limit": "table.limit_obstacle_m_per_s",
}  # fmt: skip
"""Where the claim has each attribute of `BrakingClaim`: group and key."""

STOPPING = ("lightest_kg", "heaviest_kg", "most_n", "lag_s", "linear_drag", "quadratic_drag")
LAW = {
    "barrier": "barrier", "margin": "margin_m", "reaction": "reaction_s", "brake": "brake", "limit": "limit_n",
    "k_v": "k_v_per_s", "k_i": "k_i_per_s2", "gain": "gain", "cap": "cap_m_per_s", "mass": "mass_kg",
    "linear": "linear_drag", "quadratic": "quadratic_drag", "stopping": "stopping",
}  # fmt: skip
"""The key of each attribute of `GuardedLaw` in `claim.law`; `STOPPING` are those of its entry `stopping`."""

_PAIRS = ("mass", "linear", "quadratic")
_POSITIVE = {
    "mass_kg", "brake_n", "most_n", "fastest_m_per_s", "period_s", "reaction_s", "brake", "limit_n", "k_v_per_s",
    "cap_m_per_s", "lightest_kg", "heaviest_kg",
}  # fmt: skip
MOST_NUMBERS = 12
"""Largest length of a row of the table."""


@dataclass(frozen=True)
class GuardedLaw:
    """The law's speed bound, and the response of its velocity loop to a speed above the bound; SI units.

    Attributes:
        barrier: `inertia` or `simple`.
        margin, reaction: the law's gains of these names [m], [s].
        brake, limit: share of the thrust limit that the speed bound uses for braking; thrust limit [N].
        k_v, gain: bandwidth of the velocity loop [1/s]; the commanded velocity is reduced by gain times the excess of
            the speed over the bound.
        cap: largest speed that the law wants [m/s].
        mass, linear, quadratic: mass, and linear and quadratic drag, of (surge, sway) in the law's model.
        stopping: numbers of the bound `inertia`: least mass, largest mass, largest thrust, lag, linear and quadratic
            drag.
    """

    barrier: str
    margin: Fraction
    reaction: Fraction
    brake: Fraction
    limit: Fraction
    k_v: Fraction
    gain: Fraction
    cap: Fraction
    mass: Pair
    linear: Pair
    quadratic: Pair
    stopping: tuple[Fraction, ...]


@dataclass(frozen=True)
class BrakingClaim:
    """A claim about braking; SI units, pairs are (least, largest).

    Attributes:
        mass, ratio, linear, quadratic: mass of the lighter axis, largest ratio of the masses, drag of both axes.
        drag: `along` if drag acts against the velocity, `axes` if each body axis has a drag of its own.
        brake, most, side: guaranteed braking force F_b; largest thrust towards the obstacle, and across.
        lag: largest time constant τ of the thrust.
        obstacles: approach speeds v_o, which rise.
        current, disturbance: largest speed of the current towards the obstacle, and largest other force towards it.
        sideways, turn, fastest: largest sideways speed, largest yaw rate while braking, largest own speed V.
        period, age, range_error, speed_error: control period, and age and errors of the measurements.
        law: the control law; None if the claim is about the rule alone: brake unless the needed range is available.
        speeds: own speeds for which the table has entries.
        needed: needed range [m] for each own speed and obstacle.
        limit: obstacle speed at which the braking force still exceeds the other forces.
    """

    mass: Pair
    ratio: Fraction
    linear: Pair
    quadratic: Pair
    drag: str
    brake: Fraction
    most: Fraction
    side: Fraction
    lag: Fraction
    obstacles: tuple[Fraction, ...]
    current: Fraction
    disturbance: Fraction
    sideways: Fraction
    turn: Fraction
    fastest: Fraction
    period: Fraction
    age: Fraction
    range_error: Fraction
    speed_error: Fraction
    law: GuardedLaw | None
    speeds: tuple[Fraction, ...]
    needed: tuple[tuple[Fraction, ...], ...]
    limit: Fraction


def read_claim(claim: Any) -> BrakingClaim:
    """Return the claim of a certificate.

    Raises:
        Rejected: a key is missing or unknown, a number has the wrong type or sign, or the stated assumptions are not
            those of this kind of claim.
    """
    groups = {path.partition(".")[0] for path in PLACES.values()}
    top = record(claim, {"system", "assumes", "law", "sha256_vehicle", "sha256_law"} | groups, "claim")
    if top["system"] != "braking":
        raise Rejected(f"claim.system {top['system']!r} is not known; known: braking")
    if top["assumes"] != list(ASSUMES):
        raise Rejected("claim.assumes differs from the text that this checker expects")
    for key in ("sha256_vehicle", "sha256_law"):
        if not isinstance(top[key], str) or not re.fullmatch("[0-9a-f]{64}", top[key]):
            raise Rejected(f"claim.{key} is not a SHA-256")
    for group in groups:
        keys = [path.partition(".")[2] for path in PLACES.values() if path.startswith(f"{group}.")]
        record(top[group], keys, f"claim.{group}")
    named: dict[str, Any] = {}
    for name, path in PLACES.items():
        group, _, key = path.partition(".")
        named[name] = _value(name, key, top[group][key])
    obstacles, rows = named["obstacles"], named["needed"]
    if list(obstacles) != sorted(set(obstacles)):
        raise Rejected("claim.encounter.obstacles_m_per_s must rise")
    if len(rows) != len(named["speeds"]) or any(len(row) != len(obstacles) for row in rows):
        raise Rejected("claim.table.needed_m must have one row for each speed and one column for each obstacle")
    for name in _PAIRS:
        if named[name][0] > named[name][1]:
            raise Rejected(f"claim: {PLACES[name]}: the least value exceeds the largest")
    if named["drag"] not in ("along", "axes"):
        raise Rejected("claim.vehicle.drag must be along or axes")
    return BrakingClaim(law=None if top["law"] is None else _law(top["law"]), **named)


def _law(value: Any) -> GuardedLaw:
    entries = record(value, LAW.values(), "claim.law")
    record(entries["stopping"], STOPPING, "claim.law.stopping")
    law: dict[str, Any] = {name: _value(name, key, entries[key]) for name, key in LAW.items()}
    if law.pop("k_i"):
        raise Rejected("claim.law.k_i_per_s2 must be 0: the certified loop has no integral action")
    if law["barrier"] not in ("inertia", "simple"):
        raise Rejected("claim.law.barrier must be inertia or simple")
    if law["stopping"][0] > law["stopping"][1]:
        raise Rejected("claim.law.stopping: lightest_kg exceeds heaviest_kg")
    return GuardedLaw(**law)


def _value(name: str, key: str, value: Any) -> Any:
    """Return the value of an attribute, numbers as exact decimals."""
    where, above = f"claim: {key}", key in _POSITIVE
    if name in ("drag", "barrier"):
        return value
    if name == "stopping":
        return tuple(number(value[entry], f"{where}.{entry}", above=entry in _POSITIVE) for entry in STOPPING)
    if name in _PAIRS:
        return two(value, where, above=above)
    if name == "needed":
        return tuple(_row(where, row) for row in listed(value))
    if name in ("obstacles", "speeds"):
        return _row(where, value)
    return number(value, where, least=int(name == "ratio"), above=above)


def _row(where: str, value: Any) -> tuple[Fraction, ...]:
    if not isinstance(value, list) or not 1 <= len(value) <= MOST_NUMBERS:
        raise Rejected(f"{where} must be a list of 1 to {MOST_NUMBERS} numbers")
    return tuple(number(entry, where) for entry in value)
