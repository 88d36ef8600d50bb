"""Reader of the claim of a braking certificate; it rejects missing or unknown keys and numbers that are not decimal."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.region_claim import number

__all__ = ["ASSUMES", "DRAGS", "LEMMAS", "BrakingClaim", "GuardedLaw", "read_claim"]

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

LEMMAS = (
    "distance: G' >= z/(F_b - f + D(z - v_o)) and G' rises; so clearance - m G(z) does not fall while the vehicle "
    "brakes; beyond the largest closing speed, G' may stay as it is",
    "retreat: the same holds while the vehicle retreats faster than the obstacle approaches; or G is then that at the "
    "closing speed 0, while the clearance grows and the lagging thrust falls",
    "mass: m G(s + q/m) is convex in m, so that one end of the mass range is the worst case; for unequal masses, m is "
    "the lighter one and the distance is mass_ratio times as large",
    "push: thrust towards the obstacle is at most most_n, and that of a velocity loop at most k_v m (cap + fastest) + "
    "drag(cap) of the law's model, in any direction; the lag averages commands, so it never delivers more",
    "period: with any such thrust during one period, or with the one that the loop commands at the speed that it has, "
    "the range needed is enough for the period and the braking distance after it",
    "law: wherever the law does not brake with brake_n, the clearance is at least the range needed",
    "plane: the distance to a convex body is convex in the position, so that it is enough to consider the latched "
    "direction",
)
"""Lemmas from which the claim follows; a certificate repeats them. Proofs: `surctl.marine.guidance.braking`."""

DRAGS = ("along", "axes")
_BARRIERS = ("inertia", "simple")

Pair = tuple[Fraction, Fraction]


@dataclass(frozen=True)
class GuardedLaw:
    """The law's speed bound, and the response of its velocity loop to a speed above the bound; SI units.

    Attributes:
        barrier: `inertia` or `simple`.
        margin, reaction: the law's gains `margin` [m] and `reaction` [s].
        brake, limit: limit is the thrust limit [N]; brake is the share of this limit that the speed bound uses for
            braking.
        k_v, gain: k_v is the bandwidth of the velocity loop [1/s]; the law subtracts gain times the excess of the speed
            over the bound from the commanded velocity.
        cap: largest speed that the law wants [m/s].
        mass, linear, quadratic: mass, and linear and quadratic drag, of (surge, sway) in the law's model.
        stopping: parameters of the speed bound `inertia`: least mass, largest mass, largest thrust, lag, linear drag,
            quadratic drag.
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
        mass, linear, quadratic: true mass, that of the lighter axis; and linear drag and quadratic drag of both axes.
        ratio: largest ratio of the masses in surge and sway, the heavier one over the lighter one.
        drag: `along` if the drag depends on the speed and acts against the velocity, `axes` if each body axis has a
            drag of its own.
        brake, most, side: brake is the guaranteed braking force F_b; most is the largest thrust towards the obstacle;
            side is the largest thrust perpendicular to the direction of the obstacle.
        lag: largest time constant τ of the thrust.
        obstacles: approach speeds v_o of the obstacles, in increasing order.
        current, disturbance: largest speed of the current towards the obstacle, and largest other force towards it.
        sideways, turn, fastest: largest sideways speed, largest yaw rate while braking, largest own speed.
        period, age, range_error, speed_error: control period, largest age of a measured range, largest error of the
            range, and largest error of the measured own speed.
        law: the control law; None if the claim is about the rule alone (brake unless the needed range is available).
        speeds: own speeds for which the table has entries.
        closed, distance, needed: table entries [m] for each own speed and obstacle: the closed-form braking distance,
            the braking distance with drag, and the needed range.
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
    closed: tuple[tuple[Fraction, ...], ...]
    distance: tuple[tuple[Fraction, ...], ...]
    needed: tuple[tuple[Fraction, ...], ...]
    limit: Fraction


