"""Search for V = ξᵀPξ, alternating between linear matrix inequalities for P and for the multipliers at fixed P.

M is the matrix of the inequality M ⪯ 0 that shows the decay of V in one shell. λ_j is the multiplier of the uncertain
input w_j (defined in `surctl.certcheck.region_inclusion`), and ρ the weight of the terms for commands that are held
constant over a control period.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surctl.marine.verification.region.claim import RegionClaim
from surctl.marine.verification.region.loop import (
    Bounds,
    Gains,
    Loop,
    Steady,
    bounds,
    force_gain,
    gains_of,
    loops,
)
from surctl.verification.conic import Inequality, minimise, symmetric_basis

__all__ = [
    "Candidate",
    "Proposal",
    "Start",
    "finished",
    "levels_of",
    "multipliers_of",
    "proposed",
    "synthesise",
    "widened",
]

Array = NDArray[np.float64]

_WINDS = (1, 2, 3, 5, 6)
_SPLIT, _TURN_SPLIT = 1 / 3, 1 / 5  # the checker's weights for squares of sums
_GROWTH = 0.4  # [1/s] largest part of the decay rate that disturbances use up
_SPREAD = 1e-3  # weight of the entries of P other than P_yy
_FREE = 3  # number of free multipliers, those of w_1, w_2, w_3; those of w_5, w_6 follow from P


@dataclass(frozen=True)
class Start:
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


def levels_of(floor: float, count: int) -> tuple[float, ...]:
    """Return levels from the floor to 1 in a geometric sequence."""
    return tuple(float(f"{level:.6g}") for level in np.geomspace(floor, 1.0, count + 1))


def structured(at: Bounds, loop: Loop) -> dict[int, Array]:
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


def held(claim: RegionClaim, at: Bounds, loop: Loop) -> Array:
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


def multipliers_of(claim: RegionClaim, at: Bounds, P: Array, hold: float) -> tuple[Array, float] | None:
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
        derivatives = structured(at, loop)
        derivatives[5] = derivatives[5] + at.held**2 * inner
        derivatives[6] = derivatives[6] + at.disturbance**2 * inner
        parts = [derivatives[j] for j in _WINDS] + [inner]
        pair = matrices.setdefault(total, ([], []))
        pair[0].append(-change.T @ (lyapunov(loop, P, claim.rate) + hold * held(claim, at, loop)) @ change)
        pair[1].append(np.array([-change.T @ part @ change for part in parts]))
    positive: Inequality = (np.zeros((5, 1, 1)), np.eye(6)[:5, :, None, None])
    bounded: Inequality = (np.full((5, 1, 1), 1e6), -np.eye(6)[:5, :, None, None])
    x = minimise(-np.eye(6)[5], [*((np.array(a), np.array(b)) for a, b in matrices.values()), positive, bounded])
    return None if x is None else (np.maximum(x[:5], 0), float(x[5]))


def shape(
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
            derivatives = structured(at, loop)
            total = len(loop.A) + loop.B.shape[1]
            slopes = np.zeros((unknowns, total, total))
            rate = claim.rate + growth[k].sum()
            slopes[:count] = -lyapunov(loop, basis, rate)
            for j in range(_FREE):
                slopes[count + _FREE * k + j] = -derivatives[_WINDS[j]]
            slopes[-1] = -held(claim, at, loop)
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


def synthesise(
    claim: RegionClaim, steady: Steady, start: Start, *, shells: int = 5, rounds: int = 3, spread: float = _SPREAD
) -> Candidate | None:
    """Return a candidate that the checker should accept; None if the search from `start` fails."""
    levels, gains = levels_of(start.floor, shells), _first_gains(claim, start)
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


def proposed(claim: RegionClaim, steady: Steady, start: Start, *, shells: int) -> Proposal | None:
    """Return P and ρ after the first half of a `synthesise` round: they give the offset at a third of the time."""
    levels, gains = levels_of(start.floor, shells), _first_gains(claim, start)
    shaped = _shaped(claim, steady, gains, levels, np.full((shells, 2), start.growth), _SPREAD)
    return None if shaped is None else Proposal(*shaped, gains, levels)


def finished(claim: RegionClaim, steady: Steady, proposal: Proposal) -> Candidate | None:
    """Return the candidate for a proposal (second half of a round); None if a shell has no valid multipliers."""
    return _finished(claim, steady, proposal.P, proposal.hold, proposal.gains, proposal.levels)[0]


def _first_gains(claim: RegionClaim, start: Start) -> Gains:
    velocity_gain = claim.model[0] * claim.gains["k_v"]
    return Gains(start.x, start.y, start.velocity, 0.2, 0.3 * velocity_gain, 0.3 * velocity_gain, start.share)


def _shaped(
    claim: RegionClaim, steady: Steady, gains: Gains, levels: tuple[float, ...], growth: Array, spread: float
) -> tuple[Array, float] | None:
    shells = [bounds(claim, steady, gains, low, high) for low, high in pairwise(levels)]
    known = [one for one in shells if one is not None]
    if len(known) < len(shells):
        return None
    return shape(claim, steady, gains, known, growth, spread=spread)


def widened(claim: RegionClaim, steady: Steady, P: Array, levels: tuple[float, ...]) -> Candidate | None:
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
        result = multipliers_of(claim, at, P, hold)
        if result is None:
            return None, fitted, None
        factor, left = result
        fine = fine and left > 1e-6
        factors.append(factor)
        growth.append([max(factor[3] * at.held**2, 1e-3), max(factor[4] * at.disturbance**2, 1e-3)])
    return Candidate(P, levels, np.array(factors), hold) if fine else None, fitted, np.array(growth)
