"""Search for V = ξᵀPξ of a turning cruise, over start values of linear matrix inequalities.

The start values are the extent of the region in each state, the floor of the decay, the growth η, and how far beside
the path the vehicle starts. The bounds of a region with this extent are constant in each shell, so P is the solution
of a convex program. Then the region is enlarged and the floor lowered as far as the fixed shape of P allows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surctl.verification.region.conic import Inequality, minimise
from surctl.verification.region.turning import TurningClaim
from surctl.verification.region.turning_loop import Cruise, Vertices, steady_turning, vertices
from surctl.verification.region.turning_shells import TurningCandidate, fitted, transformed, violated

__all__ = ["turning_search"]

Array = NDArray[np.float64]

_USUAL = np.array([0.3, 0.8, 0.15])  # k1 [1/s], look-ahead [m] and cruise speed [m/s] of the first start values
_ENTRIES = ((0, 0), (2, 0), (2, 2), (1, 1), (3, 1), (3, 3))
_SHELLS = 3  # shells of the search
_CELLS, _FINE = 28, 4  # cells of headings, and the number of them that one cell of the search covers
_ROUNDS, _CUTS, _TIGHT = 25, 6, 8
_FIRST = np.array([
    [0.14, 0.33, 1.0, 0.63, 0.4, 0.03, 0.25], [0.22, 0.45, 1.0, 0.45, 0.5, 0.09, 0.25],
    [0.155, 0.3, 0.5, 0.33, 0.6, 0.045, 0.3], [0.165, 0.27, 0.5, 0.33, 0.4, 0.045, 0.25],
    [0.105, 0.33, 1.0, 0.63, 0.75, 0.016, 0.3], [0.155, 0.47, 0.95, 0.57, 0.9, 0.07, 0.3],
    [0.12, 0.35, 0.9, 0.4, 0.25, 0.03, 0.25], [0.16, 0.42, 0.8, 0.45, 0.6, 0.09, 0.25],
])  # first start values, with the velocity deviation divided by the cruise speed  # fmt: skip
_SMALLER = np.array([0.7, 0.7, 0.7, 1, 2, 2, 0.7])  # of the first start values, if none of them has a V
_SPREAD = np.array([0.2, 0.2, 0.12, 0.2, 0.4, 0.4, 0.15])  # of the start values near the first ones
_NEAR = np.array([0.06, 0.06, 0.05, 0.06, 0.2, 0.2, 0.1])  # of the start values near the best one
_REST = 1.35  # factor of the first velocity deviations if the region must contain a vehicle at rest
_ENOUGH = 4  # number of regions after which the search refines the best one
_HIGHEST = 0.9  # largest floor in the search
_PRICE, _FREE = 0.8, 0.2  # a floor above 0.2 counts as a smaller region
_TRIED = 3  # number of candidates that the checker sees at most
_ERROR = 0.5  # first E, divided by k_v times the first velocity deviation
_LOOSE = 4.0  # reserve of the decay rate for each 1/s of the Coriolis terms that m12 adds
_MARGIN = 0.006  # [1/s] reserve of the decay rate, for points between the grid points


@dataclass
class _Active:
    """Numbers of the vertices that mattered in the shells of earlier programs."""

    known: list[set[int]]


def _improve(
    claim: TurningClaim, cruise: Cruise, extent: Array, levels: Array, growths: Array, beside: float, active: _Active
) -> Array | None:
    """Return P whose region V ≤ 1 has at most the given extent (4,) in each state but E; None if none.

    P has the least V at the start `beside` [m] the path, with the target's velocity or, if the claim asks for it, at
    rest.
    """
    basis, units = _basis(claim), np.array([0.3, 0.3, 0.15, 0.15]) * _sizes(claim)
    behind = claim.gains["k_v"] * extent[2:] if claim.behind else np.zeros(0)
    shells = [vertices(claim, cruise, np.diag(np.append(extent, _ERROR * behind) ** 2), high)
              for high in levels[1:]]  # fmt: skip
    if any(one is None for one in shells):
        return None
    known = [one.phases() for one in shells if one is not None]
    fixed = _extents(extent / units, basis) + _starts(claim, cruise, units, basis)
    cost = np.append(1e-3 * np.einsum("kii->k", basis), 1.0)
    units = np.append(units, units[2:] * claim.gains["k_v"] if claim.behind else [])
    cost[3] += (beside / units[1]) ** 2
    rng = np.random.default_rng(0)
    parts = [(phase, growth, low) for phases, growth, low in zip(known, growths, levels[:-1], strict=True)
             for phase in phases]  # fmt: skip
    chosen = []
    for (one, *_), some in zip(parts, active.known, strict=False):
        count = int(np.prod(one.shape))
        earlier = {k for k in some if k < count}
        chosen.append(earlier or set(rng.integers(count, size=_TIGHT).tolist()))
    for _ in range(_ROUNDS):
        own = [
            _decay(shell, some, claim.rate, growth, low, units, basis)
            for (shell, growth, low), some in zip(parts, chosen, strict=True)
        ]
        decay = (np.concatenate([one[0] for one in own]), np.concatenate([one[1] for one in own]))
        x = minimise(cost, [decay, *fixed], tolerance=1e-7)
        if x is None:
            return None
        P = np.einsum("k,kij->ij", x[:-1], basis) / (units[:, None] * units)
        if np.linalg.eigvalsh(P * units[:, None] * units)[0] <= 0:
            return None
        fine = stuck = True
        for (shell, growth, low), some in zip(parts, chosen, strict=True):
            matrices = shell.matrices(P, claim.rate, growth, low)
            bad = violated(matrices, -_MARGIN / 2)
            if len(bad):
                fine = False
                bad = bad if len(bad) <= 600 else rng.choice(bad, size=600, replace=False)
                values = np.linalg.eigvalsh(np.moveaxis(matrices[..., bad], -1, 0))[:, -1]
                more = set(bad[np.argsort(-values)[:_CUTS]].tolist())
                stuck = stuck and more <= some  # `matrices` weighs the disturbances by V
                some |= more
        if fine or stuck:
            for k, ((shell, growth, low), some) in enumerate(zip(parts, chosen, strict=True)):
                active.known[k] = _tightest(P, shell, some, growth * low)
            return np.asarray(P)
    return None


def _sizes(claim: TurningClaim) -> Array:
    """Return the typical size of each state, divided by its size for the usual gains and cruise speed."""
    k1, ahead, v = np.array([claim.gains["k1"], claim.gains["lookahead"], claim.cruise]) / _USUAL
    return np.array([v / k1, ahead, v, v])


def _basis(claim: TurningClaim) -> Array:
    """Return a basis (k, n, n) of the matrices of V: the last one is |E|², with thrust lag or held commands."""
    size = 6 if claim.behind else 4
    basis = np.zeros((len(_ENTRIES) + (size > 4), size, size))
    for k, (i, j) in enumerate(_ENTRIES):
        basis[k, i, j] = basis[k, j, i] = 1
    basis[-1, range(4, size), range(4, size)] = 1
    return basis


def _extents(extent: Array, basis: Array) -> list[Inequality]:
    """Return [P e; eᵀ extent²] ⪰ 0 for each unit vector e of the first four states."""
    corner, wide = np.zeros((4, 5, 5)), np.zeros((4, len(basis) + 1, 5, 5))
    corner[:, :4, 4] = corner[:, 4, :4] = np.eye(4)
    corner[:, 4, 4] = extent**2
    wide[:, :-1, :4, :4] = basis[:, :4, :4]
    return [(corner, wide)]


def _starts(claim: TurningClaim, cruise: Cruise, units: Array, basis: Array) -> list[Inequality]:
    """Return x_k ≥ zᵀ P z for the deviation z along the path at the start, for each ω."""
    rows = []
    for omega in sorted(set(cruise.moved)):
        z = np.array([omega / claim.gains["k1"], 0, -claim.cruise if claim.rest else 0, 0]) / units
        rows.append(np.append(-np.einsum("i,kij,j->k", z, basis[:, :4, :4], z), 1.0)[:, None, None])
    return [(np.zeros((len(rows), 1, 1)), np.array(rows))]


def _decay(
    shell: Vertices, some: set[int], rate: float, growth: float, low: float, units: Array, basis: Array
) -> Inequality:
    """Return −(Aᵀ P + P A + (a + η) P + P W P/(η low)) ⪰ 0 with a margin, by its Schur complement."""
    A, factor, weights = shell.select(sorted(some))
    count, n, inner = len(basis), len(units), factor.shape[2]
    half = np.einsum("kij,njl->nkil", basis, A * units / units[:, None])
    whole = np.zeros((len(A), count + 1, n + inner, n + inner))
    whole[:, :-1, :n, :n] = -(half + half.swapaxes(-1, -2) + (rate + growth + _MARGIN + _LOOSE * shell.loose) * basis)
    for k in range(4):  # the last entry of V is in units of |E|²
        whole[:, count - 1, k, k] -= weights[:, k] * (units[k] / units[-1]) ** 2
    side = np.einsum("kij,njl->nkil", basis, factor / units[:, None])
    whole[:, :-1, :n, n:], whole[:, :-1, n:, :n] = side, side.swapaxes(-1, -2)
    constant = np.zeros((len(A), n + inner, n + inner))
    constant[:] = np.diag([-1e-5] * n + [growth * low] * inner)
    return constant, whole


def _tightest(P: Array, shell: Vertices, some: set[int], scale: float) -> set[int]:
    """Return the vertices whose inequality is nearly tight: the first ones of the next program."""
    order = np.array(sorted(some))
    half, effect = transformed(P, shell, order)
    values = np.linalg.eigvalsh(half + effect / scale)[:, -1]
    return set(order[np.argsort(-values)[:_TIGHT]].tolist())


def _first_steps(claim: TurningClaim, away: float, rng: np.random.Generator, k: int) -> Array:
    along, beside, fast, _ = _sizes(claim)
    speed = claim.cruise * (_REST if claim.rest else 1)
    start = _FIRST[k % len(_FIRST)] * (along, beside, speed, fast / beside, 1, 1, beside)
    start = start * np.exp(rng.normal(scale=_SPREAD) * (k >= len(_FIRST)))
    start[0] += away
    return np.asarray(start)


def turning_search(
    claim: TurningClaim, *, attempts: int, seed: int = 0, slopes: tuple[float, float] | None = None
) -> Iterator[TurningCandidate]:
    """Yield candidates, the largest region first.

    The size of a region is that of its start beside the path, and also that of its start at rest if the claim asks for
    it. `attempts` is the number of start values of the search; equal seeds give equal candidates. `slopes` are those
    of ω in the mean drag factors; by default those with the least error of the trim force.
    """
    fine = steady_turning(claim, cells=_CELLS, slopes=slopes)
    cruise = replace(fine, headings=fine.headings[::_FINE], lack=fine.lack[::_FINE])
    away = max(map(abs, cruise.moved)) / claim.gains["k1"]
    rng = np.random.default_rng(seed)
    active = _Active([set() for _ in range(2 * _SHELLS)])
    regions: list[tuple[float, Array, Array]] = []  # score, next start values, P
    for k, smaller in ((k % attempts, k >= attempts) for k in range(2 * attempts)):
        if smaller and k == 0 and regions:
            break
        if len(regions) >= _ENOUGH or (regions and 4 * k >= attempts):
            start = max(regions, key=lambda one: one[0])[1] * np.exp(rng.choice([1.0, 0.4]) * rng.normal(scale=_NEAR))
        else:
            start = _first_steps(claim, away, rng, k) * (_SMALLER if smaller else 1.0)
        floor, growth, beside = min(start[4], _HIGHEST), start[5], start[6]
        levels = np.geomspace(floor, 1.0, _SHELLS + 1)
        extent = start[:4] * (1, 1, 1, start[1])
        P = _improve(claim, cruise, extent, levels, growth * levels[1:] ** -0.15, beside, active)
        if P is not None:
            regions.append((_score(claim, TurningCandidate(P, (floor,), (), cruise)), start, P))
    regions.sort(key=lambda one: -one[0])
    candidates = [fitted(claim, fine, P, start[5]) for _, start, P in regions[:_TRIED]]
    yield from sorted((one for one in candidates if one is not None), key=lambda one: -_score(claim, one))


def _score(claim: TurningClaim, candidate: TurningCandidate) -> float:
    return _size(claim, candidate) * (1 - _PRICE * max(candidate.levels[0] - _FREE, 0.0))


def _size(claim: TurningClaim, candidate: TurningCandidate) -> float:
    start = candidate.start(claim, 0.0)
    return min(start, 1.25 * candidate.start(claim, -claim.cruise)) if claim.rest else start
