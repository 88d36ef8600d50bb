"""The least-distance problem min ‖v − target‖ subject to equalities and inequalities, with a choice of solvers.

Equalities are eliminated first, and the normal of each inequality is scaled to length 1. This module checks the
optimality conditions of every solution and does not rely on the status that a solver reports.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any, Literal, Protocol, TypeAlias

import daqp
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.priority.settings import CUTOFF, ZERO_ROW

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class RowSpace:
    """A singular value decomposition J = left · diag(s) · rows, without singular values below the cut-off.

    Attributes:
        left: (k, r), orthonormal columns.
        s: (r,), singular values, all positive.
        rows: (r, n), an orthonormal basis of the row space.
        null: (n − r, n), an orthonormal basis of the null space.
    """

    left: Array
    s: Array
    rows: Array
    null: Array

    def pinv(self) -> Array:
        """Return the pseudo-inverse J⁺, (n, k)."""
        return (self.rows.T / self.s) @ self.left.T

    def particular(self, x: Array) -> Array:
        """Return the product J⁺x, (n,)."""
        return self.rows.T @ ((self.left.T @ x) / self.s)


def row_space(J: Array, *, cutoff: float = CUTOFF, scale: float | None = None) -> RowSpace:
    """Decompose J (k, n) without singular values below `cutoff`·`scale` or `ZERO_ROW`; `scale` None means ‖J‖."""
    left, s, rows = np.linalg.svd(J, full_matrices=True)
    largest = scale if scale is not None else float(s[0]) if s.size else 0.0
    rank = int(np.count_nonzero(s > max(cutoff * largest, ZERO_ROW)))
    return RowSpace(left[:, :rank], s[:rank], rows[:rank], rows[rank:])


def project(w: Array, J: Array, *, x: Array) -> Array:
    """Return, of all z that minimise ‖J z − x‖, the one nearest to w (n,), which is w + J⁺(x − J w).

    This also holds for a rank-deficient J.
    """
    if J.shape[0] == 1:
        row = J[0]
        square = row @ row
        return w if square <= ZERO_ROW**2 else w + row * ((x[0] - row @ w) / square)
    space = row_space(J)
    # J w is not computed, because its error would be divided by the smallest singular value
    moved: Array = w + space.rows.T @ ((space.left.T @ x) / space.s - space.rows @ w)
    return moved


_NO_BOUND = 1e30  # the value that DAQP uses for infinity
_DAQP_TOLERANCE = 1e-11  # largest violation of an inequality that DAQP accepts, for a normal of length 1
_DAQP_INFEASIBLE = -1


@dataclass(frozen=True)
class KernelSolution:
    """Result of one call of a QP solver.

    y: (d,), the minimiser, or None. multipliers: (m,) Lagrange multipliers, with y + Gᵀ·multipliers = 0. iterations:
    number of iterations. status: the status that the solver reports.

    The status "unfinished" means that the solver stopped early, for example at an iteration limit; y is its last
    iterate.
    """

    y: Array | None
    multipliers: Array
    iterations: int
    status: Literal["optimal", "unfinished", "infeasible", "failed"]


class Kernel(Protocol):
    """Protocol of a solver of min ½‖y‖² subject to lower ≤ G y ≤ upper: a function or an object that stores state."""

    def __call__(self, G: Array, lower: Array, upper: Array, /) -> KernelSolution:
        """Solve the problem for G (m, d), whose rows have length 1, and bounds (m,); an absent bound is ±inf."""
        ...


def _daqp(G: Array, lower: Array, upper: Array) -> KernelSolution:
    """Solve the QP with DAQP (Arnström, Bemporad and Axehill 2022), a dual active-set method; check its exit flag."""
    m, d = G.shape
    y, _, flag, info = daqp.solve(
        np.eye(d),
        np.zeros(d),
        np.ascontiguousarray(G),
        np.minimum(upper, _NO_BOUND),
        np.maximum(lower, -_NO_BOUND),
        np.zeros(m, dtype=np.intc),
        primal_tol=_DAQP_TOLERANCE,
    )
    iterations = int(info["iterations"])
    if flag == 1:
        return KernelSolution(np.array(y, dtype=float), np.array(info["lam"], dtype=float), iterations, "optimal")
    return KernelSolution(None, np.zeros(m), iterations, "infeasible" if flag == _DAQP_INFEASIBLE else "failed")


_TIGHT: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    # with its default tolerances, OSQP violates bounds by 1e-3; polishing prints to the terminal, and `_polish` follows
    {"osqp": {"eps_abs": 1e-10, "eps_rel": 1e-10, "eps_prim_inf": 1e-10, "max_iter": 20_000, "polishing": False}}
)


def _qpsolvers_kernels() -> dict[str, Kernel]:
    """Return, by name, a `Kernel` for each QP solver that the package qpsolvers (Caron et al.) finds, except DAQP."""
    import qpsolvers

    names = sorted(set(qpsolvers.available_solvers) - {"daqp"}, key=lambda name: (name != "osqp", name))
    return {name: partial(_qpsolvers_kernel, solver=name) for name in names}


def _qpsolvers_kernel(G: Array, lower: Array, upper: Array, *, solver: str) -> KernelSolution:
    import qpsolvers
    from scipy import sparse

    m, d = G.shape
    below, above = np.flatnonzero(lower > -_NO_BOUND), np.flatnonzero(upper < _NO_BOUND)
    # qpsolvers accepts one-sided rows only, and an infinite bound breaks its own check
    rows, bounds = np.vstack([G[above], -G[below]]), np.concatenate([upper[above], -lower[below]])
    form = sparse.csc_matrix if solver in qpsolvers.sparse_solvers else np.asarray
    problem = qpsolvers.Problem(form(np.eye(d)), np.zeros(d), G=form(rows), h=bounds)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the returned status already contains the warning "terminated with status ..."
        solution = qpsolvers.solve_problem(problem, solver=solver, **_TIGHT.get(solver, {}))
    x, z = solution.x, solution.z
    if x is None or z is None or not (np.isfinite(x).all() and np.isfinite(z).all()):
        # a solver without a solution rarely reports why, so this is not treated as a proof of infeasibility
        return KernelSolution(None, np.zeros(m), 0, "failed")
    multipliers = np.zeros(m)
    multipliers[above] += z[: len(above)]
    multipliers[below] -= z[len(above) :]
    done: Literal["optimal", "unfinished"] = "optimal" if solution.found else "unfinished"
    return KernelSolution(np.asarray(x, dtype=float), multipliers, 0, done)


Status: TypeAlias = Literal["optimal", "infeasible", "failed"]


class _Solvers(Mapping[str, Kernel]):
    # any name but "daqp" imports qpsolvers, which loads every installed solver
    @cached_property
    def _all(self) -> Mapping[str, Kernel]:
        return {"daqp": _daqp, **_qpsolvers_kernels()}

    def __getitem__(self, name: str) -> Kernel:
        return _daqp if name == "daqp" else self._all[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)


BACKENDS: Mapping[str, Kernel] = _Solvers()
"""Kernels by name, for "daqp" and each solver that qpsolvers finds: each minimises ½‖y‖² subject to lower ≤ G y ≤
upper, with rows of length 1."""

Backend: TypeAlias = str | Kernel
"""A name in `BACKENDS`, or a function or object that solves the problem of `Kernel`."""

FEASIBLE = 1e-9
"""Largest violation of a row (as passed in), relative to 1 + max |v|, that is accepted as rounding."""

_FAR = 1e3  # times 1 + max |x|: a target farther away than this is moved closer
_ROUNDS = 20
_STAYS = 1e-14
_STATIONARY = 1e-8
_FIXED = 1e-9  # a row that elimination shortens to this fraction no longer depends on the remaining variables


@dataclass(frozen=True)
class LeastDistance:
    """Result of `solve_least_distance`: the nearest point, Lagrange multipliers and the status.

    Attributes:
        x: the nearest point (n,), or None unless `status` is "optimal".
        multipliers: (m,) Lagrange multiplier of each row of A in min ½‖x − target‖², for the row as given; positive at
            an upper bound, negative at a lower bound.
        iterations: number of iterations of the QP solver.
        status: "optimal"; "infeasible" if no point satisfies inequalities and equalities; "failed" if the solver
            returned no point that satisfies the optimality conditions.
    """

    x: Array | None
    multipliers: Array
    iterations: int
    status: Status


def check_backend(backend: Backend) -> Kernel:
    """Return the QP solver function with the name `backend`, or `backend` itself if it is a solver function.

    An unknown name raises an InputError.
    """
    if isinstance(backend, str) and backend in BACKENDS:
        return BACKENDS[backend]
    if isinstance(backend, str) or not callable(backend):
        remedy = nearest(str(backend), BACKENDS)
        raise InputError("no such QP backend", key="backend", value=backend, remedy=remedy)
    return backend


def solve_least_distance(
    target: Array,
    *,
    A: Array,
    lower: Array,
    upper: Array,
    A_eq: Array | None = None,
    b_eq: Array | None = None,
    backend: Backend = "daqp",
) -> LeastDistance:
    """Return the point x nearest to `target` (n,) that satisfies A_eq x = b_eq and lower ≤ A x ≤ upper.

    The bounds have shape (m,) and may be ±inf. Linearly dependent equalities are allowed if they are consistent. An
    infeasible problem gives the status "infeasible" and raises no error. `backend` is a name in `BACKENDS` or a solver
    function (`Kernel`). The elimination of the equalities can remove rows of A, so the number of inequalities that the
    solver receives varies.

    Raises:
        InputError: `backend` is an unknown name.

    Example:
        >>> import numpy as np
        >>> from surctl.priority import solve_least_distance
        >>> wall = {"A": np.array([[1.0, 0.0]]), "lower": np.array([-np.inf]), "upper": np.array([0.1])}
        >>> found = solve_least_distance(np.array([0.3, 0.4]), **wall)
        >>> found.status, found.x.round(3).tolist(), found.multipliers.round(3).tolist()
        ('optimal', [0.1, 0.4], [0.2])
    """
    kernel = check_backend(backend)
    solution = _nearest(target, A, lower, upper, A_eq, b_eq, kernel)
    spent, converged = solution.iterations, False
    # rounding errors scale with the largest number: a far target is moved closer along a ray, and each point of the ray
    # has the same nearest point once that point no longer moves
    for _ in range(_ROUNDS):
        if solution.x is None or converged:
            break
        size = 1.0 + float(np.abs(solution.x).max())
        away = float(np.abs(target - solution.x).max())
        if not _FAR * size < away < np.inf:
            converged = True
            break
        pull = size / away
        near = solution.x + pull * (target - solution.x)
        candidate = _nearest(near, A, lower, upper, A_eq, b_eq, kernel, guess=pull * solution.multipliers)
        converged = candidate.x is not None and float(np.abs(candidate.x - solution.x).max()) <= _STAYS * size
        solution = replace(candidate, multipliers=candidate.multipliers / pull)
        spent += candidate.iterations
    if solution.x is not None and not converged:
        return LeastDistance(None, np.zeros(lower.size), spent, "failed")
    return replace(solution, iterations=spent)


def _nearest(
    target: Array,
    A: Array,
    lower: Array,
    upper: Array,
    A_eq: Array | None,
    b_eq: Array | None,
    kernel: Kernel,
    *,
    guess: Array | None = None,
) -> LeastDistance:
    """Return the point x nearest to the target that satisfies lower ≤ A x ≤ upper and A_eq x = b_eq.

    The inequalities hold up to a tolerance relative to 1 + max |target|. If the solver finds no solution, the rows of A
    with a nonzero multiplier in `guess` (m,) are tried as the active set. The point with this active set is returned
    only if it satisfies the optimality conditions.
    """
    nothing = np.zeros(lower.size)
    base, free = _eliminate(target, A_eq, b_eq)
    if base is None:
        return LeastDistance(None, nothing, 0, "infeasible")
    length = np.sqrt(np.einsum("ij,ij->i", A, A))
    value = A @ base
    below, above = lower - value, upper - value
    G = A @ free.T
    reduced = np.sqrt(np.einsum("ij,ij->i", G, G))
    fixed = reduced <= _FIXED * length
    slack = FEASIBLE * np.where(length > 0.0, length, 1.0) * (1.0 + np.abs(base).max(initial=0.0))
    if np.any(fixed & ((below > slack) | (above < -slack))):
        return LeastDistance(None, nothing, 0, "infeasible")
    # written with "not infinite" on purpose: a row with a NaN bound is not skipped
    use = np.flatnonzero(~fixed & ~((below == -np.inf) & (above == np.inf)))
    if use.size == 0:
        finite = bool(np.isfinite(base).all())
        return LeastDistance(base if finite else None, nothing, 0, "optimal" if finite else "failed")
    scale = reduced[use]
    G, below, above = G[use] / scale[:, None], below[use] / scale, above[use] / scale
    tolerance = FEASIBLE / np.maximum(scale, 1.0)
    solution = _checked(kernel(G, below, above), G, below, above, tolerance=tolerance)
    if solution.y is None and guess is not None:
        tried = guess[use] * scale
        pushed = KernelSolution(-G.T @ tried, tried, solution.iterations, "unfinished")
        second = _checked(pushed, G, below, above, tolerance=tolerance)
        solution = solution if second.y is None else second
    if solution.y is None:
        status: Status = "infeasible" if solution.status == "infeasible" else "failed"
        return LeastDistance(None, nothing, solution.iterations, status)
    nothing[use] = solution.multipliers / scale
    return LeastDistance(base + free.T @ solution.y, nothing, solution.iterations, "optimal")


def _eliminate(target: Array, A_eq: Array | None, b_eq: Array | None) -> tuple[Array | None, Array]:
    """Return the x nearest to the target with A_eq x = b_eq (None if there is none), and a null-space basis of A_eq."""
    if A_eq is None or b_eq is None or A_eq.shape[0] == 0:
        return target, np.eye(target.size)
    space = row_space(A_eq)
    base = target + space.particular(b_eq - A_eq @ target)
    wrong = np.abs(A_eq @ base - b_eq).max()
    tolerance = FEASIBLE * max(float(np.abs(A_eq).max()), 1.0) * (1.0 + float(np.abs(base).max()))
    return (base if wrong <= tolerance else None), space.null


def _checked(solution: KernelSolution, G: Array, lower: Array, upper: Array, *, tolerance: Array) -> KernelSolution:
    if solution.y is None:
        return solution
    for candidate in (solution, _polish(solution, G, lower, upper)):
        if _holds(candidate, G, lower, upper, tolerance):
            return replace(candidate, status="optimal")
    return KernelSolution(None, solution.multipliers, solution.iterations, "failed")


def _holds(solution: KernelSolution, G: Array, lower: Array, upper: Array, tolerance: Array | float) -> bool:
    """Return whether the solution y of min ½‖y‖² subject to lower ≤ G y ≤ upper satisfies the KKT conditions.

    `tolerance`, (m,) or one number, is the largest allowed violation of the inequalities. The return value is False if
    the solution contains a NaN.
    """
    y, multipliers = solution.y, solution.multipliers
    if y is None:
        return False
    size = 1.0 + np.abs(y).max()
    value = G @ y
    feasible = (np.maximum(lower - value, value - upper) <= tolerance * size).all()
    gap = np.where(multipliers > 0.0, upper, lower) - value
    at_bound = np.abs(np.where(np.abs(multipliers) > _STATIONARY * size, gap, 0.0)).max()
    stationary = np.abs(y + G.T @ multipliers).max()
    return bool(feasible and at_bound <= FEASIBLE * size and stationary <= _STATIONARY * size)


def _polish(solution: KernelSolution, G: Array, lower: Array, upper: Array) -> KernelSolution:
    """Solve the problem again, directly, with the inequalities that have a nonzero multiplier as equalities."""
    active = np.flatnonzero(np.abs(solution.multipliers) > 1e-6 * (1.0 + np.abs(solution.multipliers).max()))
    bound = np.where(solution.multipliers[active] > 0.0, upper[active], lower[active])
    if not np.isfinite(bound).all():
        return solution
    y = row_space(G[active]).particular(bound) if active.size else np.zeros(G.shape[1])
    multipliers = np.zeros(lower.size)
    if active.size:
        multipliers[active] = -row_space(G[active].T).particular(y)
    return KernelSolution(y, multipliers, solution.iterations, "optimal")
