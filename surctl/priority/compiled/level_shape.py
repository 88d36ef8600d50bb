"""The shape of a stack of tasks: the sizes for which a priority step is compiled."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.priority.solver.elimination import as_matrix

__all__ = ["LevelShape", "StackShape", "SymbolicLevel"]


@dataclass(frozen=True)
class LevelShape:
    """The size and kind of one level of a compiled priority step.

    Attributes:
        rows: number of rows k of J, at least 1.
        is_set: True for a level lower ≤ J v ≤ upper, whose J has 1 row; False for a level J v = lower.
    """

    rows: int
    is_set: bool = False


@dataclass(frozen=True)
class SymbolicLevel:
    """A level as symbolic expressions: J (k, n), Jacobian; lower, upper (k, 1), bounds of J v."""

    J: ca.SX
    lower: ca.SX
    upper: ca.SX
    is_set: bool

    def desired(self, w: ca.SX) -> ca.SX:
        """Return the desired value of J z for z near w: lower if not set-based, else J w moved into the bounds."""
        return ca.fmin(ca.fmax(self.J @ w, self.lower), self.upper) if self.is_set else self.lower


@dataclass(frozen=True)
class StackShape:
    """The shape of a stack: n velocities and the levels of tasks for these velocities, highest priority first.

    Raises:
        InputError: n or the number of rows of a J is not a whole number of at least 1, the stack has no level, or the J
            of a set-based level has more than one row.
    """

    n: int
    levels: tuple[LevelShape, ...]

    def __post_init__(self) -> None:
        """Check the sizes."""
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
                raise InputError(
                    f"is set-based and has {level.rows} rows; a compiled set-based level has 1",
                    key=f"level {place}",
                    remedy="split it into one level for each row",
                )

    @property
    def rows(self) -> int:
        """Return the number of rows of the J of all levels together."""
        return sum(level.rows for level in self.levels)

    @property
    def tallest(self) -> int:
        """Return the number of rows of the largest J."""
        return max(level.rows for level in self.levels)

    @property
    def starts(self) -> tuple[int, ...]:
        """Return the index of the first row of each level in the stacked J."""
        return tuple(sum(level.rows for level in self.levels[:i]) for i in range(len(self.levels)))

    @property
    def inputs(self) -> tuple[tuple[str, int], ...]:
        """Return (name, number of entries) of the arrays that hold the stack: J (row by row), lower, upper."""
        return (("J", self.rows * self.n), ("lower", self.rows), ("upper", self.rows))

    def symbols(self) -> tuple[list[ca.SX], list[SymbolicLevel]]:
        """Return symbols for the arrays in `inputs`, and the levels as expressions of these symbols."""
        flat = [ca.SX.sym(name, size) for name, size in self.inputs]
        return flat, list(self._levels(flat))

    def _levels(self, flat: Sequence[ca.SX]) -> Iterator[SymbolicLevel]:
        J, lower, upper = flat
        for start, level in zip(self.starts, self.levels, strict=True):
            end = start + level.rows
            matrix = as_matrix(J[start * self.n : end * self.n], self.n)
            yield SymbolicLevel(matrix, lower[start:end], upper[start:end], level.is_set)
