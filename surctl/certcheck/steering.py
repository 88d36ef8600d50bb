"""Check of a `steering` certificate: V decays on every motion of the heading loop of a craft without sway force.

The claim states that V = ξᵀ P ξ satisfies V̇ ≤ −a V on V ≤ 1 for all parameters in their ranges, so that every motion
that starts there satisfies V(t) ≤ e^(−a t) V(0): cross-track error, heading, sway, yaw rate and the two filters of the
law converge to 0. `steering_loop` encloses the loop by matrices A_k, and Aᵀ P + P A + a P < 0 is verified for each of
them, with a bound on all rounding errors (Rump 2006). P > 0 and the offset are checked in exact rational arithmetic.
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
from surctl.certcheck.steering_loop import Extent, command_rows, moment_rows, parameters, vertices

__all__ = ["check", "extent_of"]

Array = NDArray[np.float64]

_SIZE = len(STATES)
_ROUNDING = 1e-11  # relative rounding error of a matrix and of its factorisation
_WORST = 1e5  # largest condition of the scaled matrix of V


def check(document: Mapping[str, Any]) -> None:
    """Check a `steering` certificate whose format and hash are verified.

    Raises:
        Rejected: the certificate does not prove its claim; the message names the first failure.
    """
    record(document, ("format", "version", "kind", "claim", "proof", "sha256"), "the certificate")
    claim = read_claim(document.get("claim"))
    p = _matrix(record(document.get("proof"), ("P",), "proof")["P"])
    if not is_positive_definite(p):
        raise Rejected("P is not positive definite")
    if quadratic(p, [claim.offset, *[Fraction(0)] * (_SIZE - 1)]) > 1:
        raise Rejected(f"a start {float(claim.offset):g} m beside the path is not in the region")
    A = vertices(claim, parameters(claim, extent_of(claim, p)))
    go_on()
    _check_decay(p, A, float(claim.rate))
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


def _check_decay(p: Matrix, A: Array, rate: float) -> None:
    """Raise Rejected unless Aᵀ P + P A + a P < 0 for every matrix A (n, 6, 6)."""
    P = np.array([[float(entry) for entry in row] for row in p])
    change = np.tril(np.linalg.inv(np.linalg.cholesky(P)))
    size = np.abs(change) @ np.abs(P) @ np.abs(change).T
    if not (size.max() <= _WORST and np.all(np.diag(change) > 0)):
        raise Rejected("P is too ill-conditioned for double precision")
    most = np.abs(A).max(axis=0)
    whole = 2 * np.abs(change) @ np.abs(P) @ most @ np.abs(change).T + rate * size
    error = _ROUNDING * float(whole.sum())
    half = (change @ P) @ A @ change.T
    M = -(half + half.swapaxes(-1, -2)) - rate * (1 + 1e-9) * (change @ P @ change.T) - error * np.eye(_SIZE)
    for k in range(_SIZE):
        if not np.all(M[:, k, k] > 0):  # a NaN fails this test too
            raise Rejected("V does not decay at the claimed rate")
        share = M[:, k + 1 :, k] / M[:, k, k][:, None]
        M[:, k + 1 :, k + 1 :] -= share[:, :, None] * M[:, k, None, k + 1 :]
