"""Random problems that are difficult for a least-distance solver, and an independent check of their solutions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["FAMILIES", "Trials", "Verdict", "draw_trials", "judge"]

Array: TypeAlias = NDArray[np.float64]

FAMILIES = (
    "plain",  # random rows
    "doubled",  # repeated rows, some with different bounds
    "parallel",  # pairs of rows with an angle of 1e-3 … 1e-9 rad
    "degenerate",  # many rows that intersect in one point
    "opposed",  # soft rows that contradict each other, or allow exactly one value
    "scaled",  # rows of length 1e-8 … 1e8
    "dependent",  # a task with repeated, zero or contradicting rows
    "far",  # a target far outside the feasible set
)
"""Kinds of problems; a problem has the features of one or several kinds."""


@dataclass(frozen=True, eq=False)
class Trials:
    """N problems in the form of the input arrays of `surctl.priority.solver.fallback.safe_step`.

    Attributes:
        target (N, n), J (N, p·n), x (N, p), rows (N, m·(n + 3)), box (N, 2n): inputs of `safe_step`, one problem in
            each row.
        features: (N, len(FAMILIES)), whether the problem has this feature of `FAMILIES`.
    """

    target: Array
    J: Array
    x: Array
    rows: Array
    box: Array
    features: NDArray[np.bool_]

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array]:
        """Return the arrays target, J, x, rows and box."""
        return self.target, self.J, self.x, self.rows, self.box

    def unit(self) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Return normals (N, m, n), lower and upper bounds of rows scaled to length 1, and a mask of the soft rows."""
        n = self.target.shape[1]
        rows = self.rows.reshape(len(self.rows), -1, n + 3)
        A, length = rows[..., :n], np.linalg.norm(rows[..., :n], axis=2)
        length = np.where(length > 0, length, 1.0)
        return A / length[..., None], rows[..., n] / length, rows[..., n + 1] / length, rows[..., n + 2] > 0

    def attained(self, v: Array) -> NDArray[np.bool_]:
        """Return where v (N, n) meets the task, and no row of the task is so short that it may count as 0."""
        J = self.J.reshape(len(v), -1, v.shape[1])
        length = np.linalg.norm(J, axis=2)
        missed = np.abs(np.einsum("kij,kj->ki", J, v) - self.x) / np.where(length > 0, length, 1.0)
        met = (missed <= 1e-9 * (1 + np.abs(v).max(axis=1, keepdims=True))).all(axis=1)
        return np.asarray(met & (length.min(axis=1) >= 1e-8 * length.max(axis=1)))

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Trials:
        """Return only the chosen problems."""
        return Trials(
            self.target[chosen],
            self.J[chosen],
            self.x[chosen],
            self.rows[chosen],
            self.box[chosen],
            self.features[chosen],
        )


def draw_trials(count: int, *, n: int = 4, p: int = 2, m: int = 24, seed: int = 0, mixed: bool = True) -> Trials:
    """Return random problems: box and some thrust rows are hard, and v = 0 satisfies these; all other rows are soft.

    Args:
        count: number of problems N.
        n: number of velocities. p: number of rows of J. m: number of constraint rows, m > n.
        seed: seed of numpy's PCG64 generator.
        mixed: if true, each problem has 0–3 features of `FAMILIES`; if false, none.
    """
    rng = np.random.default_rng(seed)
    picks = rng.random((count, len(FAMILIES))) < 0.2 if mixed else np.zeros((count, len(FAMILIES)), dtype=bool)
    picks[:, 0] = ~picks[:, 1:].any(axis=1)
    has = {name: picks[:, k] for k, name in enumerate(FAMILIES)}
    A = rng.normal(size=(count, m, n))
    A /= np.linalg.norm(A, axis=2, keepdims=True)
    A[:, :n] = np.eye(n)
    _tilt(A, has["parallel"], n, rng)
    inside = 0.3 * rng.normal(size=(count, n))
    value = np.einsum("kij,kj->ki", A, inside)
    upper = value + np.abs(rng.normal(size=(count, m))) * rng.choice([0.1, 0.5, 1.0], (count, 1))
    upper[has["degenerate"], n:] = value[has["degenerate"], n:]
    lower = np.where(rng.random((count, m)) < 0.2, upper - 2 * np.abs(rng.normal(size=(count, m))), -np.inf)
    _double(A, lower, upper, has["doubled"], n, rng)
    _oppose(A, lower, upper, has["opposed"], rng)
    hard = min(n + 2, m - 1)
    upper[:, :hard] = rng.uniform(0.05, 1.5, (count, hard))
    lower[:, :hard] = -rng.uniform(0.05, 1.5, (count, hard))
    soft = np.zeros((count, m))
    soft[:, hard:] = 1.0
    box = np.concatenate([lower[:, :n], upper[:, :n]], axis=1)
    target = rng.normal(size=(count, n)) * np.where(has["far"], 10.0 ** rng.uniform(1, 4, count), 1.0)[:, None]
    J, x = _task(inside, p, has, rng)
    scale = np.where(has["scaled"][:, None], 10.0 ** rng.uniform(-8, 8, (count, m)), 1.0)
    rows = np.concatenate(
        [A * scale[..., None], (lower * scale)[..., None], (upper * scale)[..., None], soft[..., None]], axis=2
    )
    return Trials(target, J.reshape(count, -1), x, rows.reshape(count, -1), box, picks)


