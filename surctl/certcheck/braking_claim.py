"""The claim of a braking certificate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected, listed, record
from surctl.certcheck.fields import Pair, choice, number, ordered, placed, read_fields, read_top, row, two, zero

__all__ = ["ASSUMES", "STOPPING", "BrakingClaim", "GuardedLaw", "read_claim"]

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

STOPPING = ("lightest_kg", "heaviest_kg", "most_n", "lag_s", "linear_drag", "quadratic_drag")
"""The keys of `claim.law.stopping`."""


def _stopping(value: Any, where: str) -> Mapping[str, Fraction]:
    entries = record(value, STOPPING, where)
    numbers = {key: number(entries[key], f"{where}.{key}", above=key.endswith("est_kg")) for key in STOPPING}
    if numbers["lightest_kg"] > numbers["heaviest_kg"]:
        raise Rejected(f"{where}: lightest_kg exceeds heaviest_kg")
    return numbers


def _rising(value: Any, where: str) -> tuple[Fraction, ...]:
    numbers = row(value, where)
    if list(numbers) != sorted(set(numbers)):
        raise Rejected(f"{where} must rise")
    return numbers


def _rows(value: Any, where: str) -> tuple[tuple[Fraction, ...], ...]:
    return tuple(row(entry, where) for entry in listed(value))


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
        stopping: numbers of the bound `inertia`, by the keys `STOPPING`.
        k_i: integral gain, which is 0.
    """

    barrier: str = placed("barrier", choice, of=("inertia", "simple"))
    margin: Fraction = placed("margin_m", number)
    reaction: Fraction = placed("reaction_s", number, above=True)
    brake: Fraction = placed("brake", number, above=True)
    limit: Fraction = placed("limit_n", number, above=True)
    k_v: Fraction = placed("k_v_per_s", number, above=True)
    gain: Fraction = placed("gain", number)
    cap: Fraction = placed("cap_m_per_s", number, above=True)
    mass: Pair = placed("mass_kg", two, above=True)
    linear: Pair = placed("linear_drag", two)
    quadratic: Pair = placed("quadratic_drag", two)
    stopping: Mapping[str, Fraction] = placed("stopping", _stopping)
    k_i: Fraction = placed("k_i_per_s2", zero, default=Fraction(0))


@dataclass(frozen=True)
class BrakingClaim:
    """A claim about braking; SI units, pairs are (least, largest).

    Attributes:
        law: the control law; None if the claim is about the rule alone: brake unless the needed range is available.
        mass, ratio, linear, quadratic: mass of the lighter axis, largest ratio of the masses, drag of both axes.
        drag: `along` if drag acts against the velocity, `axes` if each body axis has a drag of its own.
        brake, most, side: guaranteed braking force F_b; largest thrust towards the obstacle, and across.
        lag: largest time constant τ of the thrust.
        obstacles: approach speeds v_o, which rise.
        current, disturbance: largest speed of the current towards the obstacle, and largest other force towards it.
        sideways, turn, fastest: largest sideways speed, largest yaw rate while braking, largest own speed V.
        period, age, range_error, speed_error: control period, and age and errors of the measurements.
        speeds: own speeds for which the table has entries.
        needed: needed range [m] for each own speed and obstacle.
        limit: obstacle speed at which the braking force still exceeds the other forces.
    """

    law: GuardedLaw | None
    mass: Pair = placed("vehicle.mass_kg", ordered, above=True)
    ratio: Fraction = placed("vehicle.mass_ratio", number, least=1)
    linear: Pair = placed("vehicle.linear_drag", ordered)
    quadratic: Pair = placed("vehicle.quadratic_drag", ordered)
    drag: str = placed("vehicle.drag", choice, of=("along", "axes"))
    brake: Fraction = placed("vehicle.brake_n", number, above=True)
    most: Fraction = placed("vehicle.most_n", number, above=True)
    side: Fraction = placed("vehicle.side_n", number)
    lag: Fraction = placed("vehicle.lag_s", number)
    obstacles: tuple[Fraction, ...] = placed("encounter.obstacles_m_per_s", _rising)
    current: Fraction = placed("encounter.current_m_per_s", number)
    disturbance: Fraction = placed("encounter.disturbance_n", number)
    sideways: Fraction = placed("encounter.sideways_m_per_s", number)
    turn: Fraction = placed("encounter.turn_rad_per_s", number)
    fastest: Fraction = placed("encounter.fastest_m_per_s", number, above=True)
    period: Fraction = placed("watch.period_s", number, above=True)
    age: Fraction = placed("watch.age_s", number)
    range_error: Fraction = placed("watch.range_error_m", number)
    speed_error: Fraction = placed("watch.speed_error_m_per_s", number)
    speeds: tuple[Fraction, ...] = placed("table.speeds_m_per_s", row)
    needed: tuple[tuple[Fraction, ...], ...] = placed("table.needed_m", _rows)
    limit: Fraction = placed("table.limit_obstacle_m_per_s", number)


def read_claim(claim: Any) -> BrakingClaim:
    """Return the claim of a certificate; raise Rejected if a key, number or text is not one of this kind of claim."""
    top = read_top(claim, "braking", ("law", "vehicle", "encounter", "watch", "table"), "assumes", ASSUMES)
    law = None if top["law"] is None else read_fields(GuardedLaw, top["law"], "claim.law")
    read = read_fields(BrakingClaim, top, law=law)
    if len(read.needed) != len(read.speeds) or any(len(entry) != len(read.obstacles) for entry in read.needed):
        raise Rejected("claim.table.needed_m must have one row for each speed and one column for each obstacle")
    return read