def read_claim(claim: Any) -> BrakingClaim:
    """Return the claim of a certificate.

    Raises:
        Rejected: a key is missing or unknown, a number has the wrong type or sign, or the stated assumptions or lemmas
            are not those of this kind of claim.
    """
    keys = ("system", "assumes", "lemmas", "vehicle", "encounter", "watch", "law", "table", "limit_obstacle_m_per_s",
            "sha256_vehicle", "sha256_law")  # fmt: skip
    top = record(claim, keys, "claim")
    if top["system"] != "braking":
        raise Rejected(f"claim.system {top['system']!r} is not known; known: braking")
    if top["assumes"] != list(ASSUMES) or top["lemmas"] != list(LEMMAS):
        raise Rejected("claim.assumes or claim.lemmas differs from the text that this checker expects")
    for key in ("sha256_vehicle", "sha256_law"):
        if not isinstance(top[key], str) or not re.fullmatch("[0-9a-f]{64}", top[key]):
            raise Rejected(f"claim.{key} is not a SHA-256")
    names = ("mass_kg", "mass_ratio", "linear_drag", "quadratic_drag", "drag", "brake_n", "most_n", "side_n", "lag_s")
    vehicle = record(top["vehicle"], names, "claim.vehicle")
    if vehicle["drag"] not in DRAGS:
        raise Rejected(f"claim.vehicle.drag must be one of {', '.join(DRAGS)}")
    met = record(
        top["encounter"],
        (
            "obstacles_m_per_s",
            "current_m_per_s",
            "disturbance_n",
            "sideways_m_per_s",
            "turn_rad_per_s",
            "fastest_m_per_s",
        ),
        "claim.encounter",
    )
    watch = record(top["watch"], ("period_s", "age_s", "range_error_m", "speed_error_m_per_s"), "claim.watch")
    table = record(top["table"], ("speeds_m_per_s", "closed_m", "distance_m", "needed_m"), "claim.table")
    obstacles, speeds = _row(met["obstacles_m_per_s"], "obstacles"), _row(table["speeds_m_per_s"], "speeds")
    if list(obstacles) != sorted(set(obstacles)):
        raise Rejected("claim.encounter.obstacles_m_per_s must rise")

    def grid(name: str) -> tuple[tuple[Fraction, ...], ...]:
        rows = table[name]
        if not isinstance(rows, list) or len(rows) != len(speeds):
            raise Rejected(f"claim.table.{name} must have one row for each speed")
        values = tuple(_row(row, name) for row in rows)
        if any(len(row) != len(obstacles) for row in values):
            raise Rejected(f"claim.table.{name} must have one column for each obstacle")
        return values

    def plain(part: Mapping[str, Any], name: str, *, above: bool = False) -> Fraction:
        return number(part[name], f"claim: {name}", above=above)

    return BrakingClaim(
        mass=_pair(vehicle["mass_kg"], "mass_kg", above=True),
        ratio=number(vehicle["mass_ratio"], "claim: mass_ratio", least=1),
        linear=_pair(vehicle["linear_drag"], "linear_drag"),
        quadratic=_pair(vehicle["quadratic_drag"], "quadratic_drag"),
        drag=vehicle["drag"],
        brake=plain(vehicle, "brake_n", above=True),
        most=plain(vehicle, "most_n", above=True),
        side=plain(vehicle, "side_n"),
        lag=plain(vehicle, "lag_s"),
        obstacles=obstacles,
        current=plain(met, "current_m_per_s"),
        disturbance=plain(met, "disturbance_n"),
        sideways=plain(met, "sideways_m_per_s"),
        turn=plain(met, "turn_rad_per_s"),
        fastest=plain(met, "fastest_m_per_s", above=True),
        period=plain(watch, "period_s", above=True),
        age=plain(watch, "age_s"),
        range_error=plain(watch, "range_error_m"),
        speed_error=plain(watch, "speed_error_m_per_s"),
        law=None if top["law"] is None else _law(top["law"]),
        speeds=speeds,
        closed=grid("closed_m"),
        distance=grid("distance_m"),
        needed=grid("needed_m"),
        limit=plain(top, "limit_obstacle_m_per_s"),
    )


def _law(value: Any) -> GuardedLaw:
    law = record(
        value,
        ("barrier", "margin_m", "reaction_s", "brake", "limit_n", "k_v_per_s", "k_i_per_s2", "gain",
         "cap_m_per_s", "mass_kg", "linear_drag", "quadratic_drag", "stopping"),
        "claim.law",
    )  # fmt: skip
    if number(law["k_i_per_s2"], "claim.law.k_i_per_s2"):
        raise Rejected("claim.law.k_i_per_s2 must be 0: the certified loop has no integral action")
    if law["barrier"] not in _BARRIERS:
        raise Rejected(f"claim.law.barrier must be one of {', '.join(_BARRIERS)}")
    names = ("lightest_kg", "heaviest_kg", "most_n", "lag_s", "linear_drag", "quadratic_drag")
    stopping = record(law["stopping"], names, "claim.law.stopping")

    def positive(name: str) -> Fraction:
        return number(law[name], f"claim.law.{name}", above=True)

    def axes(name: str, *, above: bool = False) -> Pair:
        if not isinstance(law[name], list) or len(law[name]) != 2:
            raise Rejected(f"claim.law.{name} must be [surge, sway]")
        surge, sway = (number(entry, f"claim.law.{name}", above=above) for entry in law[name])
        return surge, sway

    bound = tuple(number(stopping[n], f"claim.law.stopping.{n}", above=n.endswith("_kg")) for n in names)
    if bound[0] > bound[1]:
        raise Rejected("claim.law.stopping: lightest_kg exceeds heaviest_kg")
    return GuardedLaw(
        law["barrier"],
        number(law["margin_m"], "claim.law.margin_m"),
        positive("reaction_s"),
        positive("brake"),
        positive("limit_n"),
        positive("k_v_per_s"),
        number(law["gain"], "claim.law.gain"),
        positive("cap_m_per_s"),
        axes("mass_kg", above=True),
        axes("linear_drag"),
        axes("quadratic_drag"),
        bound,
    )


def _row(value: Any, where: str) -> tuple[Fraction, ...]:
    if not isinstance(value, list) or not 1 <= len(value) <= 12:
        raise Rejected(f"claim: {where} must be a list of 1 to 12 numbers")
    return tuple(number(entry, f"claim: {where}") for entry in value)


def _pair(value: Any, where: str, *, above: bool = False) -> Pair:
    if not isinstance(value, list) or len(value) != 2:
        raise Rejected(f"claim: {where} must be [least, largest]")
    low, high = (number(entry, f"claim: {where}", above=above) for entry in value)
    if low > high:
        raise Rejected(f"claim: {where}: the least value exceeds the largest")
    return low, high
