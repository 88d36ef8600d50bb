"""The sizes of a stack of tasks: what a compiled tick is made for."""

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
    """One level of a compiled tick.

    Attributes:
        rows: k, at least 1.
        is_set: the level asks for lower ≤ J v ≤ upper, not for J v = lower; then it has 1 row.
    """

    rows: int
    is_set: bool = False


@dataclass(frozen=True)
class SymbolicLevel:
    """A level in symbols: J (k, n), lower, upper (k, 1)."""

    J: ca.SX
    lower: ca.SX
    upper: ca.SX
    is_set: bool

    def desired(self, w: ca.SX) -> ca.SX:
        """What J z should be for z near w: the value asked for, or J w moved between the bounds."""
        return ca.fmin(ca.fmax(self.J @ w, self.lower), self.upper) if self.is_set else self.lower


@dataclass(frozen=True)
class StackShape:
    """n velocities and the levels over them, highest priority first.

    Raises:
        InputError: no velocity, no level, a level without a whole number of rows, or a set-based one of more than one.
    """

    n: int
    levels: tuple[LevelShape, ...]

    def __post_init__(self) -> None:
        """Check the sizes."""
        if not isinstance(self.n, int | np.integer) or self.n < 1:
            raise InputError("must be at least 1, and whole", key="n", value=self.n)
        if not self.levels:
            raise InputError("has no level", key="levels", remedy="give at least one task")
        for place, level in enumerate(self.levels, start=1):
            if not isinstance(level, LevelShape):
                raise InputError("is no LevelShape", key=f"level {place}", value=level, remedy="as in LevelShape(2)")
            if not isinstance(level.rows, int | np.integer) or level.rows < 1:
                raise InputError("is no number of rows", key=f"level {place}", value=level.rows, remedy="give 1, 2, …")
            if level.is_set and level.rows > 1:
                raise InputError(
                    f"is set-based and has {level.rows} rows; a compiled one has 1",
                    key=f"level {place}",
                    remedy="split it into one level a row",
                )

    @property
    def rows(self) -> int:
        """Rows of all levels."""
        return sum(level.rows for level in self.levels)

    @property
    def tallest(self) -> int:
        """Rows of the largest level."""
        return max(level.rows for level in self.levels)

    @property
    def starts(self) -> tuple[int, ...]:
        """First row of each level in the stack."""
        return tuple(sum(level.rows for level in self.levels[:i]) for i in range(len(self.levels)))

    @property
    def inputs(self) -> tuple[tuple[str, int], ...]:
        """(name, entries) of the arrays that hold the stack: J row by row, lower, upper."""
        return (("J", self.rows * self.n), ("lower", self.rows), ("upper", self.rows))

    def symbols(self) -> tuple[list[ca.SX], list[SymbolicLevel]]:
        """Symbols for these inputs, and the levels in them."""
        flat = [ca.SX.sym(name, size) for name, size in self.inputs]
        return flat, list(self._levels(flat))

    def _levels(self, flat: Sequence[ca.SX]) -> Iterator[SymbolicLevel]:
        J, lower, upper = flat
        for start, level in zip(self.starts, self.levels, strict=True):
            end = start + level.rows
            matrix = as_matrix(J[start * self.n : end * self.n], self.n)
            yield SymbolicLevel(matrix, lower[start:end], upper[start:end], level.is_set)
