"""Solver that meets strict priority levels one after another within the limits, then approaches a target velocity.

A strict level is one that no lower level may change. With no strict level, the solver returns the velocity nearest to
the target that satisfies the limits. With one strict level, the solver computes the projection on the first task in the
NSB law, equation (16) of the paper, restricted to the limits. If all levels are strict and the target is 0, the result
is strict (lexicographic) priority (Kanoun, Lamiraux and Wieber 2011; Escande, Mansard and Wieber 2014). After a level
is solved, its value of J v is fixed by elimination of variables, never by an inequality with a tolerance.

The method starts at a velocity v that satisfies all constraint rows lower ≤ a·v ≤ upper. Every later v satisfies these
rows too, so the method can be stopped after any step. Each step goes to the minimiser on the active constraints, or
ends at the first constraint that the step would violate (Nocedal and Wright 2006, 16.5).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.backends import Backend, LeastDistance, solve_least_distance
from surctl.priority.polyhedron import Polyhedron
from surctl.priority.problem import Level
from surctl.priority.rowspace import CUTOFF, ZERO_ROW, project, row_space
from surctl.priority.settings import Settings
from surctl.tasks.limits import Kind

__all__ = [
    "CascadeSolution",
    "Freedom",
    "LevelSolution",
    "Relaxed",
    "damped_point",
    "least_violation",
    "nsb_sweep",
    "solve_cascade",
    "without_rows",
]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Freedom:
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
    def whole(n: int) -> Freedom:
        """Return the set of all velocities (n,)."""
        return Freedom(np.zeros(n), np.eye(n), np.zeros((0, n)))

    def narrowed(self, J: Array, x: Array, *, cutoff: float) -> Freedom:
        """Return the subset of velocities that minimise ‖J v − x‖, for a task with Jacobian J (k, n).

        Singular values of J Z below `cutoff`·‖J‖ count as 0. The cut-off is relative to ‖J‖ and not to ‖J Z‖, because J
        Z contains only rounding errors if the task has no freedom left.
        """
        if J.shape[0] == 0:
            return self
        scale = float(np.linalg.norm(J, 2))
        space = row_space(J @ self.Z, cutoff=cutoff, scale=scale)
        base = self.base + self.Z @ space.particular(x - J @ self.base)
        return Freedom(base, self.Z @ space.null.T, np.vstack([self.fixed, space.rows @ self.Z.T]))

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
class LevelSolution:
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


def _solve_level(level: Level, start: Array, rows: Polyhedron, *, freedom: Freedom, cutoff: float) -> LevelSolution:
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
    wide = rows.widened(level.J[slack], level.lower[slack], level.high[slack])
    Z = np.block([[freedom.Z, np.zeros((n, q))], [np.zeros((q, freedom.Z.shape[1])), np.eye(q)]])
    x = np.append(level.lower[goal], np.zeros(q))
    solution = _least_squares(J, x, np.append(start, level.miss(start)[slack]), wide, Z=Z, cutoff=cutoff)
    return LevelSolution(
        solution.v[:n], solution.multipliers[: len(rows.names)], solution.iterations, solution.converged
    )


def _least_squares(J: Array, x: Array, start: Array, rows: Polyhedron, *, Z: Array, cutoff: float) -> LevelSolution:
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
            return LevelSolution(v, multipliers, count, True)
        active[wrong[0] if count > _PATIENT else wrong[np.argmin((multipliers * active)[wrong])]] = 0.0
    return LevelSolution(v, multipliers, _CAP, False)


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


@dataclass(frozen=True, eq=False)
class Relaxed:
    """Result of `least_violation`: constraint rows that were relaxed until they are consistent.

    Attributes:
        rows: the constraint rows, with the bounds of the relaxed ones moved outwards.
        inside: a velocity (n,) that satisfies `rows`.
        iterations: number of iterations of all solvers together.
        opened: whether any limit had to be relaxed; False if a solver reported infeasibility by mistake.
        conflict: names of the limits that contradict each other.
        least: whether the search showed that no smaller relaxation is possible.
    """

    rows: Polyhedron
    inside: Array
    iterations: int
    opened: bool
    conflict: tuple[str, ...]
    least: bool


def least_violation(rows: Polyhedron, start: Array, *, backend: Backend) -> Relaxed | None:
    """Relax barrier limits, then limits of set-based tasks, each kind by the smallest uniform amount.

    The amount applies to constraint rows scaled to length 1. Return None if the actuator limits contradict each other,
    or if no solver finds a solution. `start` is a velocity (n,).
    """
    firm = rows.only(rows.mask("actuator"))
    solution = Freedom.whole(start.size).nearest(start, firm, backend=backend)
    if solution.x is None:
        return None
    inside, iterations, least = solution.x, solution.iterations, True
    conflict: dict[str, None] = {}
    hard: tuple[Kind, ...] = ("actuator",)
    kinds: tuple[Kind, ...] = ("barrier", "set")
    for kind in kinds:
        inside, by, search, names = _least_uniform(rows, kind, hard, inside)
        iterations += search.iterations
        least &= search.converged
        if by > _OPEN:
            conflict |= dict.fromkeys(names)
        rows = rows.relaxed(rows.mask(kind), by)
        hard = (*hard, kind)
    return Relaxed(rows.holding(inside), inside, iterations, bool(conflict), tuple(conflict), least)


def _least_uniform(
    rows: Polyhedron, kind: Kind, hard: tuple[Kind, ...], inside: Array
) -> tuple[Array, float, LevelSolution, tuple[str, ...]]:
    """Return v, the least t ≥ 0 by which limits of `kind` must be relaxed, the solution, and the limits that set t.

    The minimisation of t is solved as a task in the variables (v, t) with desired value t = 0. `inside` is a velocity
    that satisfies the limits of the kinds `hard`.
    """
    n = inside.size
    close = Level("opening", np.eye(1, n + 1, n), np.zeros(1))
    start = np.append(inside, rows.violation(inside)[rows.mask(kind)].max(initial=0.0))
    opening = _opening(rows, kind, hard)
    solution = _solve_level(close, start, opening, freedom=Freedom.whole(n + 1), cutoff=CUTOFF)
    names = tuple(opening.names[i] for i in np.flatnonzero(solution.multipliers))
    return solution.v[:n], max(float(solution.v[n]), 0.0), solution, names


def _opening(rows: Polyhedron, kind: Kind, hard: tuple[Kind, ...]) -> Polyhedron:
    """Return constraints on (v, t): limits of the kinds `hard`, and limits of `kind` with both bounds widened by t."""
    keep, soft = np.flatnonzero(rows.mask(*hard)), np.flatnonzero(rows.mask(kind))
    order = np.concatenate([keep, soft, soft])
    none = np.full(soft.size, np.inf)
    slope = np.concatenate([np.zeros(keep.size), -np.ones(soft.size), np.ones(soft.size)])
    lower = np.concatenate([rows.lower[keep], -none, rows.lower[soft]])
    upper = np.concatenate([rows.upper[keep], rows.upper[soft], none])
    unbounded = np.full(rows.A.shape[1] + 1, np.inf)
    return Polyhedron(
        A=np.column_stack([rows.A[order], slope]),
        lower=lower,
        upper=upper,
        length=np.ones(order.size),
        kinds=tuple(rows.kinds[i] for i in order),
        names=tuple(rows.names[i] for i in order),
        box=(-unbounded, unbounded),
    )


_MISSED = 1e-9
_FELT = 1e-9  # a multiplier up to 1e-9, relative to 1 + max |v|, counts as rounding
_SLACK = 1e-9
"""Widening of soft constraint rows of length 1 where the feasible set has no interior and a solver calls it empty."""


@dataclass(frozen=True, eq=False)
class CascadeSolution:
    """Result of `solve_cascade`: a velocity and the limits that determine this velocity.

    Attributes:
        v: the velocity (n,).
        binding: (name, Lagrange multiplier) of each active limit, in the order and the unit of the limits. The
            multiplier belongs to min ½‖v − target‖², or, if the limit restricts a strict level, to min ½‖residual of
            this level‖².
        causes: for each strict level that the limits restrict, the names of these limits.
        iterations: number of iterations of all solvers together.
        confirmed: whether v was shown to be optimal at every level; if not, v satisfies the limits but may not be
            optimal.
    """

    v: Array
    binding: tuple[tuple[str, float], ...]
    causes: Mapping[str, tuple[str, ...]]
    iterations: int
    confirmed: bool

    @staticmethod
    def of(
        v: Array,
        rows: Polyhedron,
        multipliers: Array,
        iterations: int,
        *,
        confirmed: bool,
        held: Mapping[str, float] | None = None,
        causes: Mapping[str, tuple[str, ...]] | None = None,
    ) -> CascadeSolution:
        """Build the solution from the multipliers (m,) of constraint rows scaled to length 1.

        If `held` contains a multiplier for the name of a row, it replaces the one in `multipliers`.
        """
        by_name = _named_multipliers(rows, multipliers, above=_FELT * (1.0 + float(np.abs(v).max()))) | dict(held or {})
        return CascadeSolution(
            v,
            tuple((name, by_name[name]) for name in dict.fromkeys((*rows.names, *by_name)) if name in by_name),
            causes or {},
            iterations,
            confirmed,
        )


def _named_multipliers(rows: Polyhedron, multipliers: Array, *, above: float) -> dict[str, float]:
    """Return the multipliers (m,) of magnitude above `above`, by row name, converted to the rows before scaling."""
    return {rows.names[i]: float(u / rows.length[i]) for i, u in enumerate(multipliers) if abs(u) > above}


@dataclass(frozen=True, eq=False)
class _Place:
    freedom: Freedom
    rows: Polyhedron
    inside: Array  # nearest point to the target in the remaining freedom that satisfies the constraint rows
    multipliers: Array  # (m,) Lagrange multipliers at `inside`
    iterations: int
    held: Mapping[str, float]  # multipliers of the constraint rows that limit the level
    confirmed: bool  # whether `inside` passed the optimality check


def solve_cascade(
    strict: Sequence[Level],
    target: Array,
    rows: Polyhedron,
    *,
    backend: Backend,
    cutoff: float,
    inside: Array | None = None,
) -> CascadeSolution | None:
    """Solve the strict levels in order, then minimise ‖v − target‖; return None if no v satisfies the constraint rows.

    target: (n,) velocity. inside: (n,) velocity known to satisfy the constraint rows, or None.
    """
    freedom = Freedom.whole(target.size)
    rows = rows if inside is None else rows.holding(inside)
    causes: dict[str, tuple[str, ...]] = {}
    held: dict[str, float] = {}
    place: _Place | None = None
    spent, confirmed = 0, True
    for level in strict:
        met = _met(level, target, rows, freedom=freedom, backend=backend, cutoff=cutoff)
        if met is None:
            place = place or _nearest(freedom, rows, target, backend=backend, inside=inside)
            if place is None:
                return None
            spent += place.iterations
            met = _limited(level, target, place, backend=backend, cutoff=cutoff)
            if met.held:
                causes[level.name] = tuple(met.held)
            held = {**met.held, **held}
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
    return CascadeSolution.of(
        place.inside, place.rows, place.multipliers, spent, confirmed=confirmed, held=held, causes=causes
    )


def _met(
    level: Level, target: Array, rows: Polyhedron, *, freedom: Freedom, backend: Backend, cutoff: float
) -> _Place | None:
    """Meet the level as well as higher levels allow, and return the new state, or None if the limits prevent this."""
    goal = level.exact
    narrow = freedom.narrowed(level.J[goal], level.lower[goal], cutoff=cutoff)
    more = _with_set_rows(level, rows, ~goal)
    return _nearest(narrow, more, target, backend=backend)


def _limited(level: Level, target: Array, place: _Place, *, backend: Backend, cutoff: float) -> _Place:
    """Meet the level as well as the limits allow, fix its value of J v, and return the new state."""
    solution = _solve_level(level, place.inside, place.rows, freedom=place.freedom, cutoff=cutoff)
    value = level.J @ solution.v
    off = np.abs(level.miss(solution.v)) > _MISSED * (1.0 + np.abs(value))
    frozen = level.exact | off
    narrow = place.freedom.narrowed(level.J[frozen], value[frozen], cutoff=cutoff)
    rows = _with_set_rows(level, place.rows, ~frozen).holding(solution.v)
    after = _nearest(narrow, rows, target, backend=backend, inside=solution.v)
    assert after is not None  # a feasible point is known
    # a level whose residual the rows raise by at most 1e-9 of ‖J‖ counts as met
    felt = _MISSED * float(np.linalg.norm(level.J, 2)) ** 2
    held = _named_multipliers(place.rows, solution.multipliers, above=felt)
    spent = after.iterations + solution.iterations
    return _Place(narrow, rows, after.inside, after.multipliers, spent, held, after.confirmed and solution.converged)


def _with_set_rows(level: Level, rows: Polyhedron, chosen: NDArray[np.bool_]) -> Polyhedron:
    if not chosen.any():
        return rows
    one = level.lower.size == 1
    names = [level.name if one else f"{level.name}.{i}" for i in np.flatnonzero(chosen)]
    return rows.also(level.J[chosen], level.lower[chosen], level.high[chosen], names=names)


def _nearest(
    freedom: Freedom, rows: Polyhedron, target: Array, *, backend: Backend, inside: Array | None = None
) -> _Place | None:
    # if all solvers fail, the state is at `inside`, which is known to be feasible
    solution = freedom.nearest(target, rows, backend=backend)
    spent = solution.iterations
    if solution.x is None and inside is not None:
        solution = freedom.nearest(target, rows.relaxed(rows.mask("barrier", "set"), _SLACK), backend=backend)
        spent += solution.iterations
    if solution.x is not None:
        return _Place(freedom, rows, solution.x, solution.multipliers, spent, {}, True)
    return None if inside is None else _Place(freedom, rows, inside, np.zeros(len(rows.names)), spent, {}, False)


_PLAIN = Settings()
_NOTHING = 1e-15  # a damped problem has full rank, so no direction is cut off


def nsb_sweep(levels: Sequence[Level], *, start: Array, settings: Settings = _PLAIN) -> Array:
    """Return the velocity after one sweep, which projects `start` (n,) on every level, from lowest to highest priority.

    The projection of a velocity w on a level J v = x is the velocity nearest to w among those that minimise ‖J v − x‖,
    which is J⁺x + (I − J⁺J) w. If `start` is 0, the result is therefore the NSB law, equation (16) of the paper. If w
    satisfies a set-based task, the projection on this task is w itself. Of `settings`, the function uses only the
    damping and the cut-off.

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
        w = _onto(level, w, settings)
    return w


