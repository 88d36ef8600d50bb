"""A referee of the lower rungs that shares no code with the ladder: linear programmes, and non-negative least squares.

For `limited` and `relaxed` answers v with opening t of the soft rows it asks

* how much smaller t could be: the linear programme min t over all rows (HiGHS);
* how much smaller ‖J v − x‖ could be: with r = x − J v, the largest r·J(w − v)/‖r‖ over all w that keep the rows
  bounds it from above (a convex function lies above its tangent), a linear programme again. Its multipliers tell how
  much of that is due to rounding of the rows: near-parallel ones make any answer doubtful;
* where the nearest point with the same J v is: least distance as non-negative least squares (Lawson and Hanson
  1974, chapter 23; scipy's nnls).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.priority.solver.trials import Trials

__all__ = ["Finding", "examine"]

Array = NDArray[np.float64]

_TIGHT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}


@dataclass(frozen=True)
class Finding:
    """What the referee found for one answer; NaN where it has no answer itself.

    Attributes:
        opening: t minus the least one.
        task: ‖J v − x‖ minus the smallest one that the opened rows allow, divided by the length of J's longest row.
        weight: largest sum of multipliers behind that: by how much more the excess changes than the rows do.
        distance: largest entry of v minus the nearest point, relative to 1 + max |target|.
    """

    opening: float
    task: float
    weight: float
    distance: float


def examine(trials: Trials, v: Array, opening: Array) -> list[Finding]:
    """One finding a problem; v (N, n), opening (N,)."""
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
    """G, h with G z ≤ h; the last column is the opening's, which widens both sides."""
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
    """How far ‖J v − x‖ is above a lower bound of the least one, and the multipliers' largest sum.

    The bound is the tangent's at v, or at a better point where that is loose: the best combination of v and of what
    the linear programmes gave so far (Frank and Wolfe 1956, fully corrective).
    """
    from scipy.optimize import linprog

    scale = float(np.linalg.norm(J, axis=1).max())
    if scale == 0.0:
        return 0.0, 0.0
    # the answer keeps its rows to rounding only: without that much room the programme may have no point at all
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
    """The combination of corners, weights at least 0 and of sum 1, with ‖J v − x‖ least."""
    from scipy.optimize import nnls

    images = (J @ corners.T) - x[:, None]
    heavy = 1e3 * (1.0 + float(np.abs(images).max()))
    try:
        weights, _ = nnls(np.vstack([images, np.full((1, len(corners)), heavy)]), np.append(0.0 * x, heavy))
    except RuntimeError:
        return np.asarray(corners[0])
    return np.asarray(weights @ corners / weights.sum())


def _distance(G: Array, h: Array, J: Array, target: Array, v: Array) -> float:
    """v against min ‖w − target‖ over w with J w = J v and G w ≤ h."""
    from scipy.optimize import nnls

    length = np.linalg.norm(J, axis=1, keepdims=True)
    _, values, right = np.linalg.svd(J / np.where(length > 0, length, 1.0))
    free = right[int((values > 1e-10).sum()) :].T
    if free.shape[1] == 0:
        return 0.0
    # y = free.T (w − start): the start has the task's value of v and no other part of the way
    start = target + (v - target) - free @ (free.T @ (v - target))
    rows, slack = G @ free, np.maximum(h, G @ v) - G @ start
    matters = np.linalg.norm(rows, axis=1) > 1e-9
    rows, slack = rows[matters], slack[matters]
    # in units of the way to go, or the last entry below would be what is left of 1 after 1/way²
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
        return np.nan  # no answer: the feasible set is as good as a point, and nnls lost it
    return float(np.abs(w - v).max() / (1.0 + np.abs(target).max()))
