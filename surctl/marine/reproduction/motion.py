"""Compute the value of an expression, and the solution of a small system of differential equations."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

__all__ = ["Vector", "trajectory", "value"]

Vector = NDArray[np.float64]


def value(expression: ca.SX) -> float:
    """Return the numeric value of a CasADi SX expression that contains no symbols."""
    return float(ca.evalf(expression))


def trajectory(rate: ca.Function, start: Vector, *, duration: float, step: float = 0.05) -> Vector:
    """Return the states (k + 1, n) of ẋ = rate(x) from `start` (n,) in k = duration/step RK4 steps of `step` [s]."""
    x = ca.SX.sym("x", len(start))
    k1 = rate(x)
    k2 = rate(x + step / 2 * k1)
    k3 = rate(x + step / 2 * k2)
    k4 = rate(x + step * k3)
    steps = ca.Function("step", [x], [x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)]).mapaccum(round(duration / step))
    return np.vstack([start, np.asarray(steps(start), dtype=float).T])
