"""Compute the value of an expression, and the solution of a small system of differential equations."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
from numpy.typing import NDArray

__all__ = ["Vector", "numeric", "trajectory", "value"]

Vector = NDArray[np.float64]


def value(expression: ca.SX) -> float:
    """Return the numeric value of a CasADi SX expression that contains no symbols."""
    return float(ca.evalf(expression))


def numeric(function: ca.Function) -> Callable[[Vector], Vector]:
    """Return a CasADi function of one vector as a Python function of arrays (n,)."""

    def call(x: Vector) -> Vector:
        return np.asarray(function(x), dtype=float).ravel()

    return call


def trajectory(rate: Callable[[Vector], Vector], start: Vector, *, duration: float, step: float = 0.05) -> Vector:
    """Return the states (k + 1, n) of ẋ = rate(x) from `start` (n,) in k = duration/step RK4 steps of `step` [s]."""
    states = [np.asarray(start, dtype=float)]
    for _ in range(round(duration / step)):
        x = states[-1]
        k1 = rate(x)
        k2 = rate(x + step / 2 * k1)
        k3 = rate(x + step / 2 * k2)
        k4 = rate(x + step * k3)
        states.append(x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return np.array(states)
