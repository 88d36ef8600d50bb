"""Falsifier of a region: random search for the least level at which V decays too slowly, in the true loops.

The function of a loop takes deviations ξ (n, k) from the steady cruise and random numbers (n, DRAWS) in [0, 1], which
choose the true vehicle, the heading and the other uncertain quantities. The function of a loop returns ξ̇ (n, k) and
the largest ratio of a commanded thrust to its limit (n,). No proof uses these functions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.turning_law import Follower, followed
from surctl.marine.verification.region.claim import RegionClaim
from surctl.marine.verification.region.heading import HeadingClaim

Array = NDArray[np.float64]
Loop = Callable[[Array, Array], tuple[Array, Array]]

_DRAWS = 10


def _between(pair: tuple[float, float], share: Array) -> Array:
    return pair[0] + (pair[1] - pair[0]) * share


def heading_loop(claim: HeadingClaim) -> Loop:
    """Return the function that computes ξ̇ of the heading-steered loop with thrust limits."""
    law, limits = claim.law, claim.limits
    v, velocity_gain, ahead = law["cruise"], claim.velocity_gain, law["lookahead"]
    fed = law["linear_drag"] * v + law["quadratic_drag"] * v * v
    keys = [key for key in claim.ranges if not key.startswith("heave")]

    def rate(xi: Array, draws: Array) -> tuple[Array, Array]:
        boat = {key: _between(claim.ranges[key], draws[:, k]) for k, key in enumerate(keys)}

        def drag(axis: str, n: Array) -> Array:
            return np.asarray(boat[f"{axis}_linear"] * n + boat[f"{axis}_quadratic"] * n * np.abs(n))

        command = v + (drag("surge", np.full(len(xi), v)) - fed) / velocity_gain
        x_e, y, psi, r = xi[:, 0] + (v - command) / law["k1"], xi[:, 1], xi[:, 2], xi[:, 5]
        c, s = np.cos(psi), np.sin(psi)
        u, w = c * (v + xi[:, 3]) + s * xi[:, 4], -s * (v + xi[:, 3]) + c * xi[:, 4]
        desired = (v - law["k1"] * x_e) * np.hypot(y, ahead) / ahead
        pull = law["yaw_inertia_kg_m2"] * law["k_r"]
        forces = (
            velocity_gain * (desired - u) + fed,
            -velocity_gain * w,
            -pull * (r + law["k_psi"] * (psi + np.arctan(y / ahead))),
        )
        ends = [limits[k] for k in ("surge_n", "sway_n", "yaw_nm")]
        f, g, n = (np.clip(t, -end, end) for t, end in zip(forces, ends, strict=True))
        share = np.max([np.abs(t) / end for t, end in zip(forces, ends, strict=True)], axis=0)
        a, b = (f - drag("surge", u)) / boat["mass_kg"], (g - drag("sway", w)) / boat["mass_kg"]
        turn = (n - drag("yaw", r)) / boat["yaw_inertia_kg_m2"]
        return np.stack([xi[:, 3], xi[:, 4], r, c * a - s * b, s * a + c * b, turn], axis=1), share

    return rate


def cruise_rate(
    law: Follower, mass: Array | float, drag: tuple[Array, Array], state: Array, psi: Array
) -> tuple[Array, Array]:
    """Return d/dt of (x_e, y_e, U_x, U_y) (n, 4), and the largest ratio of a commanded thrust to its limit (n,).

    Args:
        law: the numbers of the law, with the thrust limits of the vehicle.
        mass: true mass m11 = m22 [kg].
        drag: true linear and quadratic drag of surge and sway, (2,) or (2, n).
        state: the state (n, 4), with the velocity in the path frame.
        psi: angle (n,) from the path to the heading.
    """
    forces = followed(replace(law, thrust=(np.inf, np.inf)), state, psi)
    c, s = np.cos(psi), np.sin(psi)
    parts = []
    for k, n in enumerate((c * state[:, 2] + s * state[:, 3], c * state[:, 3] - s * state[:, 2])):
        thrust = np.clip(forces[:, k], -law.thrust[k], law.thrust[k])
        parts.append((thrust - drag[0][k] * n - drag[1][k] * n * np.abs(n)) / mass)
    rate = np.stack(
        [state[:, 2] - law.cruise, state[:, 3], c * parts[0] - s * parts[1], s * parts[0] + c * parts[1]], axis=1
    )
    return rate, np.max(np.abs(forces) / law.thrust, axis=1)


def cruise_loop(claim: RegionClaim) -> Loop:
    """Return the function that computes ξ̇ of the cruise loop with thrust limits, without thrust lag or sampling."""
    mass, hat, hat2 = claim.model
    gains, v = claim.gains, claim.cruise
    ratio = np.inf if claim.asymmetry >= 2 else (2 + claim.asymmetry) / (2 - claim.asymmetry)
    law = Follower(
        gains["k1"], gains["lookahead"], v, claim.cap, gains["k_v"], (mass,) * 2, (hat,) * 2, (hat2,) * 2,
        (claim.thrust,) * 2,
    )  # fmt: skip

    def rate(xi: Array, draws: Array) -> tuple[Array, Array]:
        linear, quadratic = (
            np.array([
                first := _between(pair, draws[:, k]),
                np.clip(_between(pair, draws[:, k + 1]), first / ratio, first * ratio),
            ])
            for k, pair in ((1, claim.linear), (3, claim.quadratic))
        )  # fmt: skip
        missing = (linear.mean(axis=0) - hat) * v + 0.85 * (quadratic.mean(axis=0) - hat2) * v * v
        state = xi + np.array([0.0, 0.0, v, 0.0])
        state[:, 0] -= missing / (mass * gains["k_v"] + hat + 1.7 * hat2 * v) / gains["k1"]
        return cruise_rate(law, _between(claim.mass, draws[:, 0]), (linear, quadratic), state, 2 * np.pi * draws[:, 5])

    return rate


_LEVELS = np.geomspace(0.01, 100, 120)
_TOGETHER = 4_000  # points per call: they fit the processor's cache, and a call has little overhead
_SAMPLES, _BEST, _STEPS, _HALVINGS = 10_000, 300, 40, 10


class LevelRatios(NamedTuple):
    """Certified level divided by the least level where V̇ > −a V was found, and by the level of thrust saturation."""

    falsifier: float
    thrust: float

    @property
    def sentence(self) -> str:
        """Return a sentence that states both ratios."""
        return (
            f"certified level: {self.falsifier:.0%} of the smallest level with a counterexample, {self.thrust:.0%} of "
            "the level at which thrust saturates" + (", so no thrust limit acts in it" if self.thrust < 1 else "")
        )


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
