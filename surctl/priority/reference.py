"""The reference solver: strict levels one after another within the limits, in NumPy, with any QP solver.

A strict level is one that no lower level may change. With no strict level, the result is the velocity nearest to the
target that satisfies the limits (mode filter). With one strict level, it is the projection on the first task in the NSB
law, equation (16) of the paper, within the limits (projected). If all levels are strict and the target is 0, it is
strict priority (Kanoun, Lamiraux and Wieber 2011; Escande, Mansard and Wieber 2014). After a level is solved, its value
of J v is fixed by elimination of variables, never by an inequality with a tolerance.

A level that the limits prevent from being met is solved by an active-set method that starts at a velocity within the
limits: each step goes to the minimiser on the active limits, or ends at the first limit that it would violate (Nocedal
and Wright 2006, 16.5).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.backends import Backend, LeastDistance, check_backend, project, row_space, solve_least_distance
from surctl.priority.problem import Level, PriorityProblem
from surctl.priority.settings import CUTOFF, ZERO_ROW, Mode, Settings

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]

_ROUNDING = 1e-8


@dataclass(frozen=True, eq=False)
class Polyhedron:
    """Limits lower ≤ a·v ≤ upper, scaled to ‖a‖ = 1 so that a violation is a velocity, with names.

    Attributes:
        A: (m, n), one normal a in each row. lower, upper: (m,), bounds. length: (m,), ‖a‖ before scaling.
        soft: (m,), whether the limit may be relaxed. names: name of each limit (m,).
    """

    A: Array
    lower: Array
    upper: Array
    length: Array
    soft: Mask
    names: tuple[str, ...]

    @staticmethod
    def none(n: int) -> Polyhedron:
        """Return the set of all velocities (n,), which has no limit."""
        nothing = np.zeros(0)
        return Polyhedron(np.zeros((0, n)), nothing, nothing, nothing, np.zeros(0, dtype=bool), ())

    def violation(self, v: Array) -> Array:
        """Return the amount (m,) by which v (n,) violates each limit; 0 if v satisfies the limit."""
        value = self.A @ v
        return np.maximum(np.maximum(self.lower - value, value - self.upper), 0.0)

    def missed(self, v: Array) -> dict[str, float]:
        """Return the violation of each limit that v violates by more than rounding, by name, in the limit's unit."""
        amount = self.violation(v)
        tolerance = _ROUNDING * (1.0 + float(np.abs(v).max()))
        return {self.names[i]: float(amount[i] * self.length[i]) for i in np.flatnonzero(amount > tolerance)}

    def contains(self, v: Array) -> bool:
        """Return whether v satisfies every limit exactly, without tolerance; False if v contains a NaN."""
        value = self.A @ v
        return bool(((self.lower <= value) & (value <= self.upper)).all())

    def relaxed(self, by: float) -> Polyhedron:
        """Return the set with both bounds of the soft limits moved outwards by `by`."""
        move = np.where(self.soft, by, 0.0)
        return replace(self, lower=self.lower - move, upper=self.upper + move)

    def holding(self, v: Array) -> Polyhedron:
        """Return the set with bounds widened by rounding errors so that v, which must be feasible, satisfies them."""
        value = self.A @ v
        return replace(self, lower=np.minimum(self.lower, value), upper=np.maximum(self.upper, value))

    def hard(self) -> Polyhedron:
        """Return the set that the limits define that are never relaxed."""
        chosen = np.flatnonzero(~self.soft)
        names = tuple(self.names[i] for i in chosen)
        return Polyhedron(
            self.A[chosen], self.lower[chosen], self.upper[chosen], self.length[chosen], self.soft[chosen], names
        )

    def also(self, J: Array, lower: Array, upper: Array) -> Polyhedron:
        """Return the set with k additional soft limits lower ≤ J v ≤ upper, J (k, n)."""
        length = _lengths(J)
        return Polyhedron(
            np.vstack([self.A, J / length[:, None]]),
            np.append(self.lower, lower / length),
            np.append(self.upper, upper / length),
            np.append(self.length, length),
            np.append(self.soft, np.ones(length.size, dtype=bool)),
            (*self.names, *(("",) * length.size)),
        )


