"""Check of a certificate of the heading-steered loop (8 states), which claims V̇ ≤ −a V on the sublevel set V ≤ 1.

The claim states that, for all constant true parameters in their ranges, the vehicle comes to rest relative to the
target, which moves along the path with speed v. The offset along the path is then x* = (v − u_c*)/k1, where k1 is a
gain and u_c* the surge command at rest. ξ = (x, y, ψ, U_x, U_y, r) denotes the horizontal deviations of position,
heading, velocity and yaw rate from this rest; (z, w) are the deviations in depth and heave velocity. V = ξᵀ P ξ, and
V_z is a quadratic function of (z, w). Along every motion that starts in V ≤ 1 and V_z ≤ 1, V and V_z decay as e^(−a t).
The proof divides the set V ≤ 1 into cells. In each cell, the thrust limits reduce a command to a share φ ∈ [φ_min, 1].
Depth and heave velocity do not act on the other six states. P > 0 and the decay of V_z are checked in exact rational
arithmetic; the cells are checked in double precision with bounds on all rounding errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.heading_cells import check_cells
from surctl.certcheck.heading_claim import HeadingClaim, read_claim
from surctl.certcheck.region_claim import triangle
from surctl.certcheck.region_exact import Matrix, inverse, is_positive_definite, quadratic, root_up

__all__ = ["check"]

_MIRRORED = {(i, j) for i in (0, 3) for j in (1, 2, 4, 5)}  # only y, ψ, U_y, r change sign


def check(document: Mapping[str, Any]) -> None:
    """Check a certificate of the heading-steered loop whose format and hash are verified.

    Raises:
        Rejected: the certificate does not prove its claim; the message names the first failure.
    """
    record(document, ("format", "version", "kind", "claim", "proof", "sha256"), "the certificate")
    claim = read_claim(document.get("claim"))
    proof = record(document.get("proof"), ("P", "P_z"), "proof")
    p, p_z = triangle(proof["P"], 6, "proof.P"), triangle(proof["P_z"], 2, "proof.P_z")
    for name, m in (("P", p), ("P_z", p_z)):
        if not is_positive_definite(m):
            raise Rejected(f"{name} is not positive definite")
    if any(p[i][j] for i, j in _MIRRORED):
        raise Rejected("P is not symmetric under reflection in the path")
    _check_extent(claim, p, p_z)
    _check_heave(claim, p_z)
    check_cells(claim, np.array([[float(entry) for entry in row] for row in p]))


def _check_extent(claim: HeadingClaim, p: Matrix, p_z: Matrix) -> None:
    """Check the claimed offsets, depth and extent of the region, and the claimed bound on the offset x* at rest."""
    v, k1 = claim.law["cruise"], claim.law["k1"]
    for command in claim.command:
        if command <= 0:
            raise Rejected("at rest relative to its target, the vehicle would have to move backwards")
        away = (v - command) / k1
        if abs(away) > claim.ultimate_bound:
            raise Rejected(f"the vehicle may come to rest {float(abs(away)):.4g} m from its target, beyond the bound")
        start = [-away, claim.offset, *[Fraction(0)] * 4]
        if quadratic(p, start) > 1:  # as for −offset, because P is symmetric under reflection
            raise Rejected(f"a cross-track offset of {float(claim.offset):g} m is not in the region")
    if p[1][1] * claim.beside**2 > 1:
        raise Rejected(f"a point {float(claim.beside):g} m beside the point of rest is not in the region")
    covariance = inverse(p)
    for k, name in enumerate(("x_e", "y_e", "psi")):
        if claim.extent[k] ** 2 > covariance[k][k]:
            raise Rejected(f"no point of the region has {name} = {float(claim.extent[k]):g}")
    if p_z[0][0] * claim.depth**2 > 1:
        raise Rejected(f"a depth error of {float(claim.depth):g} m is not in the region")


def _check_heave(claim: HeadingClaim, p: Matrix) -> None:
    """Check the decay of V_z for ż = w, m33 ẇ = −φ m̂33 k (w + k_z z) − σ w (drag slope σ), in exact arithmetic."""
    covariance = inverse(p)
    velocity_gain, k_z = claim.law["heave_mass_kg"] * claim.law["k"], claim.law["k_z"]
    drags, share = _heave_bounds(claim, covariance)
    for mass, drag, part in product(claim.ranges["heave_mass_kg"], drags, (share, Fraction(1))):
        a = [[Fraction(0), Fraction(1)], [-part * velocity_gain * k_z / mass, -(part * velocity_gain + drag) / mass]]
        half = [[sum((p[i][k] * a[k][j] for k in (0, 1)), Fraction(0)) for j in (0, 1)] for i in (0, 1)]
        if not is_positive_definite(
            [[-half[i][j] - half[j][i] - claim.rate * p[i][j] for j in (0, 1)] for i in (0, 1)]
        ):
            raise Rejected("V_z does not decay at the claimed rate")


def _heave_bounds(claim: HeadingClaim, covariance: Matrix) -> tuple[tuple[Fraction, Fraction], Fraction]:
    """Return the least and largest drag slope in V_z ≤ 1 [N s/m], and the least share of the heave command."""
    linear, square = claim.ranges["heave_linear"], claim.ranges["heave_quadratic"]
    drags = (linear[0], linear[1] + square[1] * root_up(covariance[1][1]))
    gain, k_z = claim.law["heave_mass_kg"] * claim.law["k"], claim.law["k_z"]
    force = gain * root_up(quadratic(covariance, [k_z, Fraction(1)]))
    return drags, min(Fraction(1), claim.limits["heave_n"] / force)
