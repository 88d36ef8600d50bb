"""The velocity nearest to a target within constraints, as a Python function of arrays that calls compiled code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir import runnable
from surctl.priority.solver.dual_step import Space
from surctl.priority.solver.fallback import CLAMPED, safe_step
from surctl.priority.solver.kernel import in_blocks, kernel
from surctl.priority.solver.precision import LONGEST

__all__ = ["SafePoint", "Stage", "idle_row", "least_distance", "nearest_to_zero", "step_runner"]

Array: TypeAlias = NDArray[np.float64]
Runner: TypeAlias = Callable[..., list[Array]]
Stage: TypeAlias = Literal["met", "limited", "relaxed", "clamped", "bounded", "unconfirmed"]
"""met: v meets the task and satisfies all constraint rows. limited: the task is met as well as the rows allow. relaxed:
soft rows are relaxed. clamped: v is only clipped to the box. bounded: v comes from the bounded fallback, see module
`bounded`. unconfirmed: only in a priority step: v was not shown to be optimal."""

_STAGES: tuple[Stage, ...] = get_args(Stage)
_BUCKET = 8  # rows are padded to a multiple of this, to limit the number of compiled sizes


@dataclass(frozen=True, eq=False)
class SafePoint:
    """Result of `least_distance`: the nearest velocity, active constraints, and the fallback stage.

    Attributes:
        v: velocity (n,), always finite and inside the box.
        stage: which fallback stage computed v; see module `fallback`.
        binding: (name, Lagrange multiplier) of each active constraint row in min ½‖v − target‖², for the row as given;
            positive at an upper bound, negative at a lower bound. Empty if v was not computed as the nearest velocity.
        opening: amount by which the bounds of soft constraint rows had to be moved outwards [row of length 1].
        iterations: number of active-set iterations of all stages together.
    """

    v: Array
    stage: Stage
    binding: tuple[tuple[str, float], ...]
    opening: float
    iterations: int


@cache
def step_runner(n: int, p: int, m: int) -> Runner:
    """Return a function that runs `safe_step` for n velocities, p rows of J and m constraint rows, compiled once.

    Without a C compiler, `replay` computes the same numbers more slowly.
    """
    return runnable(safe_step(n, p, m))


@cache
def _nearest(d: int, m: int) -> Runner:
    return runnable(kernel(Space(d, d), m))


def least_distance(
    target: ArrayLike,
    *,
    A: ArrayLike,
    lower: ArrayLike,
    upper: ArrayLike,
    J: ArrayLike | None = None,
    x: ArrayLike | None = None,
    soft: ArrayLike | None = None,
    box: tuple[ArrayLike, ArrayLike] | None = None,
    names: tuple[str, ...] | None = None,
) -> SafePoint:
    """Return the velocity v nearest to `target` (n,) that satisfies J v = x and lower ≤ A v ≤ upper.

    If there is no such v, meet J v = x as well as the constraint rows allow; if these contradict each other, relax the
    soft ones. Module `fallback` describes these stages.

    v is exact to rounding, with two exceptions. If nearly parallel rows of A contradict each other, the relaxation is
    the smallest possible, but the residual of J v = x may be larger than necessary (by 1e-11 divided by the angle
    between the rows). If the constraint rows have common points only far away (at 1e9 times the size of the box), they
    are relaxed.

    Args:
        target: (n,) velocity.
        A: (m, n), normals of the constraint rows, of any length. lower, upper: (m,), bounds of A v; an absent bound is
            ±inf.
        J, x: the task J v = x, (p, n) and (p,). None: no task.
        soft: (m,), true for constraint rows that may be relaxed if the rows contradict each other. None: all may.
        box: lower (n,) and upper (n,), bounds to which v is clipped at the end. None: no box. The constraint rows must
            contain these bounds too.
        names: names of the constraint rows; None means "row 0", "row 1", …

    Raises:
        InputError: the shapes of the arrays disagree, a number is not finite, an entry of A or J exceeds 1e140, or
            lower > upper; the message names the constraint row.

    Example:
        >>> import numpy as np
        >>> from surctl.priority import least_distance
        >>> found = least_distance([0.3, 0.4], A=[[1.0, 0.0]], lower=[-np.inf], upper=[0.1], names=("wall",))
        >>> found.v.round(3).tolist(), found.stage, [(name, round(force, 3)) for name, force in found.binding]
        ([0.1, 0.4], 'met', [('wall', 0.2)])
    """
    goal = _array("target", target, (None,))
    n = goal.size
    rows, names = _rows(n, A, lower, upper, soft, names)
    matrix = _array("J", np.zeros((1, n)) if J is None else J, (None, n))
    value = _array("x", np.zeros(1) if x is None else x, (matrix.shape[0],))
    if J is None and value.any():
        raise InputError("requires J", key="x")
    limits = np.array([np.full(n, -np.inf), np.full(n, np.inf)]) if box is None else _box(box, n)
    m = max(_BUCKET, -(-len(rows) // _BUCKET) * _BUCKET)
    for key, value_of in (("A", rows[:, :n]), ("J", matrix)):
        for i in np.flatnonzero(np.abs(value_of).max(axis=1, initial=0.0) > LONGEST)[:1]:
            raise InputError(
                "is too large to be squared", key=f"{key}[{i}]", value=value_of[i].tolist(), remedy="use SI units"
            )
    padded = np.vstack([rows, np.tile(idle_row(n), (m - len(rows), 1))])
    if matrix.shape[0] == 0:
        matrix, value = np.zeros((1, n)), np.zeros(1)
    v, active, multipliers, opening, status, count = step_runner(n, matrix.shape[0], m)(
        goal, matrix.reshape(-1), value, padded.reshape(-1), limits.reshape(-1)
    )
    solved = int(status[0]) != CLAMPED
    binding = tuple(
        (names[int(abs(k)) - 1], float(np.sign(k) * u / _length(rows[int(abs(k)) - 1, :n])))
        for k, u in zip(active, multipliers, strict=True)
        if k != 0.0 and solved
    )
    return SafePoint(v, _STAGES[int(status[0]) - 1], binding, float(opening[0]), int(count[0]))


def nearest_to_zero(G: Array, lower: Array, upper: Array) -> tuple[Array, Array, int, int]:
    """Find the y (d,) nearest to 0 with lower ≤ G y ≤ upper, for G (m, d) with rows of length 1.

    Return y, the Lagrange multipliers (m,), the status, and the number of iterations.

    The status is one of the values in module `dual_step`, or 0 if the iteration limit was reached.
    """
    m, d = G.shape
    size = -(-m // _BUCKET) * _BUCKET
    rows = np.tile(idle_row(d), (size, 1))
    rows[:m, :d], rows[:m, d], rows[:m, d + 1] = G, lower, upper
    point, numbers, u, status, count = _nearest(d, size)(
        in_blocks(rows), np.zeros(d + 1), np.zeros(1), np.eye(d).reshape(-1)
    )
    multipliers = np.zeros(size)
    used = numbers != 0.0
    multipliers[np.abs(numbers[used]).astype(int) - 1] = np.sign(numbers[used]) * u[used]
    return point[:d], multipliers[:m], int(status[0]), int(count[0])


def idle_row(n: int) -> Array:
    """Return a constraint row that every velocity satisfies."""
    return np.concatenate([np.zeros(n), [-np.inf, np.inf, 0.0]])


def _length(a: Array) -> float:
    length = float(np.sqrt(a @ a))
    return length if length > 0.0 else 1.0


def _rows(
    n: int, A: ArrayLike, lower: ArrayLike, upper: ArrayLike, soft: ArrayLike | None, names: tuple[str, ...] | None
) -> tuple[Array, tuple[str, ...]]:
    normals = _array("A", A, (None, n))
    m = len(normals)
    named = tuple(f"row {i}" for i in range(m)) if names is None else names
    if len(named) != m:
        raise InputError(f"has {len(named)} entries, but A has {m} rows", key="names")
    low, high = _array("lower", lower, (m,), finite=False), _array("upper", upper, (m,), finite=False)
    opens = np.ones(m) if soft is None else (_array("soft", soft, (m,)) != 0.0).astype(float)
    for name, below, above in zip(named, low, high, strict=True):
        _check_bounds(f"limit {name}", float(below), float(above))
    return np.column_stack([normals, low, high, opens]), named


def _box(box: tuple[ArrayLike, ArrayLike], n: int) -> Array:
    limits = np.array([_array("box", side, (n,), finite=False) for side in box])
    for i, (low, high) in enumerate(limits.T):
        _check_bounds(f"box[{i}]", float(low), float(high))
    return limits


def _check_bounds(key: str, low: float, high: float) -> None:
    if not low <= high or low == np.inf or high == -np.inf:
        raise InputError(
            "bounds exclude every velocity", key=key, value=[low, high], remedy="give lower <= upper, no NaN"
        )


def _array(key: str, value: ArrayLike, shape: tuple[int | None, ...], *, finite: bool = True) -> Array:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("is not an array of numbers", key=key, value=value) from None
    if array.ndim != len(shape) or any(s is not None and s != a for s, a in zip(shape, array.shape, strict=True)):
        expected = tuple("any" if s is None else s for s in shape)
        raise InputError(f"has shape {array.shape}, expected {expected}", key=key)
    if finite and not np.isfinite(array).all():
        bad = int(np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))[0])
        raise InputError(
            "is not finite", key=f"{key}[{bad}]", value=array[bad].tolist(), remedy="check the inputs for NaN first"
        )
    return array
