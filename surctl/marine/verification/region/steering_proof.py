"""Proof of a claim about the heading loop of a craft without sway force: search, rounding, decision of the checker.

The search finds P by linear matrix inequalities over the matrices of `certcheck.steering_loop`. These depend on the
extent of the region, so the region starts small and grows until no P is found. The multiplier of limited yaw moments
is fixed in each inequality; after each step, it is chosen anew for the P found.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import Checked, Rejected, check_document, seal
from surctl.certcheck.steering_claim import SteeringClaim as Stated
from surctl.certcheck.steering_loop import (
    Extent,
    command_rows,
    delivered,
    lookahead,
    moment_rows,
    nodes,
    parameters,
    vertices,
)
from surctl.marine.verification.region.proof import RegionProof
from surctl.marine.verification.region.steering import SteeringClaim
from surctl.verification.conic import Inequality, minimise, symmetric_basis

__all__ = ["prove_steering"]

Array = NDArray[np.float64]

_BASIS = symmetric_basis(6)
_ROUNDS, _CUTS, _FEW, _TIGHT, _SAMPLE = 14, 12, 60, 60, 1000
_GROWTH, _STEPS = 1.8, 24  # first factor and largest number of the enlargements of the region
_LEAST = 1.05  # the search ends when the factor is smaller
_FIRST = 0.002  # |y_e| of the first region, divided by the look-ahead distance
_WIDER = 1.15  # how much more the next region may extend in the other states
_FACTORS = (1.0, 1.4, 0.7, 2.0, 0.5)  # of the last multiplier
_NARROW = 5e-3  # the search takes the mean of parameters whose range is narrower
_MARGIN = 0.02  # relative reserve of the decay rate
_NOT = "not provable for this vehicle and these gains, because"


class _Loops(NamedTuple):
    """Matrices A (n, 6, 6), the terms (n, 6, 6) and rates (n,) that limited moments add; V̇ = ξᵀ(AᵀP + PA)ξ."""

    A: Array
    limited_moment: Array
    shift: Array


class _Candidate(NamedTuple):
    """P of a region V ≤ 1, and the multiplier of its limited moments."""

    P: Array
    multiplier: float


def prove_steering(claim: SteeringClaim) -> RegionProof:
    """Search for the largest region in which the claim holds, and let the checker decide."""
    began = time.perf_counter()
    reason = f"{_NOT} the search found no quadratic V with this decay rate"
    stated, active = claim.stated(), set[int]()
    target, factor, known = _FIRST * float(lookahead(stated)[1]), _GROWTH, None
    best: tuple[float, dict[str, Any], Checked, _Candidate] | None = None
    for _ in range(_STEPS):
        candidate = _region(claim, stated, target, known, active)
        document = {} if candidate is None else _certificate(claim, candidate)
        checked = check_document(document) if document else None
        if candidate is not None and checked is not None and checked.accepted:
            known, offset = candidate, document["claim"]["motion"]["offset_m"]
            if best is None or offset > best[0]:
                best = offset, document, checked, candidate
            target *= factor
        else:
            reason = reason if checked is None else f"{_NOT} {checked.reason}"
            if best is None:
                break
            target /= factor
            factor = np.sqrt(factor)
            target *= factor
            if factor < _LEAST:
                break
    took = time.perf_counter() - began
    if best is None:
        return RegionProof(claim, "unknown", {}, reason, 0.0, (0.0, 0.0), took, 0.0)
    offset, document, checked, candidate = best
    beside = float(np.sqrt(np.linalg.inv(candidate.P)[0, 0]))
    return RegionProof(claim, "proved", document, "", offset, (0.0, 0.0), took, checked.seconds, beside)


def _certificate(claim: SteeringClaim, candidate: _Candidate) -> dict[str, Any]:
    P = candidate.P
    rounded = [[float(f"{P[i, j]:.9g}") for j in range(i + 1)] for i in range(6)]
    offset = float(np.floor(1e4 * 0.9999 / np.sqrt(rounded[0][0])) / 1e4)
    return seal(
        "steering",
        claim.document(offset=offset),
        {"proof": {"P": rounded, "shares": [[1.0, float(f"{candidate.multiplier:.4g}")]]}},
    )


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


def _region(
    claim: SteeringClaim, stated: Stated, target: float, before: _Candidate | None, active: set[int]
) -> _Candidate | None:
    """Return a region that reaches about `target` [m] beside the path; None if none."""
    units = _units(claim, stated) * target
    if before is None:
        P: Array | None = None
        at = _extent_of(np.zeros(8))
        for _ in range(2):
            P = _shape(claim, stated, at, units, None, 0.0, active)
            if P is None:
                return None
            P = P * float(np.linalg.inv(P)[0, 0]) / target**2  # the loop is linear here: scale the region to the target
            at, _ = _extent(claim, stated, P)
        assert P is not None
        return _Candidate(P, 0.0)
    _, sizes = _extent(claim, stated, before.P)
    bounds = sizes * (target / sizes[0]) * _WIDER
    for factor in _FACTORS if before.multiplier else (1.0,):
        multiplier = before.multiplier * factor
        P = _shape(claim, stated, _extent_of(bounds), units, bounds, multiplier, active)
        if P is not None:
            return _Candidate(P, _tuned(claim, stated, P, multiplier))
    return None


def _tuned(claim: SteeringClaim, stated: Stated, P: Array, multiplier: float) -> float:
    """Return the multiplier with the fastest decay of V at the worst matrices of limited moment."""
    at, _ = _extent(claim, stated, P)
    if delivered(stated, at) >= 1:
        return 0.0
    tries = multiplier * np.geomspace(0.5, 2, 9) if multiplier else np.geomspace(0.005, 1, 16)
    loops, change = _loops(stated, at, np.ones(6), 1.0), np.linalg.inv(np.linalg.cholesky(P))
    limited = np.flatnonzero(loops.shift)
    some = np.random.default_rng(0).choice(limited, size=min(len(limited), _SAMPLE), replace=False)
    half = (change @ P) @ loops.A[some] @ change.T
    limited_moment = change @ loops.limited_moment[some] @ change.T + loops.shift[some, None, None] * np.eye(6)
    worst = [np.linalg.eigvalsh(half + half.swapaxes(-1, -2) + one * limited_moment)[:, -1].max() for one in tries]
    return float(tries[int(np.argmin(worst))])


def _units(claim: SteeringClaim, stated: Stated) -> Array:
    """Return typical sizes of the states for |y_e| = 1 m."""
    ahead = float(lookahead(stated)[1])
    turn = claim.gains["k_psi"] / ahead
    slip = claim.vehicle["m11"] / claim.vehicle["m22"] * turn
    return np.array([1.0, 1 / ahead, slip, turn, 1 / ahead, slip])


def _loops(stated: Stated, at: Extent, units: Array, multiplier: float) -> _Loops:
    """Return the matrices of all nodes in units of the states; parameters with narrow ranges have their mean."""
    A, limited_moment, shift = [], [], []
    least = float(delivered(stated, at))
    pairs = [(1.0, 0.0)] + [(share, multiplier) for share in (least, 1.0) if least < 1]
    loops = []
    for node in nodes(stated):
        theta = [((low + high) / 2,) * 2 if high - low < _NARROW * abs(high) else (low, high)
                 for low, high in parameters(stated, at, node)]  # fmt: skip
        loop, b, m = vertices(stated, theta, node)
        loops.append((node, loop * units / units[:, None], b / units, m * units))
    for share, one in pairs:
        for node, loop, b, m in loops:
            near = float(node.moment / stated.moment)
            A.append(loop + share * b[:, :, None] * m[:, None, :])
            weight = one * share**2 / float(node.moment * stated.moment)
            limited_moment.append(weight * m[:, :, None] * m[:, None, :])
            shift.append(np.full(len(m), -one * near))
    return _Loops(np.concatenate(A), np.concatenate(limited_moment), np.concatenate(shift))


def _violated(M: Array, bound: float) -> NDArray[np.intp]:
    """Return the numbers of the matrices M (n, 6, 6) with an eigenvalue above `bound`."""
    a = np.moveaxis(bound * np.eye(6) - M, 0, -1)
    good = np.ones(len(M), dtype=bool)
    for k in range(6):
        good &= a[k, k] > 0
        share = a[k, k + 1 :] / np.where(good, a[k, k], 1.0)
        a[k + 1 :, k + 1 :] -= share[:, None] * a[k, None, k + 1 :]
    return np.flatnonzero(~good)


def _shape(
    claim: SteeringClaim,
    stated: Stated,
    at: Extent,
    units: Array,
    bounds: Array | None,
    multiplier: float,
    active: set[int],
) -> Array | None:
    """Return P that decays for all matrices of the extent `at`, within the bounds (8,), with the least V beside."""
    try:
        loops = _loops(stated, at, units, multiplier)
    except Rejected:
        return None
    A, limited_moment, shift = loops
    rng = np.random.default_rng(0)
    chosen = {k for k in active if k < len(A)} or set(rng.integers(len(A), size=_FEW).tolist())
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
        order = sorted(chosen)
        some = A[order]
        half = np.einsum("kij,njl->nkil", _BASIS, some)
        whole = np.zeros((len(some), 22, 6, 6))
        whole[:, :21] = -(half + half.swapaxes(-1, -2) + (rate + shift[order])[:, None, None, None] * _BASIS)
        x = minimise(cost, [(-1e-6 * np.eye(6) - limited_moment[order], whole), *fixed])
        if x is None:
            return None
        P = np.einsum("k,kij->ij", x[:21], _BASIS)
        if np.linalg.eigvalsh(P)[0] <= 0:
            return None
        change = np.linalg.inv(np.linalg.cholesky(P))
        half = (change @ P) @ A @ change.T
        M = half + half.swapaxes(-1, -2) + change @ limited_moment @ change.T + shift[:, None, None] * np.eye(6)
        bad = _violated(M, -claim.rate * (1 + _MARGIN / 4))
        if not len(bad):
            values = np.linalg.eigvalsh(M[order])[:, -1]
            active.clear()
            active.update(np.array(order)[np.argsort(-values)[:_TIGHT]].tolist())
            return np.asarray(P / (units * units[:, None]))
        bad = bad if len(bad) <= _SAMPLE else rng.choice(bad, size=_SAMPLE, replace=False)
        values = np.linalg.eigvalsh(M[bad])[:, -1]
        chosen |= set(bad[np.argsort(-values)[:_CUTS]].tolist())
    return None
