"""How the steady command of a turning cruise shifts with a current, in the search for V; see
`certcheck.turning_flow`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.marine.verification.region.turning import TurningClaim

__all__ = ["best_flow", "flow_error", "least_error"]

Array = NDArray[np.float64]


def least_error(rows: Array, sides: Array) -> Array:
    """Return x (k,) that minimises the largest |rows x + sides|, with six decimals."""
    from scipy.optimize import linprog

    ones, count = np.ones((len(rows), 1)), rows.shape[1]
    solution = linprog(
        [0] * count + [1], A_ub=np.vstack([np.hstack([rows, -ones]), np.hstack([-rows, -ones])]),
        b_ub=np.concatenate([-sides, sides]), bounds=[(None, None)] * (count + 1),
    )  # fmt: skip
    return np.asarray(np.round(solution.x[:count], 6))


def _sizes(claim: TurningClaim, n: Array, factors: Array, moved: Array | float) -> tuple[Array, Array]:
    """Return α (2, n, 2) and β (2, k, n, 2) of each axis [N s/m] at the ends of the secant slopes."""
    v, mass, square = claim.cruise, np.array(claim.mass), np.array(claim.quadratic)

    def slopes(speed: Array, change: Array | float) -> Array:
        return np.stack([np.maximum(0.828 * speed, 2 * speed - change), 2 * speed + change])

    law = mass * claim.gains["k_v"] + claim.linear + square * slopes(v * n, moved)
    drag = factors[:, 0, None] * claim.linear + factors[:, 1, None] * square * slopes(v * n, claim.current)[:, None]
    return law, drag


def best_flow(claim: TurningClaim, n: Array, factors: Array, means: Array) -> Array:
    """Return the coefficients (3, 2) of the gains of the current with the least error at the worst heading.

    Args:
        claim: the claim.
        n: |cosine| (n, 2) between the path and each axis of the body.
        factors: vertices (k, 2, 2) of the factors of linear and quadratic drag of both axes.
        means: 1 and the mean factors − 1 (k, 3) at the vertices.
    """
    law, drag = _sizes(claim, n, factors, 0.0)
    flow = np.zeros((3, 2))
    for k, along in enumerate((n, np.sqrt(np.maximum(1 - n**2, 0)))):
        weight = along / claim.mass
        rows = (weight * law[0])[None, None, ..., None] * means[None, :, None, None]
        rows = np.broadcast_to(rows, (*drag.shape, 3))
        flow[:, k] = least_error(rows.reshape(-1, 3), -(weight * drag).reshape(-1))
    return flow


def flow_error(claim: TurningClaim, n: Array, factors: Array, gains: Array, omega: tuple[float, float]) -> Array:
    """Return the largest error (n, 2) [N] on each axis by the current for the gains (k, 2) at the vertices."""
    moved = claim.current * np.abs(gains).max() + 2 * max(map(abs, omega))
    law, drag = _sizes(claim, n, factors, moved)
    across = np.sqrt(np.maximum(1 - n**2, 0))
    left = [
        np.abs(drag[:, None] - law[None, :, None] * gains[:, k, None, None]).max(axis=(0, 1)) * side
        for k, side in enumerate((n, across))
    ]
    return np.asarray(claim.current * np.hypot(*left).max(axis=0))
