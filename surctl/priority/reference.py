"""The reference solver: strict levels one after another within the limits, each a QP for a solver of qpsolvers.

A strict level is one that no lower level may change. With no strict level, the result is the velocity nearest to the
target that satisfies the limits (mode filter). With one strict level, it is the projection on the first task in the NSB
law, equation (16) of the paper, within the limits (projected). If all levels are strict and the target is 0, it is
strict priority (Kanoun, Lamiraux and Wieber 2011). After a level is solved, its value of J v is fixed by elimination of
variables, never by an inequality with a tolerance. The QP solver finds the active limits; the velocity is then computed
from them.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_known
from surctl.priority.problem import Level, Limits, PriorityProblem
from surctl.priority.settings import Settings, negligible

Array: TypeAlias = NDArray[np.float64]


class RowSpace(NamedTuple):
    """A singular value decomposition J = left · diag(s) · rows, without singular values below a cut-off.

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

    def solve(self, x: Array) -> Array:
        """Return the product J⁺x (n,), for x (k,) or x (k, j)."""
        return np.asarray((self.rows.T / self.s) @ (self.left.T @ x))


def row_space(J: Array, *, scale: float | None = None) -> RowSpace:
    """Decompose J (k, n) without singular values below `CUTOFF`·`scale` or `ZERO_ROW`; `scale` None means ‖J‖."""
    left, s, rows = np.linalg.svd(J, full_matrices=True)
    largest = scale if scale is not None else float(s[0]) if s.size else 0.0
    rank = int(np.count_nonzero(s > negligible(largest)))
    return RowSpace(left[:, :rank], s[:rank], rows[:rank], rows[rank:])


_PLAIN = Settings()


def nsb_sweep(levels: Sequence[Level], *, start: Array, settings: Settings = _PLAIN) -> Array:
    """Return the velocity after one sweep, which projects `start` (n,) on every level, from lowest to highest priority.

    The projection of a velocity w on a level J v = x is the velocity nearest to w among those that minimise ‖J v − x‖,
    which is J⁺x + (I − J⁺J) w. If `start` is 0, the result is therefore the NSB law, equation (16) of the paper. If w
    satisfies a set-based task, the projection on this task is w itself. Of `settings`, the function uses only the
    damping.

    Example:
        >>> import numpy as np
        >>> from surctl.priority import Level, Settings, nsb_sweep
        >>> away = Level("away", np.array([[1.0, 0.0]]), np.array([0.0]))
        >>> goal = Level("goal", np.eye(2), np.array([0.3, 0.4]))
        >>> damped = Settings(damping=0.5)
        >>> [nsb_sweep([away, goal], start=np.zeros(2), settings=s).round(3).tolist() for s in (Settings(), damped)]
        [[0.0, 0.4], [0.048, 0.32]]
    """
    w = start
    for level in reversed(levels):
        w = _onto(level, w, settings.damping)
    return w


def nsb(problem: PriorityProblem) -> Array:
    """Return the velocity v (n,) of the NSB law, equation (16) of the paper: v = v_1 + N_1(v_2 + N_2(v_3 + …)).

    Here v_i = J_i⁺x_i is the velocity for task i alone, J_i is its Jacobian, x_i its desired rate, and N_i = I −
    J_i⁺J_i the projector on the null space of J_i. Singular values of J_i below 1e-10·‖J_i‖ count as 0. The law
    ignores limits.

    Raises:
        InputError: a level is set-based; equation (16) has no set-based tasks.

    Example:
        >>> import numpy as np
        >>> from surctl.priority import Level, build_problem, nsb
        >>> away = Level("away", np.array([[1.0, 0.0]]), np.array([0.0]))
        >>> goal = Level("goal", np.eye(2), np.array([0.3, 0.4]))
        >>> [nsb(build_problem(order)).round(3).tolist() for order in ([away, goal], [goal, away])]
        [[0.0, 0.4], [0.3, 0.4]]
    """
    for level in problem.levels:
        if not level.is_goal:
            raise InputError(
                "is set-based, and the printed law has no such task", key=f"task {level.name}", remedy="use solve"
            )
    return nsb_sweep(problem.levels, start=np.zeros(problem.width))


