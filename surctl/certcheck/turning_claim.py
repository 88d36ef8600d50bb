"""Reader of the claim of a `turning` certificate: the cruise of a vehicle with unequal masses that turns meanwhile."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.region_claim import (
    LAW,
    Pair,
    axis_pairs,
    lag_range,
    law_gains,
    number,
    ordered,
    read_top,
    two,
)

__all__ = ["EXCLUDES", "Pair", "TurningClaim", "drag_factors", "read_claim", "read_terms"]

_TERM = re.compile("m[1-4][1-4]|[XYZN][uvwr]{1,2}|[XYZN]0|F[uvwr]_reverse")
_EQUATION_3 = {
    *(f"m{i}{j}" for i in range(1, 5) for j in range(1, i + 1)),
    *(force + axis * count for force, axis in zip("XYZN", "uvwr", strict=True) for count in (1, 2)),
}  # entries on and below the diagonal, and terms of equation (3)
_MOST_TERMS = 60
_ERRORS = (("force", "n"), ("place_error", "m"), ("velocity_error", "m_per_s"))

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
        k1, lookahead, k_v, wait: the law's gains of these names [1/s, m, 1/s, m].
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

    mass_factor: Pair
    drag_factor: Pair
    mass_asymmetry: Fraction
    drag_asymmetry: Fraction
    thrust: Pair
    yaw_rate: Fraction
    munk_moment: Fraction
    terms: Mapping[str, Fraction]
    heave: Fraction
    heave_rate: Fraction
    turn_rate: Fraction
    mass: Pair
    linear: Pair
    quadratic: Pair
    k1: Fraction
    lookahead: Fraction
    k_v: Fraction
    wait: Fraction
    cruise: Fraction
    cap: Fraction
    rate: Fraction
    offset: Fraction
    rest_offset: Fraction | None
    ultimate_bound: Pair
    curvature: Fraction
    current: Fraction = Fraction(0)
    lag: Pair = (Fraction(0), Fraction(0))
    period: Fraction = Fraction(0)
    force: Fraction = Fraction(0)
    place_error: Fraction = Fraction(0)
    velocity_error: Fraction = Fraction(0)

    @property
    def behind(self) -> bool:
        """Whether the thrust may differ from the present command: by a lag, or because a command is held."""
        return bool(self.lag[1] or self.period)


def drag_factors(claim: TurningClaim) -> list[tuple[Fraction, ...]]:
    """Return the vertices of the drag factors (linear surge, linear sway, quadratic surge, quadratic sway)."""
    pairs = axis_pairs(claim.drag_factor, claim.drag_asymmetry)
    return [(*linear, *quadratic) for linear, quadratic in product(pairs, repeat=2)]


def read_claim(claim: Any) -> TurningClaim:
    """Return the claim of a certificate.

    Raises:
        Rejected: a key is missing or unknown, a number has the wrong type or sign, or the stated restrictions are not
            those of this kind of claim.
    """
    top = read_top(claim, "turning-cruise", EXCLUDES)
    vehicle = record(
        top["vehicle"],
        ("mass_factor", "drag_factor", "mass_asymmetry", "drag_asymmetry", "thrust_n",
         "yaw_rate_rad_per_s", "munk_moment_nm", "terms", "heave_m_per_s", "heave_m_per_s2", "yaw_rad_per_s2",
         "current_m_per_s", "force_n", "place_error_m", "velocity_error_m_per_s", "lag_s"),
        "claim.vehicle",
    )  # fmt: skip
    law = record(top["law"], LAW, "claim.law")
    motion = record(
        top["motion"], ("rate_per_s", "offset_m", "rest_offset_m", "ultimate_bound_m", "curvature_per_m"),
        "claim.motion",
    )  # fmt: skip
    asymmetries = {key: number(vehicle[key], f"claim.vehicle.{key}") for key in ("mass_asymmetry", "drag_asymmetry")}
    if any(share >= 2 for share in asymmetries.values()):
        raise Rejected("an asymmetry must be below 2")
    rest = motion["rest_offset_m"]

    return TurningClaim(
        mass_factor=ordered(vehicle["mass_factor"], "claim.vehicle.mass_factor", above=True),
        drag_factor=ordered(vehicle["drag_factor"], "claim.vehicle.drag_factor", above=True),
        **asymmetries,
        thrust=two(vehicle["thrust_n"], "claim.vehicle.thrust_n", above=True),
        yaw_rate=number(vehicle["yaw_rate_rad_per_s"], "claim.vehicle.yaw_rate_rad_per_s"),
        munk_moment=number(vehicle["munk_moment_nm"], "claim.vehicle.munk_moment_nm"),
        terms=read_terms(vehicle["terms"]),
        heave=number(vehicle["heave_m_per_s"], "claim.vehicle.heave_m_per_s"),
        heave_rate=number(vehicle["heave_m_per_s2"], "claim.vehicle.heave_m_per_s2"),
        turn_rate=number(vehicle["yaw_rad_per_s2"], "claim.vehicle.yaw_rad_per_s2"),
        mass=two(law["mass_kg"], "claim.law.mass_kg", above=True),
        linear=two(law["linear_drag"], "claim.law.linear_drag"),
        quadratic=two(law["quadratic_drag"], "claim.law.quadratic_drag"),
        **law_gains(law),
        rate=number(motion["rate_per_s"], "claim.motion.rate_per_s", above=True),
        offset=number(motion["offset_m"], "claim.motion.offset_m", above=True),
        rest_offset=None if rest is None else number(rest, "claim.motion.rest_offset_m"),
        ultimate_bound=two(motion["ultimate_bound_m"], "claim.motion.ultimate_bound_m", above=True),
        curvature=number(motion["curvature_per_m"], "claim.motion.curvature_per_m"),
        current=number(vehicle["current_m_per_s"], "claim.vehicle.current_m_per_s"),
        lag=lag_range(vehicle["lag_s"]),
        **{key: number(vehicle[f"{key}_{unit}"], f"claim.vehicle.{key}_{unit}") for key, unit in _ERRORS},
    )


def read_terms(value: Any) -> dict[str, Fraction]:
    """Return the terms of a vehicle beside equation (3), by name.

    Raises:
        Rejected: a name is not that of a term, a term belongs to equation (3), or a value is not a number.
    """
    if not isinstance(value, dict) or len(value) > _MOST_TERMS:
        raise Rejected("claim.vehicle.terms must be an object")
    terms = {}
    for name, entry in value.items():
        if not _TERM.fullmatch(name) or name in _EQUATION_3:
            raise Rejected(f"claim.vehicle.terms: {name!r} is not a term beside equation (3)")
        terms[name] = number(entry, f"claim.vehicle.terms.{name}", least=-(10**9))
    return terms