def _tilt(A: Array, chosen: NDArray[np.bool_], n: int, rng: np.random.Generator) -> None:
    for i in range(n + 1, A.shape[1], 2):
        angle = 10.0 ** rng.uniform(-9, -3, len(A))
        tilted = A[:, i - 1] + angle[:, None] * A[:, i]
        tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
        A[chosen, i] = tilted[chosen]


def _double(A: Array, lower: Array, upper: Array, chosen: NDArray[np.bool_], n: int, rng: np.random.Generator) -> None:
    for i in range(n + 1, A.shape[1], 3):
        sign = rng.choice([-1.0, 1.0], len(A))
        A[chosen, i] = (sign[:, None] * A[:, i - 1])[chosen]
        same = chosen & (sign > 0)
        upper[same, i], lower[same, i] = upper[same, i - 1], lower[same, i - 1]


def _oppose(A: Array, lower: Array, upper: Array, chosen: NDArray[np.bool_], rng: np.random.Generator) -> None:
    m = A.shape[1]
    gap = rng.choice([0.0, 0.1, -0.1, -0.5, 1e-6, -1e-6], len(A))
    A[chosen, m - 1] = -A[chosen, m - 2]
    upper[chosen, m - 1] = (gap - upper[:, m - 2])[chosen]
    lower[chosen, m - 2 :] = -np.inf


def _task(inside: Array, p: int, has: dict[str, NDArray[np.bool_]], rng: np.random.Generator) -> tuple[Array, Array]:
    count, n = inside.shape
    J = rng.normal(size=(count, p, n))
    scale = np.where(has["scaled"][:, None], 10.0 ** rng.uniform(-8, 8, (count, p)), 1.0)
    J *= scale[..., None]
    kind = np.where(has["dependent"], rng.integers(0, 4, count), 4)
    J[kind == 0, 0] = 0.0
    if p > 1:
        J[kind >= 1, p - 1] = np.where((kind < 4)[kind >= 1, None], 2.0 * J[kind >= 1, 0], J[kind >= 1, p - 1])
    x = np.einsum("kij,kj->ki", J, inside + (rng.random((count, 1)) < 0.4) * rng.normal(size=(count, n)))
    x[kind == 3, p - 1] += np.linalg.norm(J[kind == 3, p - 1], axis=1)
    return J, x


@dataclass(frozen=True, eq=False)
class Verdict:
    """Residuals (N,) of the KKT conditions for solutions reported as optimal, relative to 1 + max(|v|, |target|).

    Attributes:
        missed: largest violation of a constraint row of length 1. task: residual of J v = x for rows of J scaled to
            length 1.
        stationary: largest entry of target − v after subtraction of the active normals times their multipliers, and of
            the part in the row space of J.
        loose: largest distance from its bound of a constraint row with a nonzero multiplier.
        negative: largest absolute value of a multiplier with the wrong sign.
    """

    missed: Array
    task: Array
    stationary: Array
    loose: Array
    negative: Array

    def worst(self) -> Array:
        """Return the largest residual (N,) of each problem; the KKT conditions hold if this residual is 0."""
        every = (self.missed, self.task, self.stationary, self.loose, self.negative)
        largest: Array = np.max(np.stack(every), axis=0)
        return largest


def judge(trials: Trials, v: Array, active: Array, *, multipliers: Array) -> Verdict:
    """Return the KKT residuals of v (N, n), from signed numbers of the active rows and their multipliers (N, k)."""
    A, lower, upper, _ = trials.unit()
    count, n = v.shape
    size = 1.0 + np.maximum(np.abs(v).max(axis=1), np.abs(trials.target).max(axis=1))
    value = np.einsum("kij,kj->ki", A, v)
    missed = np.maximum(np.maximum(value - upper, lower - value).max(axis=1), 0.0)
    J = trials.J.reshape(count, -1, n)
    length = np.linalg.norm(J, axis=2)
    length = np.where(length > 0, length, 1.0)
    J, off = J / length[..., None], (np.einsum("kij,kj->ki", J, v) - trials.x) / length
    used = active != 0
    at = np.maximum(np.abs(active) - 1, 0).astype(np.intp)
    normals = np.take_along_axis(A, at[..., None], axis=1) * (np.sign(active) * used)[..., None]
    here = np.take_along_axis(value, at, axis=1)
    bound = np.where(active > 0, np.take_along_axis(upper, at, axis=1), np.take_along_axis(lower, at, axis=1))
    force = trials.target - v - np.einsum("kij,ki->kj", normals, multipliers)
    outside = force - np.einsum("kij,kj->ki", np.linalg.pinv(J, rcond=1e-10) @ J, force)
    loose = np.where(used, np.abs(here - np.where(used, bound, 0.0)), 0.0).max(axis=1)
    negative = np.maximum(np.where(used, -multipliers, 0.0).max(axis=1), 0.0)
    return Verdict(
        missed / size,
        np.abs(off).max(axis=1) / size,
        np.abs(outside).max(axis=1) / size,
        loose / size,
        negative / size,
    )
