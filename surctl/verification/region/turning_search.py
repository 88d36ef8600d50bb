"""Search for V = ξᵀPξ of a turning cruise, over start values of linear matrix inequalities.

The start values are the extent of the region in each state, the floor of the decay, the growth η, and the level of a
vehicle at rest. The bounds of a region with this extent are constant, so P is the solution of a convex program. Then
the floor is lowered as far as the fixed P allows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surctl.verification.region.conic import minimise
from surctl.verification.region.turning import TurningClaim
from surctl.verification.region.turning_loop import Cruise, Vertices, steady_turning, vertices

__all__ = ["TurningCandidate", "turning_search"]

Array = NDArray[np.float64]

_UNITS = np.array([0.3, 0.3, 0.15, 0.15])  # typical sizes of the states, to scale the inequalities
_BASIS = np.zeros((6, 4, 4))
for _k, (_i, _j) in enumerate(((0, 0), (2, 0), (2, 2), (1, 1), (3, 1), (3, 3))):
    _BASIS[_k, _i, _j] = _BASIS[_k, _j, _i] = 1
_FINE = 6  # largest number of shells in the proof
_CELLS = 9  # cells of headings in the search
_ROUNDS, _CUTS = 25, 14
_SCALES = np.array([0.12, 0.12, 0.08, 0.12, 0.3, 0.3, 0.1])  # spread of the start values near the best
_FIRST = np.array([
    [0.105, 0.33, 1.0, 0.63, 0.75, 0.016, 0.45], [0.155, 0.47, 0.95, 0.57, 0.9, 0.07, 0.73],
    [0.12, 0.35, 0.9, 0.4, 0.25, 0.03, 0.6], [0.16, 0.42, 0.7, 0.5, 0.9, 0.13, 0.7],
])  # first start values, with the velocity deviation divided by the cruise speed  # fmt: skip
_ENOUGH = 6  # number of regions after which the search refines the best one
_HIGHEST = 0.9  # largest floor in the search
_PRICE, _FREE = 0.8, 0.2  # a floor above 0.2 counts as a smaller region
_WIDER = (1.0, 1.05, 1.1, 1.16)  # factors by which a region is enlarged
_TRIED = 4  # number of candidates that the checker sees at most
_GROWTHS = np.geomspace(0.01, 2, 24)  # [1/s] part of the decay rate that the disturbance uses up
_MARGIN = 0.012  # [1/s] reserve of the decay rate, for points between the grid points
_LEVELS = (0.8, 0.65, 0.5, 0.4, 0.3, 0.22, 0.16, 0.12, 0.09, 0.065, 0.045, 0.03, 0.02)


@dataclass(frozen=True)
class TurningCandidate:
    """A proof before its check: P (4, 4), levels (k + 1,) from floor to 1, growth (k,) of each shell, steady cruise."""

    P: Array
    levels: tuple[float, ...]
    growths: tuple[float, ...]
    cruise: Cruise

    def start(self, claim: TurningClaim, speed: float) -> float:
        """Return the largest |y_e| [m] in the region at x_e = 0 with the speed U_x − v = `speed` [m/s]; 0 if none."""
        left = 1.0
        for omega in self.cruise.omega:
            z = np.array([omega / claim.gains["k1"], speed])
            left = min(left, 1 - float(z @ self.P[np.ix_((0, 2), (0, 2))] @ z))
        return float(np.sqrt(max(left, 0.0) / self.P[1, 1]))


def _shells(floor: float, count: int) -> tuple[float, ...]:
    return tuple(float(f"{level:.6g}") for level in np.geomspace(floor, 1.0, count + 1))


def _worst(P: Array, at: Vertices, rate: float, growth: float, low: float) -> Array:
    """Return the largest eigenvalue (n,) of Aᵀ P + P A + (a + η) P + P B Q Bᵀ P/(η low) in units of P."""
    change = np.linalg.inv(np.linalg.cholesky(P))
    half = (change @ P) @ at.A @ change.T
    side = change @ P[:, 2:]
    effect = side @ at.Q @ side.T / (growth * low)
    return np.asarray(np.linalg.eigvalsh(half + half.swapaxes(-1, -2) + effect)[:, -1] + rate + growth)


def _growth(P: Array, at: Vertices, rate: float, low: float) -> tuple[float, float]:
    """Return the growth η with the least of the largest eigenvalues, and that eigenvalue."""
    few = at
    if len(at.A) > 400:  # the vertices that matter at the largest and least growth usually contain the worst
        best = np.unique(np.concatenate([np.argsort(-_worst(P, at, rate, g, low))[:60] for g in _GROWTHS[4::6]]))
        few = Vertices(at.A[best], at.Q[best])
    values = [float(_worst(P, few, rate, g, low).max()) for g in _GROWTHS]
    k = int(np.argmin(values))
    return float(_GROWTHS[k]), float(_worst(P, at, rate, float(_GROWTHS[k]), low).max())


def _improve(
    claim: TurningClaim, cruise: Cruise, extent: Array, levels: tuple[float, ...], growths: list[float], left: float
) -> Array | None:
    """Return P with the least P_yy whose region V ≤ 1 has at most the given extent (4,) in each state; None if none.

    At rest, the x block of V is at most `left`.
    """
    shells = [vertices(claim, cruise, np.diag(extent**2), high) for high in levels[1:]]
    known = [one for one in shells if one is not None]
    if len(known) < len(shells):
        return None
    units = _UNITS[:, None] * _UNITS
    forced = any(np.any(one.Q) for one in known)
    rng = np.random.default_rng(0)
    active = [set(rng.choice(len(one.A), min(20, len(one.A)), replace=False).tolist()) for one in known]
    weight = 2e-3 * np.eye(4)
    weight[1, 1] = 1
    cost = np.einsum("kij,ij->k", _BASIS, weight)
    corner, wide = np.zeros((4, 5, 5)), np.zeros((4, 6, 5, 5))  # [P e; eᵀ extent²] ⪰ 0 for each unit vector e
    corner[:, :4, 4] = corner[:, 4, :4] = np.eye(4)
    corner[:, 4, 4] = (extent / _UNITS) ** 2
    wide[:, :, :4, :4] = _BASIS
    fixed = [(corner, wide)]
    if claim.rest:
        for omega in cruise.omega:
            z = np.array([omega / claim.gains["k1"], 0, -claim.cruise, 0]) / _UNITS
            fixed.append((np.full((1, 1, 1), left), -np.einsum("i,kij,j->k", z, _BASIS, z)[None, :, None, None]))
    for _ in range(_ROUNDS):
        constants, slopes = [], []
        for shell, some, growth, low in zip(known, active, growths, levels[:-1], strict=True):
            k = sorted(some)
            A = shell.A[k] * _UNITS / _UNITS[:, None]
            half = np.einsum("kij,njl->nkil", _BASIS, A)
            own = -(half + half.swapaxes(-1, -2) + (claim.rate + growth + _MARGIN) * _BASIS)
            if not forced:
                slopes.append(own)
                constants.append(np.broadcast_to(-1e-5 * np.eye(4), (len(k), 4, 4)))
                continue
            values, vectors = np.linalg.eigh(shell.Q[k])
            entry = np.zeros((len(k), 4, 2))
            entry[:, 2:] = vectors * np.sqrt(np.maximum(values, 0))[:, None] / _UNITS[2]
            whole = np.zeros((len(k), 6, 6, 6))
            whole[:, :, :4, :4] = own
            side = np.einsum("kij,njl->nkil", _BASIS, entry)
            whole[:, :, :4, 4:], whole[:, :, 4:, :4] = side, side.swapaxes(-1, -2)
            constant = np.zeros((len(k), 6, 6))
            constant[:] = np.diag([-1e-5] * 4 + [growth * low] * 2)
            slopes.append(whole)
            constants.append(constant)
        x = minimise(cost, [(np.concatenate(constants), np.concatenate(slopes)), *fixed], tolerance=1e-7)
        if x is None:
            return None
        P = np.einsum("k,kij->ij", x, _BASIS) / units
        if np.linalg.eigvalsh(P * units)[0] <= 0:
            return None
        fine = True
        for shell, some, growth, low in zip(known, active, growths, levels[:-1], strict=True):
            worst = _worst(P, shell, claim.rate, growth, low)
            if worst.max() > -_MARGIN / 2:
                fine = False
                some |= {int(i) for i in np.argsort(-worst)[:_CUTS] if worst[i] > -_MARGIN / 2}
        if fine:
            return np.asarray(P)
    return None


def _fitted(claim: TurningClaim, cruise: Cruise, P: Array) -> TurningCandidate | None:
    """Return the candidate for P with the lowest floor; None if V does not decay even close to the boundary."""
    best: TurningCandidate | None = None
    covariance = np.asarray(np.linalg.inv(P), dtype=np.float64)
    for floor in (0.9, *_LEVELS):
        levels = _shells(floor, max(2, min(_FINE, int(np.ceil(np.log(1 / floor) / 0.4)))))
        growths = []
        for low, high in pairwise(levels):
            at = vertices(claim, cruise, covariance, high)
            if at is None:
                return best
            growth, worst = _growth(P, at, claim.rate, low)
            if worst > -_MARGIN / 4:
                return best
            growths.append(float(f"{growth:.4g}"))
        best = TurningCandidate(P, levels, tuple(growths), cruise)
    return best


def turning_search(claim: TurningClaim, *, attempts: int, seed: int = 0) -> Iterator[TurningCandidate]:
    """Yield candidates, the largest region first.

    The size of a region is that of its start beside the path, and also that of its start at rest if the claim asks for
    it. `attempts` is the number of start values of the search; equal seeds give equal candidates.
    """
    cruise = steady_turning(claim, cells=_CELLS)
    away = max(map(abs, cruise.omega)) / claim.gains["k1"]
    rng = np.random.default_rng(seed)
    low, high = (1.1, 1.6) if claim.rest else (0.6, 1.2)  # range of the velocity deviation along the path / cruise
    least = np.array([0.08 + away, 0.2, low * claim.cruise, 0.35, 0.2, 0.015, 0.4])
    largest = np.array([0.25 + away, 0.6, high * claim.cruise, 0.65, 1.2, 0.15, 0.95])
    candidates: list[tuple[float, Array, Array]] = []
    for k in range(attempts):
        if candidates and (3 * k >= attempts or len(candidates) >= _ENOUGH):
            start = max(candidates, key=lambda one: one[0])[1] * np.exp(
                rng.choice([1, 0.5]) * rng.normal(scale=_SCALES)
            )
        elif k < len(_FIRST):
            start = _FIRST[k] * (1, 1, claim.cruise * (1.4 if claim.rest else 1), 1, 1, 1, 1)
            start[0] += away
        else:
            start = least * (largest / least) ** rng.uniform(size=7)
        extent = start[:4] * (1, 1, 1, start[1])
        floor, growth, left = min(start[4], _HIGHEST), start[5], min(start[6], 0.95)
        P = _improve(claim, cruise, extent, _shells(floor, 1), [growth], left)
        if P is not None:
            candidates.append((_score(claim, TurningCandidate(P, (floor,), (), cruise)), start, P))
    candidates.sort(key=lambda one: -one[0])
    for _, _, P in candidates[:_TRIED]:
        # the bounds that the search assumed may leave room for a larger region
        fitted = [_fitted(claim, cruise, np.asarray(P / wide**2)) for wide in _WIDER]
        yield from sorted((one for one in fitted if one is not None), key=lambda one: -_score(claim, one))


def _score(claim: TurningClaim, candidate: TurningCandidate) -> float:
    return _size(claim, candidate) * (1 - _PRICE * max(candidate.levels[0] - _FREE, 0.0))


def _size(claim: TurningClaim, candidate: TurningCandidate) -> float:
    start = candidate.start(claim, 0.0)
    return min(start, 1.25 * candidate.start(claim, -claim.cruise)) if claim.rest else start
