"""Forces beside equation (3) of the paper in a turning cruise: coupled inertia, drag by other velocities, constants.

Let ν be the horizontal velocity in the body frame, w the heave velocity, r the yaw rate, and S the quarter turn. The
horizontal part of the dynamics with a full inertia matrix is

    M ν̇ = τ − D(ν)ν − r S M ν + d,    M = [[m11, m12], [m12, m22]],
    d = d_0 − M' (ẇ, ṙ) − r S M' (w, r) − Σ coefficient · velocities,    M' = [[m13, m14], [m23, m24]].

d_0 are the constant forces. The claim bounds w, ẇ, r and ṙ, and the region bounds ν, so that each entry of d is
bounded. m12 is part of the proof's matrices (`turning_cells`). Each true term is its value times a factor: that of the
masses for m12 to m24, that of the drag for all others; the bounds take the largest factor.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

from surctl.certcheck.document import Rejected
from surctl.certcheck.turning_claim import TurningClaim

__all__ = ["coupled_mass", "other_forces", "other_moment"]

_FORCES, _VELOCITIES = "XY", "uvwr"


def _size(claim: TurningClaim, name: str) -> Fraction:
    """Return the largest size of a term; 0 if the vehicle does not have it."""
    factor = claim.mass_factor if name[0] == "m" else claim.drag_factor
    return abs(claim.terms.get(name, Fraction(0))) * max(factor[1], Fraction(1))


def coupled_mass(claim: TurningClaim) -> Fraction:
    """Return the largest |m12| [kg].

    Raises:
        Rejected: the horizontal inertia matrix is not positive definite for every mass in its range.
    """
    size = _size(claim, "m12")
    if size * size >= claim.mass_factor[0] ** 2 * claim.mass[0] * claim.mass[1] / 4:
        raise Rejected("m12 is not small against m11 and m22")
    return size


def _carried(claim: TurningClaim) -> tuple[Fraction, Fraction]:
    """Return bounds on the two entries of M' (w, r) [kg m/s]."""
    first, second = (_size(claim, f"m{i}3") * claim.heave + _size(claim, f"m{i}4") * claim.yaw_rate for i in (1, 2))
    return first, second


def other_forces(claim: TurningClaim, fastest: Fraction) -> tuple[Fraction, Fraction]:
    """Return bounds on both entries of d [N] where the horizontal speed is at most `fastest` [m/s]."""
    most: Mapping[str, Fraction] = {"u": fastest, "v": fastest, "w": claim.heave, "r": claim.yaw_rate}
    carried = _carried(claim)
    bounds = []
    for axis, letter in enumerate(_FORCES):
        force = _size(claim, f"{letter}0") + claim.yaw_rate * carried[1 - axis]
        force += _size(claim, f"m{axis + 1}3") * claim.heave_rate + _size(claim, f"m{axis + 1}4") * claim.turn_rate
        for name in claim.terms:
            if name[0] == letter and name[1] in _VELOCITIES:
                product = Fraction(1)
                for velocity in name[1:]:
                    product *= most[velocity]
                force += _size(claim, name) * product
        bounds.append(force)
    return bounds[0], bounds[1]


def other_moment(claim: TurningClaim, fastest: Fraction) -> Fraction:
    """Return a bound on the yaw moment u p_y − v p_x beside (m22 − m11) u v, with (p_x, p_y) the momentum [N m]."""
    return fastest * (fastest * coupled_mass(claim) + sum(_carried(claim)))
