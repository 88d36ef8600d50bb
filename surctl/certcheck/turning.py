"""Check of a `turning` certificate: V decays on every motion of a cruise with unequal masses at any heading.

The claim states that, for all constant true parameters in their ranges, there is a steady cruise ξ* with the offset
x_e* = −ω/k1 along the path, and in a current with one across it (`turning_terms`). With V = (ξ − ξ*)ᵀ P (ξ − ξ*) and ξ
= (x_e, y_e, U_x, U_y), every motion that starts in V ≤ 1 satisfies V(t) ≤ max(e^(−a t) V(0), floor) for all t ≥ 0,
however the heading moves with |r| ≤ yaw_rate_rad_per_s and on any curve with |curvature| ≤ curvature_per_m, and in any
constant current of at most current_m_per_s. With thrust lag, V is a form in ξ and the thrust; with commands that are
held for a period that begins at t = 0, it has a term that vanishes at each control instant (`turning_form`). The levels
floor = ℓ_0 < ℓ_1 < … < 1 divide the region into shells, and `turning_cells` proves the decay in every shell and every
cell of headings; a shell may state a higher rate than that of the claim. P > 0, the offsets, the ultimate bound and the
Munk moment are checked in exact rational arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected, listed, record
from surctl.certcheck.fields import Pair, number, two
from surctl.certcheck.region_exact import (
    Matrix,
    inverse,
    is_positive_definite,
    largest_eigenvalue,
    quadratic,
    root_up,
)
from surctl.certcheck.turning_cells import Setting, Trim, check_shell, heading_cells, steady
from surctl.certcheck.turning_claim import TurningClaim, axis_pairs, read_claim
from surctl.certcheck.turning_form import Extent, Form, Phase
from surctl.certcheck.turning_terms import STILL, coupled_mass, other_forces, other_moment

__all__ = ["check", "cruise_of", "require_bound", "require_starts", "shells_of", "triangle"]

_MOST_SHELLS = 24
_CELLS = (4, 96)  # least and largest number of cells of headings


def check(document: Mapping[str, Any]) -> None:
    """Check a `turning` certificate whose format and hash are verified.

    Raises:
        Rejected: the certificate does not prove its claim; the message names the first failure.
    """
    record(document, ("format", "version", "kind", "claim", "proof", "sha256"), "the certificate")
    claim = read_claim(document.get("claim"))
    keys = ("P", "floor", "trim", "cells", "shells") + (("thrust",) if claim.period else ())
    keys += ("flow",) if claim.current else ()
    proof = record(document.get("proof"), keys, "proof")
    p = triangle(proof["P"], 6 if claim.lag[1] else 4, "proof.P")
    if not is_positive_definite(p):
        raise Rejected("P is not positive definite")
    if any(p[i][j] for i in range(1, len(p)) for j in range(1 - i % 2, i, 2)):  # y, U_y and F_y alone change their sign
        raise Rejected("P is not symmetric under reflection in the path")
    trim, cells = cruise_of(claim, proof), proof["cells"]
    if type(cells) is not int or not _CELLS[0] <= cells <= _CELLS[1]:
        raise Rejected(f"proof.cells must be a whole number from {_CELLS[0]} to {_CELLS[1]}")
    shells = shells_of(claim, proof)
    covariance = inverse(p)
    require_starts(claim, p, trim.moved, trim.beside, claim.rest_offset)
    require_bound(claim, covariance, trim.moved, trim.beside, shells[0][0])
    fastest = claim.cruise + claim.current + root_up(largest_eigenvalue([row[2:4] for row in covariance[2:4]]))
    _check_munk_moment(claim, fastest)
    forces = other_forces(claim, fastest)
    setting, extent = Setting(claim, trim, heading_cells(claim, trim, cells)), Extent.of(covariance)
    weight, phases = _phases(claim, proof)
    form = Form.of(p, weight)
    for shell in shells:
        bounds = setting.bounds(extent, shell[1], forces)
        for phase in phases:
            check_shell(setting, bounds, form, phase, shell)


def triangle(rows: Any, size: int, where: str) -> Matrix:
    """Return the symmetric matrix (size, size) whose lower triangle has the given rows."""
    shaped = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
    if not shaped or [len(row) for row in rows] != list(range(1, size + 1)):
        raise Rejected(f"{where} must be a lower triangle with {size} rows")
    lower = [[number(entry, where, least=-(10**9)) for entry in row] for row in rows]
    return [[lower[max(i, j)][min(i, j)] for j in range(size)] for i in range(size)]


def shells_of(claim: TurningClaim, proof: Mapping[str, Any]) -> list[tuple[Fraction, ...]]:
    """Return (low, high, growth, rate) of each shell: its levels of V, its η [1/s], and the decay rate in it [1/s].

    The shells divide V from the floor to 1. The rate is the claimed one, or a higher rate that the shell states.
    """
    shells = proof["shells"]
    if not isinstance(shells, list) or not 1 <= len(shells) <= _MOST_SHELLS:
        raise Rejected(f"proof.shells must hold 1 to {_MOST_SHELLS} shells")
    low, read = number(proof["floor"], "proof.floor", above=True), list[tuple[Fraction, ...]]()
    for entry in shells:
        faster = isinstance(entry, dict) and "rate" in entry
        one = record(entry, ("level", "growth", "rate") if faster else ("level", "growth"), "a shell")
        high = number(one["level"], "the level of a shell", least=low, above=True)
        pace = number(one["rate"], "the rate of a shell", least=claim.rate) if faster else claim.rate
        read.append((low, high, number(one["growth"], "the growth of a shell"), pace))
        low = high
    if low != 1:
        raise Rejected("the last shell must end at level 1")
    return read


def _phases(claim: TurningClaim, proof: Mapping[str, Any]) -> tuple[Fraction | None, list[Phase]]:
    """Return the weight q, None for commands that are not held, and the forms of `turning_form` that decide.

    Raises:
        Rejected: the proof has other numbers, or the claim has thrust lag or held commands and is about a curved path,
            an inertia with m12, disturbance forces or errors of measurement.
    """
    more = (claim.curvature, coupled_mass(claim), claim.force, claim.place_error, claim.velocity_error)
    if claim.behind and any(more):
        raise Rejected("thrust lag and held commands are not covered together with m12, a curved path, a force or "
                       "errors of measurement")  # fmt: skip
    lags = [float(lag) for lag in sorted(set(claim.lag))]
    if not claim.period:
        return None, [Phase(lag) for lag in lags]
    thrust = record(proof["thrust"], ("weight", "split"), "proof.thrust")
    weight, split = (number(thrust[key], f"proof.thrust.{key}", above=True) for key in ("weight", "split"))
    # the matrices take off a + η, of which a quarter is enough
    fall = float(1 / claim.period - claim.k_v / claim.mass_factor[0] / 2)
    return weight, [one for lag in lags for one in (Phase(lag, float(split), fall), Phase(lag, 0.0, fall, False))]


def _flow(claim: TurningClaim, value: Any) -> tuple[Pair, Pair, Pair]:
    """Return the coefficients of the gains of the current."""
    if len(listed(value)) != 3:
        raise Rejected("proof.flow must have three pairs of numbers")
    first, second, third = (two(row, "proof.flow", least=-(10**9)) for row in value)
    if (claim.behind or claim.curvature) and any(map(any, (first, second, third))):
        raise Rejected("with thrust lag, held commands or a curved path, proof.flow must be 0")
    return first, second, third


def cruise_of(claim: TurningClaim, proof: Mapping[str, Any]) -> Trim:
    """Return the steady cruise of a proof that `check` accepts."""
    slopes = two(proof["trim"], "proof.trim", least=-(10**9))
    return steady(claim, slopes, _flow(claim, proof["flow"]) if claim.current else STILL)


def require_starts(claim: TurningClaim, p: Matrix, moved: Pair, beside: Fraction, rest: Fraction | None = None) -> None:
    """Raise Rejected unless the starts with x_e = 0, |y_e| = offset lie in V ≤ 1 for all steady cruises.

    Args:
        claim: the claim.
        p: matrix P of V.
        moved: range of the commanded speed at the steady cruise minus the cruise speed [m/s].
        beside: largest steady offset beside the path [m].
        rest: offset of the start at rest [m]; the other start has the target's velocity.
    """
    starts = [(claim.offset, Fraction(0), "with the target's velocity")]
    if rest is not None:
        starts.append((rest, -claim.cruise, "at rest"))
    none = [Fraction(0)] * (len(p) - 3)
    for omega in moved:
        for offset, speed, how in starts:
            for side in (1, -1):
                if quadratic(p, [omega / claim.k1, side * (offset + beside), speed, *none]) > 1:
                    raise Rejected(f"a start {how} {float(offset):g} m beside the path is not in the region")


def require_bound(claim: TurningClaim, covariance: Matrix, moved: Pair, beside: Fraction, floor: Fraction) -> None:
    """Raise Rejected unless |x_e| and |y_e| in V ≤ floor are within the ultimate bound; see `require_starts`."""
    away = max(map(abs, moved)) / claim.k1
    x, y = (root_up(covariance[k][k] * floor) + shift for k, shift in enumerate((away, beside)))
    if x > claim.ultimate_bound[0] or y > claim.ultimate_bound[1]:
        raise Rejected(f"the set V <= floor extends to |x_e| = {float(x):.4g} m and |y_e| = {float(y):.4g} m, "
                       "beyond the claimed ultimate bound")  # fmt: skip


def _check_munk_moment(claim: TurningClaim, fastest: Fraction) -> None:
    """Check the claimed bound on the yaw moment of the Coriolis forces: |u v| ≤ |U|²/2, and |U| ≤ `fastest` [m/s]."""
    apart = max(
        abs(f * claim.mass[0] - g * claim.mass[1]) for f, g in axis_pairs(claim.mass_factor, claim.mass_asymmetry)
    )
    if not (moment := apart * fastest * fastest / 2 + other_moment(claim, fastest)) <= claim.munk_moment:
        stated = math.ceil(1e6 * float(moment)) / 1e6
        raise Rejected(f"the Munk moment reaches up to {stated:g} N m in the region, above the claimed bound")
