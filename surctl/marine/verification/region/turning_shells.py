"""Shells of V of a turning cruise: the decay rate in a shell, its best growth η, the shells of a P, the certificate.

All of it is in floating point, and a candidate is only a proposal to the checker. Its certificate has few decimals, and
its stated numbers are rounded to the safe side.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import seal
from surctl.certcheck.turning_claim import axis_pairs
from surctl.certcheck.turning_form import Form
from surctl.certcheck.turning_matrix import Entries, Inclusion, indefinite
from surctl.certcheck.turning_terms import other_moment
from surctl.marine.verification.region.turning import TurningClaim
from surctl.marine.verification.region.turning_loop import Cruise, selected, split_of, vertices

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]

_RATIO, _THIN = 0.82, 0.95  # of the two levels of the outermost shell
_THICKEST, _THINNEST = 0.4, 0.96  # ratios of the two levels of a shell
_MOST = 20  # largest number of shells
_MARGIN = 0.002  # [1/s] reserve of the decay rate: the cells of the checker have other edges than those of the search
_LEVELS = (1.0, 0.7, 0.5, 0.35, 0.25)  # levels of V that the search tries first
_WIDEST, _STEPS = 1.5, 6  # a region is enlarged up to this multiple of its level, which is bisected
_SOME = 150  # number of matrices whose eigenvalues are compared at a time
_LEAST_GROWTH, _LARGEST_GROWTH = 3e-3, 4.0  # [1/s]


@dataclass(frozen=True)
class TurningCandidate:
    """A candidate of a proof, which is not yet checked.

    Attributes:
        P: matrix (n, n) of the Lyapunov function V = zᵀ P z; n is 6 with thrust lag or held commands, and 4 without.
        levels: levels of V that divide the region into k shells, in ascending order; the last is 1.
        growths: for each of the k shells, the coefficient η [1/s] in the condition on the decay rate.
        rates: the decay rate in each of the k shells [1/s].
        cruise: the steady motion on the path.
    """

    P: Array
    levels: tuple[float, ...]
    growths: tuple[float, ...]
    rates: tuple[float, ...]
    cruise: Cruise

    def start(self, claim: TurningClaim, speed: float) -> float:
        """Return the largest |y_e| [m] in the region at x_e = 0 with the speed U_x − v = `speed` [m/s]; 0 if none."""
        left = 1.0
        for omega in self.cruise.moved:
            z = np.array([omega / claim.gains["k1"], speed])
            left = min(left, 1 - float(z @ self.P[np.ix_((0, 2), (0, 2))] @ z))
        return max(float(np.sqrt(max(left, 0.0) / self.P[1, 1])) - self.cruise.beside, 0.0)


def slowness(claim: TurningClaim) -> float:
    """Return the factor of the reserves of the decay rate, which fall with the cruise speed below 0.1 m/s."""
    return min(claim.cruise / 0.1, 1.0)


def excess_of(losses: Entries, chosen: Numbers | Sequence[int]) -> Array:
    """Return the largest eigenvalue of minus each of some matrices (k,)."""
    size = max(i for i, _ in losses) + 1
    matrices = np.empty((len(chosen), size, size))
    for (i, j), entry in losses.items():
        matrices[:, i, j] = matrices[:, j, i] = -entry.reshape(-1)[chosen]
    return np.asarray(np.linalg.eigvalsh(matrices)[:, -1])


def worst_rate(losses: Entries, first: Numbers) -> tuple[float, Numbers]:
    """Return the largest eigenvalue of minus all matrices, and numbers of large ones; `first` is where to look."""
    rng = np.random.default_rng(0)
    known: Numbers = first if len(first) else rng.integers(losses[0, 0].size, size=_SOME)
    values = excess_of(losses, known)
    while True:
        best = float(values.max())
        more = np.flatnonzero(indefinite(losses, best + 1e-9))
        if not len(more):
            order = np.argsort(-values)[:_SOME]
            return best, known[order]
        if len(more) > _SOME:
            more = rng.choice(more, size=_SOME, replace=False)
        known, values = np.concatenate([known, more]), np.concatenate([values, excess_of(losses, more)])


def transformed(P: Array, at: Inclusion, chosen: Numbers | list[int]) -> tuple[Array, Array]:
    """Return T (Aᵀ P + P A) Tᵀ and T P W P Tᵀ (k, n, n) of the vertices with the numbers (k,), where T P Tᵀ = I."""
    A, factor, weights = selected(at, chosen, P)
    change = np.linalg.inv(np.linalg.cholesky(P))
    half, side = (change @ P) @ A @ change.T, (change @ P) @ factor
    half = half + half.swapaxes(-1, -2)
    if len(P) > 4:
        half = half + P[-1, -1] * (change[:, :4] * weights[:, None]) @ change[:, :4].T
    return half, side @ side.swapaxes(-1, -2)


def _best_growth(P: Array, phases: list[Inclusion], rate: float, low: float, guess: float) -> tuple[float, float]:
    """Return the growth η [1/s] that nearly minimises the largest eigenvalue at the vertices, and this eigenvalue.

    `phases` are the vertices of each form that decides. The matrices that matter at one η are those that matter close
    to it, so few of them are searched.
    """
    growth, known, form = guess, [np.zeros(0, dtype=np.intp) for _ in phases], Form(P)
    best = (growth, np.inf)
    for _ in range(4):
        losses = (at.losses(form, rate, growth, growth * low) for at in phases)
        worst = [worst_rate(one, few) for one, few in zip(losses, known, strict=True)]
        value, known = max(one[0] for one in worst), [one[1] for one in worst]
        if value < best[1] - 1e-6:
            best = (growth, value)
        elif np.isfinite(best[1]):
            break
        pairs = [transformed(P, at, few[:60]) for at, few in zip(phases, known, strict=True)]
        half, effect = (np.concatenate(part) for part in zip(*pairs, strict=True))
        effect = effect / low
        grid = np.unique(np.clip(growth * np.geomspace(0.4, 2.5, 25), _LEAST_GROWTH, _LARGEST_GROWTH))
        rates = np.linalg.eigvalsh(half + effect / grid[:, None, None, None])[..., -1].max(axis=1) + grid
        growth = float(grid[int(np.argmin(rates))])
    return float(f"{best[0]:.4g}"), best[1]


def fitted(claim: TurningClaim, cruise: Cruise, P: Array, guess: float) -> TurningCandidate | None:
    """Return the candidate with the shape P, the largest region and the lowest floor; None if V does not decay.

    Args:
        claim: the claim.
        cruise: its steady cruise.
        P: shape of V; its region may be enlarged or reduced.
        guess: growth of the outermost shell to start from [1/s].
    """
    covariance, margin = np.asarray(np.linalg.inv(P), dtype=np.float64), _MARGIN * slowness(claim)

    def shell(low: float, high: float, growth: float) -> tuple[float, float]:
        at = vertices(claim, cruise, covariance, high)
        return (growth, np.inf) if at is None else _best_growth(P, at, claim.rate, low, growth)

    def holds(high: float) -> bool:
        return shell(high * _RATIO, high, guess)[1] <= -margin

    low = next((level for level in _LEVELS if holds(level)), None)
    if low is None:
        return None
    high = low * _WIDEST
    for _ in range(_STEPS):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    # a region for jumps of the velocity is so large that V hardly decays at its border, but soon faster inside
    top, ratio, growth = low, _THIN if claim.jumps else _RATIO, guess
    levels: list[float] = [1.0]
    growths, rates = list[float](), list[float]()
    while len(growths) < _MOST and ratio < _THINNEST:
        below = levels[-1] * ratio
        growth, value = shell(below * top, levels[-1] * top, growth)
        if value > -margin:
            ratio = np.sqrt(ratio)
            continue
        levels.append(float(f"{below:.6g}"))
        growths.append(growth)
        rates.append(max(float(f"{claim.rate + 0.99 * (-margin - value):.4g}"), claim.rate))
        ratio = max(0.85 * ratio, _THICKEST)
    if not growths:
        return None
    return TurningCandidate(P / top, tuple(levels[::-1]), tuple(growths[::-1]), tuple(rates[::-1]), cruise)


_CELLS, _HELD = 48, 32  # cells of headings; with held commands, each of them is checked twice


def raised(candidate: TurningCandidate) -> Iterator[TurningCandidate]:
    """Yield the candidate, then with a higher floor: between the headings of the search, a low shell may not hold."""
    for inner in range(len(candidate.growths)):
        levels, growths, rates = candidate.levels, candidate.growths, candidate.rates
        yield replace(candidate, levels=levels[inner:], growths=growths[inner:], rates=rates[inner:])


def certificate_of(claim: TurningClaim, candidate: TurningCandidate) -> dict[str, Any]:
    """Return the certificate of a candidate."""
    P = np.array([[float(f"{entry:.9g}") for entry in row] for row in candidate.P])
    rounded, covariance, cruise = replace(candidate, P=P), np.linalg.inv(P), candidate.cruise
    floor = np.sqrt(np.diag(covariance)[:2] * candidate.levels[0]) * 1.0001
    away = max(map(abs, cruise.moved)) / claim.gains["k1"]
    exact = [rounded.start(claim, speed) for speed in (0.0, -claim.cruise)]
    start, still = (float(np.floor(1e4 * value * 0.9999) / 1e4) for value in exact)  # rounded down
    fastest = float(claim.cruise + claim.current + np.sqrt(np.linalg.eigvalsh(covariance[2:4, 2:4])[-1]))
    apart = np.abs(
        np.array(axis_pairs(claim.mass_factor, claim.mass_asymmetry)) @ (claim.mass * np.array([1, -1]))
    ).max()
    moment = apart * fastest**2 / 2 + float(other_moment(claim.stated, Fraction(fastest)))
    stated = claim.document(
        offset=start,
        rest_offset=still if still > 0 else None,
        ultimate_bound=(_up(float(floor[0]) + away), _up(float(floor[1]) + cruise.beside)),
        munk_moment=_up(float(1.0001 * moment)),
    )
    proof = {
        "P": [[float(P[i, j]) for j in range(i + 1)] for i in range(6 if claim.lag else 4)],
        "floor": candidate.levels[0],
        "cells": _HELD if claim.period else _CELLS,
        "shells": [
            {"level": level, "growth": growth, "rate": rate}
            for level, growth, rate in zip(candidate.levels[1:], candidate.growths, candidate.rates, strict=True)
        ],
    }
    if claim.current:
        proof["flow"] = cruise.flow.tolist()
    if claim.period:
        proof["thrust"] = {"weight": float(P[-1, -1]), "split": split_of(claim)}
    return seal("turning", stated, {"proof": {**proof, "trim": list(cruise.slopes)}})


def _up(value: float) -> float:
    return float(np.ceil(1e4 * value) / 1e4)
