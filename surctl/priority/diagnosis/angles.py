"""Angles between the row spaces of tasks, and measures of how close a task is to a rank loss, for many samples."""

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
    """Return the sines (N, n), largest first, of the principal angles between a task's row space and range(P).

    Entries beyond the rank of the task are 0.

    The sines are the singular values of V(I − P), where V is an orthonormal basis of the row space. Unlike the singular
    values of J(I − P), the sines do not depend on the lengths of the rows of J, so a task with short rows does not look
    dependent.
    """
    s = np.linalg.svd(task.rows @ (np.eye(P.shape[-1]) - P), compute_uv=False)
    sines: Array = np.minimum(np.asarray(s, dtype=float), 1.0)
    return sines


def pair_angles(first: Directions, second: Directions) -> tuple[Array, Array]:
    """Return sine and cosine (N,) of the smallest principal angle between two row spaces (Björck and Golub 1973).

    Sine and cosine are both computed, so the angle is accurate near 0° and near 90°. The result is NaN where a row
    space is empty.
    """
    P, rank = first.projector, second.rank
    least = np.take_along_axis(outside_sines(second, P), np.maximum(rank - 1, 0)[..., None], axis=-1)[..., 0]
    cosine = np.minimum(np.linalg.norm(second.rows @ P, 2, axis=(-2, -1)), 1.0)
    none = (rank == 0) | (first.rank == 0)
    return np.where(none, np.nan, least), np.where(none, np.nan, cosine)


def smallest_angle(i: int, j: int) -> Measure:
    """Return a measure: the sine (N,) of the smallest angle between the row spaces of tasks i and j."""
    return lambda values: pair_angles(directions(values.jacobians[i]), directions(values.jacobians[j]))[0]


def projector_above(values: Values, i: int) -> Array:
    """Return the projector (N, n, n) on the row space of the tasks above level i (counted from 0)."""
    n = values.jacobians[i].shape[-1]
    P = np.zeros((len(values.jacobians[i]), n, n))
    for J in values.jacobians[:i]:
        P = absorb(P, directions(J))
    return P


def freedom(values: Values, i: int) -> Array:
    """Return `outside_sines` (N, n) of level i relative to all levels above level i."""
    return outside_sines(directions(values.jacobians[i]), projector_above(values, i))


def remaining_sine(i: int, *, gained: int, rank: int) -> Measure:
    """Return a measure: a sine (N,) that is 0 where level i loses one of the `gained` directions that it usually adds.

    The value is inf where the level's own Jacobian has less than its usual `rank`, because the levels above do not
    cause this rank loss.
    """

    def measure(values: Values) -> Array:
        whole = directions(values.jacobians[i]).rank >= rank
        return np.where(whole, freedom(values, i)[:, gained - 1], np.inf)

    return measure


def task_strength(i: int, *, rank: int, size: float) -> Measure:
    """Return a measure: singular value number `rank` (N,) of J_i, divided by `size`; inf where the task is inactive."""

    def measure(values: Values) -> Array:
        s = np.linalg.svd(values.jacobians[i], compute_uv=False)
        return np.where(s[:, 0] > ZERO_ROW, s[:, rank - 1] / size, np.inf)

    return measure
