"""Search for V of a straight cruise: linear matrix inequalities for P, then for the multipliers at fixed P.

M is the matrix of the inequality M ⪯ 0 that shows the decay of V in one shell. λ_j is the multiplier of the uncertain
input w_j (defined in `surctl.certcheck.region_inclusion`), and ρ the weight of the terms for commands that are held
constant over a control period.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice, pairwise, product

import numpy as np
from numpy.typing import NDArray

from surctl.marine.verification.region.claim import RegionClaim
from surctl.marine.verification.region.loop import Bounds, Gains, Loop, Steady, bounds, force_gain, gains_of, loops
from surctl.verification.conic import Inequality, minimise, symmetric_basis

Array = NDArray[np.float64]

_WINDS = (1, 2, 3, 5, 6)
_SPLIT, _TURN_SPLIT = 1 / 3, 1 / 5  # the checker's weights for squares of sums
_GROWTH = 0.4  # [1/s] largest part of the decay rate that disturbances use up
_SPREAD = 1e-3  # weight of the entries of P other than P_yy
_FREE = 3  # number of free multipliers, those of w_1, w_2, w_3; those of w_5, w_6 follow from P


@dataclass(frozen=True)
class _Start:
    """Start values of the synthesis for the region V ≤ 1.

    `x` and `y` are the largest |x| and |y| [m], `share` is the least thrust share φ, `floor` the level of the innermost
    shell, `growth` the part of the decay rate that the uncertain input w_5 uses up, and `velocity` the largest velocity
    deviation [m/s].
    """

    x: float
    y: float
    share: float
    floor: float
    growth: float
    velocity: float = 0.2


@dataclass(frozen=True)
class Candidate:
    """A proof before its check: P (n, n), levels (k + 1,) of V from floor to 1, multipliers (k, 5), weight ρ."""

    P: Array
    levels: tuple[float, ...]
    multipliers: Array
    hold: float

    @property
    def offset(self) -> float:
        """Return the largest |y_e| [m] in the region V ≤ 1 if all other deviations are 0."""
        return float(1 / np.sqrt(self.P[1, 1]))


@dataclass(frozen=True)
class Proposal:
    """P (n, n) and ρ that satisfy the first matrix inequalities; the multipliers of the shells are not yet computed."""

    P: Array
    hold: float
    gains: Gains
    levels: tuple[float, ...]

    @property
    def offset(self) -> float:
        """Return the largest |y_e| [m] in the region V ≤ 1 if all other deviations are 0, as `Candidate` does."""
        return float(1 / np.sqrt(self.P[1, 1]))


def _levels_of(floor: float, count: int) -> tuple[float, ...]:
    """Return levels from the floor to 1 in a geometric sequence."""
    return tuple(float(f"{level:.6g}") for level in np.geomspace(floor, 1.0, count + 1))


def _structured(at: Bounds, loop: Loop) -> dict[int, Array]:
    """Return the derivatives ∂M/∂λ_j (N, N) for j = 1, 2, 3, 5 and 6; for j = 5 and 6 the term in P is omitted."""
    size, total, q = len(loop.A), len(loop.A) + loop.B.shape[1], len(loop.desired)
    start = {j: size + q * k for k, j in enumerate(loop.wind)}
    derivatives = {}
    for j in _WINDS:
        slope = np.zeros((total, total))
        if j in start:
            slope[start[j] : start[j] + q, start[j] : start[j] + q] = -np.eye(q)
            if j == 2:
                whole = np.zeros((q, total))
                whole[:, :size] = loop.force
                whole[:, start[1] : start[1] + q] = np.eye(q)
                slope += ((1 - at.share) / 2) ** 2 * whole.T @ whole
            elif j in (1, 3):
                low, high = at.model_drag if j == 1 else at.drag
                rows = loop.desired if j == 1 else loop.speed
                slope[:size, :size] += ((high - low) / 2) ** 2 * rows.T @ rows
        derivatives[j] = slope
    return derivatives


def _held(claim: RegionClaim, at: Bounds, loop: Loop) -> Array:
    """Return the derivative ∂M/∂ρ (N, N) with respect to the weight ρ of held commands.

    M contains ρ in two terms: h |ḟ|², where h is the control period and ḟ the rate of the commanded force, and the
    bound on |w_4|².
    """
    size, total, q = len(loop.A), len(loop.A) + loop.B.shape[1], len(loop.desired)
    slope = np.zeros((total, total))
    if 4 not in loop.wind:
        return slope
    start = {j: size + q * k for k, j in enumerate(loop.wind)}
    h, turn, velocity_gain = claim.period, claim.yaw_rate * claim.period, claim.model[0] * claim.gains["k_v"]
    slope += h * (1 + _SPLIT) * velocity_gain**2 * loop.braking.T @ loop.braking
    slope[:size, :size] += h * (1 + 1 / _SPLIT) * at.desired_rate**2 * loop.speed.T @ loop.speed
    owed = (1 - h * (claim.rate + _GROWTH)) / (h * (1 + _TURN_SPLIT) * (1 + turn) ** 2)
    whole = np.zeros((q, total))
    whole[:, :size] = loop.force
    whole[:, start[1] : start[1] + q] = np.eye(q)
    slope += owed * (1 + 1 / _TURN_SPLIT) * turn**2 * whole.T @ whole
    slope[start[4] : start[4] + q, start[4] : start[4] + q] -= owed * np.eye(q)
    return slope


def lyapunov(loop: Loop, P: Array, growth: float) -> Array:
    """Return the matrix [[AᵀP + PA + growth P, PB], [BᵀP, 0]] (…, N, N) for P (…, n, n)."""
    P = P[..., loop.states[:, None], loop.states]
    half, side = P @ loop.A, P @ loop.B
    size, total = len(loop.A), len(loop.A) + loop.B.shape[1]
    whole = np.zeros((*P.shape[:-2], total, total))
    whole[..., :size, :size] = half + half.swapaxes(-1, -2) + growth * P
    whole[..., :size, size:], whole[..., size:, :size] = side, side.swapaxes(-1, -2)
    return whole


def _multipliers_of(claim: RegionClaim, at: Bounds, P: Array, hold: float) -> tuple[Array, float] | None:
    """Return the multipliers λ (5,) of a shell with the largest reserve in the decay rate, and this reserve [1/s].

    The inequalities are scaled so that P becomes the identity. The result is None if the solver finds no solution.
    """
    matrices: dict[int, tuple[list[Array], list[Array]]] = {}
    for loop in loops(claim, at):
        size, total = len(loop.A), len(loop.A) + loop.B.shape[1]
        own = P[np.ix_(loop.states, loop.states)]
        change, inner = np.eye(total), np.zeros((total, total))
        change[:size, :size] = np.linalg.inv(np.linalg.cholesky(own)).T  # changeᵀ P change = I
        inner[:size, :size] = own
        derivatives = _structured(at, loop)
        derivatives[5] = derivatives[5] + at.held**2 * inner
        derivatives[6] = derivatives[6] + at.disturbance**2 * inner
        parts = [derivatives[j] for j in _WINDS] + [inner]
        pair = matrices.setdefault(total, ([], []))
        pair[0].append(-change.T @ (lyapunov(loop, P, claim.rate) + hold * _held(claim, at, loop)) @ change)
        pair[1].append(np.array([-change.T @ part @ change for part in parts]))
    positive: Inequality = (np.zeros((5, 1, 1)), np.eye(6)[:5, :, None, None])
    bounded: Inequality = (np.full((5, 1, 1), 1e6), -np.eye(6)[:5, :, None, None])
    x = minimise(-np.eye(6)[5], [*((np.array(a), np.array(b)) for a, b in matrices.values()), positive, bounded])
    return None if x is None else (np.maximum(x[:5], 0), float(x[5]))


def _shape(
    claim: RegionClaim, steady: Steady, gains: Gains, shells: list[Bounds], growth: Array, *, spread: float
) -> tuple[Array, float] | None:
    """Return P with the least entry P_yy, and the weight ρ; None if the inequalities have no solution.

    `growth` (k, 2) holds the parts of the decay rate that the inputs w_5 and w_6 use up in each shell.
    """
    basis = symmetric_basis(claim.size)
    # averaging P with its mirror image loses nothing, so entries between x and y are not needed
    basis = basis[[not np.any(one[::2, 1::2]) for one in basis]]
    count = len(basis)
    unknowns = count + _FREE * len(shells) + 1
    matrices: dict[int, tuple[list[Array], list[Array]]] = {}
    for k, at in enumerate(shells):
        for loop in loops(claim, at):
            derivatives = _structured(at, loop)
            total = len(loop.A) + loop.B.shape[1]
            slopes = np.zeros((unknowns, total, total))
            rate = claim.rate + growth[k].sum()
            slopes[:count] = -lyapunov(loop, basis, rate)
            for j in range(_FREE):
                slopes[count + _FREE * k + j] = -derivatives[_WINDS[j]]
            slopes[-1] = -_held(claim, at, loop)
            fixed = growth[k, 0] / at.held**2 * derivatives[5]
            if 6 in loop.wind:
                fixed = fixed + growth[k, 1] / at.disturbance**2 * derivatives[6]
            pair = matrices.setdefault(total, ([], []))
            pair[0].append(-fixed)
            pair[1].append(slopes)
    inequalities: list[Inequality] = [(np.array(a), np.array(b)) for a, b in matrices.values()]
    limited = _rows(claim, steady, gains, shells[-1])
    for rows in ([row[None] for row in limited], _pairs_of(claim, gains, shells[-1])):
        slopes = np.zeros((len(rows), unknowns, claim.size, claim.size))
        slopes[:, :count] = basis
        inequalities.append((-np.array([row.T @ row for row in rows]), slopes))
    last = np.eye(unknowns)[-1:, :, None, None]
    inequalities.append((np.zeros((1, 1, 1)), last))
    cost = np.zeros(unknowns)
    weight = spread * np.eye(claim.size)
    weight[1, 1] += 1
    cost[:count] = np.einsum("kij,ij->k", basis, weight)
    x = minimise(cost, inequalities)
    return None if x is None else (np.einsum("k,kij->ij", x[:count], basis), float(x[-1]))


def _rows(claim: RegionClaim, steady: Steady, gains: Gains, at: Bounds) -> list[Array]:
    """Return row vectors c; the conditions |c ξ| ≤ 1 on V ≤ 1 bound the position and the thrust in every direction."""
    eye, rows = np.eye(claim.size), []
    rows += [eye[0] / gains.x, eye[1] / gains.y]
    for angle in np.linspace(0, np.pi / 2, 9):
        n = np.array([np.cos(angle), np.sin(angle)])
        left = float(claim.thrust - steady.along(*np.abs(n[:, None]))[0]) * 0.99
        for slope in at.model_drag:
            for s in at.steer:
                for k in sorted(set(at.catch)):
                    rows.append(gains.share * (n @ force_gain(claim, slope, s, k, at.aside)[1]) / left)
    return rows


def _pairs_of(claim: RegionClaim, gains: Gains, at: Bounds) -> list[Array]:
    """Return matrices C (2, n); the conditions |C ξ| ≤ 1 on V ≤ 1 bound velocity, commanded velocity and force."""
    eye, middle = np.eye(claim.size), sum(at.model_drag) / 2
    rows = [eye[2:4] / gains.velocity]
    for s in at.steer:
        for k in sorted(set(at.catch)):
            desired, force = force_gain(claim, middle, s, k, at.aside)
            rows += [desired / gains.desired, force / gains.command]
    if claim.size == 6:
        rows.append(eye[4:6] / gains.thrust)
    return rows


def _synthesise(
    claim: RegionClaim, steady: Steady, start: _Start, *, shells: int = 5, rounds: int = 3, spread: float = _SPREAD
) -> Candidate | None:
    """Return a candidate that the checker should accept; None if the search from `start` fails."""
    levels, gains = _levels_of(start.floor, shells), _first_gains(claim, start)
    growth = np.full((shells, 2), start.growth)
    best: Candidate | None = None
    for _ in range(rounds):
        shaped = _shaped(claim, steady, gains, levels, growth, spread)
        if shaped is None:
            return best
        candidate, fitted, fitted_growth = _finished(claim, steady, *shaped, gains, levels)
        if candidate is not None and (best is None or candidate.offset > best.offset):
            best = candidate
        gains = replace(
            fitted, x=gains.x, y=gains.y, share=gains.share,
            velocity=1.03 * fitted.velocity, desired=1.03 * fitted.desired, command=1.03 * fitted.command,
            thrust=1.03 * fitted.thrust,
        )  # fmt: skip
        if fitted_growth is not None:
            growth = fitted_growth
    return best


def _proposed(claim: RegionClaim, steady: Steady, start: _Start, *, shells: int) -> Proposal | None:
    """Return P and ρ after the first half of a `_synthesise` round: they give the offset at a third of the time."""
    levels, gains = _levels_of(start.floor, shells), _first_gains(claim, start)
    shaped = _shaped(claim, steady, gains, levels, np.full((shells, 2), start.growth), _SPREAD)
    return None if shaped is None else Proposal(*shaped, gains, levels)


def finished(claim: RegionClaim, steady: Steady, proposal: Proposal) -> Candidate | None:
    """Return the candidate for a proposal (second half of a round); None if a shell has no valid multipliers."""
    return _finished(claim, steady, proposal.P, proposal.hold, proposal.gains, proposal.levels)[0]


def _first_gains(claim: RegionClaim, start: _Start) -> Gains:
    velocity_gain = claim.model[0] * claim.gains["k_v"]
    return Gains(start.x, start.y, start.velocity, 0.2, 0.3 * velocity_gain, 0.3 * velocity_gain, start.share)


def _shaped(
    claim: RegionClaim, steady: Steady, gains: Gains, levels: tuple[float, ...], growth: Array, spread: float
) -> tuple[Array, float] | None:
    shells = [bounds(claim, steady, gains, low, high) for low, high in pairwise(levels)]
    known = [one for one in shells if one is not None]
    if len(known) < len(shells):
        return None
    return _shape(claim, steady, gains, known, growth, spread=spread)


def _widened(claim: RegionClaim, steady: Steady, P: Array, levels: tuple[float, ...]) -> Candidate | None:
    """Return the candidate for P and levels in continuous time; None if a shell has no valid multipliers."""
    extent = np.sqrt(np.diag(np.linalg.inv(P)))
    velocity_gain = claim.model[0] * claim.gains["k_v"]
    gains = Gains(
        extent[0], extent[1], float(np.hypot(*extent[2:4])), claim.cap, 0.5 * velocity_gain, 0.5 * velocity_gain, 0.5
    )
    if bounds(claim, steady, gains, levels[-2], levels[-1]) is None:
        return None
    return _finished(claim, steady, P, 0.0, gains, levels)[0]


def _finished(
    claim: RegionClaim, steady: Steady, P: Array, hold: float, gains: Gains, levels: tuple[float, ...]
) -> tuple[Candidate | None, Gains, Array | None]:
    """Return the candidate, its largest norms, and the parts of the decay rate that the inputs w_5 and w_6 use up.

    The candidate is None if a shell has no valid multipliers.
    """
    outer = bounds(claim, steady, gains, levels[-2], levels[-1])
    assert outer is not None
    fitted = gains_of(claim, steady, P, outer)
    factors, growth, fine = [], [], True
    for low, high in pairwise(levels):
        at = bounds(claim, steady, fitted, low, high)
        if at is None:
            return None, fitted, None
        result = _multipliers_of(claim, at, P, hold)
        if result is None:
            return None, fitted, None
        factor, left = result
        fine = fine and left > 1e-6
        factors.append(factor)
        growth.append([max(factor[3] * at.held**2, 1e-3), max(factor[4] * at.disturbance**2, 1e-3)])
    return Candidate(P, levels, np.array(factors), hold) if fine else None, fitted, np.array(growth)


_STARTS = tuple(product((0.5, 1.0, 0.3), (0.02, 0.06), (0.28, 0.15, 0.08), (0.1, 0.3, 0.7)))
_COARSE, _FINE = 2, 6  # number of shells in a coarse and in a fine proof
_INVARIANT_FLOOR = 0.95  # floor of a region that is invariant but has almost no decay


def search(claim: RegionClaim, steady: Steady, *, attempts: int, seed: int) -> Iterator[Candidate]:
    """Yield candidates from `attempts` start values, the largest region first; equal seeds give equal candidates.

    In a current, the candidate that keeps the vehicle closest to the path comes first; `attempts` and `seed` then have
    no effect.
    """
    if claim.current:
        yield from _holding(claim, steady)
        return
    candidates: list[Candidate] = []
    passed_over: list[Proposal] = []
    draw = np.random.default_rng(seed)
    cruise, cap, ahead = claim.cruise, claim.cap, claim.gains["lookahead"]
    wide = ahead * np.sqrt(max((cap / (cruise + steady.omega[1])) ** 2 - 1, 1e-6))
    best: tuple[float, _Start] | None = None
    refining = False

    def attempt(start: _Start) -> None:
        nonlocal best
        proposal = _proposed(claim, steady, start, shells=_COARSE)
        if proposal is None:
            return
        if refining and best is not None and proposal.offset <= best[0]:
            passed_over.append(proposal)  # it cannot be the best candidate: find its multipliers only if needed
            return
        candidate = finished(claim, steady, proposal)
        if candidate is None:
            return
        candidates.append(candidate)
        if best is None or candidate.offset > best[0]:
            best = candidate.offset, start

    for share, growth, far, floor in _STARTS:  # infeasible starts fail early
        attempt(_Start(far * cruise / claim.gains["k1"], 0.46 * wide, share, floor, growth))
        if len(candidates) >= max(attempts // 3, 1):
            break
    refining = True
    for _ in range(attempts - len(candidates)):
        if best is None:
            break
        base = best[1]
        factors = np.exp(draw.normal(scale=(0.2, 0.15, 0.15, 0.3, 0.3)))
        attempt(
            replace(
                base,
                x=base.x * factors[0],
                y=min(base.y * factors[1], 0.98 * wide),
                share=min(base.share * factors[2], 1.0),
                floor=min(base.floor * factors[3], 0.8),
                growth=base.growth * factors[4],
            )
        )
    if best is not None:
        for share in (8, 4, 2, 1):  # a lower floor ends nearer to the path, for a slightly smaller offset
            fine = _synthesise(claim, steady, replace(best[1], floor=best[1].floor / share), shells=_FINE, rounds=4)
            if fine is not None and fine.offset > 0.95 * best[0]:
                yield fine
    yield from islice(_largest(claim, steady, [*candidates, *passed_over]), 5)


def _largest(claim: RegionClaim, steady: Steady, candidates: list[Candidate | Proposal]) -> Iterator[Candidate]:
    for one in sorted(candidates, key=lambda one: -one.offset):
        candidate = finished(claim, steady, one) if isinstance(one, Proposal) else one
        if candidate is not None:
            yield candidate


def _holding(claim: RegionClaim, steady: Steady) -> Iterator[Candidate]:
    """Yield regions that keep the vehicle close to the path in a current, in order of rising distance.

    The function first computes the matrix P of the smallest invariant region, which is a few times as large as the
    static deflection by the force error. Then the function tries larger regions with this P.
    """
    velocity_gain = claim.model[0] * claim.gains["k_v"]
    x, y = (
        steady.total / (velocity_gain * claim.gains["k1"]),
        steady.total * claim.gains["lookahead"] / (velocity_gain * claim.cruise),
    )
    regions: list[tuple[float, Candidate]] = []
    for wide, far, growth in product((2.0, 2.3, 2.8), (2.3, 2.6, 3.0), (0.08, 0.1)):
        close = _synthesise(
            claim, steady, _Start(far * x, wide * y, 1.0, _INVARIANT_FLOOR, growth, 0.05), shells=1, rounds=2
        )
        if close is None:
            continue
        along, across = np.sqrt(np.diag(np.linalg.inv(close.P))[:2] * _INVARIANT_FLOOR)
        away = max(map(abs, steady.omega)) / claim.gains["k1"]
        extent = np.ceil(100 * max(along + away, across + steady.aside))  # of extents in the same cm, the widest region
        for level in (2.0, 3.0, 4.0, 6.0, 9.0):
            wider = _widened(claim, steady, close.P / level, _levels_of(_INVARIANT_FLOOR / level, _FINE))
            if wider is None:
                break
            regions.append((float(extent - wider.offset), wider))
    yield from (one for _, one in sorted(regions, key=lambda pair: pair[0]))
