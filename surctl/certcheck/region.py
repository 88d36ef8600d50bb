"""Check of a region certificate, which claims that V decays exponentially from V ≤ 1 to V ≤ floor on every motion.

The claim states that, for all constant true parameters in their ranges, there is a steady cruise ξ*. Its offset along
the path is x_e* = −ω/k1, where ω is the difference of commanded speed and cruise speed and k1 is a gain; in a current
it also has an offset beside the path. With V = (ξ − ξ*)ᵀ P (ξ − ξ*), every motion that is in V ≤ 1 at the control
instant t = 0 satisfies V(t) ≤ max(e^(−a t) V(0), floor) for all t ≥ 0. The levels floor = ℓ_0 < ℓ_1 < … < 1 divide the
region into shells. In each shell the closed loop is a linear inclusion, and one negative definite matrix for each
vertex of the inclusion proves V̇ < −a V. All numbers are exact rational numbers, except the bounds for a current in
`region_trim`.

Without thrust lag, held commands, current, force and errors of measurement, a proof may also divide the headings into
cells: the claim is then that of a turning cruise (`turning`) with equal masses and the same ω, with a larger region.

If the commands are held between control instants, the decay is proved for a functional W ≥ V that equals V at the
control instants; `region_inclusion` derives W.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.patience import go_on
from surctl.certcheck.region_claim import CruiseClaim, number, read_claim, triangle
from surctl.certcheck.region_exact import Matrix, inverse, is_positive_definite, quadratic, root_up, scaled
from surctl.certcheck.region_inclusion import MULTIPLIERS, rate_matrix, shell, vertices
from surctl.certcheck.region_trim import MEAN_SHARE, Trim, steady_trim
from surctl.certcheck.turning import check_cells
from surctl.certcheck.turning_claim import TurningClaim

__all__ = ["check"]

_MOST_SHELLS = 40


def check(document: Mapping[str, Any]) -> None:
    """Check a region certificate whose format and hash are verified.

    Raises:
        Rejected: the certificate does not prove its claim; the message names the first failure.
    """
    record(document, ("format", "version", "kind", "claim", "proof", "sha256"), "the certificate")
    claim, proof = read_claim(document.get("claim")), document.get("proof")
    if isinstance(proof, dict) and "cells" in proof:
        check_cells(_turning(claim), record(proof, ("P", "floor", "cells", "shells"), "proof"), _slopes(claim))
        return
    proof = record(proof, ("P", "floor", "hold", "shells"), "proof")
    p = triangle(proof["P"], 6 if claim.lag[1] else 4, "proof.P")
    if not is_positive_definite(p):
        raise Rejected("P is not positive definite")
    levels, multipliers = _shells(proof)
    hold = number(proof["hold"], "proof.hold")
    covariance, steady = inverse(p), steady_trim(claim)
    _check_offset(claim, p, steady)
    _check_ultimate_bound(claim, covariance, steady, levels[0])
    # the reflection y, U_y, F_y → −y, −U_y, −F_y does not change such a V and changes the sign of r
    mirrored = not any(p[i][j] for i in range(0, len(p), 2) for j in range(1, len(p), 2))
    for k, factors in enumerate(multipliers):
        low, high = levels[k], levels[k + 1]
        at = shell(claim, steady, covariance, low, high)
        for j, loop in enumerate(vertices(claim, at, len(p), aside=steady.aside, mirrored=mirrored)):
            go_on()
            m = rate_matrix(claim, at, p, loop, factors, hold)
            if not is_positive_definite(scaled(Fraction(-1), m)):
                raise Rejected(f"V does not decay at the claimed rate between levels {float(low):g} and "
                               f"{float(high):g}, vertex {j}")  # fmt: skip


def _turning(claim: CruiseClaim) -> TurningClaim:
    """Return the same claim about a turning cruise with equal masses; the drag factors have one range that holds both.

    Raises:
        Rejected: the claim states more than a turning cruise does.
    """
    more = (claim.lag[1], claim.period, claim.current, claim.force, claim.place_error, claim.velocity_error)
    drag = (claim.linear, claim.linear_model), (claim.quadratic, claim.quadratic_model)
    if any(more) or any(high and not model for (_, high), model in drag) or claim.asymmetry >= 2:
        raise Rejected("a proof by cells of headings needs a loop without lag, held commands, current, force and error "
                       "of measurement, the true drag in the law's model, and an asymmetry below 2")  # fmt: skip
    ends = [end / model for pair, model in drag for end in pair if model] or [Fraction(1)]
    zero = Fraction(0)
    return TurningClaim(
        mass_factor=(claim.mass[0] / claim.mass_model, claim.mass[1] / claim.mass_model),
        drag_factor=(min(ends), max(ends)),
        mass_asymmetry=zero,
        drag_asymmetry=claim.asymmetry,
        thrust=(claim.thrust,) * 2,
        yaw_rate=claim.yaw_rate,
        munk_moment=zero,
        terms={},
        heave=zero,
        heave_rate=zero,
        turn_rate=zero,
        mass=(claim.mass_model,) * 2,
        linear=(claim.linear_model,) * 2,
        quadratic=(claim.quadratic_model,) * 2,
        k1=claim.k1,
        lookahead=claim.lookahead,
        k_v=claim.k_v,
        wait=claim.wait,
        cruise=claim.cruise,
        cap=claim.cap,
        rate=claim.rate,
        offset=claim.offset,
        rest_offset=None,
        ultimate_bound=claim.ultimate_bound,
        curvature=zero,
    )


def _slopes(claim: CruiseClaim) -> tuple[Fraction, Fraction]:
    """Return the slopes of `region_trim.offset_speed` in the mean factors of the linear and of the quadratic drag."""
    v, linear, quadratic = claim.cruise, claim.linear_model, MEAN_SHARE * claim.quadratic_model
    stiffness = claim.mass_model * claim.k_v + linear + 2 * quadratic * v
    return linear * v / stiffness, quadratic * v * v / stiffness


def _shells(proof: Mapping[str, Any]) -> tuple[list[Fraction], list[list[Fraction]]]:
    """Return the levels of V from the floor to 1, and the multipliers λ_j of each shell."""
    shells = proof["shells"]
    if not isinstance(shells, list) or not 1 <= len(shells) <= _MOST_SHELLS:
        raise Rejected(f"proof.shells must hold 1 to {_MOST_SHELLS} shells")
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
    """Check that the points with x_e = 0, |y_e| = offset and the target's velocity lie in the region for every ω."""
    for omega in steady.omega:
        for side in (1, -1):
            away = side * (claim.offset + steady.aside)
            start = [omega / claim.k1, away, *[Fraction(0)] * (len(p) - 2)]
            if quadratic(p, start) > 1:
                raise Rejected(f"a cross-track offset of {float(claim.offset):g} m is not in the region")


def _check_ultimate_bound(claim: CruiseClaim, covariance: Matrix, steady: Trim, floor: Fraction) -> None:
    """Check that |x_e| and |y_e| in the set V ≤ floor do not exceed the claimed ultimate bound."""
    away = max(abs(omega) for omega in steady.omega) / claim.k1
    x, y = (root_up(covariance[k][k] * floor) for k in (0, 1))
    if x + away > claim.ultimate_bound[0] or y + steady.aside > claim.ultimate_bound[1]:
        raise Rejected(f"the set V <= floor extends to |x_e| = {float(x + away):.4g} m and "
                       f"|y_e| = {float(y + steady.aside):.4g} m, beyond the claimed ultimate bound")  # fmt: skip
