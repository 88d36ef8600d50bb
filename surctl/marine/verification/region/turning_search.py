"""Search for V = ξᵀPξ of a turning cruise, over start values of linear matrix inequalities.

The start values are the extent of the region in each state, the floor of the decay, the growth η, and how far beside
the path the vehicle starts. The bounds of a region with this extent are constant in each shell, so P is the solution
of a convex program. The next program has the bounds of a multiple of that region, which hold in every region inside
it, and so on while the region grows. Then it is enlarged and the floor lowered as far as the fixed shape of P allows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.turning_form import Form
from surctl.certcheck.turning_matrix import Inclusion, indefinite
from surctl.marine.verification.region.turning import TurningClaim
from surctl.marine.verification.region.turning_loop import Cruise, selected, steady_turning, vertices
from surctl.marine.verification.region.turning_shells import (
    TurningCandidate,
    excess_of,
    fitted,
    slowness,
    transformed,
)
from surctl.verification.conic import Inequality, minimise

Array = NDArray[np.float64]

_USUAL = np.array([0.3, 0.8, 0.15])  # k1 [1/s], look-ahead [m] and cruise speed [m/s] of the first start values
_ENTRIES = ((0, 0), (2, 0), (2, 2), (1, 1), (3, 1), (3, 3))
_OF_THRUST = ((4, 0), (4, 2), (4, 4), (5, 1), (5, 3), (5, 5))
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
_REST = 1.35  # factor of the first velocity deviations if the region must contain a vehicle at rest
_WIDER = 1.1  # factor of the jumps of the velocity in the first velocity deviations
_ENOUGH = 4  # number of first regions after which the search enlarges the best one
_GROWTH, _LEAST = 1.25, 1.01  # first and least factor of y in a step, by which the floor is lowered
_OTHERS = 0.3  # exponent of that factor for x and U_x, without a start at rest
_GAIN = 1.001  # factor of the score that a step must reach
_LOWEST = 0.15  # lowest floor in the search
_WEIGHT = 1e-4  # of the trace of P in the cost
_FACTORS = np.geomspace(0.5, 2, 21)  # of a growth, in the search of a better one
_HIGHEST = 0.9  # largest floor in the search
_PRICE, _FREE = 0.8, 0.2  # a floor above 0.2 counts as a smaller region
_TRIED = 3  # number of candidates that the checker sees at most
_ERROR = 0.5  # first E, divided by k_v times the first velocity deviation
_LOOSE = 4.0  # reserve of the decay rate for each 1/s of the Coriolis terms that m12 adds
_WEIGHTS = np.array([0.6, 1.0, 1.5])  # of held commands, in units of that of the thrust
_MARGIN = 0.001  # [1/s] reserve of the decay rate, for points between the grid points
_LOWER, _LOWERED, _SAME = 0.65, 2, 0.995  # factor of the floor, number of steps that lower it, and size that they keep
_CLOSE, _NARROWER = 0.07, 0.922  # share of the size that is close enough, and factor of the position if it jumps


@dataclass(frozen=True)
class _Start:
    """Start values of a program: levels of V (shells + 1,), growths η (shells,) [1/s], and the start beside the path.

    `beside` [m] is how far beside the path the vehicle starts.
    """

    levels: Array
    growths: Array
    beside: float


@dataclass(frozen=True)
class _Region:
    """A solution P of a program, the start values of the next one, and the score."""

    P: Array
    start: _Start
    score: float


@dataclass(frozen=True)
class _Part:
    """The vertices of one form that decides in the shell `number`, from the level `low`, and its growth η [1/s]."""

    number: int
    shell: Inclusion
    growth: float
    low: float


_Active: TypeAlias = dict[int, set[int]]
"""Numbers of the vertices that mattered in earlier programs, by number of the part."""


def _improve(
    claim: TurningClaim, cruise: Cruise, bound: Array, start: _Start, active: _Active, extent: Array | None = None
) -> tuple[Array, Array] | None:
    """Return P and the best growth of each shell [1/s] for the bounds in ξᵀ bound⁻¹ ξ ≤ 1; None if there is no P.

    The region V ≤ 1 lies in that ellipsoid, or has at most the given extent (4,) in each state but E. P has the least V
    at the start `beside` [m] the path, with the target's velocity or, if the claim asks for it, at rest.
    """
    basis, units, levels = _basis(claim), np.array([0.3, 0.3, 0.15, 0.15]) * _sizes(claim), start.levels
    shells = [vertices(claim, cruise, bound, high) for high in levels[1:]]
    known = [one for one in shells if one is not None]
    if len(known) < len(shells):
        return None
    parts = [
        _Part(k, phase, growth, low)
        for k, (one, growth, low) in enumerate(zip(known, start.growths, levels[:-1], strict=True))
        for phase in one
    ]
    fixed = _starts(claim, cruise, units, basis)
    cost = np.append(_WEIGHT * np.einsum("kii->k", basis), 1.0)
    cost[3] += (start.beside / units[1]) ** 2
    if extent is not None:
        fixed += _extents(extent / units, basis)
    units = np.append(units, np.tile(units[2:] * claim.gains["k_v"], claim.late_parts))
    if extent is None:
        fixed += _within(np.linalg.inv(bound) * units[:, None] * units, basis)
    rng, margin = np.random.default_rng(0), _MARGIN * slowness(claim)
    chosen, P = [], np.asarray(np.linalg.inv(bound))
    for number, part in enumerate(parts):
        count = int(np.prod(part.shell.shape))
        earlier = {k for k in active.get(number, ()) if k < count}
        chosen.append(earlier or set(rng.integers(count, size=_TIGHT).tolist()))
    for _ in range(_ROUNDS):
        own = [
            _decay(part.shell, some, P, claim.rate + margin, part.growth, part.low, units, basis)
            for part, some in zip(parts, chosen, strict=True)
        ]
        decay = (np.concatenate([one[0] for one in own]), np.concatenate([one[1] for one in own]))
        x = minimise(cost, [decay, *fixed], tolerance=1e-7)
        if x is None:
            return None
        P = np.einsum("k,kij->ij", x[:-1], basis) / (units[:, None] * units)
        if np.linalg.eigvalsh(P * units[:, None] * units)[0] <= 0:
            return None
        fine, stuck, form = True, True, Form(P)
        for part, some in zip(parts, chosen, strict=True):
            losses = part.shell.losses(form, claim.rate, part.growth, part.growth * part.low)
            bad = np.flatnonzero(indefinite(losses, -margin / 2))
            if len(bad):
                fine = False
                bad = bad if len(bad) <= 600 else rng.choice(bad, size=600, replace=False)
                more = set(bad[np.argsort(-excess_of(losses, bad))[:_CUTS]].tolist())
                stuck = stuck and more <= some  # `losses` weighs the disturbances by V
                some |= more
        if fine or stuck:
            return np.asarray(P), _remember(P, parts, chosen, active)
    return None


def _sizes(claim: TurningClaim) -> Array:
    """Return the typical size of each state, divided by its size for the usual gains and cruise speed."""
    k1, ahead, v = np.array([claim.gains["k1"], claim.gains["lookahead"], claim.cruise]) / _USUAL
    return np.array([v / k1, ahead, v, v])


def _basis(claim: TurningClaim) -> Array:
    """Return a basis (k, n, n) of the matrices of V: the last one is |E|², with thrust lag or held commands."""
    size = 4 + 2 * claim.late_parts
    entries = _ENTRIES + (_OF_THRUST if claim.lag else ())
    basis = np.zeros((len(entries) + (claim.period > 0), size, size))
    for k, (i, j) in enumerate(entries):
        basis[k, i, j] = basis[k, j, i] = 1
    if claim.period:
        basis[-1, (-2, -1), (-2, -1)] = 1
    return basis


def _extents(extent: Array, basis: Array) -> list[Inequality]:
    """Return [P e; eᵀ extent²] ⪰ 0 for each unit vector e of the first four states."""
    corner, wide = np.zeros((4, 5, 5)), np.zeros((4, len(basis) + 1, 5, 5))
    corner[:, :4, 4] = corner[:, 4, :4] = np.eye(4)
    corner[:, 4, 4] = extent**2
    wide[:, :-1, :4, :4] = basis[:, :4, :4]
    return [(corner, wide)]


def _within(least: Array, basis: Array) -> list[Inequality]:
    """Return P ⪰ `least` (n, n): the region lies in the ellipsoid ξᵀ least ξ ≤ 1."""
    wide = np.zeros((1, len(basis) + 1, *least.shape))
    wide[0, :-1] = basis
    return [(-least[None], wide)]


def _starts(claim: TurningClaim, cruise: Cruise, units: Array, basis: Array) -> list[Inequality]:
    """Return x_k ≥ zᵀ P z for the deviation z along the path at the start, for each ω."""
    starts = [one / units for one in _deviations(claim, cruise)]
    rows = [np.append(-np.einsum("i,kij,j->k", z, basis[:, :4, :4], z), 1.0)[:, None, None] for z in starts]
    return [(np.zeros((len(rows), 1, 1)), np.array(rows))]


def _deviations(claim: TurningClaim, cruise: Cruise) -> list[Array]:
    """Return the deviations (4,) at the starts on the path, for each ω."""
    jumps = claim.jumps or ((0.0, -claim.cruise if claim.rest else 0.0, 0.0),)
    pairs = product(sorted(set(cruise.moved)), jumps)
    return [np.array([omega / claim.gains["k1"] + x, 0.0, u, w]) for omega, (x, u, w) in pairs]


def _decay(
    shell: Inclusion, some: set[int], P: Array, rate: float, growth: float, low: float, units: Array, basis: Array
) -> Inequality:
    """Return −(Aᵀ P + P A + (a + η) P + P W P/(η low)) ⪰ 0 with a margin, by its Schur complement.

    The disturbances are weighted as with the given P.
    """
    A, factor, weights = selected(shell, sorted(some), P)
    count, n, inner = len(basis), len(units), factor.shape[2]
    half = np.einsum("kij,njl->nkil", basis, A * units / units[:, None])
    whole = np.zeros((len(A), count + 1, n + inner, n + inner))
    whole[:, :-1, :n, :n] = -(half + half.swapaxes(-1, -2) + (rate + growth + _LOOSE * shell.loose) * basis)
    for k in range(4):  # the last entry of V is in units of |ε|²
        whole[:, count - 1, k, k] -= weights[:, k] * (units[k] / units[-1]) ** 2
    scale = (growth * low) ** 0.25  # both blocks of the complement are of similar size
    side = np.einsum("kij,njl->nkil", basis, factor / (scale * units[:, None]))
    whole[:, :-1, :n, n:], whole[:, :-1, n:, :n] = side, side.swapaxes(-1, -2)
    constant = np.zeros((len(A), n + inner, n + inner))
    constant[:] = np.diag([-1e-5] * n + [scale**2] * inner)
    return constant, whole


def _remember(P: Array, parts: list[_Part], chosen: list[set[int]], active: _Active) -> Array:
    """Store the vertices whose inequality is nearly tight for the next program, and return the best growths for P."""
    worst: dict[int, Array] = {}
    growths: dict[int, Array] = {}
    for k, (part, some) in enumerate(zip(parts, chosen, strict=True)):
        order, grid = np.array(sorted(some)), part.growth * _FACTORS
        half, effect = transformed(P, part.shell, order)
        values = np.linalg.eigvalsh(half + effect / (part.growth * part.low))[:, -1]
        tight = np.argsort(-values)[:_TIGHT]
        active[k] = set(order[tight].tolist())
        bound = np.linalg.eigvalsh(half[tight] + effect[tight] / (part.low * grid[:, None, None, None]))[..., -1]
        worst[part.number] = np.maximum(worst.get(part.number, -np.inf), bound.max(axis=1) + grid)
        growths[part.number] = grid
    return np.array([growths[k][int(np.argmin(worst[k]))] for k in sorted(worst)])


def _first(claim: TurningClaim, away: float, rng: np.random.Generator, k: int, *, smaller: int) -> tuple[_Start, Array]:
    """Return the start values number k and the extent (4,) of the region."""
    along, beside, fast, _ = _sizes(claim)
    speed = claim.cruise * (_REST if claim.rest else 1)
    start = _FIRST[k % len(_FIRST)] * (along, beside, speed, fast / beside, 1, 1, beside)
    start = start * np.exp(rng.normal(scale=_SPREAD) * (k >= len(_FIRST)))
    start[0] += away
    if claim.jumps:
        fast = _WIDER * np.abs(claim.jumps).max(axis=0)[1:]
        start[2], start[3], start[6] = fast[0], max(fast[1] / start[1], start[3]), 0.0
    start = start * _SMALLER ** (min(smaller, 2) * (_SMALLER > 1) + smaller * (_SMALLER <= 1))
    levels = np.geomspace(min(start[4], _HIGHEST), 1.0, _SHELLS + 1)
    return _Start(levels, start[5] * levels[1:] ** -0.15, start[6]), start[:4] * (1, 1, 1, start[1])


def turning_search(claim: TurningClaim, *, attempts: int, seed: int = 0) -> Iterator[TurningCandidate]:
    """Yield candidates, the largest region first.

    The size of a region is that of its start beside the path, and also that of its start at rest if the claim asks for
    it. `attempts` is the number of convex programs, or half of it if the first start values yield no V; equal seeds
    give equal candidates.
    """
    fine = steady_turning(claim, cells=_CELLS)
    if claim.lag and claim.period:
        yield from _held(claim, fine, turning_search(replace(claim, period=0.0), attempts=attempts, seed=seed))
        return
    cruise = fine.coarse(_FINE)
    away = max(map(abs, cruise.moved)) / claim.gains["k1"]
    rng = np.random.default_rng(seed)
    active: _Active = {}
    first: list[_Region] = []
    grown: list[_Region] = []
    for smaller in (0, 1, 3, 5):
        left, k = attempts, 0
        while left > 0:
            if first and (len(first) + len(grown) >= _ENOUGH or 4 * (attempts - left) >= attempts):
                first.sort(key=lambda one: one.score)
                region, used = _grown(claim, cruise, first.pop(), left, active)
                grown.append(region)
                left -= used
                continue
            start, extent = _first(claim, away, rng, k, smaller=smaller)
            behind = np.tile(_ERROR * claim.gains["k_v"] * extent[2:], claim.late_parts)
            bound = np.diag(np.append(extent, behind) ** 2)
            improved = _improve(claim, cruise, bound, start, active, extent)
            k, left = k + 1, left - 1
            if improved is not None and (one := _region(claim, cruise, start, *improved)).score > 0:
                first.append(one)
        if grown:
            break
    regions = sorted([*first, *grown], key=lambda one: -one.score)[:_TRIED]
    further = ((one.score, fitted(claim, fine, one.P, float(one.start.growths[-1]))) for one in regions)
    candidates = []
    for score, candidate in further:
        if candidate is not None:
            candidates.append(candidate)
            if _score(claim, candidate) >= score:
                break
    for larger in sorted(candidates, key=lambda one: -_score(claim, one)):
        yield _closer(claim, fine, larger)
        yield larger
    for _, candidate in further:  # the checker accepts none of the others
        if candidate is not None:
            yield candidate


def _held(claim: TurningClaim, fine: Cruise, without: Iterator[TurningCandidate]) -> Iterator[TurningCandidate]:
    """Yield candidates for held commands with lag from those `without` held commands: the shape of V hardly changes."""
    for one in without:
        size, candidates = len(one.P), []
        for weight in _WEIGHTS * np.sqrt(one.P[4, 4] * one.P[5, 5]):
            P = np.diag(np.full(size + 2, weight))
            P[:size, :size] = one.P
            candidate = fitted(claim, fine, P, one.growths[-1])
            if candidate is not None:
                candidates.append(candidate)
        yield from sorted(candidates, key=lambda one: -_score(claim, one))


def _region(claim: TurningClaim, cruise: Cruise, start: _Start, P: Array, growths: Array) -> _Region:
    candidate = TurningCandidate(P, (float(start.levels[0]),), (), (), cruise)
    beside = 0.0 if claim.jumps else _size(claim, candidate) or start.beside
    return _Region(P, replace(start, growths=growths, beside=beside), _score(claim, candidate))


def _grown(claim: TurningClaim, cruise: Cruise, region: _Region, most: int, active: _Active) -> tuple[_Region, int]:
    """Return the region after steps that enlarge it, each by one convex program, and their number, at most `most`.

    Bounds that hold in a multiple of the last region hold in every region inside it.
    """
    growth, used = _GROWTH, 0
    while used < most and growth > _LEAST:
        stretch = np.full(len(region.P), growth ** (1.0 if claim.rest or claim.jumps or claim.behind else _OTHERS))
        stretch[[1, 3]] = growth
        if any(x for x, *_ in claim.jumps):  # what is left of y before a corner is a part of x after it
            stretch[1] = 1.0
        bound = np.linalg.inv(region.P) * stretch[:, None] * stretch
        floor = max(float(region.start.levels[0]) / growth, min(_LOWEST, float(region.start.levels[0])))
        start = replace(region.start, levels=np.geomspace(floor, 1.0, _SHELLS + 1))
        improved = _improve(claim, cruise, bound, start, active)
        used += 1
        larger = None if improved is None else _region(claim, cruise, start, *improved)
        if larger is not None and larger.score > region.score * _GAIN:
            region = larger
        else:
            growth = float(np.sqrt(growth))
    return region, used


def _closer(claim: TurningClaim, fine: Cruise, candidate: TurningCandidate) -> TurningCandidate:
    """Return the candidate after programs that bring the vehicle closer to the path and keep nearly all of its size.

    They add a shell inside or, for jumps of the velocity, make the region narrower.
    """
    size, factor, shrunk = _size(claim, candidate), _LOWER, np.ones(len(candidate.P))
    shrunk[:2] = _NARROWER if claim.jumps else 1.0
    for _ in range(_LOWERED):
        levels, growths = candidate.levels, candidate.growths
        start = _Start(np.array(levels), np.array(growths), 0.0)
        if not claim.jumps:
            if _remains(candidate) < _CLOSE * size:
                break
            start = _Start(np.array([factor * levels[0], *levels]), np.array([growths[0], *growths]), size)
        bound = np.linalg.inv(candidate.P) * shrunk[:, None] * shrunk
        improved = _improve(claim, fine, bound, start, {})
        other = None if improved is None else fitted(claim, fine, improved[0], growths[-1])
        if other is not None and _size(claim, other) >= _SAME * size and _remains(other) < _remains(candidate):
            candidate = other
        elif claim.jumps:
            break
        else:
            factor = np.sqrt(factor)
    return candidate


def _remains(candidate: TurningCandidate) -> float:
    """Return how close to the path the vehicle settles [m]."""
    return float(np.sqrt(np.linalg.inv(candidate.P)[1, 1] * candidate.levels[0])) + candidate.cruise.beside


def _score(claim: TurningClaim, candidate: TurningCandidate) -> float:
    return _size(claim, candidate) * (1 - _PRICE * max(candidate.levels[0] - _FREE, 0.0))


def _size(claim: TurningClaim, candidate: TurningCandidate) -> float:
    if claim.jumps:
        return float(max(z @ candidate.P[:4, :4] @ z for z in _deviations(claim, candidate.cruise)) ** -0.5)
    start = candidate.start(claim, 0.0)
    return min(start, 1.25 * candidate.start(claim, -claim.cruise)) if claim.rest else start