def polyhedron_of(problem: PriorityProblem) -> Polyhedron:
    """Return the limits of the problem as rows of length 1.

    A row with normal 0 is not scaled; all velocities satisfy this row, or none does.
    """
    A, soft = problem.table[:, :-3], problem.table[:, -1] != 0.0
    length = _lengths(A)
    lower, upper = problem.table[:, -3] / length, problem.table[:, -2] / length
    names = tuple(row.name for row in problem.rows)
    return Polyhedron(np.where(_is_zero(A), 0.0, A / length[:, None]), lower, upper, length, soft, names)


def _lengths(A: Array) -> Array:
    # a row of zeros gets length 1
    largest = np.abs(A).max(axis=1, initial=0.0)
    largest[largest == 0.0] = 1.0
    scaled = A / largest[:, None]  # without this scaling the square of a row of 1e155 would overflow
    length: Array = largest * np.sqrt(np.einsum("ij,ij->i", scaled, scaled))
    length[_is_zero(A)[:, 0]] = 1.0
    return length


def _is_zero(A: Array) -> Mask:
    zero: Mask = np.abs(A).max(axis=1, initial=0.0, keepdims=True) <= ZERO_ROW
    return zero


@dataclass(frozen=True, eq=False)
class _Freedom:
    """The affine set of velocities v = base + Z y, where y is arbitrary.

    Attributes:
        base: (n,), one velocity of the set.
        Z: (n, d), orthonormal columns: the directions in which v is free.
        fixed: (n − d, n), orthonormal rows: the directions in which v is fixed.
    """

    base: Array
    Z: Array
    fixed: Array

    @staticmethod
    def whole(n: int) -> _Freedom:
        """Return the set of all velocities (n,)."""
        return _Freedom(np.zeros(n), np.eye(n), np.zeros((0, n)))

    def narrowed(self, J: Array, x: Array) -> _Freedom:
        """Return the subset of velocities that minimise ‖J v − x‖, for a task with Jacobian J (k, n).

        Singular values of J Z below CUTOFF·‖J‖ count as 0. The cut-off is relative to ‖J‖ and not to ‖J Z‖, because J
        Z contains only rounding errors if the task has no freedom left.
        """
        if J.shape[0] == 0:
            return self
        scale = float(np.linalg.norm(J, 2))
        space = row_space(J @ self.Z, scale=scale)
        base = self.base + self.Z @ space.particular(x - J @ self.base)
        return _Freedom(base, self.Z @ space.null.T, np.vstack([self.fixed, space.rows @ self.Z.T]))

    def nearest(self, target: Array, rows: Polyhedron, *, backend: Backend) -> LeastDistance:
        """Return the velocity of the set that satisfies the constraint rows and is nearest to `target` (n,)."""
        return solve_least_distance(
            target,
            A=rows.A,
            lower=rows.lower,
            upper=rows.upper,
            A_eq=self.fixed,
            b_eq=self.fixed @ self.base,
            backend=backend,
        )


_CAP = 100
_PATIENT = 20
"""After this many steps, drop the first constraint with a wrong sign, not the worst; this cannot cycle (Bland 1977)."""

_STILL = 1e-14
_WRONG_SIGN = 1e-11


@dataclass(frozen=True, eq=False)
class _LevelSolution:
    """A velocity at which the residual of the priority level is as small as the constraint rows allow.

    Attributes:
        v: the velocity (n,).
        multipliers: (m,) Lagrange multiplier of each constraint row in min ½‖residual of the level‖², positive at an
            upper bound, negative at a lower bound.
        iterations: number of active-set steps.
        converged: whether the multipliers have the signs that optimality requires; if not, v satisfies the constraint
            rows but may not be optimal.
    """

    v: Array
    multipliers: Array
    iterations: int
    converged: bool


