"""Check of a `steering` certificate: V decays on every motion of the heading loop of a craft without sway force.

The claim states that V = ξᵀ P ξ satisfies V̇ ≤ −a V on V ≤ 1 for all parameters in their ranges, so that every motion
that starts there satisfies V(t) ≤ e^(−a t) V(0): cross-track error, heading, sway, yaw rate and the two filters of the
law converge to 0. `steering_loop` encloses the loop by matrices A + φ b mᵀ with the share φ that the limit of the yaw
moment leaves. Where φ < 1, the moment is at its limit, so the decay is only needed for such ξ, and a multiplier for
each interval of φ proves it (S-procedure). The inequality is verified at each matrix, with a bound on all rounding
errors (Rump 2006). P > 0 and the offset are checked in exact rational arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.patience import go_on
from surctl.certcheck.region_claim import number
from surctl.certcheck.region_exact import Matrix, inverse, is_positive_definite, quadratic, root_up
from surctl.certcheck.steering_claim import STATES, SteeringClaim, read_claim
from surctl.certcheck.steering_law import check_samples
from surctl.certcheck.steering_loop import (
    Extent,
    Node,
    command_rows,
    delivered,
    moment_rows,
    nodes,
    parameters,
    vertices,
)

__all__ = ["check", "extent_of"]

Array = NDArray[np.float64]

_SIZE = len(STATES)
_ROUNDING = 1e-11  # relative rounding error of a matrix and of its factorisation
_UP = 1 + 1e-9  # covers the rounding of a number
_MOST_SHARES, _CHUNK = 4, 4096
_WORST = 1e5  # largest condition of the scaled matrix of V


def check(document: Mapping[str, Any]) -> None:
    """Check a `steering` certificate whose format and hash are verified.

    Raises:
        Rejected: the certificate does not prove its claim; the message names the first failure.
    """
    record(document, ("format", "version", "kind", "claim", "proof", "sha256"), "the certificate")
    claim = read_claim(document.get("claim"))
    proof = record(document.get("proof"), ("P", "shares"), "proof")
    p = _matrix(proof["P"])
    if not is_positive_definite(p):
        raise Rejected("P is not positive definite")
    if quadratic(p, [claim.offset, *[Fraction(0)] * (_SIZE - 1)]) > 1:
        raise Rejected(f"a start {float(claim.offset):g} m beside the path is not in the region")
    at = extent_of(claim, p)
    shares = _shares(proof["shares"], delivered(claim, at))
    for node in nodes(claim):
        _check_decay(p, vertices(claim, parameters(claim, at, node), node), shares, node, claim)
    check_samples(claim, np.array([[float(entry) for entry in row] for row in p]))


def _matrix(rows: Any) -> Matrix:
    shaped = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
    if not shaped or [len(row) for row in rows] != list(range(1, _SIZE + 1)):
        raise Rejected(f"proof.P must be a lower triangle with {_SIZE} rows")
    lower = [[number(entry, "proof.P", least=-(10**9)) for entry in row] for row in rows]
    return [[lower[max(i, j)][min(i, j)] for j in range(_SIZE)] for i in range(_SIZE)]


def extent_of(claim: SteeringClaim, p: Matrix) -> Extent:
    """Return the bounds on the states and on the commanded yaw rate in V ≤ 1."""
    covariance = inverse(p)
    y, psi, v, r, _, s = (root_up(covariance[k][k]) for k in range(_SIZE))
    command = max(root_up(quadratic(covariance, row)) for row in command_rows(claim, y))
    at = Extent(y, psi, v, r, s, command, Fraction(0))
    return replace(at, moment=max(root_up(quadratic(covariance, row)) for row in moment_rows(claim, at)))


def _shares(rows: Any, least: Fraction) -> list[tuple[float, float]]:
    """Return pairs of share φ and multiplier: both ends of each interval of φ, and φ = 1 without a multiplier."""
    if not isinstance(rows, list) or len(rows) > _MOST_SHARES:
        raise Rejected(f"proof.shares must be a list of at most {_MOST_SHARES} pairs")
    pairs, low = [(1.0, 0.0)], least
    for row in rows:
        if not isinstance(row, list) or len(row) != 2:
            raise Rejected("proof.shares must be a list of pairs")
        end, multiplier = (number(entry, "proof.shares") for entry in row)
        if end > low:
            pairs += [(float(low) / _UP, float(multiplier)), (float(end) * _UP, float(multiplier))]
            low = end
    if low < 1:
        raise Rejected("proof.shares must end at 1")
    return pairs


def _check_decay(
    p: Matrix, loops: tuple[Array, Array, Array], shares: list[tuple[float, float]], node: Node, claim: SteeringClaim
) -> None:
    """Raise Rejected unless V decays at all matrices A + φ b mᵀ of a node, for each pair of φ and multiplier μ.

    Where the moment is limited, φ |m ξ| is at least the limit, and so at least the node's moment M times √V. Hence
    V̇ + a V < 0 follows from V̇ + a V + μ ((φ m ξ)²/(M M₀) − V M/M₀) < 0. This form is convex in each parameter.
    """
    P = np.array([[float(entry) for entry in row] for row in p])
    change = np.tril(np.linalg.inv(np.linalg.cholesky(P)))
    size = np.abs(change) @ np.abs(P) @ np.abs(change).T
    if not (size.max() <= _WORST and np.all(np.diag(change) > 0)):
        raise Rejected("P is too ill-conditioned for double precision")
    A, b, m = loops
    rate, unit, near = float(claim.rate), change @ P @ change.T, float(node.moment) / float(claim.moment)
    most_b, most_m = np.abs(b).max(axis=0), np.abs(m).max(axis=0)
    most = np.maximum(A.max(axis=0), -A.min(axis=0)) + np.outer(most_b, most_m) * _UP
    whole = 2 * np.abs(change) @ np.abs(P) @ most @ np.abs(change).T
    moment = np.abs(change) @ most_m
    weighted = []
    for share, multiplier in shares:
        weight = multiplier * share**2 / (float(node.moment) * float(claim.moment))
        terms = whole + (rate + multiplier * near) * size + weight * np.outer(moment, moment)
        constant = (rate - multiplier * near) * unit + _ROUNDING * float(terms.sum()) * np.eye(_SIZE)
        weighted.append((share, weight, constant[:, :, None]))
    for start in range(0, len(A), _CHUNK):
        at = np.s_[start : start + _CHUNK]
        free = np.tensordot(np.tensordot(change @ P, np.moveaxis(A[at], 0, -1), 1), change, ([1], [1])).swapaxes(1, 2)
        free = free + free.swapaxes(0, 1)
        column, r = (change @ P) @ b[at].T, change @ m[at].T
        for share, weight, constant in weighted:
            go_on()
            c = share * column
            M = -free - constant - c[:, None] * r - r[:, None] * (c + weight * r)
            for k in range(_SIZE):
                if not np.all(M[k, k] > 0):  # a NaN fails this test too
                    raise Rejected("V does not decay at the claimed rate")
                M[k + 1 :, k + 1 :] -= (M[k + 1 :, k] / M[k, k])[:, None] * M[k, k + 1 :]
