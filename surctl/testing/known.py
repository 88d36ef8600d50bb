"""Least-distance problems that are constructed from their solutions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["BACKEND_FAMILIES", "Known", "draw_known"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Known:
    """A problem min ½‖y‖² subject to lower ≤ G y ≤ upper, together with its solution.

    Attributes:
        G: (m, d). lower, upper: (m,).
        y: (d,), the only optimum; None if no y satisfies the inequalities.
        angle: smallest angle between normals of active inequalities [rad], at most 1; a small angle amplifies errors in
            the bounds to errors in y by 1/angle.
    """

    G: Array
    lower: Array
    upper: Array
    y: Array | None
    angle: float = 1.0


def _unit(rng: np.random.Generator, count: int, size: int) -> Array:
    rows: Array = rng.normal(size=(count, size))
    unit: Array = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return unit


def _with_active(normals: Array, rng: np.random.Generator, *, idle: int = 6, free: int = 0) -> Known:
    """Return a problem with the optimum y* = −normalsᵀ·multipliers, at which the inequalities of `normals` are active.

    The signs of normals are random, and `idle` inequalities that are not active at y* are added.

    The last `free` normals have multiplier 0: their inequalities hold with equality at y* but do not affect y*.
    """
    count, size = normals.shape
    multipliers = np.append(rng.uniform(0.1, 1.0, count - free), np.zeros(free))
    y = -normals.T @ multipliers
    others = _unit(rng, idle, size)
    G = np.vstack([normals, others])
    value = G @ y
    slack = np.concatenate([np.zeros(count), rng.exponential(0.5, idle) + 1e-3])
    width = rng.exponential(1.0, len(G)) + 1e-3
    upper, lower = value + slack, np.where(rng.random(len(G)) < 0.5, value - width, -np.inf)
    side = np.where(rng.random(len(G)) < 0.5, -1.0, 1.0)  # a·y ≤ b is equivalent to −b ≤ −a·y
    turned = side < 0.0
    G, lower, upper = G * side[:, None], np.where(turned, -upper, lower), np.where(turned, -lower, upper)
    order = rng.permutation(len(G))
    return Known(G[order], lower[order], upper[order], y)


def _loose(size: int, rng: np.random.Generator) -> Known:
    # no inequality binds, so that the solution is 0
    return _with_active(np.zeros((0, size)), rng, idle=8)


def _plain(size: int, rng: np.random.Generator) -> Known:
    return _with_active(_unit(rng, int(rng.integers(1, size + 1)), size), rng)


def _equal(size: int, rng: np.random.Generator) -> Known:
    # some inequalities have equal bounds
    problem = _with_active(_unit(rng, int(rng.integers(1, size)), size), rng)
    if problem.y is None:
        return problem
    value = problem.G @ problem.y
    tight = np.minimum(problem.upper - value, value - problem.lower) < 1e-12
    return Known(problem.G, np.where(tight, value, problem.lower), np.where(tight, value, problem.upper), problem.y)


def _degenerate(size: int, rng: np.random.Generator) -> Known:
    # more inequalities at their bounds than unknowns, most of them with multiplier 0
    return _with_active(_unit(rng, 2 * size, size), rng, free=int(rng.integers(size, 2 * size)))


def _doubled(size: int, rng: np.random.Generator) -> Known:
    # some inequalities occur twice
    problem = _plain(size, rng)
    twice = rng.integers(0, len(problem.G), 4)
    side = rng.choice([-1.0, 1.0], 4)
    lower = np.where(side > 0.0, problem.lower[twice], -problem.upper[twice])
    upper = np.where(side > 0.0, problem.upper[twice], -problem.lower[twice])
    G = np.vstack([problem.G, problem.G[twice] * side[:, None]])
    return Known(G, np.concatenate([problem.lower, lower]), np.concatenate([problem.upper, upper]), problem.y)


def _parallel(size: int, rng: np.random.Generator) -> Known:
    # the normals of two active inequalities have an angle of 1e-5 to 1e-2 rad
    normals = _unit(rng, 2, size)
    angle = float(10.0 ** rng.uniform(-5, -2))
    across = normals[1] - (normals[0] @ normals[1]) * normals[0]
    normals[1] = np.cos(angle) * normals[0] + np.sin(angle) * across / np.linalg.norm(across)
    problem = _with_active(normals, rng)
    return Known(problem.G, problem.lower, problem.upper, problem.y, angle)


def _scaled(size: int, rng: np.random.Generator) -> Known:
    # the normals have lengths from 1e-3 to 1e3
    problem = _plain(size, rng)
    length = 10.0 ** rng.uniform(-3, 3, len(problem.G))
    return Known(problem.G * length[:, None], problem.lower * length, problem.upper * length, problem.y)


def _infeasible(size: int, rng: np.random.Generator) -> Known:
    # with positive weights, the normals sum to 0 and the bounds to a negative number
    count = int(rng.integers(2, size + 2))
    weights = rng.uniform(0.2, 1.0, count)
    normals = _unit(rng, count, size)
    closing = -weights[:-1] @ normals[:-1] / weights[-1]
    length = float(np.linalg.norm(closing))
    normals[-1], weights[-1] = closing / length, weights[-1] * length
    upper = rng.normal(size=count)
    upper[-1] -= (weights @ upper + rng.uniform(0.05, 1.0)) / weights[-1]
    problem = _with_active(np.zeros((0, size)), rng)
    G = np.vstack([normals, problem.G])
    lower = np.concatenate([np.full(count, -np.inf), problem.lower])
    return Known(G, lower, np.concatenate([upper, problem.upper]), None)


_MAKERS: Mapping[str, Callable[[int, np.random.Generator], Known]] = MappingProxyType(
    {
        "loose": _loose,
        "plain": _plain,
        "equal": _equal,
        "degenerate": _degenerate,
        "doubled": _doubled,
        "parallel": _parallel,
        "scaled": _scaled,
        "infeasible": _infeasible,
    }
)

BACKEND_FAMILIES = tuple(_MAKERS)
"""Kinds of problems: no row binds; random rows; equalities; more rows through the solution than unknowns; repeated
rows; nearly parallel rows; rows of length 1e-3 to 1e3; no solution."""


def draw_known(family: str, *, size: int, rng: np.random.Generator) -> Known:
    """Return one random problem of a family in `BACKEND_FAMILIES` with `size` unknowns, at least 2."""
    return _MAKERS[family](size, rng)