def _solve_level(level: Level, start: Array, rows: Polyhedron, *, freedom: _Freedom, cutoff: float) -> _LevelSolution:
    """Minimise the residual of a priority level over all velocities in `freedom` that satisfy the constraint rows.

    start: (n,), a velocity in `freedom` that satisfies the constraint rows.
    """
    goal = level.exact
    if goal.all():
        return _least_squares(level.J, level.lower, start, rows, Z=freedom.Z, cutoff=cutoff)
    # a set-based row gets a slack variable: J v + s lies inside the bounds, and the desired s is 0
    slack, n = np.flatnonzero(~goal), start.size
    q = slack.size
    J = np.block([[level.J[goal], np.zeros((int(goal.sum()), q))], [np.zeros((q, n)), np.eye(q)]])
    wide = replace(rows, A=np.hstack([rows.A, np.zeros((rows.A.shape[0], q))]))
    wide = wide.also(np.hstack([level.J[slack], np.eye(q)]), level.lower[slack], level.high[slack])
    Z = np.block([[freedom.Z, np.zeros((n, q))], [np.zeros((q, freedom.Z.shape[1])), np.eye(q)]])
    x = np.append(level.lower[goal], np.zeros(q))
    solution = _least_squares(J, x, np.append(start, level.miss(start)[slack]), wide, Z=Z, cutoff=cutoff)
    return _LevelSolution(
        solution.v[:n], solution.multipliers[: len(rows.names)], solution.iterations, solution.converged
    )


def _least_squares(J: Array, x: Array, start: Array, rows: Polyhedron, *, Z: Array, cutoff: float) -> _LevelSolution:
    """Return the minimiser of ‖J v − x‖ over all v = start + Z y that satisfy the rows, by an active-set method."""
    rows = rows.holding(start)
    scale = float(np.linalg.norm(J, 2))
    v, active, multipliers = start, np.zeros(len(rows.names)), np.zeros(len(rows.names))
    for count in range(1, _CAP + 1):
        held = np.flatnonzero(active)
        A = rows.A[held] @ Z
        basis = Z @ row_space(A, cutoff=1e-13).null.T if held.size else Z
        step = basis @ row_space(J @ basis, cutoff=cutoff, scale=scale).particular(x - J @ v)
        length, blocking = _as_far_as(v, step, rows, active)
        v = v + length * step
        if blocking is not None:
            active[blocking] = np.sign(rows.A[blocking] @ step)
            continue
        gradient = Z.T @ (J.T @ (x - J @ v))
        multipliers = np.zeros(active.size)
        multipliers[held] = np.linalg.lstsq(A.T, gradient, rcond=None)[0] if held.size else 0.0
        wrong = np.flatnonzero(multipliers * active < -_WRONG_SIGN * scale * max(scale, float(np.abs(x - J @ v).max())))
        if wrong.size == 0:
            return _LevelSolution(v, multipliers, count, True)
        active[wrong[0] if count > _PATIENT else wrong[np.argmin((multipliers * active)[wrong])]] = 0.0
    return _LevelSolution(v, multipliers, _CAP, False)


def _as_far_as(v: Array, step: Array, rows: Polyhedron, active: Array) -> tuple[float, int | None]:
    """Return the largest fraction ≤ 1 of the step that violates no row, and the index of the limiting row, if any."""
    rate = rows.A @ step
    with np.errstate(invalid="ignore"):
        slack = np.where(rate > 0.0, rows.upper, rows.lower) - rows.A @ v
    moving = (active == 0.0) & (np.abs(rate) > _STILL * np.abs(step).max(initial=0.0)) & np.isfinite(slack)
    if not moving.any():
        return 1.0, None
    part = np.full(rate.size, np.inf)
    part[moving] = np.maximum(slack[moving] / rate[moving], 0.0)
    first = int(np.argmin(part))
    return (float(part[first]), first) if part[first] < 1.0 else (1.0, None)


_OPEN = 1e-9
"""Limits that are relaxed by at most this amount count as consistent."""

_MISSED = 1e-9
_SLACK = 1e-9
"""Widening of soft limits of length 1 where the feasible set has no interior and a solver calls it empty."""


@dataclass(frozen=True, eq=False)
class _Relaxed:
    rows: Polyhedron
    inside: Array  # a velocity (n,) that satisfies `rows`
    iterations: int
    opened: bool  # whether any limit had to be relaxed; False if a solver reported infeasibility by mistake
    least: bool  # whether the search showed that no smaller relaxation is possible


