"""Reader of the claim of a region certificate; it rejects missing or unknown keys and numbers that are not decimal."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeVar

from surctl.certcheck.document import Rejected, record

__all__ = [
    "EXCLUDES", "LAW", "CruiseClaim", "Pair", "axis_pairs", "lag_range", "law_gains", "number", "ordered", "read_claim",
    "read_shells", "read_top", "triangle", "two",
]  # fmt: skip

Pair = tuple[Fraction, Fraction]
Number = TypeVar("Number", float, Fraction)

_LARGEST = 10**9

EXCLUDES = (
    "the path is one straight leg, and its target moves along it at the cruise speed",
    "surge and sway have the same mass; their drag coefficients differ by no more than the stated asymmetry",
    "no obstacle, wall or unknown area bounds the velocity; no inequality constraint of the priority problem is active",
    "measured position and velocity are off by at most place_error_m and velocity_error_m_per_s; the heading is exact",
    "the depth and heading loops are not covered: the heading may turn in any way up to yaw_rate_rad_per_s",
    "waves and thrust errors act as a horizontal force of at most force_n; the current is the same everywhere and at "
    "all times, and at most current_m_per_s",
)
"""Restrictions of the claim; a certificate repeats the restrictions word for word."""


@dataclass(frozen=True)
class CruiseClaim:
    """Claim about the cruise along a straight path; SI units, pairs are (least, largest).

    Attributes:
        mass: true m11 = m22 [kg].
        linear, quadratic: range of the true drag of surge and of sway [N s/m, N s²/m²].
        asymmetry: largest difference of the drag coefficients of surge and sway, divided by their mean; the bound holds
            for the linear and for the quadratic coefficients.
        thrust: least thrust limit among the horizontal axes of the vehicle and of the law [N].
        lag: time constant of the thrust [s]; (0, 0) for thrust without lag.
        mass_model, linear_model, quadratic_model: mass and drag in the law's model.
        k1, lookahead, k_v, wait: the law's gains of these names [1/s, m, 1/s, m].
        cruise, cap: speed of the path's target and largest commanded speed [m/s].
        period: time for which a command is held [s]; 0 for continuous commands.
        yaw_rate: largest yaw rate |r| [rad/s].
        current: largest speed of a constant current in any direction [m/s].
        force: largest horizontal disturbance force, which may vary arbitrarily [N].
        place_error, velocity_error: largest error of the measured position [m] and of the measured velocity [m/s]; the
            errors vary arbitrarily.
        rate: decay rate a of V̇ ≤ −a V [1/s].
        offset: the region contains the points with x_e = 0, |y_e| = offset [m] and the target's velocity.
        ultimate_bound: largest |x_e| and |y_e| [m] in the set that every motion reaches and then does not leave.
    """

    mass: Pair
    linear: Pair
    quadratic: Pair
    asymmetry: Fraction
    thrust: Fraction
    lag: Pair
    mass_model: Fraction
    linear_model: Fraction
    quadratic_model: Fraction
    k1: Fraction
    lookahead: Fraction
    k_v: Fraction
    wait: Fraction
    cruise: Fraction
    cap: Fraction
    period: Fraction
    yaw_rate: Fraction
    current: Fraction
    force: Fraction
    place_error: Fraction
    velocity_error: Fraction
    rate: Fraction
    offset: Fraction
    ultimate_bound: tuple[Fraction, Fraction]


def number(value: Any, where: str, *, least: Fraction | int = 0, above: bool = False) -> Fraction:
    """Return the printed decimal of a number; raise Rejected if the number is < least (≤ least with `above`)."""
    whole = type(value) is int and abs(value) <= _LARGEST
    if not whole and not (type(value) is float and math.isfinite(value)):
        raise Rejected(f"{where} must be a finite number of at most {_LARGEST}")
    exact = Fraction(repr(value))
    if exact < least or (above and exact == least):
        raise Rejected(f"{where} must be {'above' if above else 'at least'} {least}, not {value!r}")
    if abs(exact) > _LARGEST or (exact and abs(exact) < Fraction(1, 10**18)):
        raise Rejected(f"{where} is too large or too close to 0: {value!r}")
    return exact


def triangle(rows: Any, size: int, where: str) -> list[list[Fraction]]:
    """Return the symmetric matrix (size, size) whose lower triangle has the given rows."""
    shaped = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
    if not shaped or [len(row) for row in rows] != list(range(1, size + 1)):
        raise Rejected(f"{where} must be a lower triangle with {size} rows")
    lower = [[number(entry, where, least=-_LARGEST) for entry in row] for row in rows]
    return [[lower[max(i, j)][min(i, j)] for j in range(size)] for i in range(size)]


def read_shells(proof: Mapping[str, Any], key: str, most: int) -> tuple[list[Fraction], list[Any]]:
    """Return the levels of V from the floor to 1, and the entry `key` of each shell."""
    shells = proof["shells"]
    if not isinstance(shells, list) or not 1 <= len(shells) <= most:
        raise Rejected(f"proof.shells must hold 1 to {most} shells")
    levels, entries = [number(proof["floor"], "proof.floor", above=True)], []
    for entry in shells:
        one = record(entry, ("level", key), "a shell")
        levels.append(number(one["level"], "the level of a shell", least=levels[-1], above=True))
        entries.append(one[key])
    if levels[-1] != 1:
        raise Rejected("the last shell must end at level 1")
    return levels, entries


def two(value: Any, where: str, *, least: Fraction | int = 0, above: bool = False) -> Pair:
    """Return two numbers, see `number`."""
    if not isinstance(value, list) or len(value) != 2:
        raise Rejected(f"{where} must have two entries")
    first, second = (number(entry, where, least=least, above=above) for entry in value)
    return first, second


def ordered(value: Any, where: str, *, above: bool = False) -> Pair:
    """Return the least and the largest value of a range, see `number`."""
    low, high = two(value, where, above=above)
    if low > high:
        raise Rejected(f"{where}: the least value exceeds the largest")
    return low, high


def lag_range(value: Any) -> Pair:
    """Return the range of the time constant of the thrust [s]; (0, 0) for thrust without lag."""
    low, high = ordered(value, "claim.vehicle.lag_s")
    if high and not low:
        raise Rejected("claim.vehicle.lag_s must be a range above 0, or [0, 0]")
    return low, high


LAW = (
    "mass_kg", "linear_drag", "quadratic_drag", "k1", "lookahead", "k_v", "k_i", "wait", "cruise", "cap", "period_s",
)  # fmt: skip
"""Entries of `claim.law` in a claim about the path-following law."""


def law_gains(law: Mapping[str, Any]) -> dict[str, Fraction]:
    """Return k1, lookahead, k_v, wait, cruise and cap, which are above 0, and the control period `period`."""
    if number(law["k_i"], "claim.law.k_i"):
        raise Rejected("claim.law.k_i must be 0: the certified loop has no integral action")
    names = ("k1", "lookahead", "k_v", "wait", "cruise", "cap")
    gains = {name: number(law[name], f"claim.law.{name}", above=True) for name in names}
    return {**gains, "period": number(law["period_s"], "claim.law.period_s")}


def axis_pairs(ends: tuple[Number, Number], asymmetry: Number) -> list[tuple[Number, Number]]:
    """Return the vertices of {(a, b): least ≤ a, b ≤ largest, |a − b| ≤ asymmetry (a + b)/2}.

    The numbers lie between t and t ratio for some t, so at a vertex each is one of the two, for the least or largest t.
    """
    least, largest = low, high = ends
    if asymmetry < 2:
        ratio = (2 + asymmetry) / (2 - asymmetry)
        low, high = max(largest / ratio, least), min(least * ratio, largest)
    return sorted({(least, least), (least, high), (high, least), (largest, largest), (largest, low), (low, largest)})


def read_top(claim: Any, system: str, excludes: Sequence[str]) -> Mapping[str, Any]:
    """Return the entries of a claim about this system; raise Rejected unless its texts and digests are as expected."""
    top = record(claim, ("system", "excludes", "vehicle", "law", "motion", "sha256_vehicle", "sha256_law"), "claim")
    if top["system"] != system:
        raise Rejected(f"claim.system {top['system']!r} is not known; known: {system}")
    if top["excludes"] != list(excludes):
        raise Rejected("claim.excludes differs from the text that this checker expects")
    for key in ("sha256_vehicle", "sha256_law"):
        if not isinstance(top[key], str) or not re.fullmatch("[0-9a-f]{64}", top[key]):
            raise Rejected(f"claim.{key} is not a SHA-256")
    return top


def read_claim(claim: Any) -> CruiseClaim:
    """Return the claim of a certificate.

    Raises:
        Rejected: a key is missing or unknown, a number has the wrong type or sign, or the stated restrictions are not
            those of this kind of claim.
    """
    top = read_top(claim, "cruise", EXCLUDES)
    vehicle = record(
        top["vehicle"],
        (
            "mass_kg",
            "linear_drag",
            "quadratic_drag",
            "asymmetry",
            "thrust_n",
            "lag_s",
            "yaw_rate_rad_per_s",
            "current_m_per_s",
            "force_n",
            "place_error_m",
            "velocity_error_m_per_s",
        ),
        "claim.vehicle",
    )
    law = record(top["law"], LAW, "claim.law")
    motion = record(top["motion"], ("rate_per_s", "offset_m", "ultimate_bound_m"), "claim.motion")
    lag = lag_range(vehicle["lag_s"])
    current = number(vehicle["current_m_per_s"], "claim.vehicle.current_m_per_s")
    gains = law_gains(law)
    if current and (lag[1] or gains["period"]):
        raise Rejected("claim.vehicle.current_m_per_s: a current with lag or with held commands is not supported")

    return CruiseClaim(
        mass=ordered(vehicle["mass_kg"], "claim.vehicle.mass_kg", above=True),
        linear=ordered(vehicle["linear_drag"], "claim.vehicle.linear_drag"),
        quadratic=ordered(vehicle["quadratic_drag"], "claim.vehicle.quadratic_drag"),
        asymmetry=number(vehicle["asymmetry"], "claim.vehicle.asymmetry"),
        thrust=number(vehicle["thrust_n"], "claim.vehicle.thrust_n", above=True),
        lag=lag,
        mass_model=number(law["mass_kg"], "claim.law.mass_kg", above=True),
        linear_model=number(law["linear_drag"], "claim.law.linear_drag"),
        quadratic_model=number(law["quadratic_drag"], "claim.law.quadratic_drag"),
        **gains,
        yaw_rate=number(vehicle["yaw_rate_rad_per_s"], "claim.vehicle.yaw_rate_rad_per_s"),
        current=current,
        force=number(vehicle["force_n"], "claim.vehicle.force_n"),
        place_error=number(vehicle["place_error_m"], "claim.vehicle.place_error_m"),
        velocity_error=number(vehicle["velocity_error_m_per_s"], "claim.vehicle.velocity_error_m_per_s"),
        rate=number(motion["rate_per_s"], "claim.motion.rate_per_s", above=True),
        offset=number(motion["offset_m"], "claim.motion.offset_m", above=True),
        ultimate_bound=two(motion["ultimate_bound_m"], "claim.motion.ultimate_bound_m", above=True),
    )
