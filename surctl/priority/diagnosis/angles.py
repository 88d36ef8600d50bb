"""Angles between row spaces, and how near a task or what is left of it is to losing rank; for many samples."""

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

    They are the singular values of V(I − P) with V an orthonormal basis of the rows: those of J(I − P) without the
    lengths of J's own rows, so that a weak task is not taken for a dependent one.
    """
    s = np.linalg.svd(task.rows @ (np.eye(P.shape[-1]) - P), compute_uv=False)
    sines: Array = np.minimum(np.asarray(s, dtype=float), 1.0)
    return sines


def pair_angles(first: Directions, second: Directions) -> tuple[Array, Array]:
    """Sine and cosine (N,) of the smallest principal angle between two row spaces (Björck and Golub 1973).

    Both are computed, so that the angle is exact near 0 and near 90 degrees. NaN where one of them is empty.
    """
    P, rank = first.projector, second.rank
    least = np.take_along_axis(outside_sines(second, P), np.maximum(rank - 1, 0)[..., None], axis=-1)[..., 0]
    cosine = np.minimum(np.linalg.norm(second.rows @ P, 2, axis=(-2, -1)), 1.0)
    none = (rank == 0) | (first.rank == 0)
    return np.where(none, np.nan, least), np.where(none, np.nan, cosine)


def smallest_angle(i: int, j: int) -> Measure:
    """The measure: sine (N,) of the smallest angle between tasks i and j."""
    return lambda values: pair_angles(directions(values.jacobians[i]), directions(values.jacobians[j]))[0]


def projector_above(values: Values, i: int) -> Array:
    """(N, n, n), on the row space of the tasks above level i (counted from 0)."""
    n = values.jacobians[i].shape[-1]
    P = np.zeros((len(values.jacobians[i]), n, n))
    for J in values.jacobians[:i]:
        P = absorb(P, directions(J))
    return P


def freedom(values: Values, i: int) -> Array:
    """`outside_sines` (N, n) of level i against all levels above it."""
    return outside_sines(directions(values.jacobians[i]), projector_above(values, i))


def remaining_sine(i: int, *, gained: int, rank: int) -> Measure:
    """The measure: the sine (N,) that vanishes where level i loses one of the `gained` directions it usually finds.

    inf where its own Jacobian is below its usual `rank`: that is no matter of the levels above.
    """

    def measure(values: Values) -> Array:
        whole = directions(values.jacobians[i]).rank >= rank
        return np.where(whole, freedom(values, i)[:, gained - 1], np.inf)

    return measure


def task_strength(i: int, *, rank: int, size: float) -> Measure:
    """The measure: the rank-th singular value (N,) of J_i, in parts of `size`; inf where the task is inactive."""

    def measure(values: Values) -> Array:
        s = np.linalg.svd(values.jacobians[i], compute_uv=False)
        return np.where(s[:, 0] > ZERO_ROW, s[:, rank - 1] / size, np.inf)

    return measure