def _least_violation(rows: Polyhedron, start: Array, *, backend: Backend) -> _Relaxed | None:
    """Relax the soft limits by the smallest uniform amount t, for rows of length 1.

    Return None if the hard limits contradict each other, or if no solver finds a solution. The minimisation of t is
    solved as a task in the variables (v, t) with desired value t = 0. `start` is a velocity (n,).
    """
    n = start.size
    nearest = _Freedom.whole(n).nearest(start, rows.hard(), backend=backend)
    if nearest.x is None:
        return None
    hard, soft = np.flatnonzero(~rows.soft), np.flatnonzero(rows.soft)
    order, none = np.concatenate([hard, soft, soft]), np.full(soft.size, np.inf)
    slope = np.concatenate([np.zeros(hard.size), -np.ones(soft.size), np.ones(soft.size)])
    opening = Polyhedron(
        A=np.column_stack([rows.A[order], slope]),
        lower=np.concatenate([rows.lower[hard], -none, rows.lower[soft]]),
        upper=np.concatenate([rows.upper[hard], rows.upper[soft], none]),
        length=np.ones(order.size),
        soft=np.zeros(order.size, dtype=bool),
        names=("",) * order.size,
    )
    first = np.append(nearest.x, rows.violation(nearest.x)[soft].max(initial=0.0))
    close = Level("opening", np.eye(1, n + 1, n), np.zeros(1))
    solution = _solve_level(close, first, opening, freedom=_Freedom.whole(n + 1), cutoff=CUTOFF)
    inside, by = solution.v[:n], max(float(solution.v[n]), 0.0)
    iterations = nearest.iterations + solution.iterations
    return _Relaxed(rows.relaxed(by).holding(inside), inside, iterations, by > _OPEN, solution.converged)


@dataclass(frozen=True, eq=False)
class _Place:
    freedom: _Freedom
    rows: Polyhedron
    inside: Array  # nearest point to the target in the remaining freedom that satisfies the limits
    iterations: int
    confirmed: bool  # whether `inside` passed the optimality check


@dataclass(frozen=True, eq=False)
class Reference:
    """The velocity v (n,) of the reference solver, and the velocity `target` (n,) that it approaches last.

    `status` is the name of the outcome as in `PrioritySolution`, but "optimal" includes the case that limits prevent
    level 1 from being met. `iterations` counts those of all solvers together.
    """

    v: Array
    target: Array
    status: str
    iterations: int = 0


_Find: TypeAlias = Callable[[Polyhedron, Array | None], Reference | None]


def _cascade(
    strict: Sequence[Level], target: Array, backend: Backend, rows: Polyhedron, inside: Array | None = None
) -> Reference | None:
    """Solve the strict levels in order, then minimise ‖v − target‖; return None if no v satisfies the limits.

    target: (n,) velocity. inside: (n,) velocity known to satisfy the limits, or None.
    """
    freedom = _Freedom.whole(target.size)
    rows = rows if inside is None else rows.holding(inside)
    place: _Place | None = None
    spent, confirmed, limited = 0, True, False
    for level in strict:
        met = _met(level, target, rows, freedom=freedom, backend=backend)
        if met is None:
            place = place or _nearest(freedom, rows, target, backend=backend, inside=inside)
            if place is None:
                return None
            spent += place.iterations
            met, held = _limited(level, target, place, backend=backend)
            limited |= held and level is strict[0]
        place = met
        spent += place.iterations
        confirmed &= place.confirmed
        freedom, rows = place.freedom, place.rows
    if place is None:
        place = _nearest(freedom, rows, target, backend=backend, inside=inside)
        if place is None:
            return None
        spent += place.iterations
        confirmed &= place.confirmed
    status = "unconfirmed" if not confirmed else "limited" if limited else "optimal"
    return Reference(place.inside, target, status, spent)


def _met(level: Level, target: Array, rows: Polyhedron, *, freedom: _Freedom, backend: Backend) -> _Place | None:
    """Meet the level as well as higher levels allow, and return the new state, or None if the limits prevent this."""
    goal = level.exact
    narrow = freedom.narrowed(level.J[goal], level.lower[goal])
    return _nearest(narrow, _with_set_rows(level, rows, ~goal), target, backend=backend)


