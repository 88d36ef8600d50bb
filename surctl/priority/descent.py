"""Down the ladder: inside the rows; inside rows that were opened by the least; in the box at any rate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.backends import Backend
from surctl.priority.cascade import Reached
from surctl.priority.freedom import Freedom
from surctl.priority.polyhedron import Polyhedron
from surctl.priority.reach import least_violation
from surctl.priority.solution import Outcome

__all__ = ["Answer", "descend"]

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Answer:
    """What a mode answers.

    Attributes:
        v: (n,). target: (n,), the point that the last projection started from. free: (n,), the answer without rows.
        status: how it came about; "optimal" here also where rows hold levels back; "unconfirmed" where a solver's
            failure left a point that keeps the rows.
        binding, blame, iterations: as `Reached`.
        conflict: names of the rows that contradict each other.
    """

    v: Array
    target: Array
    free: Array
    status: Outcome
    binding: tuple[tuple[str, float], ...] = ()
    blame: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    iterations: int = 0
    conflict: tuple[str, ...] = ()


def descend(
    find: Callable[..., Reached | None], target: Array, rows: Polyhedron, *, free: Array, backend: Backend
) -> Answer:
    """The first rung that holds; always a finite v inside the box.

    Args:
        find: (rows, inside) → the mode's answer inside the rows, None if no v keeps them; `inside` (n,) is a point
            known to keep them, or None.
        target: (n,), what `find` starts from; free: (n,), the answer without rows.
    """
    found = find(rows, inside=None)
    if found is not None:
        return _answer(found, target, rows, free, "optimal" if found.confirmed else "unconfirmed", 0, ())
    relaxed = least_violation(rows, target, backend=backend)
    if relaxed is None:
        return _last_resort(free, target, rows, backend)
    found = find(relaxed.rows, inside=relaxed.inside)
    if found is None:  # cannot be but by a solver's failure: a point inside is known
        return _last_resort(free, target, rows, backend)
    status: Outcome = "relaxed" if relaxed.opened else "optimal"
    if not (found.confirmed and relaxed.least):
        status = "unconfirmed"
    return _answer(found, target, rows, free, status, relaxed.iterations, relaxed.conflict)


def _answer(
    found: Reached,
    target: Array,
    rows: Polyhedron,
    free: Array,
    status: Outcome,
    spent: int,
    conflict: tuple[str, ...],
) -> Answer:
    v = rows.clamp(found.v)
    return Answer(v, target, free, status, found.binding, found.blame, spent + found.iterations, conflict)


def _last_resort(free: Array, target: Array, rows: Polyhedron, backend: Backend) -> Answer:
    """The actuator rows contradict each other, or every solver gave up: what misses those rows least."""
    hard = rows.mask("actuator")
    answer = Freedom.whole(free.size).nearest(free, rows.only(hard), backend=backend)
    options = [rows.clamp(option) for option in (answer.x, free, np.zeros(free.size)) if option is not None]
    finite = [option for option in options if np.isfinite(option).all()] or [rows.clamp(np.zeros(free.size))]
    v = min(finite, key=lambda option: float(rows.violation(option)[hard].max(initial=0.0)))
    return Answer(v, target, free, "clamped", iterations=answer.iterations)