def _onto(level: Level, w: Array, damping: float) -> Array:
    if not level.is_goal and level.lower.size > 1:
        strict = _damped(level, w, damping) if damping else level
        reached = _cascade([strict], w, Limits.none(w.size), _Solver("daqp"))
        return w if reached is None else reached
    if not level.is_goal and not level.miss(w).any():
        return w
    # singular values are not squared: damping would be lost next to a Jacobian 1e8 times as large
    space = row_space(level.J, scale=0.0 if damping else None)
    ratio = damping / space.s
    x = level.J @ w + level.miss(w) if not level.is_goal else level.x
    # J w is not computed for a goal, because its error would be divided by the smallest singular value
    moved: Array = w + space.rows.T @ ((space.left.T @ x / space.s - space.rows @ w) / (1.0 + ratio**2))
    return moved


def without_rows(levels: Sequence[Level], *, width: int, settings: Settings = _PLAIN) -> Array:
    """Return the velocity (width,) of the priority mode without limits: the NSB law, or strict priority."""
    v = np.zeros(width)
    if settings.mode == "lexicographic":
        reached = _cascade(levels, v, Limits.none(width), _Solver("daqp"))
        return v if reached is None else reached
    return nsb_sweep(levels, start=v, settings=settings)


def target_of(problem: PriorityProblem, settings: Settings) -> Array:
    """Return the velocity (n,) that the mode approaches last."""
    start = np.zeros(problem.width)
    if settings.mode == "lexicographic":
        return start
    levels = problem.levels[1:] if settings.mode == "projected" else problem.levels
    return nsb_sweep(levels, start=start, settings=settings)


_TIGHT: dict[str, dict[str, Any]] = {
    # with its default tolerances, OSQP violates bounds by 1e-3; its polishing prints to the terminal
    "osqp": {"eps_abs": 1e-10, "eps_rel": 1e-10, "eps_prim_inf": 1e-10, "max_iter": 20_000, "polishing": False},
    "daqp": {"primal_tol": 1e-9},
}
_FEASIBLE = 1e-9  # violation of a row of length 1, relative to 1 + |bound|, that counts as rounding


class _Solver:
    """A QP solver of qpsolvers (Caron et al.), and how many problems it was given."""

    def __init__(self, name: str) -> None:
        self.name, self.calls = name, 0

    def minimisers(
        self, R: Array, r: Array, H: Array, bound: Array, slack: float, convex: float, centre: Array
    ) -> list[Array]:
        """Return the minimiser of ‖R y − r‖² + convex ‖y − centre‖² with H y ≤ bound + slack; [] if none is found.

        Two candidates come before it: minimisers of ‖R y − r‖ with H y = bound in the rows that may be active.
        """
        import qpsolvers
        from scipy import sparse

        self.calls += 1
        form = sparse.csc_matrix if self.name in qpsolvers.sparse_solvers else np.asarray
        scale = 1.0 / (1.0 + np.abs(r).max())
        P = scale * (R.T @ R + convex * np.eye(R.shape[1]))
        problem = qpsolvers.Problem(form(P), -scale * (R.T @ r + convex * centre), form(H), bound + slack)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a solver that fails says so in its result
            solution = qpsolvers.solve_problem(problem, solver=self.name, **_TIGHT.get(self.name, {}))
        y, z = solution.x, solution.z
        if y is None or z is None or not (np.isfinite(y).all() and np.isfinite(z).all()):
            return []
        near = bound - H @ y <= 1e-7 * (1.0 + np.abs(y).max())
        return [*(_at(R, r, y, H[held], bound[held]) for held in (z > 1e-6 * (1.0 + z.max()), near)), y]


