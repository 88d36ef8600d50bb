"""Angles between the row spaces of task Jacobians, and how close a task is to a rank loss, for many sample poses."""

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
    """Return the sines (N, n), largest first, of the principal angles between a task's row space and the range of P.

    N is the number of samples, and P the projector on the row space of other tasks. Entries beyond the rank of the task
    are 0.

    The sines are the singular values of V(I − P), where V is an orthonormal basis of the task's row space. They do not
    depend on the lengths of the Jacobian's rows, so a task with short rows is not mistaken for a dependent one.
    """
    s = np.linalg.svd(task.rows @ (np.eye(P.shape[-1]) - P), compute_uv=False)
    sines: Array = np.minimum(np.asarray(s, dtype=float), 1.0)
    return sines


def pair_angles(first: Directions, second: Directions) -> tuple[Array, Array]:
    """Return sine and cosine (N,) of the smallest principal angle between two row spaces at N samples.

    Sine and cosine are computed independently (Björck and Golub 1973), so the angle is accurate near 0° and near 90°.
    Both are NaN at samples where a row space is empty.
    """
    P, rank = first.projector, second.rank
    least = np.take_along_axis(outside_sines(second, P), np.maximum(rank - 1, 0)[..., None], axis=-1)[..., 0]
    cosine = np.minimum(np.linalg.norm(second.rows @ P, 2, axis=(-2, -1)), 1.0)
    none = (rank == 0) | (first.rank == 0)
    return np.where(none, np.nan, least), np.where(none, np.nan, cosine)


def smallest_angle(i: int, j: int) -> Measure:
    """Return a function that computes the sine (N,) of the smallest angle between the row spaces of tasks i and j."""
    return lambda values: pair_angles(directions(values.jacobians[i]), directions(values.jacobians[j]))[0]


def projector_above(values: Values, i: int) -> Array:
    """Return the projectors (N, n, n), one for each sample, on the row space of all tasks above level i (from 0)."""
    n = values.jacobians[i].shape[-1]
    P = np.zeros((len(values.jacobians[i]), n, n))
    for J in values.jacobians[:i]:
        P = absorb(P, directions(J))
    return P


def freedom(values: Values, i: int) -> Array:
    """Return the sines (N, n) of the principal angles between the row space of level i and that of all levels above."""
    return outside_sines(directions(values.jacobians[i]), projector_above(values, i))


def remaining_sine(i: int, *, gained: int, rank: int) -> Measure:
    """Return a function that measures how close level i is to a rank loss due to the levels above, as a sine (N,).

    Level i usually adds `gained` directions to the row space of the levels above. The sine is 0 at samples where one of
    these directions is lost. It is inf where the level's own Jacobian has less than its usual `rank`, because the
    levels above do not cause this rank loss.
    """

    def measure(values: Values) -> Array:
        whole = directions(values.jacobians[i]).rank >= rank
        return np.where(whole, freedom(values, i)[:, gained - 1], np.inf)

    return measure


def task_strength(i: int, *, rank: int, size: float) -> Measure:
    """Return a function that measures how close the Jacobian of task i is to a rank loss, by a singular value (N,).

    The measure is singular value number `rank` divided by `size`; inf where the task is inactive.
    """

    def measure(values: Values) -> Array:
        s = np.linalg.svd(values.jacobians[i], compute_uv=False)
        return np.where(s[:, 0] > ZERO_ROW, s[:, rank - 1] / size, np.inf)

    return measure
