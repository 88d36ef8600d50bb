"""What a constant current leaves of the trim force of a turning cruise whose steady command shifts with the current.

Let c be the current, n_i an axis of the body in the path frame, and δ = −n_i G c the shift of the steady command along
it, G = diag(g_x, g_y). The law adds m_i k_v δ and the change of its feedforward, and the drag at the target's velocity
changes by the current. With α = m_i k_v + â + b̂ S_w and β = f a + g b S_u, the error on axis i changes by n_i (β − α
G) c. S_w is the secant slope of |w| w from w = n_i (v + ω, 0) to w + δ, and S_u that of |u| u from u = n_i (v, 0) to u
− n_i c, both between max(2 (√2 − 1) |u|, 2 |u| − change) and 2 |u| + change. For given slopes, β − α g_k is affine in
the drag factors, so that their vertices decide.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.turning_claim import Pair, TurningClaim, drag_factors
from surctl.certcheck.turning_masses import UP

__all__ = ["STILL", "flow_gains", "flow_lack"]

Array = NDArray[np.float64]

STILL: tuple[Pair, Pair, Pair] = ((Fraction(0), Fraction(0)),) * 3
"""Coefficients of the gains of a steady command that does not shift."""

_FIRST = 2 * (np.sqrt(2) - 1)  # least secant slope of |u| u from v, divided by v


def flow_gains(flow: tuple[Pair, Pair, Pair], f: tuple[Fraction, ...]) -> Pair:
    """Return (g_x, g_y) for the drag factors (linear surge, linear sway, quadratic surge, quadratic sway)."""
    means = Fraction(1), (f[0] + f[1]) / 2 - 1, (f[2] + f[3]) / 2 - 1
    along, across = (sum((row[k] * mean for row, mean in zip(flow, means, strict=True)), Fraction(0)) for k in (0, 1))
    return along, across


def flow_lack(claim: TurningClaim, flow: tuple[Pair, Pair, Pair], omega: tuple[float, float], share: Array) -> Array:
    """Return the largest error [N] (cells, 2) on each axis by the current; arguments as in `turning_cells`."""
    v, current = float(claim.cruise), float(claim.current) * UP
    moved = current * max(abs(float(g)) for f in drag_factors(claim) for g in flow_gains(flow, f))
    lack = np.zeros(share.shape[:2])
    for axis in (0, 1):
        gain, linear, square = (float(n) for n in (claim.mass[axis] * claim.k_v, claim.linear[axis],
                                                   claim.quadratic[axis]))  # fmt: skip
        low, high = share[:, axis, 0], share[:, axis, 1]
        most = np.stack([high, np.sqrt(np.clip(1 - low**2, 0, 1))], 1)  # |n_i| along and across the path
        for f in drag_factors(claim):
            gains = [float(g) for g in flow_gains(flow, f)]
            law = [gain + linear + square * s for s in _slopes((v + omega[0]) * low, (v + omega[1]) * high, moved)]
            drag = [float(f[axis]) * linear + float(f[2 + axis]) * square * s
                    for s in _slopes(v * low, v * high, current)]  # fmt: skip
            left = np.stack([
                np.max([np.abs(beta - alpha * g) for alpha in law for beta in drag], axis=0) for g in gains
            ], 1)  # fmt: skip
            size = max(map(abs, gains)) * law[1] + drag[1]
            lack[:, axis] = np.maximum(
                lack[:, axis], current * (np.linalg.norm(left * most, axis=1) + 1e-12 * size) * UP
            )
    return lack


def _slopes(low: Array, high: Array, change: float) -> tuple[Array, Array]:
    """Return bounds of the secant slopes of |u| u from u in [low, high] to a point at most `change` away."""
    return np.maximum(_FIRST * low, 2 * low - change) / UP, (2 * high + change) * UP