def without_rows(levels: Sequence[Level], *, width: int, settings: Settings = _PLAIN) -> Array:
    """Return the velocity (width,) of the priority mode without limits: sweeps of the NSB law, or strict priority.

    Strict priority is v ← v + (J N)⁺(x − J v) for one level after another, with its Jacobian J, its desired rate x, and
    the null-space projector N of all levels above (Siciliano and Slotine 1991). Small singular values of J N relative
    to ‖J‖ count as 0.
    """
    v = np.zeros(width)
    if settings.mode == "lexicographic":
        reached = solve_cascade(levels, v, Polyhedron.none(width), backend="daqp", cutoff=settings.cutoff)
        return v if reached is None else reached.v
    for _ in range(settings.sweeps):
        v = nsb_sweep(levels, start=v, settings=settings)
    return v


def _onto(level: Level, w: Array, settings: Settings) -> Array:
    damping = settings.damping
    if level.is_goal and damping == 0.0:
        return project(w, level.J, x=level.x, cutoff=settings.cutoff)
    if level.is_goal or level.J.shape[0] == 1:
        # not by the Gram matrix: after squaring, λ would be lost next to a Jacobian 1e8 times as large
        left, s, right = np.linalg.svd(level.J, full_matrices=False)
        if damping == 0.0 and s[0] <= ZERO_ROW:
            return w
        moved: Array = w + right.T @ (left.T @ level.miss(w) * (s / (s**2 + damping**2)))
        return moved
    rows = Polyhedron.none(w.size)
    if damping == 0.0:
        reached = solve_cascade([level], w, rows, backend="daqp", cutoff=settings.cutoff)
        return w if reached is None else reached.v
    return damped_point(level, w, rows, damping=damping, inside=w).v


def damped_point(level: Level, w: Array, rows: Polyhedron, *, damping: float, inside: Array) -> LevelSolution:
    """Minimise λ²‖v − w‖² + ‖residual of the level‖² over v subject to the limits; λ = `damping` > 0, w (n,).

    `inside` (n,) is a velocity that satisfies the limits. The returned Lagrange multipliers are those of half this
    cost.
    """
    n, pull = w.size, damping * w
    both = Level(
        level.name,
        np.vstack([level.J, damping * np.eye(n)]),
        np.append(level.lower, pull),
        np.append(level.high, pull),
    )
    return _solve_level(both, inside, rows, freedom=Freedom.whole(n), cutoff=_NOTHING)
