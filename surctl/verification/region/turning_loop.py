"""The turning cruise as a linear inclusion on a grid of headings, in floating point; the checker derives its own.

The state is ξ = (x, y, δU_x, δU_y), the deviation from the steady cruise in the path frame. At a vertex of the
parameters ξ̇ = A ξ + B w with w wᵀ ⪯ Q; `certcheck.turning_cells` derives this inclusion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from surctl.verification.region.turning import TurningClaim

__all__ = ["Cruise", "Vertices", "steady_turning", "vertices"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Cruise:
    """The steady cruise: slopes of ω [m/s] in the mean drag factors, range of ω, and headings ψ (cells + 1,) [rad].

    `lack` (cells + 1, 2) holds the largest error of the trim force on each axis [N].
    """

    slopes: tuple[float, float]
    omega: tuple[float, float]
    headings: Array
    lack: Array


@dataclass(frozen=True)
class Vertices:
    """Vertices of a shell: A (n, 4, 4) and Q (n, 2, 2)."""

    A: Array
    Q: Array


def corner_factors(ends: tuple[float, float], asymmetry: float, count: int) -> Array:
    """Return the vertices (k, count) of the factors of the masses or of the drag coefficients."""
    low, high = ends
    ratio = (2 + asymmetry) / (2 - asymmetry)
    pairs = ((low, min(low * ratio, high)), (max(high / ratio, low), high))
    return np.array(sorted({one for pair in pairs for one in product(pair, repeat=count)}))


def steady_turning(claim: TurningClaim, *, cells: int) -> Cruise:
    """Return the steady cruise whose ω leaves the least error of the trim force at the worst heading."""
    from scipy.optimize import linprog

    v, psi = claim.cruise, np.linspace(0, np.pi / 2, cells + 1)
    n = np.stack([np.cos(psi), np.sin(psi)], 1)  # (cells + 1, 2)
    corners = corner_factors(claim.drag_factor, claim.drag_asymmetry, 4)
    f, g = corners[:, :2], corners[:, 2:]  # of linear and of quadratic drag
    gain = np.array(claim.mass) * claim.gains["k_v"]
    own = (gain + claim.linear) * n + 2 * np.array(claim.quadratic) * v * n * n  # force per ω
    missing = (1 - f)[:, None] * claim.linear * n * v + (1 - g)[:, None] * claim.quadratic * (n * v) ** 2
    means = np.stack([f.mean(axis=1) - 1, g.mean(axis=1) - 1], 1)  # (k, 2)
    rows = (means[:, None, None, :] * own[None, :, :, None] / np.array(claim.mass)[:, None]).reshape(-1, 2)
    sides = (missing / claim.mass).reshape(-1)
    ones = np.ones((len(rows), 1))
    solution = linprog(
        [0, 0, 1], A_ub=np.vstack([np.hstack([rows, -ones]), np.hstack([-rows, -ones])]),
        b_ub=np.concatenate([-sides, sides]), bounds=[(None, None)] * 3,
    )  # fmt: skip
    slopes = np.round(solution.x[:2], 6)
    omegas = means @ slopes
    lack = (
        np.abs(missing + omegas[:, None, None] * own).max(axis=0)
        + np.square(omegas).max() * np.array(claim.quadratic) * n * n
    )
    return Cruise((float(slopes[0]), float(slopes[1])), (float(omegas.min()), float(omegas.max())), psi, lack)


def vertices(claim: TurningClaim, cruise: Cruise, covariance: Array, high: float) -> Vertices | None:
    """Return the vertices in V ≤ high for the covariance P⁻¹ (4, 4); None if the law has another form there."""
    headings = list(_each(claim, cruise, covariance, high))
    if not headings or any(one is None for one in headings):
        return None
    return Vertices(
        np.concatenate([one[0] for one in headings if one]), np.concatenate([one[1] for one in headings if one])
    )


def _each(claim: TurningClaim, cruise: Cruise, covariance: Array, high: float) -> Iterator[tuple[Array, Array] | None]:
    k1, ahead, v, cap = claim.gains["k1"], claim.gains["lookahead"], claim.cruise, claim.cap
    x, y = 1.001 * np.sqrt(np.diag(covariance)[:2] * high)
    slow, fast = v + cruise.omega[0], v + cruise.omega[1]
    most = cap * ahead / np.hypot(ahead, y)
    if most <= fast or k1 * x >= slow or x + max(map(abs, cruise.omega)) / k1 >= claim.gains["wait"] / 2:
        return
    steer, catch = (slow - k1 * x, min(fast + k1 * x, cap)), {min(k1, (most - fast) / x), k1}
    plans = [np.diag([k, s / ahead]) for k, s in product(sorted(catch), steer)]
    masses = 1 / (corner_factors(claim.mass_factor, claim.mass_asymmetry, 2) * claim.mass)
    ratio = min((2 + claim.mass_asymmetry) / (2 - claim.mass_asymmetry), claim.mass_factor[1] / claim.mass_factor[0])
    low, top = claim.mass[0] / claim.mass[1] / ratio, claim.mass[0] / claim.mass[1] * ratio
    points = {(1 - 1 / low, low - 1), (1 - 1 / top, top - 1), (1 - 2 / (low + top), 2 * low * top / (low + top) - 1)}
    turns = sorted({(k * claim.yaw_rate * a, k * claim.yaw_rate * b) for a, b in points for k in (1, -1)})
    step = (cruise.headings[1] - cruise.headings[0]) / 2
    for psi, lack in zip(cruise.headings, cruise.lack, strict=True):
        c, s = np.cos(psi), np.sin(psi)
        R = np.array([[c, -s], [s, c]])
        near, far = np.clip(psi - step, 0, None), np.clip(psi + step, None, np.pi / 2)
        shares = ((np.cos(far), np.cos(near)), (np.sin(near), np.sin(far)))
        loops = []
        for i in (0, 1):
            one = _axis(claim, cruise, covariance * high * 1.002, i, R[:, i], shares[i], plans)
            if one is None:
                yield None
                return
            loops.append(one)
        bodies = [np.outer(R[:, i], R[:, i]) for i in (0, 1)]
        As, Qs = [], []
        for per_mass in masses:
            for a, b in turns:
                C = R @ np.array([[0, a], [b, 0]]) @ R.T
                pieces = [(np.sqrt(max(np.square(C[:, 0]).sum(), 0)) * v, np.outer(C[:, 0], C[:, 0]) * v * v)]
                pieces += [(lack[i] * per_mass[i], (lack[i] * per_mass[i]) ** 2 * bodies[i]) for i in (0, 1)]
                total = sum(size for size, _ in pieces)
                Q = sum((one * total / size for size, one in pieces if size > 0), np.zeros((2, 2)))
                stiff = [np.einsum("k,ij->kij", loops[i][:, 0] * per_mass[i], bodies[i]) for i in (0, 1)]
                damped = [np.einsum("k,ij->kij", loops[i][:, 1] * per_mass[i], bodies[i]) for i in (0, 1)]
                both = (stiff[0][:, None] + stiff[1][None]).reshape(-1, 2, 2)
                A = np.zeros((len(plans), len(both), 4, 4))
                A[..., 0, 2] = A[..., 1, 3] = 1
                A[..., 2:, :2] = -np.array([both @ plan for plan in plans])
                A[..., 2:, 2:] = -((damped[0][:, None] + damped[1][None]).reshape(-1, 2, 2) + C)
                As.append(A.reshape(-1, 4, 4))
                Qs.append(np.broadcast_to(Q, (len(As[-1]), 2, 2)))
        yield np.concatenate(As), np.concatenate(Qs)


def _axis(
    claim: TurningClaim, cruise: Cruise, sized: Array, i: int, n: Array, share: tuple[float, float], plans: list[Array]
) -> Array | None:
    """Return the extreme pairs (k, 2) of stiffness and damping of an axis; `sized` is P⁻¹ times the level."""
    v, cap = claim.cruise, claim.cap
    gain, linear, square = claim.mass[i] * claim.gains["k_v"], claim.linear[i], claim.quadratic[i]

    def largest(row: Array) -> float:
        return float(np.sqrt(max(float(row @ sized @ row), 0.0)))

    moved = largest(np.concatenate([[0, 0], n]))
    led = max(largest(np.concatenate([n @ plan, [0, 0]])) for plan in plans)
    slow, fast = v + cruise.omega[0], v + cruise.omega[1]
    w, u = (slow * share[0], fast * share[1]), (v * share[0], v * share[1])
    h = (linear + square * max(0.828 * w[0], 2 * w[0] - led), linear + square * (w[1] + min(cap, w[1] + led)))
    t = (claim.drag_factor[0] * linear + claim.drag_factor[0] * square * max(0.828 * u[0], 2 * u[0] - moved),
         claim.drag_factor[1] * linear + claim.drag_factor[1] * square * (2 * u[1] + moved))  # fmt: skip
    forces = [
        abs(((gain + linear) * one - gain * v) * k + square * (one * k) ** 2) for one in (slow, fast) for k in share
    ]
    left = claim.thrust[i] - max(*forces, -((gain + linear) * slow - gain * v) * share[1])
    if left <= 0:
        return None
    most = max(largest(np.concatenate([(gain + slope) * (n @ plan), gain * n])) for plan in plans for slope in h)
    part = min(1.0, 0.99 * left / most)
    return np.array([(q * (gain + a), q * gain + b) for q in {part, 1.0} for a in h for b in t])
