"""Shapes of the levels for which a priority step is compiled, and its inputs as symbols."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.priority.solver.elimination import as_matrix


@dataclass(frozen=True)
class LevelShape:
    """Number of Jacobian rows and kind of one level of a compiled priority step.

    Attributes:
        rows: number of rows of the level's Jacobian J, at least 1.
        is_set: True for a set-based level lower ≤ J v ≤ upper, whose J must have 1 row; False for a level J v = lower.
    """

    rows: int
    is_set: bool = False


@dataclass(frozen=True)
class SymbolicLevel:
    """A priority level as symbolic expressions: Jacobian J (k, n), and lower, upper (k, 1), the bounds of J v."""

    J: ca.SX
    lower: ca.SX
    upper: ca.SX
    is_set: bool

    def desired(self, w: ca.SX) -> ca.SX:
        """Return the desired value of J v in the projection of w: `lower`, or J w clipped if the level is set-based."""
        return ca.fmin(ca.fmax(self.J @ w, self.lower), self.upper) if self.is_set else self.lower


@dataclass(frozen=True)
class StackShape:
    """The number of velocities n, and the shapes of all levels of a task stack, highest priority first.

    Raises:
        InputError: n or the number of rows of a Jacobian is not a whole number of at least 1, the stack has no level,
            or the Jacobian of a set-based level has more than one row.
    """

    n: int
    levels: tuple[LevelShape, ...]

    def __post_init__(self) -> None:
        """Check the number of velocities and the number of Jacobian rows of each level."""
        if not isinstance(self.n, int | np.integer) or self.n < 1:
            raise InputError("must be a whole number of at least 1", key="n", value=self.n)
        if not self.levels:
            raise InputError("has no level", key="levels", remedy="give at least one task")
        for place, level in enumerate(self.levels, start=1):
            if not isinstance(level, LevelShape):
                raise InputError("is not a LevelShape", key=f"level {place}", value=level, remedy="as in LevelShape(2)")
            if not isinstance(level.rows, int | np.integer) or level.rows < 1:
                raise InputError("is not a row count", key=f"level {place}", value=level.rows, remedy="give 1, 2, …")
            if level.is_set and level.rows > 1:
                problem = f"is set-based and has {level.rows} rows; a compiled set-based level has 1"
                raise InputError(problem, key=f"level {place}", remedy="split it into one level for each row")

    @property
    def rows(self) -> int:
        """Return the number of Jacobian rows of all levels together."""
        return sum(level.rows for level in self.levels)

    @property
    def starts(self) -> tuple[int, ...]:
        """Return the index of the first row of each level in the stacked Jacobian J."""
        return tuple(sum(level.rows for level in self.levels[:i]) for i in range(len(self.levels)))

    @property
    def inputs(self) -> tuple[tuple[str, int], ...]:
        """Return (name, number of entries) of the arrays for all levels together: J (row by row), lower, upper."""
        return (("J", self.rows * self.n), ("lower", self.rows), ("upper", self.rows))

    def symbols(self) -> tuple[list[ca.SX], list[SymbolicLevel]]:
        """Return symbols for the arrays named in `inputs`, and the levels as expressions of these symbols."""
        flat = [ca.SX.sym(name, size) for name, size in self.inputs]
        return flat, list(self._levels(flat))

    def _levels(self, flat: Sequence[ca.SX]) -> Iterator[SymbolicLevel]:
        J, lower, upper = flat
        for start, level in zip(self.starts, self.levels, strict=True):
            end = start + level.rows
            matrix = as_matrix(J[start * self.n : end * self.n], self.n)
            yield SymbolicLevel(matrix, lower[start:end], upper[start:end], level.is_set)