def _at(R: Array, r: Array, y: Array, H: Array, bound: Array) -> Array:
    """Return the minimiser of ‖R y − r‖ with H y = bound that is nearest to y."""
    if len(bound) == 0:
        return y + row_space(R, scale=1.0).solve(r - R @ y)
    space = row_space(H)
    y = y + space.solve(bound - H @ y)
    basis = space.null.T
    return np.asarray(y + basis @ row_space(R @ basis, scale=1.0).solve(r - R @ y))


def _minimiser(R: Array, r: Array, G: Array, lower: Array, upper: Array, solver: _Solver) -> Array | None:
    """Return a minimiser y (d,) of ‖R y − r‖ with lower ≤ G y ≤ upper, ‖R‖ about 1; None if none is found."""
    size = np.sqrt((G**2).sum(axis=1))
    fixed = size <= _FEASIBLE
    if (np.maximum(lower, -upper)[fixed] > 1e-8).any():
        return None
    G, lower, upper = ((part[~fixed].T / size[~fixed]).T for part in (G, lower, upper))
    above, below = np.isfinite(upper), np.isfinite(lower)
    H, bound = np.vstack([G[above], -G[below]]), np.append(upper[above], -lower[below])
    free = _at(R, r, np.zeros(R.shape[1]), H[:0], bound[:0])
    if (H @ free <= bound).all():
        return free
    centre, tolerance = np.zeros(R.shape[1]), 2.0 * _FEASIBLE * (1.0 + np.abs(bound))
    best = centre if (bound > -_FEASIBLE).all() else None
    for slack, convex in ((0.0, 1e-6), *((_FEASIBLE, 1e-4),) * 3):  # a set without inside may seem empty
        *exact, centre = [*solver.minimisers(R, r, H, bound, slack, convex, centre), centre]
        for share in (1e-3, 1.0):
            for y in exact[:2]:
                if (H @ y <= bound + share * tolerance).all():
                    return y
        for y in exact[2:]:
            best, centre = (y if (H @ y <= bound + tolerance).all() else best), y
    return best


def _cascade(
    strict: Sequence[Level], target: Array, rows: Limits, solver: _Solver, inside: Array | None = None
) -> Array | None:
    """Minimise the strict levels in order, then ‖v − target‖, within the limits; None if no v is found within them.

    inside: (n,), a velocity that is known to satisfy the limits, or None.
    """
    v, Z = np.zeros(target.size) if inside is None else inside, np.eye(target.size)
    for level in strict:
        exact, scale = level.exact, float(np.linalg.norm(level.J, 2)) or 1.0
        J, lower, high, q = level.J / scale, level.lower / scale, level.high / scale, int((~level.exact).sum())
        d, value, slack = Z.shape[1], J @ v, (level.miss(v) / scale)[~exact]
        # a set-based row gets a slack variable s: J v + s lies inside the bounds, and the desired s is 0
        R = np.block([[J[exact] @ Z, np.zeros((int(exact.sum()), q))], [np.zeros((q, d)), np.eye(q)]])
        r = np.append((lower - value)[exact], -slack)
        A = np.block([[rows.A @ Z, np.zeros((len(rows.A), q))], [J[~exact] @ Z, np.eye(q)]])
        at = np.append(rows.A @ v, value[~exact] + slack)
        low, up = np.append(rows.lower, lower[~exact]), np.append(rows.upper, high[~exact])
        y = _minimiser(R, r, A, low - at, up - at, solver)
        if y is None:
            return None
        v = v + Z @ y[:d]
        frozen = exact | (np.abs(level.miss(v)) > 1e-9 * (scale + np.abs(level.J @ v)))
        rows = rows.also(level.J[~frozen], level.lower[~frozen], level.high[~frozen]).holding(v)
        Z = Z @ row_space(J[frozen] @ Z, scale=1.0).null.T
    at = rows.A @ v
    y = _minimiser(np.eye(Z.shape[1]), Z.T @ (target - v), rows.A @ Z, rows.lower - at, rows.upper - at, solver)
    return v + Z @ y if y is not None else v if strict else None


