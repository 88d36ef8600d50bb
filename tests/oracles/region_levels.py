"""Falsifier of a region: random search for the least level at which V decays too slowly, in the true loops.

The function of a loop takes deviations ξ (n, k) from the steady cruise and random numbers (n, 10) in [0, 1], which
choose the true vehicle, the heading and the other uncertain quantities. The function of a loop returns ξ̇ (n, k) and
the largest ratio of a commanded thrust to its limit (n,).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.turning_law import Follower, followed
from surctl.marine.verification.region.turning import TurningClaim

Array = NDArray[np.float64]
Loop = Callable[[Array, Array], tuple[Array, Array]]

_DRAWS = 10


def _between(pair: tuple[float, float], share: Array) -> Array:
    return pair[0] + (pair[1] - pair[0]) * share


def cruise_loop(claim: TurningClaim, slopes: tuple[float, float]) -> Loop:
    """Return the function that computes ξ̇ of the cruise loop with thrust limits, without thrust lag or sampling.

    Args:
        claim: a claim about equal masses.
        slopes: those of ω in the mean drag factors.
    """
    v = claim.cruise
    law = Follower.of(claim.stated, claim.mass, claim.linear, claim.quadratic, (np.inf, np.inf))
    ratio = (2 + claim.drag_asymmetry) / (2 - claim.drag_asymmetry)

    def rate(xi: Array, draws: Array) -> tuple[Array, Array]:
        factors = [
            np.stack([
                first := _between(claim.drag_factor, draws[:, k]),
                np.clip(_between(claim.drag_factor, draws[:, k + 1]), first / ratio, first * ratio),
            ], 1)
            for k in (1, 3)
        ]  # fmt: skip
        omega = sum(slope * (pair.mean(axis=1) - 1) for slope, pair in zip(slopes, factors, strict=True))
        state, psi = xi + np.array([0.0, 0.0, v, 0.0]), 2 * np.pi * draws[:, 5]
        state[:, 0] -= omega / claim.gains["k1"]
        command = followed(law, state, psi)
        c, s = np.cos(psi), np.sin(psi)
        body = np.stack([c * state[:, 2] + s * state[:, 3], c * state[:, 3] - s * state[:, 2]], axis=1)
        drag = factors[0] * claim.linear * body + factors[1] * claim.quadratic * body * np.abs(body)
        limited = np.clip(command, -np.array(claim.thrust), claim.thrust)
        u, w = ((limited - drag) / (claim.mass[0] * _between(claim.mass_factor, draws[:, 0]))[:, None]).T
        moved = np.stack([state[:, 2] - v, state[:, 3], c * u - s * w, s * u + c * w], axis=1)
        return moved, np.max(np.abs(command) / claim.thrust, axis=1)

    return rate


_LEVELS = np.geomspace(0.01, 100, 120)
_TOGETHER = 4_000  # points per call: they fit the processor's cache, and a call has little overhead
_SAMPLES, _BEST, _STEPS, _HALVINGS = 10_000, 300, 40, 10


class LevelRatios(NamedTuple):
    """Certified level divided by the least level where V̇ > −a V was found, and by the level of thrust saturation."""

    falsifier: float
    thrust: float


def certified_ratios(claim: TurningClaim, proof: Mapping[str, Any]) -> LevelRatios | None:
    """Return the ratios of a certified region; None if the masses differ, or the claim has more than drag and limits.

    Args:
        claim: the claim.
        proof: the entry `proof` of its certificate.
    """
    more = (claim.mass_asymmetry, claim.lag, claim.period, claim.current, claim.curvature, claim.terms)
    if claim.mass[0] != claim.mass[1] or any((*more, claim.force, claim.place_error, claim.velocity_error)):
        return None
    lower = proof["P"]
    P = np.array([[lower[max(i, j)][min(i, j)] for j in range(len(lower))] for i in range(len(lower))])
    first, second = proof["trim"]
    return level_ratios(cruise_loop(claim, (first, second)), P, claim.rate)


def level_ratios(loop: Loop, P: Array, rate: float, *, seed: int = 0) -> LevelRatios:
    """Return the ratios of the region V ≤ 1 for V = ξᵀPξ and the decay rate a = `rate`, found by random search.

    The search can miss counterexamples, so the true ratio of the certified level to the smallest level with a
    counterexample may be larger.
    """

    def lost(at: Array, draws: Array, level: Array) -> Array:
        return np.asarray(2 * np.einsum("ni,ij,nj->n", at, P, loop(at, draws)[0]) > -rate * level)

    def bound(at: Array, draws: Array, level: Array) -> Array:
        return np.asarray(loop(at, draws)[1] > 1)

    # inside the certified region, level 1, there is no counterexample
    return LevelRatios(*(1 / _least(test, P, low, seed) for test, low in ((lost, 1.0), (bound, 0.0))))


def _least(test: Callable[[Array, Array, Array], Array], P: Array, low: float, seed: int) -> float:
    """Return the least level found above `low` where `test` is true, by random samples and then local search."""
    draw, size = np.random.default_rng(seed), len(P)
    root, levels = np.linalg.inv(np.linalg.cholesky(P)), np.array([level for level in _LEVELS if level >= low])

    def least(unit: Array, draws: Array, most: Array) -> Array:
        """Return for each sample the least level ≤ `most` at which `test` is true; inf if there is no such level."""
        xi, lowest = unit / np.linalg.norm(unit, axis=1, keepdims=True) @ root, np.full(len(unit), np.inf)
        left, k = np.arange(len(unit)), 0
        while k < len(levels) and left.size:
            several = levels[k : k + max(_TOGETHER // left.size, 1)]
            k += len(several)
            at = np.tile(several, len(left))
            every = np.repeat(left, len(several))
            met = test(xi[every] * np.sqrt(at)[:, None], draws[every], at).reshape(len(left), -1)
            reached = several[np.argmax(met, axis=1)]
            good = met.any(axis=1) & (reached <= most[left])
            lowest[left[good]] = reached[good]
            left = left[~good & (most[left] > several[-1])]
        return lowest

    unit, draws = draw.normal(size=(_SAMPLES, size)), draw.uniform(size=(_SAMPLES, _DRAWS))
    draws = np.where(draw.uniform(size=draws.shape) < 0.6, np.round(draws), draws)
    draws[:, 5] = draw.uniform(size=len(draws))  # a heading has no extreme values
    level = least(unit, draws, np.full(_SAMPLES, np.inf))
    best = np.argsort(level)[:_BEST]
    unit, draws, level = unit[best], draws[best], level[best]
    for step in np.geomspace(0.3, 0.01, _STEPS):
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        moved = unit + draw.normal(scale=step, size=unit.shape)
        other = np.where(draw.uniform(size=draws.shape) < 0.1, np.round(draw.uniform(size=draws.shape)), draws)
        other[:, 5] = (draws[:, 5] + draw.normal(scale=step / 5, size=len(draws))) % 1
        now = least(moved, other, level)
        better = now <= level
        unit[better], draws[better], level[better] = moved[better], other[better], now[better]
    if not np.isfinite(level).any():
        return np.inf
    unit, draws, level = (each[np.isfinite(level)] for each in (unit, draws, level))
    below = level * _LEVELS[0] / _LEVELS[1]
    for _ in range(_HALVINGS):  # bisection, because the grid of levels is too coarse for two digits of a ratio
        middle = np.sqrt(np.maximum(below, low) * level)
        met = test(unit / np.linalg.norm(unit, axis=1, keepdims=True) @ root * np.sqrt(middle)[:, None], draws, middle)
        below, level = np.where(met, below, middle), np.where(met, middle, level)
    return float(level.min())