def _limited(level: Level, target: Array, place: _Place, *, backend: Backend) -> tuple[_Place, bool]:
    """Meet the level as well as the limits allow and fix its value of J v; return also whether limits restrict it."""
    solution = _solve_level(level, place.inside, place.rows, freedom=place.freedom, cutoff=CUTOFF)
    value = level.J @ solution.v
    frozen = level.exact | (np.abs(level.miss(solution.v)) > _MISSED * (1.0 + np.abs(value)))
    narrow = place.freedom.narrowed(level.J[frozen], value[frozen])
    rows = _with_set_rows(level, place.rows, ~frozen).holding(solution.v)
    after = _nearest(narrow, rows, target, backend=backend, inside=solution.v)
    assert after is not None  # a feasible point is known
    # a level whose residual the limits raise by at most 1e-9 of ‖J‖ counts as met
    felt = _MISSED * float(np.linalg.norm(level.J, 2)) ** 2
    held = bool((np.abs(solution.multipliers) > felt).any())
    spent = after.iterations + solution.iterations
    return replace(after, iterations=spent, confirmed=after.confirmed and solution.converged), held


def _with_set_rows(level: Level, rows: Polyhedron, chosen: Mask) -> Polyhedron:
    return rows.also(level.J[chosen], level.lower[chosen], level.high[chosen]) if chosen.any() else rows


def _nearest(
    freedom: _Freedom, rows: Polyhedron, target: Array, *, backend: Backend, inside: Array | None = None
) -> _Place | None:
    # if all solvers fail, the state is at `inside`, which is known to be feasible
    solution = freedom.nearest(target, rows, backend=backend)
    spent = solution.iterations
    if solution.x is None and inside is not None:
        solution = freedom.nearest(target, rows.relaxed(_SLACK), backend=backend)
        spent += solution.iterations
    if solution.x is not None:
        return _Place(freedom, rows, solution.x, spent, True)
    return None if inside is None else _Place(freedom, rows, inside, spent, False)


_PLAIN = Settings()
_NOTHING = 1e-15  # a damped problem has full rank, so no direction is cut off


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


def without_rows(levels: Sequence[Level], *, width: int, settings: Settings = _PLAIN) -> Array:
    """Return the velocity (width,) of the priority mode without limits: sweeps of the NSB law, or strict priority.

    Strict priority is v ← v + (J N)⁺(x − J v) for one level after another, with its Jacobian J, its desired rate x, and
    the null-space projector N of all levels above (Siciliano and Slotine 1991). Small singular values of J N relative
    to ‖J‖ count as 0.
    """
    v = np.zeros(width)
    if settings.mode == "lexicographic":
        reached = _cascade(levels, v, "daqp", Polyhedron.none(width))
        return v if reached is None else reached.v
    for _ in range(settings.sweeps):
        v = nsb_sweep(levels, start=v, settings=settings)
    return v


def _onto(level: Level, w: Array, damping: float) -> Array:
    if level.is_goal and damping == 0.0:
        return project(w, level.J, x=level.x)
    if level.is_goal or level.J.shape[0] == 1:
        # not by the Gram matrix: after squaring, λ would be lost next to a Jacobian 1e8 times as large
        left, s, right = np.linalg.svd(level.J, full_matrices=False)
        if damping == 0.0 and s[0] <= ZERO_ROW:
            return w
        moved: Array = w + right.T @ (left.T @ level.miss(w) * (s / (s**2 + damping**2)))
        return moved
    rows = Polyhedron.none(w.size)
    reached = _cascade([level], w, "daqp", rows) if damping == 0.0 else _damped(level, w, damping, "daqp", rows, w)
    return w if reached is None else reached.v


def _damped(
    level: Level, w: Array, damping: float, backend: Backend, rows: Polyhedron, inside: Array | None = None
) -> Reference | None:
    """Minimise λ²‖v − w‖² + ‖residual of the level‖² over v within the limits; λ = `damping` > 0, w (n,)."""
    spent = 0
    if inside is None:
        start = _Freedom.whole(w.size).nearest(w, rows, backend=backend)
        inside, spent = start.x, start.iterations
    if inside is None:
        return None
    n, pull = w.size, damping * w
    both = Level(
        level.name, np.vstack([level.J, damping * np.eye(n)]), np.append(level.lower, pull), np.append(level.high, pull)
    )
    solution = _solve_level(both, inside, rows, freedom=_Freedom.whole(n), cutoff=_NOTHING)
    status = "optimal" if solution.converged else "unconfirmed"
    return Reference(solution.v, w, status, spent + solution.iterations)