def _damped(level: Level, w: Array, damping: float) -> Level:
    """Return the level whose residual is that of the level and λ‖v − w‖ together; λ = `damping`."""
    J, pull = np.vstack([level.J, damping * np.eye(w.size)]), damping * w
    return Level(level.name, J, np.append(level.lower, pull), np.append(level.high, pull))


def _least_violation(rows: Limits, solver: _Solver) -> tuple[Array, float] | None:
    """Return v (n,) and the smallest t by which soft limits must be moved for it; None if the hard ones exclude it."""
    n, soft = rows.A.shape[1], rows.soft
    ends = np.full(int(soft.sum()), np.inf)
    A = np.column_stack([np.vstack([rows.A, rows.A[soft]]), np.append(-1.0 * soft, np.ones(ends.size))])
    lower = np.append(np.where(soft, -np.inf, rows.lower), rows.lower[soft])
    y = _minimiser(np.eye(1, n + 1, n), np.zeros(1), A, lower, np.append(rows.upper, ends), solver)
    return None if y is None else (y[:n], max(float(y[n]), 0.0))


@dataclass(frozen=True, eq=False)
class Reference:
    """The velocity v (n,) of the reference solver, and the velocity `target` (n,) that it approaches last.

    `status` is the name of the outcome as in `PrioritySolution`; that v is optimal is not checked yet. `iterations` is
    the number of QPs.
    """

    v: Array
    target: Array
    status: str
    iterations: int = 0


def reference_solution(problem: PriorityProblem, settings: Settings, backend: str) -> Reference:
    """Return the velocity of the mode in `settings`; v is always finite and inside the velocity bounds.

    Raises:
        InputError: qpsolvers has no solver of the name `backend`.
    """
    import qpsolvers

    check_known(backend, qpsolvers.available_solvers, "no such QP backend", key="backend")
    with np.errstate(all="ignore"):  # overflow is handled below, so no warning is needed
        try:
            solution = _solution(problem, settings, _Solver(backend))
            if np.isfinite(solution.v).all() and np.isfinite(solution.target).all():
                return solution
        except (np.linalg.LinAlgError, ArithmeticError):
            pass
        v = np.nan_to_num(np.clip(np.zeros(problem.width), *problem.box))
        return Reference(v, v, "clamped")


def _solution(problem: PriorityProblem, settings: Settings, solver: _Solver) -> Reference:
    target, levels = target_of(problem, settings), problem.levels
    if settings.mode == "nsb":
        return Reference(target, target, "optimal")
    if settings.mode == "projected":
        levels = (_damped(levels[0], target, settings.damping),) if settings.damping else levels[:1]
    solution = _within(problem, () if settings.mode == "filter" else levels, target, solver)
    damped = settings.mode == "projected" and settings.damping > 0.0 and solution.status == "limited"
    return replace(solution, status="optimal") if damped else solution


def _within(problem: PriorityProblem, strict: Sequence[Level], target: Array, solver: _Solver) -> Reference:
    """Return the solution of the cascade within the limits, or within the least relaxation of the soft ones."""
    rows, status, n = problem.limits, "optimal", target.size
    free = _cascade(strict, target, Limits.none(n), solver)
    if free is not None and rows.contains(free):
        return Reference(free, target, status)
    v = _cascade(strict, target, rows, solver)
    if v is None:
        least = _least_violation(rows, solver)
        if least is not None:
            inside, t = least
            status = "relaxed" if t > _FEASIBLE else status
            v = _cascade(strict, target, rows.relaxed(t).holding(inside), solver, inside)
    if v is None:
        return Reference(np.clip(target, *problem.box), target, "clamped", solver.calls)
    v = np.clip(v, *problem.box)
    if status == "optimal" and strict and free is not None:
        loss = strict[0].residual(v) - strict[0].residual(free)
        status = "limited" if loss > _FEASIBLE * max(1.0, float(np.abs(strict[0].J).max())) else status
    return Reference(v, target, status, solver.calls)
