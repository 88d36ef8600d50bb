"""Check of a region certificate: every motion that starts in V ≤ 1 decays at the claimed rate to V ≤ floor.

The claim: whatever the constant true parameters in their ranges, there is a steady cruise ξ*, with x_e* = −ω/k1
and, in a current, beside the path; V = (ξ − ξ*)ᵀ P (ξ − ξ*); along every motion that is at a control instant in V ≤ 1,
V(t) ≤ max(e^(−a t) V(0), floor). The levels floor = ℓ_0 < ℓ_1 < … < 1 cut the region into shells, and in each
V̇ < −a V is proved by one negative definite matrix a vertex of the loop. All of it in exact rational numbers.

With commands that are held, the same of a functional W ≥ V that equals V at the control instants: see
`region_inclusion`.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected
from surctl.certcheck.patience import go_on
from surctl.certcheck.region_bounds import shell
from surctl.certcheck.region_claim import CruiseClaim, number, read_claim, record
from surctl.certcheck.region_exact import Matrix, inverse, is_positive_definite, quadratic, root_up, scaled
from surctl.certcheck.region_flow import steady_trim
from surctl.certcheck.region_inclusion import MULTIPLIERS, rate_matrix, vertices
from surctl.certcheck.region_law import check_identity
from surctl.certcheck.region_trim import Trim

__all__ = ["check"]

_MOST_SHELLS = 40


def check(document: Mapping[str, Any]) -> None:
    """Check a region certificate whose format and hash are in order.

    Raises:
        Rejected: with the first thing that is not proved.
    """
    record(document, ("format", "version", "kind", "claim", "proof", "sha256"), "the certificate")
    claim = read_claim(document.get("claim"))
    proof = record(document.get("proof"), ("P", "floor", "hold", "shells"), "proof")
    p = _matrix(proof["P"], 6 if claim.lag[1] else 4)
    if not is_positive_definite(p):
        raise Rejected("P is not positive definite")
    levels, multipliers = _shells(proof)
    hold = number(proof["hold"], "proof.hold")
    covariance, steady = inverse(p), steady_trim(claim)
    _check_offset(claim, p, steady)
    _check_ultimate_bound(claim, covariance, steady, levels[0])
    # y, U_y, F_y → −y, −U_y, −F_y leaves such a V, and turns r round
    mirrored = not any(p[i][j] for i in range(0, len(p), 2) for j in range(1, len(p), 2))
    for k, factors in enumerate(multipliers):
        low, high = levels[k], levels[k + 1]
        at = shell(claim, steady, covariance, low, high)
        for j, loop in enumerate(vertices(claim, at, len(p), aside=steady.aside, mirrored=mirrored)):
            go_on()
            m = rate_matrix(claim, at, p, loop, factors, hold)
            if not is_positive_definite(scaled(Fraction(-1), m)):
                raise Rejected(f"V does not decay at the rate between levels {float(low):g} and {float(high):g}, "
                               f"vertex {j}")  # fmt: skip
        check_identity(claim, at, steady, covariance, high, len(p))


def _matrix(rows: Any, size: int) -> Matrix:
    """The symmetric matrix whose lower triangle is given row by row."""
    shaped = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
    if not shaped or [len(row) for row in rows] != list(range(1, size + 1)):
        raise Rejected(f"proof.P must be the lower triangle of {size} rows")
    lower = [[_signed(entry) for entry in row] for row in rows]
    return [[lower[max(i, j)][min(i, j)] for j in range(size)] for i in range(size)]


def _signed(value: Any) -> Fraction:
    return number(value, "proof.P", least=-(10**9))


def _shells(proof: Mapping[str, Any]) -> tuple[list[Fraction], list[list[Fraction]]]:
    """Levels from the floor to 1, and the multipliers of each shell."""
    shells = proof["shells"]
    if not isinstance(shells, list) or not 1 <= len(shells) <= _MOST_SHELLS:
        raise Rejected(f"proof.shells must be 1 to {_MOST_SHELLS} shells")
    levels, multipliers = [number(proof["floor"], "proof.floor", above=True)], []
    for entry in shells:
        one = record(entry, ("level", "multipliers"), "a shell")
        levels.append(number(one["level"], "the level of a shell", least=levels[-1], above=True))
        factors = one["multipliers"]
        if not isinstance(factors, list) or len(factors) != MULTIPLIERS:
            raise Rejected(f"a shell must have {MULTIPLIERS} multipliers")
        multipliers.append([number(factor, "a multiplier") for factor in factors])
    if levels[-1] != 1:
        raise Rejected("the last shell must end at level 1")
    return levels, multipliers


def _check_offset(claim: CruiseClaim, p: Matrix, steady: Trim) -> None:
    """x_e = 0, |y_e| = offset, at the target's velocity: in the region whatever ω is."""
    for omega in steady.omega:
        for side in (1, -1):
            away = side * (claim.offset + steady.aside)
            start = [omega / claim.k1, away, *[Fraction(0)] * (len(p) - 2)]
            if quadratic(p, start) > 1:
                raise Rejected(f"a cross-track offset of {float(claim.offset):g} m is not in the region")


def _check_ultimate_bound(claim: CruiseClaim, covariance: Matrix, steady: Trim, floor: Fraction) -> None:
    """|x_e| and |y_e| on V ≤ floor."""
    away = max(abs(omega) for omega in steady.omega) / claim.k1
    x, y = (root_up(covariance[k][k] * floor) for k in (0, 1))
    if x + away > claim.ultimate_bound[0] or y + steady.aside > claim.ultimate_bound[1]:
        raise Rejected(f"it settles within {float(x + away):.4g} and {float(y + steady.aside):.4g} m only")
