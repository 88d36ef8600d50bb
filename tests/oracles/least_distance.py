"""Independent check of the safe step when the task is not met, by linear programmes and non-negative least squares.

The check shares no code with the solver. The solver returns a velocity v and the opening t, the amount by which the
bounds of soft constraint rows are moved outwards. The check computes

* by how much t could be smaller, from the linear programme min t subject to all constraint rows (solver HiGHS);
* an upper bound on the amount by which the task residual ‖J v − x‖ could be smaller. With r = x − J v, this bound is
  the largest r·J(w − v)/‖r‖ over all w that satisfy the constraint rows, because a convex function lies above its
  tangent. It is the solution of another linear programme, whose multipliers show how much of the bound may be due to
  rounding errors in nearly parallel constraint rows;
* the feasible velocity w nearest to the target with J w = J v, from a non-negative least-squares problem (Lawson and
  Hanson 1974, chapter 23; scipy's nnls).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.oracles.distance_trials import Trials

__all__ = ["Finding", "examine"]

Array = NDArray[np.float64]

_TIGHT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}


@dataclass(frozen=True)
class Finding:
    """Differences between one solution of the safe step and the optimum; NaN if a difference could not be computed.

    Attributes:
        opening: by how much the bounds of the soft rows are widened, minus the least widening that is feasible.
        task: upper bound on the difference between ‖J v − x‖ and the smallest residual that the constraint rows with
            this opening allow, divided by the length of the longest row of J.
        weight: largest sum of the Lagrange multipliers of the linear programme for `task`, which is the sensitivity of
            `task` to changes of the constraint rows.
        distance: largest entry of the difference between v and the velocity with the same J v that is nearest to the
            target, relative to 1 + max |target|.
    """

    opening: float
    task: float
    weight: float
    distance: float


def examine(trials: Trials, v: Array, opening: Array) -> list[Finding]:
    """Check the velocities v (N, n) and openings (N,) of N problems, and return one `Finding` for each."""
    A, lower, upper, soft = trials.unit()
    findings = []
    for k, (point, t) in enumerate(zip(v, opening, strict=True)):
        opens = soft[k].astype(float)
        G, h = _one_sided(np.column_stack([A[k], -opens]), lower[k], upper[k])
        J = trials.J[k].reshape(-1, v.shape[1])
        opened = h - G[:, -1] * t
        findings.append(
            Finding(
                float(t) - _least_opening(G, h) if t > 0 else 0.0,
                *_excess(G[:, :-1], opened, J, trials.x[k], point),
                _distance(G[:, :-1], opened, J, trials.target[k], point),
            )
        )
    return findings


def _one_sided(rows: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Convert constraint rows with two bounds to one-sided constraints G z ≤ h, and return G and h."""
    above, below = np.isfinite(upper), np.isfinite(lower)
    turned = np.column_stack([-rows[below, :-1], rows[below, -1]])
    return np.vstack([rows[above], turned]), np.concatenate([upper[above], -lower[below]])


def _least_opening(G: Array, h: Array) -> float:
    from scipy.optimize import linprog

    n = G.shape[1] - 1
    cost = np.append(np.zeros(n), 1.0)
    done = linprog(cost, G, h, bounds=[(None, None)] * n + [(0, None)], method="highs-ds", options=_TIGHT)
    return float(done.x[-1]) if done.status == 0 else np.nan


def _excess(G: Array, h: Array, J: Array, x: Array, v: Array) -> tuple[float, float]:
    """Return ‖J v − x‖ minus a lower bound of its minimum over G v ≤ h, and the largest sum of multipliers.

    The lower bound is the minimum of the tangent of ‖J v − x‖ at v. If this bound is loose, the tangent at another
    point is used: the best convex combination of v and the solutions of the linear programmes so far (fully corrective
    method of Frank and Wolfe 1956).
    """
    from scipy.optimize import linprog

    scale = float(np.linalg.norm(J, axis=1).max())
    if scale == 0.0:
        return 0.0, 0.0
    # the solution satisfies its rows only up to rounding; without that tolerance the programme may be infeasible
    bounds, corners, best, weight = np.maximum(h, G @ v), v[None], 0.0, 0.0
    size, at = float(np.linalg.norm(x - J @ v)) / scale, v
    for _ in range(30):
        rest = (x - J @ at) / scale
        here = float(np.linalg.norm(rest))
        if here <= 1e-10:
            break
        slope = J.T @ rest / (here * scale)
        done = linprog(-slope, G, bounds, bounds=[(None, None)] * len(v), method="highs-ds", options=_TIGHT)
        if done.status != 0:
            return np.nan, np.inf
        gain, multipliers = float(slope @ (done.x - at)), float(-done.ineqlin.marginals.sum())
        best, weight = max(best, here - gain), max(weight, multipliers)
        if gain <= 1e-11:
            break
        corners = np.vstack([corners, done.x])
        at = _closest(corners, J / scale, x / scale)
    return size - best, weight


def _closest(corners: Array, J: Array, x: Array) -> Array:
    """Return the convex combination v of the points `corners` that minimises ‖J v − x‖."""
    from scipy.optimize import nnls

    images = (J @ corners.T) - x[:, None]
    heavy = 1e3 * (1.0 + float(np.abs(images).max()))
    try:
        weights, _ = nnls(np.vstack([images, np.full((1, len(corners)), heavy)]), np.append(0.0 * x, heavy))
    except RuntimeError:
        return np.asarray(corners[0])
    return np.asarray(weights @ corners / weights.sum())


def _distance(G: Array, h: Array, J: Array, target: Array, v: Array) -> float:
    """Return the distance from v to the w nearest to the target among all w with J w = J v and G w ≤ h."""
    from scipy.optimize import nnls

    length = np.linalg.norm(J, axis=1, keepdims=True)
    _, values, right = np.linalg.svd(J / np.where(length > 0, length, 1.0))
    free = right[int((values > 1e-10).sum()) :].T
    if free.shape[1] == 0:
        return 0.0
    # y = free.T (w − start): the start has the task value of v and agrees with the target in the free directions
    start = target + (v - target) - free @ (free.T @ (v - target))
    rows, slack = G @ free, np.maximum(h, G @ v) - G @ start
    matters = np.linalg.norm(rows, axis=1) > 1e-9
    rows, slack = rows[matters], slack[matters]
    # scaled by the distance to go: otherwise the last entry below would lose all its digits
    unit = max(1.0, float(np.linalg.norm(v - start)))
    E = np.vstack([-rows.T, -slack / unit])
    f = np.append(np.zeros(len(E) - 1), 1.0)
    try:
        u, _ = nnls(E, f, maxiter=1000)
    except RuntimeError:
        return np.nan
    rest = E @ u - f
    if abs(rest[-1]) < 1e-12:
        return np.nan
    w = start - free @ rest[:-1] * (unit / rest[-1])
    if (G @ w - np.maximum(h, G @ v)).max() > 1e-9 or np.linalg.norm(w - target) > np.linalg.norm(v - target) + 1e-9:
        return np.nan  # no result: the feasible set is nearly a single point, and nnls failed
    return float(np.abs(w - v).max() / (1.0 + np.abs(target).max()))
