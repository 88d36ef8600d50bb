"""Points that enclose the inertia and Coriolis terms of all vehicles and curves of a claim about a turning cruise."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from surctl.certcheck.turning_claim import TurningClaim, factors
from surctl.certcheck.turning_terms import coupled_mass

__all__ = ["UP", "Coupling", "Turn", "coupling_of", "inverse_masses", "turn_points"]

UP = 1 + 1e-9
"""Factor that covers the rounding of a bound."""

Turn = tuple[float, float, float, float]
"""The numbers r e1, r e2, turn rate of the path frame, and r; r is 0 in claims whose thrust is the present command."""


@dataclass(frozen=True)
class Coupling:
    """Bounds of what m12 changes: 1 − ρ², the largest |β| [1/kg], and the norm `loose` [1/s] of the loose terms."""

    remaining: Fraction
    cross: Fraction
    loose: Fraction


def coupling_of(claim: TurningClaim) -> Coupling:
    """Return the bounds of what m12 changes for all masses."""
    c = coupled_mass(claim)
    first, second = (claim.mass_factor[0] * m for m in claim.mass)
    rho = c * c / (first * second)
    ratio = _ratio(claim) * max(claim.mass[0] / claim.mass[1], claim.mass[1] / claim.mass[0])
    loose = claim.yaw_rate * (c * (1 / first + 1 / second) + rho * (1 + ratio)) / (1 - rho)
    return Coupling(1 - rho, c / (first * second * (1 - rho)), loose)


def inverse_masses(claim: TurningClaim, coupling: Coupling) -> list[tuple[float, float, float]]:
    """Return the vertices of the diagonal of M⁻¹ and of its other entry.

    Two equal factors g with f < g < h are left out: the point (1/g, 1/g) lies between (1/f, 1/f) and (1/h, 1/h).
    """
    ends = claim.mass_factor[0] * coupling.remaining, claim.mass_factor[1]
    pairs = [pair for pair in factors(ends, claim.mass_asymmetry, 2) if pair[0] != pair[1] or pair[0] in ends]
    cross = float(coupling.cross) * UP
    signs = sorted({cross, -cross})
    first, second = claim.mass
    return [(float(1 / (f * first)), float(1 / (g * second)), b) for f, g in pairs for b in signs]


def _ratio(claim: TurningClaim) -> Fraction:
    """Return the largest ratio of the factors of the two masses."""
    ratio = (2 + claim.mass_asymmetry) / (2 - claim.mass_asymmetry)
    return min(ratio, claim.mass_factor[1] / claim.mass_factor[0])


def turn_points(claim: TurningClaim) -> list[Turn]:
    """Return points whose hull contains (r e1, r e2, σ, r) for all masses, |r| ≤ r_max and all curvatures.

    With q = m11/m22, (1 − e1)(1 + e2) = 1/q · q = 1 is a hyperbola, which lies in the triangle of its ends and of the
    intersection of the tangents there.
    """
    ratio = _ratio(claim)
    low, high = claim.mass[0] / claim.mass[1] / ratio, claim.mass[0] / claim.mass[1] * ratio
    points = {(1 - 1 / q, q - 1) for q in (low, high)} | {(1 - 2 / (low + high), 2 * low * high / (low + high) - 1)}
    turn = claim.yaw_rate if claim.behind else Fraction(0)
    ends = {(sign * claim.yaw_rate * a, sign * claim.yaw_rate * b, sign * turn) for a, b in points for sign in (1, -1)}
    bend = float(claim.curvature * claim.cruise) * UP
    return [(float(a) * UP, float(b) * UP, c, float(r) * UP) for a, b, r in sorted(ends) for c in sorted({bend, -bend})]
