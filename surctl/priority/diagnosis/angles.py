"""Angles between row spaces, and distances to rank loss of a task or of its remaining freedom, for many samples."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.diagnosis.commutator import Directions, absorb, directions
from surctl.priority.diagnosis.field import Measure, Values
from surctl.priority.rowspace import ZERO_ROW

__all__ = [
    "freedom",
    "outside_sines",
    "pair_angles",
    "projector_above",
    "remaining_sine",
    "smallest_angle",
    "task_strength",
]

Array: TypeAlias = NDArray[np.float64]


def outside_sines(task: Directions, P: Array) -> Array:
    """Sines (N, n), largest first, of the principal angles between a task's rows and range(P); 0 beyond its rank.

    They are the singular values of V(I − P), where V is an orthonormal basis of the rows. Unlike those of J(I − P) they
    do not depend on the lengths of the rows of J, so a task with short rows does not look dependent.
    """
    s = np.linalg.svd(task.rows @ (np.eye(P.shape[-1]) - P), compute_uv=False)
    sines: Array = np.minimum(np.asarray(s, dtype=float), 1.0)
    return sines


def pair_angles(first: Directions, second: Directions) -> tuple[Array, Array]:
    """Sine and cosine (N,) of the smallest principal angle between two row spaces (Björck and Golub 1973).

    Sine and cosine are both computed, so the angle is accurate near 0° and near 90°. NaN where a row space is empty.
    """
    P, rank = first.projector, second.rank
    least = np.take_along_axis(outside_sines(second, P), np.maximum(rank - 1, 0)[..., None], axis=-1)[..., 0]
    cosine = np.minimum(np.linalg.norm(second.rows @ P, 2, axis=(-2, -1)), 1.0)
    none = (rank == 0) | (first.rank == 0)
    return np.where(none, np.nan, least), np.where(none, np.nan, cosine)


def smallest_angle(i: int, j: int) -> Measure:
    """Measure: the sine (N,) of the smallest angle between tasks i and j."""
    return lambda values: pair_angles(directions(values.jacobians[i]), directions(values.jacobians[j]))[0]


def projector_above(values: Values, i: int) -> Array:
    """Projector (N, n, n) on the row space of the tasks above level i (counted from 0)."""
    n = values.jacobians[i].shape[-1]
    P = np.zeros((len(values.jacobians[i]), n, n))
    for J in values.jacobians[:i]:
        P = absorb(P, directions(J))
    return P


def freedom(values: Values, i: int) -> Array:
    """`outside_sines` (N, n) of level i relative to all levels above it."""
    return outside_sines(directions(values.jacobians[i]), projector_above(values, i))


def remaining_sine(i: int, *, gained: int, rank: int) -> Measure:
    """Measure: a sine (N,) that vanishes where level i loses one of the `gained` directions that it usually adds.

    The value is inf where the level's own Jacobian has less than its usual `rank`: the levels above do not cause that.
    """

    def measure(values: Values) -> Array:
        whole = directions(values.jacobians[i]).rank >= rank
        return np.where(whole, freedom(values, i)[:, gained - 1], np.inf)

    return measure


def task_strength(i: int, *, rank: int, size: float) -> Measure:
    """Measure: the rank-th singular value (N,) of J_i, divided by `size`; inf where the task is inactive."""

    def measure(values: Values) -> Array:
        s = np.linalg.svd(values.jacobians[i], compute_uv=False)
        return np.where(s[:, 0] > ZERO_ROW, s[:, rank - 1] / size, np.inf)

    return measure
