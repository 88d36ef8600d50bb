"""Reader of the claim of a braking certificate; it rejects missing or unknown keys and numbers that are not decimal."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.inequality import listed
from surctl.certcheck.region_claim import number

__all__ = ["ASSUMES", "MOST_NUMBERS", "STOPPING", "BrakingClaim", "GuardedLaw", "read_claim"]

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
Rows = tuple[tuple[Fraction, ...], ...]

_TOP = (
    "system", "assumes", "vehicle", "encounter", "watch", "law", "table", "limit_obstacle_m_per_s", "sha256_vehicle",
    "sha256_law",
)  # fmt: skip
_VEHICLE = (
    "mass_kg", "mass_ratio", "linear_drag", "quadratic_drag", "drag", "brake_n", "most_n", "side_n", "lag_s",
)  # fmt: skip
_ENCOUNTER = (
    "obstacles_m_per_s", "current_m_per_s", "disturbance_n", "sideways_m_per_s", "turn_rad_per_s", "fastest_m_per_s",
)  # fmt: skip
_NAMES = (
    "current", "disturbance", "sideways", "turn", "fastest", "period", "age", "range_error", "speed_error",
)  # fmt: skip
_WATCH = ("period_s", "age_s", "range_error_m", "speed_error_m_per_s")
_LAW = (
    "barrier", "margin_m", "reaction_s", "brake", "limit_n", "k_v_per_s", "k_i_per_s2", "gain", "cap_m_per_s",
    "mass_kg", "linear_drag", "quadratic_drag", "stopping",
)  # fmt: skip
_SCALARS = ("margin_m", "reaction_s", "brake", "limit_n", "k_v_per_s", "gain", "cap_m_per_s")
STOPPING = ("lightest_kg", "heaviest_kg", "most_n", "lag_s", "linear_drag", "quadratic_drag")
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
        closed, distance, needed: braking distance without drag, braking distance, and needed range [m], for each own
            speed and obstacle.
        limit: largest obstacle speed at which the braking force still exceeds drag and disturbance.
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
    closed: Rows
    distance: Rows
    needed: Rows
    limit: Fraction


def read_claim(claim: Any) -> BrakingClaim:
    """Return the claim of a certificate.

    Raises:
        Rejected: a key is missing or unknown, a number has the wrong type or sign, or the stated assumptions are not
            those of this kind of claim.
    """
    top = record(claim, _TOP, "claim")
    if top["system"] != "braking":
        raise Rejected(f"claim.system {top['system']!r} is not known; known: braking")
    if top["assumes"] != list(ASSUMES):
        raise Rejected("claim.assumes differs from the text that this checker expects")
    for key in ("sha256_vehicle", "sha256_law"):
        if not isinstance(top[key], str) or not re.fullmatch("[0-9a-f]{64}", top[key]):
            raise Rejected(f"claim.{key} is not a SHA-256")
    vehicle = record(top["vehicle"], _VEHICLE, "claim.vehicle")
    met, watch = record(top["encounter"], _ENCOUNTER, "claim.encounter"), record(top["watch"], _WATCH, "claim.watch")
    table = record(top["table"], ("speeds_m_per_s", "closed_m", "distance_m", "needed_m"), "claim.table")
    if vehicle["drag"] not in ("along", "axes"):
        raise Rejected("claim.vehicle.drag must be along or axes")
    obstacles, speeds = _row(met, "obstacles_m_per_s"), _row(table, "speeds_m_per_s")
    if list(obstacles) != sorted(set(obstacles)):
        raise Rejected("claim.encounter.obstacles_m_per_s must rise")

    def grid(key: str) -> Rows:
        rows = tuple(_row({key: row}, key) for row in listed(table[key]))
        if len(rows) != len(speeds) or any(len(row) != len(obstacles) for row in rows):
            raise Rejected(f"claim.table.{key} must have one row for each speed and one column for each obstacle")
        return rows

    named: dict[str, Any] = {key.rpartition("_")[0]: _one(vehicle, key) for key in _VEHICLE[5:]}
    named |= dict(zip(_NAMES, [*(_one(met, key) for key in _ENCOUNTER[1:]), *(_one(watch, key) for key in _WATCH)],
                      strict=True))  # fmt: skip
    return BrakingClaim(
        mass=_pair(vehicle, "mass_kg"),
        ratio=number(vehicle["mass_ratio"], "claim: mass_ratio", least=1),
        linear=_pair(vehicle, "linear_drag"),
        quadratic=_pair(vehicle, "quadratic_drag"),
        drag=vehicle["drag"],
        obstacles=obstacles,
        law=None if top["law"] is None else _law(top["law"]),
        speeds=speeds,
        closed=grid("closed_m"),
        distance=grid("distance_m"),
        needed=grid("needed_m"),
        limit=_one(top, "limit_obstacle_m_per_s"),
        **named,
    )


def _law(value: Any) -> GuardedLaw:
    law = record(value, _LAW, "claim.law")
    stopping = record(law["stopping"], STOPPING, "claim.law.stopping")
    if _one(law, "k_i_per_s2"):
        raise Rejected("claim.law.k_i_per_s2 must be 0: the certified loop has no integral action")
    if law["barrier"] not in ("inertia", "simple"):
        raise Rejected("claim.law.barrier must be inertia or simple")
    believed = tuple(_one(stopping, key) for key in STOPPING)
    if believed[0] > believed[1]:
        raise Rejected("claim.law.stopping: lightest_kg exceeds heaviest_kg")
    named: dict[str, Any] = {key.partition("_")[0]: _row(law, key, 2) for key in _LAW[9:12]}
    for name, key in zip(("margin", "reaction", "brake", "limit", "k_v", "gain", "cap"), _SCALARS, strict=True):
        named[name] = _one(law, key)
    return GuardedLaw(barrier=law["barrier"], stopping=believed, **named)


def _one(part: Mapping[str, Any], key: str) -> Fraction:
    return number(part[key], f"claim: {key}", above=key in _POSITIVE)


def _row(part: Mapping[str, Any], key: str, size: int = 0) -> tuple[Fraction, ...]:
    value = part[key]
    if not isinstance(value, list) or not 1 <= len(value) <= MOST_NUMBERS or (size and len(value) != size):
        raise Rejected(f"claim: {key} must be a list of {size or f'1 to {MOST_NUMBERS}'} numbers")
    return tuple(_one({key: entry}, key) for entry in value)


def _pair(part: Mapping[str, Any], key: str) -> Pair:
    low, high = _row(part, key, 2)
    if low > high:
        raise Rejected(f"claim: {key}: the least value exceeds the largest")
    return low, high
