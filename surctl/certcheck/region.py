"""Check of a region certificate, which claims that V decays exponentially from V ≤ 1 to V ≤ floor on every motion.

The claim states that, for all constant true parameters in their ranges, there is a steady cruise ξ*. Its offset along
the path is x_e* = −ω/k1, where ω is the difference of commanded speed and cruise speed and k1 is a gain; in a current
it also has an offset beside the path. With V = (ξ − ξ*)ᵀ P (ξ − ξ*), every motion that is in V ≤ 1 at the control
instant t = 0 satisfies V(t) ≤ max(e^(−a t) V(0), floor) for all t ≥ 0. The levels floor = ℓ_0 < ℓ_1 < … < 1 divide the
region into shells. In each shell the closed loop is a linear inclusion, and one negative definite matrix for each
vertex of the inclusion proves V̇ < −a V. All numbers are exact rational numbers, except the bounds for a current in
`region_trim`.

Without thrust lag, held commands and current, a proof may also divide the headings into cells: the claim is then that
of a turning cruise (`turning`) with equal masses and the same ω, with a larger region.

If the commands are held between control instants, the decay is proved for a functional W ≥ V that equals V at the
control instants; `region_inclusion` derives W.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.patience import go_on
from surctl.certcheck.region_claim import CruiseClaim, number, read_claim, read_shells, triangle
from surctl.certcheck.region_exact import inverse, is_positive_definite, scaled
from surctl.certcheck.region_inclusion import MULTIPLIERS, rate_matrix, shell, vertices
from surctl.certcheck.region_trim import MEAN_SHARE, steady_trim
from surctl.certcheck.turning import check_cells, require_bound, require_starts
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
    levels, stated = read_shells(proof, "multipliers", _MOST_SHELLS)
    multipliers = [_multipliers(factors) for factors in stated]
    hold = number(proof["hold"], "proof.hold")
    covariance, steady = inverse(p), steady_trim(claim)
    require_starts(claim, p, steady.omega, steady.aside)
    require_bound(claim, covariance, steady.omega, steady.aside, levels[0])
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
    more = (claim.lag[1], claim.period, claim.current)
    drag = (claim.linear, claim.linear_model), (claim.quadratic, claim.quadratic_model)
    if any(more) or any(high and not model for (_, high), model in drag) or claim.asymmetry >= 2:
        raise Rejected("a proof by cells of headings needs a loop without lag, held commands and current, the true "
                       "drag in the law's model, and an asymmetry below 2")  # fmt: skip
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
        force=claim.force,
        place_error=claim.place_error,
        velocity_error=claim.velocity_error,
    )


def _slopes(claim: CruiseClaim) -> tuple[Fraction, Fraction]:
    """Return the slopes of `region_trim.offset_speed` in the mean factors of the linear and of the quadratic drag."""
    v, linear, quadratic = claim.cruise, claim.linear_model, MEAN_SHARE * claim.quadratic_model
    stiffness = claim.mass_model * claim.k_v + linear + 2 * quadratic * v
    return linear * v / stiffness, quadratic * v * v / stiffness


def _multipliers(factors: Any) -> list[Fraction]:
    if not isinstance(factors, list) or len(factors) != MULTIPLIERS:
        raise Rejected(f"a shell must have {MULTIPLIERS} multipliers")
    return [number(factor, "a multiplier") for factor in factors]
