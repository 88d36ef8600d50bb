"""Proof of a claim about the heading loop of a craft without sway force: search, rounding, decision of the checker.

The search finds P by linear matrix inequalities over the matrices of `certcheck.steering_loop`. These depend on the
extent of the region, so the region starts small and grows until no P is found.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import Rejected, check_document, seal
from surctl.certcheck.steering_claim import SteeringClaim as Stated
from surctl.certcheck.steering_loop import Extent, command_rows, lookahead, moment_rows, parameters, vertices
from surctl.verification.region.conic import Inequality, minimise, symmetric_basis
from surctl.verification.region.proof import RegionProof
from surctl.verification.region.steering import SteeringClaim

__all__ = ["prove_steering"]

Array = NDArray[np.float64]

_BASIS = symmetric_basis(6)
_ROUNDS, _CUTS, _FEW = 14, 25, 60
_GROWTH, _STEPS = 1.8, 24  # first factor and largest number of the enlargements of the region
_LEAST = 1.02  # the search ends when the factor is smaller
_FIRST = 0.002  # |y_e| of the first region, divided by the look-ahead distance
_WIDER = 1.15  # how much more the next region may extend in the other states
_MARGIN = 0.02  # relative reserve of the decay rate
_NOT = "not provable for this vehicle and these gains, because"


def prove_steering(claim: SteeringClaim) -> RegionProof:
    """Search for the largest region in which the claim holds, and let the checker decide."""
    began = time.perf_counter()
    reason, proved = f"{_NOT} the search found no quadratic V with this decay rate", None
    stated = claim.stated()
    ahead = float(lookahead(stated)[1])
    target, factor, P = _FIRST * ahead, _GROWTH, None
    for _ in range(_STEPS):
        candidate = _region(claim, stated, target, P)
        document = {} if candidate is None else _certificate(claim, candidate)
        checked = check_document(document) if document else None
        if checked is not None and checked.accepted:
            proved, P = (document, checked), candidate
            target *= factor
        else:
            reason = reason if checked is None else f"{_NOT} {checked.reason}"
            if proved is None:
                break
            target /= factor
            factor = np.sqrt(factor)
            target *= factor
            if factor < _LEAST:
                break
    took = time.perf_counter() - began
    if proved is None or P is None:
        return RegionProof(claim, "unknown", {}, reason, 0.0, (0.0, 0.0), took, 0.0)
    document, checked = proved
    beside = float(np.sqrt(np.linalg.inv(P)[0, 0]))
    offset = document["claim"]["motion"]["offset_m"]
    return RegionProof(claim, "proved", document, "", offset, (0.0, 0.0), took, checked.seconds, beside)


def _certificate(claim: SteeringClaim, P: Array) -> dict[str, Any]:
    rounded = [[float(f"{P[i, j]:.9g}") for j in range(i + 1)] for i in range(6)]
    offset = float(np.floor(1e4 * 0.9999 / np.sqrt(rounded[0][0])) / 1e4)
    return seal("steering", claim.document(offset=offset), {"proof": {"P": rounded}})


def _extent(claim: SteeringClaim, stated: Stated, P: Array) -> tuple[Extent, Array]:
    """Return the extent of V ≤ 1 as exact bounds, and as an array (8,)."""
    covariance = np.linalg.inv(P)
    sizes = np.sqrt(np.diag(covariance)) * 1.0001
    rows = np.array([[float(n) for n in row] for row in command_rows(stated, Fraction(float(sizes[0])))])
    command = np.sqrt(np.einsum("ki,ij,kj->k", rows, covariance, rows).max()) * 1.0001
    at = _extent_of([*sizes, command, 0.0])
    rows = np.array([[float(n) for n in row] for row in moment_rows(stated, at)])
    moment = np.sqrt(np.einsum("ki,ij,kj->k", rows, covariance, rows).max()) * 1.0001
    bounds = np.array([*sizes, command, moment])
    return _extent_of(bounds), bounds


def _extent_of(bounds: Iterable[float]) -> Extent:
    """Return the bounds on the six states, the commanded yaw rate and the moment as exact numbers."""
    y, psi, v, r, _, s, command, moment = (Fraction(float(n)) for n in bounds)
    return Extent(y, psi, v, r, s, command, moment)


def _region(claim: SteeringClaim, stated: Stated, target: float, before: Array | None) -> Array | None:
    """Return P of a region that reaches about `target` [m] beside the path; None if none."""
    units = _units(claim, stated) * target
    if before is None:
        bounds: Array | None = None
        at = _extent_of(np.zeros(8))
    else:
        _, sizes = _extent(claim, stated, before)
        bounds = sizes * (target / sizes[0]) * _WIDER
        at = _extent_of(bounds)
    for _ in range(2 if before is None else 1):
        P = _shape(claim, stated, at, units, bounds, target)
        if P is None or bounds is not None:
            return P
        P = P * float(np.linalg.inv(P)[0, 0]) / target**2  # the loop is linear here: scale the region to the target
        at, _ = _extent(claim, stated, P)
        bounds = None
    return P


def _units(claim: SteeringClaim, stated: Stated) -> Array:
    """Return typical sizes of the states for |y_e| = 1 m."""
    ahead = float(lookahead(stated)[1])
    turn = claim.gains["k_psi"] / ahead
    slip = claim.vehicle["m11"] / claim.vehicle["m22"] * turn
    return np.array([1.0, 1 / ahead, slip, turn, 1 / ahead, slip])


def _shape(
    claim: SteeringClaim, stated: Stated, at: Extent, units: Array, bounds: Array | None, target: float
) -> Array | None:
    """Return P that decays for all matrices of the extent `at`, within the bounds (8,), with the least V beside."""
    try:
        A = vertices(stated, parameters(stated, at)) * units / units[:, None]
    except Rejected:
        return None
    rng = np.random.default_rng(0)
    chosen = set(rng.integers(len(A), size=_FEW).tolist())
    fixed: list[Inequality] = [(-1e-4 * np.eye(6)[None], np.append(_BASIS, np.zeros((1, 6, 6)), axis=0)[None])]
    if bounds is None:
        fixed.append((np.zeros((1, 6, 6)), np.append(-_BASIS, np.eye(6)[None], axis=0)[None]))
        fixed[0] = (-np.eye(6)[None], fixed[0][1])
        cost = np.append(np.zeros(21), 1.0)
    else:
        turns, moments = (
            np.array([[float(n) for n in row] for row in rows]) * units
            for rows in (command_rows(stated, at.beside), moment_rows(stated, at))
        )
        limited = [*zip(np.eye(6), bounds[:6] / units, strict=True)]
        limited += [(row, bounds[6]) for row in turns] + [(row, bounds[7]) for row in moments]
        corner, wide = np.zeros((len(limited), 7, 7)), np.zeros((len(limited), 22, 7, 7))
        for k, (row, size) in enumerate(limited):
            corner[k, :6, 6] = corner[k, 6, :6] = row / size
            corner[k, 6, 6] = 1.0
        wide[:, :21, :6, :6] = _BASIS
        fixed.append((corner, wide))
        cost = np.append(1e-4 * np.einsum("kii->k", _BASIS), 0.0)
        cost[0] += 1.0
    rate = claim.rate * (1 + _MARGIN)
    for _ in range(_ROUNDS):
        some = A[sorted(chosen)]
        half = np.einsum("kij,njl->nkil", _BASIS, some)
        whole = np.zeros((len(some), 22, 6, 6))
        whole[:, :21] = -(half + half.swapaxes(-1, -2) + rate * _BASIS)
        x = minimise(cost, [(np.tile(-1e-6 * np.eye(6), (len(some), 1, 1)), whole), *fixed])
        if x is None:
            return None
        P = np.einsum("k,kij->ij", x[:21], _BASIS)
        if np.linalg.eigvalsh(P)[0] <= 0:
            return None
        change = np.linalg.inv(np.linalg.cholesky(P))
        half = (change @ P) @ A @ change.T
        values = np.linalg.eigvalsh(half + half.swapaxes(-1, -2))[:, -1]
        bad = np.flatnonzero(values > -claim.rate * (1 + _MARGIN / 4))
        if not len(bad):
            return np.asarray(P / (units * units[:, None]))
        chosen |= set(bad[np.argsort(-values[bad])[:_CUTS]].tolist())
    return None
