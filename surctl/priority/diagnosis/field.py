"""The field of Jacobians that a diagnosis examines: structure for all poses, commutators, and angles between tasks.

The Jacobian of a task is J = A(η) R(ψ), where A = ∂σ/∂η and R is the orthogonal rotation matrix in equation (2) of the
paper. So J_iᵀJ_i commutes with the projector on the row space of the tasks above if and only if A_iᵀA_i commutes with
the corresponding projector formed from A. The tests use A, because A does not contain the sines and cosines of R, and
most A are constant.

True means that the property holds as an identity of the expressions. False means only that no identity was shown.

For all desired rates x_i, the NSB law, equation (16) of the paper, equals strict (lexicographic) priority

    v_i = v_{i−1} + (J_i N)⁺(x_i − J_i v_{i−1}),   N = I − P,   P the projector on the row space of all tasks above i

if and only if J_iᵀJ_i commutes with P at every level i ≥ 2, where J_i is the Jacobian of level i. The condition is
valid for Jacobians of any rank: a task may be rank-deficient, depend on the tasks above it, or have no freedom left.

All functions of this module accept arrays with additional leading axes, one entry for each sample: J (..., k, n).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir.symbolic import on_columns
from surctl.priority.diagnosis.findings import Region, pose_text
from surctl.priority.reference import row_space
from surctl.priority.settings import CUTOFF, ZERO_ROW
from surctl.tasks import Stack

Array: TypeAlias = NDArray[np.float64]

_ROUNDING = 1e-12  # constants of this size are rounding errors of zero


def world_jacobians(stack: Stack) -> list[ca.SX]:
    """Return A = ∂σ/∂η (k, 4) of each task, so that σ̇ = A η̇ in {E}; equal subexpressions are shared."""
    parts = [ca.jacobian(task.sigma, stack.eta) for task in stack.tasks]
    together = ca.cse(ca.vertcat(*parts))
    ends = np.cumsum([0, *(task.size for task in stack.tasks)])
    return [together[int(a) : int(b), :] for a, b in pairwise(ends)]


def commuting_levels(stack: Stack) -> tuple[bool, ...]:
    """Return for each level whether its commutator is zero for all poses η and all parameters.

    See module `commutator`. With A_i = ∂σ_i/∂η, the commutator of level i is zero if A_iᵀA_i maps the row space of the
    higher levels into itself, which is tested row by row, or if this row space contains all rows of A_i.
    """
    levels = world_jacobians(stack)
    rows = [[A[i, :].T for i in range(A.shape[0])] for A in levels]
    return tuple(_commutes(levels[i], [row for above in rows[:i] for row in above]) for i in range(len(levels)))


def orthogonal_pairs(stack: Stack) -> set[tuple[int, int]]:
    """Return the pairs (i, j), i < j, of tasks whose Jacobian rows are orthogonal for all poses and parameters."""
    levels = world_jacobians(stack)
    return {(i, j) for j, B in enumerate(levels) for i, A in enumerate(levels[:j]) if _vanishes(A @ B.T)}


def _commutes(A: ca.SX, above: list[ca.SX]) -> bool:
    """Return whether AᵀA maps the span of the vectors `above`, the rows of higher levels as columns, into itself.

    The return value is also valid if the dimension of the span varies from pose to pose.
    """
    # the span is range(P), P the projector on the constant rows, plus the parts of the other rows outside range(P)
    P = _projector([np.array(ca.DM(row)).ravel() for row in above if row.is_constant()], A.shape[1])
    outside = ca.SX(ca.sparsify(ca.DM(np.eye(A.shape[1]) - P)))
    moving = [b for b in (_clean(outside @ row) for row in above if not row.is_constant()) if b.nnz()]
    own = [_clean(outside @ A[i, :].T) for i in range(A.shape[0])]
    if all(a.nnz() == 0 or any(_vanishes(a - b) or _vanishes(a + b) for b in moving) for a in own):
        return True
    G = _clean(outside @ A.T @ A)
    if not _vanishes(G @ ca.SX(ca.sparsify(ca.DM(P)))):
        return False
    factors = _eigenvalues(A)
    images = [(G @ b, b) for b in moving]
    return all(any(_vanishes(image - factor * b) for factor in factors) for image, b in images)


def _projector(rows: list[Array], n: int) -> Array:
    if not rows:
        return np.zeros((n, n))
    basis = row_space(np.array(rows)).rows
    P: Array = basis.T @ basis
    return np.where(np.abs(P - np.round(P)) <= _ROUNDING, np.round(P), P)


def _eigenvalues(A: ca.SX) -> list[float]:
    """Return 0 and, if AᵀA is constant, the eigenvalues of AᵀA."""
    if not A.is_constant():
        return [0.0]
    squares = np.linalg.svd(np.array(ca.DM(A)), compute_uv=False) ** 2
    return [0.0, *(float(np.round(s)) if abs(s - np.round(s)) <= _ROUNDING else float(s) for s in squares)]


def _clean(expression: ca.SX) -> ca.SX:
    entries = ca.SX(*expression.shape)
    simple = ca.simplify(expression)
    for i, j in zip(*simple.sparsity().get_triplet(), strict=True):
        entry = simple[i, j]
        if not (entry.is_constant() and abs(float(entry)) <= _ROUNDING):
            entries[i, j] = entry
    return entries


def _vanishes(expression: ca.SX) -> bool:
    return bool(_clean(expression).nnz() == 0)


_STEP = 1e-7  # in units of the unit box, for finite differences
_APART = 0.1  # least distance between two starts, in unit boxes, times the root of the dimension


@dataclass(frozen=True, eq=False)
class Values:
    """Jacobians and desired rates of all tasks of a stack at N points (poses and parameters).

    Attributes:
        jacobians: Jacobians (N, k, 4) of each task.
        references: desired values (N, k) of σ̇ of each task [unit of σ per second].
        turning: length (N,) [m or rad] of a step in the pose η that may reverse a row of ∂σ/∂η, for each task: the
            smallest ‖a‖/‖∂a/∂η‖ over the rows a, inf if no row changes. The length goes to 0 at a singular point of the
            task, such as the point from which a distance is measured.
    """

    jacobians: list[Array]
    references: list[Array]
    turning: list[Array]


Measure: TypeAlias = Callable[[Values], Array]
"""A function that returns one non-negative number (N,) for each point; inf or NaN where it is undefined."""


@dataclass(frozen=True, eq=False)
class Field:
    """A task stack, compiled to a numeric function of pose and parameters, and the region of these variables.

    Attributes:
        names: names of the tasks. sizes: number of rows of each task. units: unit of σ̇ of each task.
        region: the region of poses and parameters.
        function: function of points (d, N) of the region. Its output is one array whose columns contain, for one task
            after another, the Jacobian column by column, the desired rate, and ‖a‖² and ‖∂a/∂η‖² of each row a of
            ∂σ/∂η.
    """

    names: tuple[str, ...]
    sizes: tuple[int, ...]
    units: tuple[str, ...]
    region: Region
    function: Callable[[Array], list[Array]]

    def at(self, points: Array) -> Values:
        """Evaluate all tasks at points (N, d); numbers that are not finite are returned unchanged."""
        column = self.function(points.T)[0].T
        values, start = Values([], [], []), 0
        for k in self.sizes:
            J, x, square, change = np.split(column[:, start : start + 7 * k], [4 * k, 5 * k, 6 * k], axis=1)
            values.jacobians.append(J.reshape(-1, 4, k).swapaxes(1, 2))
            values.references.append(x)
            moves = (change > 0.0) & (square > 0.0)
            ratio = np.where(moves, square, np.inf) / np.where(moves, change, 1.0)
            values.turning.append(np.sqrt(ratio.min(axis=1)))
            start += 7 * k
        return values

    def require_finite(self, values: Values, points: Array) -> None:
        """Raise an InputError that names task and pose if a Jacobian or a desired rate is not finite."""
        for name, J, x in zip(self.names, values.jacobians, values.references, strict=True):
            broken = np.flatnonzero(~(np.isfinite(J).all(axis=(1, 2)) & np.isfinite(x).all(axis=1)))
            if broken.size:
                where = pose_text(self.region.pose(points[broken[0]]))
                raise InputError(f"is not finite at {where}", key=f"task {name}", remedy="exclude that pose")


def build_field(stack: Stack, region: Region) -> Field:
    """Compile a task stack for evaluation over a region from `build_region`."""
    parts = []
    for (J, x), A in zip(stack.levels(), world_jacobians(stack), strict=True):
        square = ca.sum2(A**2)
        change = [ca.sumsqr(ca.jacobian(A[i, :], stack.eta)) for i in range(J.shape[0])]
        parts += [ca.vec(J), x, square, *change]
    column = ca.densify(ca.vertcat(*parts))
    function = on_columns(ca.Function("field", [region.symbols], [column]))
    sizes, units = tuple(task.size for task in stack.tasks), tuple(task.rate_unit for task in stack.tasks)
    return Field(stack.names, sizes, units, region, function)


def best_of(measure: Array, unit: Array, *, most: int) -> NDArray[np.intp]:
    """Return the indices of up to `most` samples with the smallest finite measures (N,), at some distance apart."""
    order = np.argsort(measure, kind="stable")
    left = order[np.isfinite(measure[order])]
    chosen: list[np.intp] = []
    while left.size and len(chosen) < most:
        chosen.append(left[0])
        distance = np.linalg.norm(unit[left] - unit[left[0]], axis=1)
        left = left[distance > _APART * np.sqrt(unit.shape[1])]
    return np.array(chosen, dtype=np.intp)


def descend(field: Field, measure: Measure, start: Array) -> tuple[Array, float]:
    """Return a point (d,) at which `measure` has a local minimum, and this minimum, by a search from `start` (f,).

    `start` is in the unit box: coordinates of the f free variables of the region, scaled to 0 … 1. The search uses
    L-BFGS-B with central differences on the squared measure, because a distance or a sine that reaches 0 is not smooth
    there, but its square is. The returned minimum is never larger than the measure at the start.
    """
    from scipy.optimize import minimize

    begin = _value(field, measure, start[None])[0]
    if not np.isfinite(begin) or begin == 0.0 or start.size == 0:
        return field.region.place(start[None])[0], float(begin)
    run = minimize(
        lambda u: _slope(field, measure, u, scale=begin),
        start,
        jac=True,
        bounds=[(0.0, 1.0)] * start.size,
        method="L-BFGS-B",
        options={"maxiter": 60, "ftol": 1e-18, "gtol": 1e-12},
    )
    end = np.asarray(run.x, dtype=float)
    reached = _value(field, measure, end[None])[0]
    point, value = (end, reached) if reached <= begin else (start, begin)
    return field.region.place(point[None])[0], float(value)


def _value(field: Field, measure: Measure, unit: Array) -> Array:
    """Return the measure (N,) at points of the unit box (the scaled region); inf where a Jacobian is not finite."""
    values = field.at(field.region.place(unit))
    finite = np.logical_and.reduce([np.isfinite(J).all(axis=(1, 2)) for J in values.jacobians])
    cleaned = [np.where(finite[:, None, None], J, 0.0) for J in values.jacobians]
    measured = measure(Values(cleaned, values.references, values.turning))
    return np.where(finite & ~np.isnan(measured), measured, np.inf)


def _slope(field: Field, measure: Measure, u: Array, *, scale: float) -> tuple[float, Array]:
    """Return q = min((m/scale)², 2) at a point u (f,) of the unit box, and the gradient (f,) of q with respect to u.

    u holds the f free variables of the region, scaled to 0 … 1. m is the value of the function `measure` at u; inf if a
    Jacobian is not finite or the value is NaN. `scale` > 0 is a constant divisor. The gradient is computed by finite
    differences.
    """
    steps = _STEP * np.eye(u.size)
    around = np.clip(np.vstack([u[None], u + steps, u - steps]), 0.0, 1.0)
    # where the measure is undefined it is capped at a value just high enough to shorten a step that ends there
    values = np.minimum((_value(field, measure, around) / scale) ** 2, 2.0)
    ahead, behind = values[1 : u.size + 1], values[u.size + 1 :]
    width = (around[1 : u.size + 1] - around[u.size + 1 :]).diagonal()
    return float(values[0]), (ahead - behind) / width


TOLERANCE = 1e-9
"""Commutators up to this norm count as zero: far above rounding errors (1e-15), and above the cut-off for ranks."""


@dataclass(frozen=True, eq=False)
class Directions:
    """Right singular vectors and singular values of J (..., k, n); singular values below a cut-off are set to 0.

    Attributes:
        vectors: (..., n, n), unit vectors as rows, largest singular value first.
        s: (..., n), singular values [unit of J]; 0 in the null space.
    """

    vectors: Array
    s: Array

    @property
    def rank(self) -> NDArray[np.intp]:
        """Return the number (...,) of nonzero singular values."""
        count: NDArray[np.intp] = np.asarray(np.count_nonzero(self.s, axis=-1), dtype=np.intp)
        return count

    @property
    def rows(self) -> Array:
        """Return an orthonormal basis (..., n, n) of the row space, one vector in each row, followed by zero rows."""
        basis: Array = self.vectors * (self.s > 0.0)[..., None]
        return basis

    @property
    def projector(self) -> Array:
        """Return the orthogonal projector (..., n, n) on the row space."""
        product: Array = np.swapaxes(self.rows, -1, -2) @ self.rows
        return product


def directions(J: Array, *, cutoff: float = CUTOFF) -> Directions:
    """Return the singular vectors and values of J (..., k, n); values up to `cutoff`·‖J‖ or `ZERO_ROW` count as 0."""
    _, singular, vectors = np.linalg.svd(J, full_matrices=True)
    s = np.zeros(vectors.shape[:-1])
    s[..., : singular.shape[-1]] = singular
    return Directions(vectors, np.where(s > np.maximum(cutoff * s[..., :1], ZERO_ROW), s, 0.0))


def _absorb(P: Array, task: Directions) -> Array:
    """Return the projector on the sum of the range of P (..., n, n) and the row space of a task."""
    N = np.eye(P.shape[-1]) - P
    _, s, vectors = np.linalg.svd(task.rows @ N)
    new = vectors @ N * (s > CUTOFF)[..., None]  # N again, because a short remainder has lost digits
    enlarged: Array = P + np.swapaxes(new, -1, -2) @ new
    return enlarged


# Sketch of the proof of the condition. With x_i = 0, both laws for the first i levels must equal the laws for the first
# i − 1 levels inside range(P), because strict priority uses all of range(P) for the levels above i. So the correction
# by level i vanishes in range(P): (J_i N)⁺J_i P = 0, which means N J_iᵀJ_i P = 0. Conversely, N then commutes with
# J_iᵀJ_i, hence with J_i⁺J_i, so that (J_i N)⁺ = N J_i⁺, and N_1 ⋯ N_i projects on the intersection of the null spaces.
def commutator_norms(jacobians: Sequence[Array]) -> Array:
    """Return, for each level i, a norm of the commutator of J_iᵀJ_i and P, (..., levels); 0 for the first level.

    J_i is the Jacobian of level i, and P the projector on the row space of all levels above. The commutator is J_iᵀJ_i
    P − P J_iᵀJ_i, written in the basis of the right singular vectors of J_i. Its entry (a, b) is divided by s_a² +
    s_b², where s are the singular values of J_i; the returned number is the spectral norm of this matrix. This norm has
    no unit, is at most 1/2 for a task of one row and √(n/8) for any task, and is zero if and only if the commutator is
    zero. The division makes short rows of J_i count as much as long rows, because short rows affect both laws as much
    as long rows do.

    Args:
        jacobians: J (..., k, n) of each level, highest priority first.

    Raises:
        InputError: there is no level, the Jacobians have different numbers of columns, or a number is not finite; the
            message names the level.
    """
    levels = _checked(jacobians)
    n = levels[0].shape[-1]
    P = np.zeros((*np.broadcast_shapes(*(J.shape[:-2] for J in levels)), n, n))
    norms = np.zeros((*P.shape[:-2], len(levels)))
    for i, J in enumerate(levels):
        task = directions(J)
        norms[..., i] = _norm(task, P)
        P = _absorb(P, task)
    return norms


def equals_strict_priority(jacobians: Sequence[Array], *, tol: float = TOLERANCE) -> bool:
    """Return whether NSB equals strict priority for all desired rates, that is, no commutator norm exceeds `tol`.

    Args:
        jacobians: J (k, n) of each level, highest priority first; with leading axes for samples, the condition must
            hold at all samples.
        tol: largest value of `commutator_norms` that counts as zero.

    Raises:
        InputError: as in `commutator_norms`.
    """
    return bool((commutator_norms(jacobians) <= tol).all())


def _norm(task: Directions, P: Array) -> Array:
    square = (task.s / np.where(task.s[..., :1] > 0.0, task.s[..., :1], 1.0)) ** 2
    total = square[..., :, None] + square[..., None, :]
    weight = (square[..., None, :] - square[..., :, None]) / np.where(total > 0.0, total, 1.0)
    inside = task.vectors @ P @ np.swapaxes(task.vectors, -1, -2)
    norm: Array = np.linalg.norm(weight * inside, 2, axis=(-2, -1))
    return norm


def _checked(jacobians: Sequence[Array]) -> list[Array]:
    levels = [np.asarray(J, dtype=float) for J in jacobians]
    if not levels:
        raise InputError("has no level", key="jacobians", remedy="give at least one")
    for place, J in enumerate(levels, start=1):
        if J.ndim < 2 or 0 in J.shape or J.shape[-1] != levels[0].shape[-1]:
            remedy = "give (k, n), with the same n for all levels"
            raise InputError(f"J has shape {J.shape}", key=f"level {place}", remedy=remedy)
        if not np.isfinite(J).all():
            raise InputError("J is not finite", key=f"level {place}", remedy="check the inputs for NaN first")
    return levels


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
        P = _absorb(P, directions(J))
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
