"""Solver that meets strict priority levels one after another within the limits, then approaches a target velocity.

A strict level is one that no lower level may change. With no strict level, the solver returns the velocity nearest to
the target that satisfies the limits. With one strict level, the solver computes the projection on the first task in the
NSB law, equation (16) of the paper, restricted to the limits. If all levels are strict and the target is 0, the result
is strict (lexicographic) priority (Kanoun, Lamiraux and Wieber 2011; Escande, Mansard and Wieber 2014). After a level
is solved, its value of J v is fixed by elimination of variables, never by an inequality with a tolerance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.active_set import solve_level
from surctl.priority.backends import Backend
from surctl.priority.freedom import Freedom
from surctl.priority.polyhedron import Polyhedron
from surctl.priority.problem import Level

__all__ = ["CascadeSolution", "solve_cascade"]

Array: TypeAlias = NDArray[np.float64]

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
        by_name = named_multipliers(rows, multipliers, above=_FELT * (1.0 + float(np.abs(v).max()))) | dict(held or {})
        return CascadeSolution(
            v,
            tuple((name, by_name[name]) for name in dict.fromkeys((*rows.names, *by_name)) if name in by_name),
            causes or {},
            iterations,
            confirmed,
        )


def named_multipliers(rows: Polyhedron, multipliers: Array, *, above: float) -> dict[str, float]:
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
    solution = solve_level(level, place.inside, place.rows, freedom=place.freedom, cutoff=cutoff)
    value = level.J @ solution.v
    off = np.abs(level.miss(solution.v)) > _MISSED * (1.0 + np.abs(value))
    frozen = level.exact | off
    narrow = place.freedom.narrowed(level.J[frozen], value[frozen], cutoff=cutoff)
    rows = _with_set_rows(level, place.rows, ~frozen).holding(solution.v)
    after = _nearest(narrow, rows, target, backend=backend, inside=solution.v)
    assert after is not None  # a feasible point is known
    # a level whose residual the rows raise by at most 1e-9 of ‖J‖ counts as met
    felt = _MISSED * float(np.linalg.norm(level.J, 2)) ** 2
    held = named_multipliers(place.rows, solution.multipliers, above=felt)
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
