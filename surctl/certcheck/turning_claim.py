"""Reader of the claim of a `turning` certificate: the cruise of a vehicle with unequal masses that turns meanwhile."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any, TypeVar

from surctl.certcheck.document import Rejected
from surctl.certcheck.fields import Pair, number, ordered, placed, read_fields, read_top, two, zero

__all__ = ["EXCLUDES", "TurningClaim", "axis_pairs", "drag_factors", "read_claim"]

Number = TypeVar("Number", float, Fraction)

_TERM = re.compile("m[1-4][1-4]|[XYZN][uvwr]{1,2}|[XYZN]0|F[uvwr]_reverse")
_EQUATION_3 = {
    *(f"m{i}{j}" for i in range(1, 5) for j in range(1, i + 1)),
    *(force + axis * count for force, axis in zip("XYZN", "uvwr", strict=True) for count in (1, 2)),
}  # entries on and below the diagonal, and terms of equation (3)
_MOST_TERMS = 60

EXCLUDES = (
    "the path is a smooth curve with a curvature of at most curvature_per_m (0: one straight leg), and its target "
    "moves along it at the cruise speed; a path of short straight legs is not such a curve",
    "no obstacle, wall or unknown area bounds the velocity; no inequality constraint of the priority problem is active",
    "measured position and velocity are off by at most place_error_m and velocity_error_m_per_s; the heading is exact, "
    "and the command is computed without delay; waves and thrust errors act as a horizontal force of at most force_n; "
    "the current is the same everywhere and at all times, and at most current_m_per_s",
    "the thrust lags behind its command with a time constant of lag_s (0: no lag), and is that of the steady cruise at "
    "the stated starts; a command is held for period_s (0: not at all), and time begins at a control instant",
    "the depth and heading loops are not covered: the heading may turn in any way up to yaw_rate_rad_per_s, with a yaw "
    "acceleration of at most yaw_rad_per_s2 and a heave of at most heave_m_per_s and heave_m_per_s2; the heading loop "
    "must hold its limits against a Munk moment of up to munk_moment_nm",
)
"""Restrictions of the claim; a certificate repeats the restrictions word for word."""


def _asymmetry(value: Any, where: str) -> Fraction:
    if (share := number(value, where)) >= 2:
        raise Rejected(f"{where}: an asymmetry must be below 2")
    return share


def _rest(value: Any, where: str) -> Fraction | None:
    return None if value is None else number(value, where)


def _lag(value: Any, where: str) -> Pair:
    low, high = ordered(value, where)
    if high and not low:
        raise Rejected(f"{where} must be a range above 0, or [0, 0]")
    return low, high


def _terms(value: Any, where: str) -> dict[str, Fraction]:
    """Return the terms of a vehicle beside equation (3), by name."""
    if not isinstance(value, dict) or len(value) > _MOST_TERMS:
        raise Rejected(f"{where} must be an object")
    terms = {}
    for name, entry in value.items():
        if not _TERM.fullmatch(name) or name in _EQUATION_3:
            raise Rejected(f"{where}: {name!r} is not a term beside equation (3)")
        terms[name] = number(entry, f"{where}.{name}", least=-(10**9))
    return terms


@dataclass(frozen=True)
class TurningClaim:
    """Claim about the cruise along a straight path for m11 ≠ m22; SI units, pairs are (surge, sway).

    A true parameter is its value in the law's model times a constant factor. The two masses have their own factors
    within the same range (least, largest), and so have the four drag coefficients. The factors of the two masses, of
    the two linear and of the two quadratic drag coefficients differ by at most an asymmetry times their mean.

    Attributes:
        mass_factor, drag_factor: ranges of the factors of the masses and of the drag coefficients.
        mass_asymmetry, drag_asymmetry: largest asymmetry of the factors.
        thrust: least thrust limit of the vehicle and of the law [N].
        yaw_rate: largest yaw rate |r| [rad/s].
        munk_moment: largest yaw moment of the Coriolis forces in the region [N m].
        terms: the vehicle's terms beside equation (3), by name.
        heave, heave_rate: largest heave velocity [m/s] and heave acceleration [m/s²].
        turn_rate: largest yaw acceleration [rad/s²].
        mass, linear, quadratic: mass [kg] and drag [N s/m, N s²/m²] in the law's model.
        k1, lookahead, k_v, k_i, wait: the law's gains of these names [1/s, m, 1/s, 1/s², m].
        cruise, cap: speed of the path's target and largest commanded speed [m/s].
        rate: decay rate a of V̇ ≤ −a V [1/s].
        offset: the region contains the points with x_e = 0, |y_e| = offset [m] and the target's velocity.
        rest_offset: the region contains the points with x_e = 0, |y_e| = rest_offset [m] and a vehicle at rest; None if
            the claim states no such points.
        ultimate_bound: largest |x_e| and |y_e| [m] in the set that every motion reaches and then does not leave.
        curvature: largest curvature of the path [1/m].
        current: largest speed of a constant current in any direction [m/s].
        lag: range of the time constant of the thrust [s]; (0, 0) for thrust without lag.
        period: time for which a command is held [s]; 0 for continuous commands.
        force: largest horizontal disturbance force, which may vary arbitrarily [N].
        place_error, velocity_error: largest error of the measured position [m] and of the measured velocity [m/s]; the
            errors vary arbitrarily. Only claims without lag and held commands have these errors and a force.
    """

    mass_factor: Pair = placed("vehicle.mass_factor", ordered, above=True)
    drag_factor: Pair = placed("vehicle.drag_factor", ordered, above=True)
    mass_asymmetry: Fraction = placed("vehicle.mass_asymmetry", _asymmetry)
    drag_asymmetry: Fraction = placed("vehicle.drag_asymmetry", _asymmetry)
    thrust: Pair = placed("vehicle.thrust_n", two, above=True)
    yaw_rate: Fraction = placed("vehicle.yaw_rate_rad_per_s", number)
    munk_moment: Fraction = placed("vehicle.munk_moment_nm", number)
    terms: Mapping[str, Fraction] = placed("vehicle.terms", _terms)
    heave: Fraction = placed("vehicle.heave_m_per_s", number)
    heave_rate: Fraction = placed("vehicle.heave_m_per_s2", number)
    turn_rate: Fraction = placed("vehicle.yaw_rad_per_s2", number)
    mass: Pair = placed("law.mass_kg", two, above=True)
    linear: Pair = placed("law.linear_drag", two)
    quadratic: Pair = placed("law.quadratic_drag", two)
    k1: Fraction = placed("law.k1", number, above=True)
    lookahead: Fraction = placed("law.lookahead", number, above=True)
    k_v: Fraction = placed("law.k_v", number, above=True)
    k_i: Fraction = placed("law.k_i", zero)
    wait: Fraction = placed("law.wait", number, above=True)
    cruise: Fraction = placed("law.cruise", number, above=True)
    cap: Fraction = placed("law.cap", number, above=True)
    rate: Fraction = placed("motion.rate_per_s", number, above=True)
    offset: Fraction = placed("motion.offset_m", number, above=True)
    rest_offset: Fraction | None = placed("motion.rest_offset_m", _rest)
    ultimate_bound: Pair = placed("motion.ultimate_bound_m", two, above=True)
    curvature: Fraction = placed("motion.curvature_per_m", number)
    current: Fraction = placed("vehicle.current_m_per_s", number)
    lag: Pair = placed("vehicle.lag_s", _lag)
    period: Fraction = placed("law.period_s", number)
    force: Fraction = placed("vehicle.force_n", number)
    place_error: Fraction = placed("vehicle.place_error_m", number)
    velocity_error: Fraction = placed("vehicle.velocity_error_m_per_s", number)

    @property
    def behind(self) -> bool:
        """Whether the thrust may differ from the present command: by a lag, or because a command is held."""
        return bool(self.lag[1] or self.period)


def axis_pairs(ends: tuple[Number, Number], asymmetry: Number) -> list[tuple[Number, Number]]:
    """Return the vertices of {(a, b): least ≤ a, b ≤ largest, |a − b| ≤ asymmetry (a + b)/2}.

    The numbers lie between t and t ratio for some t, so at a vertex each is one of the two, for the least or largest t.
    """
    least, largest = low, high = ends
    if asymmetry < 2:
        ratio = (2 + asymmetry) / (2 - asymmetry)
        low, high = max(largest / ratio, least), min(least * ratio, largest)
    return sorted({(least, least), (least, high), (high, least), (largest, largest), (largest, low), (low, largest)})


def drag_factors(claim: TurningClaim) -> list[tuple[Fraction, ...]]:
    """Return the vertices of the drag factors (linear surge, linear sway, quadratic surge, quadratic sway)."""
    pairs = axis_pairs(claim.drag_factor, claim.drag_asymmetry)
    return [(*linear, *quadratic) for linear, quadratic in product(pairs, repeat=2)]


def read_claim(claim: Any) -> TurningClaim:
    """Return the claim of a certificate; raise Rejected if a key, number or text is not one of this kind of claim."""
    return read_fields(
        TurningClaim, read_top(claim, "turning-cruise", ("vehicle", "law", "motion"), "excludes", EXCLUDES)
    )
