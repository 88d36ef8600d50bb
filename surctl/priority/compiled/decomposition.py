"""Row space of a symbolic Jacobian J, computed without J Jᵀ, so that linearly dependent rows are treated exactly.

Rows and columns that are not yet computed are zero, so the inner loops can always run over all of them.

`StackShape` says for which numbers of velocities and Jacobian rows a step is compiled.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.priority.settings import CUTOFF, ZERO_ROW
from surctl.priority.solver.elimination import as_matrix

__all__ = ["Decomposition", "LevelShape", "StackShape", "SymbolicLevel", "decompose"]


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
                raise InputError(
                    f"is set-based and has {level.rows} rows; a compiled set-based level has 1",
                    key=f"level {place}",
                    remedy="split it into one level for each row",
                )

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


class Decomposition(NamedTuple):
    """Complete orthogonal decomposition scale·J N = P T Q of a Jacobian J (k, n) times an orthogonal projector N.

    Attributes:
        Q: k columns (n, 1), orthonormal basis of the row space of J N; column i is zero if row i of J N depends on the
            rows above (Golub and Van Loan 2013, 5.4.7).
        P: k orthonormal columns (k, 1); column i is zero if column i of Q is zero.
        T: rows of an upper triangular matrix (k, k); row i and column i are zero if column i of Q is zero.
        inverse: reciprocals of the k diagonal entries of T; 0 for a diagonal entry of 0.
        scale: 1/‖J‖, where ‖J‖ is the length of the longest row of J; 0 for a zero J (inactive task).
    """

    Q: list[ca.SX]
    P: list[ca.SX]
    T: list[list[ca.SX]]
    inverse: list[ca.SX]
    scale: ca.SX

    def turned(self, x: ca.SX) -> ca.SX:
        """Return b = Pᵀ·scale·x (k, 1), for which ‖J N y − x‖ and ‖T Q y − b‖ have the same minimisers y."""
        rest, entries = x * self.scale, []
        for p in self.P:
            entries.append(ca.dot(p, rest))
            rest = rest - entries[-1] * p
        return ca.vertcat(*entries)

    def coordinates(self, x: ca.SX) -> ca.SX:
        """Return c (k, 1), where Qᵀc is the shortest y in the range of N that minimises ‖J N y − x‖."""
        c = ca.vertsplit(self.turned(x))
        for j in reversed(range(len(c))):
            for i in range(j + 1, len(c)):
                c[j] = c[j] - self.T[j][i] * c[i]
            c[j] = c[j] * self.inverse[j]
        return ca.vertcat(*c)

    def directions(self) -> ca.SX:
        """Return Q as a matrix (k, n), with one direction in each row."""
        return ca.horzcat(*self.Q).T


def decompose(J: ca.SX, N: ca.SX | None = None) -> Decomposition:
    """Return the decomposition of J N for J (k, n) and an orthogonal projector N (n, n); None means the identity.

    A row of J counts as linearly dependent if its part in the range of N and orthogonal to the rows above is shorter
    than `CUTOFF`·‖J‖. The cut-off is relative to ‖J‖ and not to ‖J N‖, because J N contains only rounding errors if the
    task has no freedom left.
    """
    k = J.shape[0]
    longest = ca.SX(0)
    for i in range(k):
        longest = ca.fmax(longest, ca.sqrt(ca.sumsqr(J[i, :])))
    alive = longest > ZERO_ROW
    scale = ca.if_else(alive, 1 / ca.if_else(alive, longest, 1), 0)
    rows = [(scale * J[i, :]).T for i in range(k)]
    Q: list[ca.SX] = []
    for row in rows:
        Q.append(_direction(row, Q, N))
    # row i depends on directions 1 … i only; rounding errors in the other entries are dropped
    left = [[ca.dot(rows[i], Q[j]) if j <= i else ca.SX(0) for j in range(k)] for i in range(k)]
    P, T, inverse = _orthonormal_columns(left)
    return Decomposition(Q, P, T, inverse, scale)


def _direction(row: ca.SX, Q: list[ca.SX], N: ca.SX | None) -> ca.SX:
    """Return the unit vector along the part of a row that is orthogonal to the directions Q, or 0 if this part is 0."""
    # two orthogonalisation passes suffice (Parlett 1998, 6.9)
    q = _outside(row, Q, N)
    length = ca.sqrt(ca.sumsqr(q))
    alive = length > CUTOFF
    q = q * ca.if_else(alive, 1 / ca.if_else(alive, length, 1), 0)
    if not Q and N is None:
        return q
    q = _outside(q, Q, N)
    again = ca.sqrt(ca.sumsqr(q))
    return q * ca.if_else(alive, 1 / ca.if_else(alive, again, 1), 0)


def _outside(vector: ca.SX, Q: list[ca.SX], N: ca.SX | None) -> ca.SX:
    if N is not None:
        vector = N @ vector
    for q in Q:
        vector = vector - ca.dot(q, vector) * q
    return vector


def _orthonormal_columns(left: list[list[ca.SX]]) -> tuple[list[ca.SX], list[list[ca.SX]], list[ca.SX]]:
    """Factor a k × k matrix into P T by modified Gram–Schmidt, with two passes per column; return P, T, 1/diag T."""
    k = len(left)
    P: list[ca.SX] = []
    T: list[list[ca.SX]] = [[ca.SX(0)] * k for _ in range(k)]
    inverse: list[ca.SX] = []
    for j in range(k):
        p = ca.vertcat(*(left[i][j] for i in range(k)))
        for _ in range(2 if j else 0):
            for i, earlier in enumerate(P):
                part = ca.dot(earlier, p)
                T[i][j] = T[i][j] + part
                p = p - part * earlier
        T[j][j] = ca.sqrt(ca.sumsqr(p))
        alive = T[j][j] > 0
        inverse.append(ca.if_else(alive, 1 / ca.if_else(alive, T[j][j], 1), 0))
        P.append(p * inverse[j])
    return P, T, inverse