def reference_solution(problem: PriorityProblem, settings: Settings, backend: Backend) -> Reference:
    """Return the velocity of the mode in `settings`; v is always finite and inside the velocity bounds."""
    check_backend(backend)
    with np.errstate(all="ignore"):  # overflow is handled below, so no warning is needed
        try:
            solution = _MODES[settings.mode](problem, settings, backend)
            if np.isfinite(solution.v).all() and np.isfinite(solution.target).all():
                return solution
        except (np.linalg.LinAlgError, ArithmeticError):
            pass
        v = np.nan_to_num(np.clip(np.zeros(problem.width), *problem.box))
        return Reference(v, v, "clamped")


def _within(problem: PriorityProblem, find: _Find, target: Array, rows: Polyhedron, backend: Backend) -> Reference:
    """Return the solution of `find`; if no velocity satisfies the limits, with the least relaxation of the soft ones.

    find: function of the limits and of a velocity (n,) that satisfies them, or None.
    """
    result = find(rows, None)
    if result is None:
        relaxed = _least_violation(rows, target, backend=backend)
        if relaxed is not None:
            result = find(relaxed.rows, relaxed.inside)
        if relaxed is None or result is None:  # without `relaxed`, the hard limits contradict each other
            return _clamped(problem, target, rows, backend)
        status = "unconfirmed" if not relaxed.least else "relaxed" if relaxed.opened else result.status
        status = result.status if result.status == "unconfirmed" else status
        result = replace(result, status=status, iterations=relaxed.iterations + result.iterations)
    return replace(result, v=np.clip(result.v, *problem.box))


def _clamped(problem: PriorityProblem, target: Array, rows: Polyhedron, backend: Backend) -> Reference:
    """Return the velocity in the box with the least violation of the hard limits, if these conflict or solvers fail."""
    hard = rows.hard()
    solution = _Freedom.whole(target.size).nearest(target, hard, backend=backend)
    options = [np.clip(v, *problem.box) for v in (solution.x, target, np.zeros(target.size)) if v is not None]
    finite = [v for v in options if np.isfinite(v).all()]
    v = min(finite, key=lambda option: float(hard.violation(option).max(initial=0.0)))
    return Reference(v, target, "clamped", solution.iterations)


def _nsb(problem: PriorityProblem, settings: Settings, _: Backend) -> Reference:
    v = without_rows(problem.levels, width=problem.width, settings=settings)
    return Reference(v, v, "optimal")


def _filter(problem: PriorityProblem, settings: Settings, backend: Backend) -> Reference:
    target, rows = without_rows(problem.levels, width=problem.width, settings=settings), polyhedron_of(problem)
    if rows.contains(target):
        return Reference(target, target, "optimal")
    return _within(problem, partial(_cascade, (), target, backend), target, rows, backend)


def _projected(problem: PriorityProblem, settings: Settings, backend: Backend) -> Reference:
    rows, first, v = polyhedron_of(problem), problem.levels[:1], np.zeros(problem.width)
    for _ in range(settings.sweeps):
        target = nsb_sweep(problem.levels[1:], start=v, settings=settings)
        free = nsb_sweep(first, start=target, settings=settings)
        solution = Reference(free, target, "optimal")
        if not rows.contains(free):
            find: _Find = partial(_cascade, first, target, backend)
            if settings.damping > 0.0:
                find = partial(_damped, first[0], target, settings.damping, backend)
            solution = _within(problem, find, target, rows, backend)
        v = solution.v
    return solution


def _lexicographic(problem: PriorityProblem, settings: Settings, backend: Backend) -> Reference:
    rows, target = polyhedron_of(problem), np.zeros(problem.width)
    free = without_rows(problem.levels, width=problem.width, settings=settings)
    if rows.contains(free):
        return Reference(free, target, "optimal")
    return _within(problem, partial(_cascade, problem.levels, target, backend), target, rows, backend)


_MODES: dict[Mode, Callable[[PriorityProblem, Settings, Backend], Reference]] = {
    "nsb": _nsb,
    "filter": _filter,
    "projected": _projected,
    "lexicographic": _lexicographic,
}
