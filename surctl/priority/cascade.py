"""Strict levels one after another inside the rows, then the nearest point to a target in what they leave.

With no strict level this is a filter of the target; with one, the last projection of the paper's sweep kept inside
the rows; with all of them and target 0, strict (lexicographic) priority (Kanoun, Lamiraux and Wieber 2011; Escande,
Mansard and Wieber 2014). What a level reached is kept by elimination, never by an inequality with a tolerance.
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
_FELT = 1e-9  # a multiplier up to this, relative to 1 + max |v|, is rounding
_SLACK = 1e-9
"""Room [row of length 1] for rows that may give, where the set has no inside and a solver calls it empty."""


@dataclass(frozen=True, eq=False)
class CascadeSolution:
    """Where the cascade ended.

    Attributes:
        v: (n,).
        binding: (name, multiplier) of the rows in the way, for the rows as given, in their order: of ½‖v − target‖²; of
            ½‖miss‖² for rows that hold a strict level back.
        blame: for each strict level that rows hold back, their names.
        iterations: of all solvers.
        confirmed: whether every step passed its check; if not, v keeps the rows but may not be the best.
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
        """From multipliers (m,) of rows of length 1; `held`, of rows that hold a strict level back, count first."""
        by_name = named_multipliers(rows, multipliers, above=_FELT * (1.0 + float(np.abs(v).max()))) | dict(held or {})
        return CascadeSolution(
            v,
            tuple((name, by_name[name]) for name in dict.fromkeys((*rows.names, *by_name)) if name in by_name),
            causes or {},
            iterations,
            confirmed,
        )


def named_multipliers(rows: Polyhedron, multipliers: Array, *, above: float) -> dict[str, float]:
    """Multipliers (m,) of rows of length 1 that are larger than `above`, by name, for the rows as given."""
    return {rows.names[i]: float(u / rows.length[i]) for i, u in enumerate(multipliers) if abs(u) > above}


@dataclass(frozen=True, eq=False)
class _Place:
    """What some levels leave: a freedom, rows, and the point in both that is nearest to the target.

    multipliers: (m,) of that point. held: the same of the level that rows hold back. confirmed: whether the point
    passed its check.
    """

    freedom: Freedom
    rows: Polyhedron
    inside: Array
    multipliers: Array
    iterations: int
    held: Mapping[str, float]
    confirmed: bool


def solve_cascade(
    strict: Sequence[Level],
    target: Array,
    rows: Polyhedron,
    *,
    backend: Backend,
    cutoff: float,
    inside: Array | None = None,
) -> CascadeSolution | None:
    """The cascade; None if no v keeps the rows. target (n,); inside (n,): a point known to keep them, or None."""
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
    """The level met as well as the levels above allow, if the rows allow that too."""
    goal = level.exact
    narrow = freedom.narrowed(level.J[goal], level.lower[goal], cutoff=cutoff)
    more = _with_set_rows(level, rows, ~goal)
    return _nearest(narrow, more, target, backend=backend)


def _limited(level: Level, target: Array, place: _Place, *, backend: Backend, cutoff: float) -> _Place:
    """The level met as well as the rows allow, and frozen there."""
    solution = solve_level(level, place.inside, place.rows, freedom=place.freedom, cutoff=cutoff)
    value = level.J @ solution.v
    off = np.abs(level.miss(solution.v)) > _MISSED * (1.0 + np.abs(value))
    frozen = level.exact | off
    narrow = place.freedom.narrowed(level.J[frozen], value[frozen], cutoff=cutoff)
    rows = _with_set_rows(level, place.rows, ~frozen).holding(solution.v)
    after = _nearest(narrow, rows, target, backend=backend, inside=solution.v)
    assert after is not None  # a point inside is known
    # a level that rows hardly hold back (by 1e-9 of ‖J‖) counts as met
    felt = _MISSED * float(np.linalg.norm(level.J, 2)) ** 2
    held = named_multipliers(place.rows, solution.multipliers, above=felt)
    spent = after.iterations + solution.iterations
    return _Place(narrow, rows, after.inside, after.multipliers, spent, held, after.confirmed and solution.converged)


def _with_set_rows(level: Level, rows: Polyhedron, chosen: NDArray[np.bool_]) -> Polyhedron:
    """The rows, and the chosen ones of a set-based level."""
    if not chosen.any():
        return rows
    one = level.lower.size == 1
    names = [level.name if one else f"{level.name}.{i}" for i in np.flatnonzero(chosen)]
    return rows.also(level.J[chosen], level.lower[chosen], level.high[chosen], names=names)


def _nearest(
    freedom: Freedom, rows: Polyhedron, target: Array, *, backend: Backend, inside: Array | None = None
) -> _Place | None:
    """The nearest point to the target; else the one that is known to be inside, unconfirmed; None if there is none."""
    solution = freedom.nearest(target, rows, backend=backend)
    spent = solution.iterations
    if solution.x is None and inside is not None:
        solution = freedom.nearest(target, rows.relaxed(rows.mask("barrier", "set"), _SLACK), backend=backend)
        spent += solution.iterations
    if solution.x is not None:
        return _Place(freedom, rows, solution.x, solution.multipliers, spent, {}, True)
    return None if inside is None else _Place(freedom, rows, inside, np.zeros(len(rows.names)), spent, {}, False)
