"""Row space of a symbolic Jacobian J, computed without J Jᵀ, so that linearly dependent rows are treated exactly.

Rows and columns that are not yet computed are zero, so the inner loops can always run over all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, lower
from surctl.priority.settings import CUTOFF, ZERO_ROW
from surctl.priority.solver.elimination import as_matrix, product

__all__ = ["Decomposition", "attainable", "decompose"]


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

    @property
    def rank(self) -> ca.SX:
        """Return the number of linearly independent rows of J N."""
        return sum((inverse > 0 for inverse in self.inverse), ca.SX(0))

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

    def task(self) -> ca.SX:
        """Return the matrix T Q (k, n)."""
        return _matrix(self.T) @ self.directions()

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


def _matrix(entries: list[list[ca.SX]]) -> ca.SX:
    return ca.vertcat(*(ca.horzcat(*row) for row in entries))


def attainable(k: int, n: int) -> Routine:
    """Return the routine that removes from J v = x what no velocity attains.

    Inputs: J (k·n,) row by row, k > 1; x (k,). Outputs: both unchanged if the rows of J are linearly independent,
    otherwise the matrix T Q and the vector Pᵀ·scale·x of `Decomposition`.
    """
    T = ca.SX.sym("T", k * k)
    turned = lower(ca.Function("turned_over", [T], [ca.vec(as_matrix(T, k))]))
    steps = (
        Call(_scaled(k, n), ("J", "x"), ("rows", "rest", "Q_none", "P_none")),
        Loop(_direction_in_loops(k, n), k, ("Q_none",), ("Q",), sliced=("rows",), index=True),
        Loop(_column(k, n), k, (), ("columns",), sliced=("Q",), fixed=("rows",), index=True),
        Loop(_orthonormal(k), k, ("P_none",), ("P", "T_columns", "inverse"), sliced=("columns",), index=True),
        Loop(_outside_in_loops(k), k, ("rest",), ("left", "b"), sliced=("P",)),
        Call(turned, ("T_columns",), ("T",)),
        Loop(product(k, n), k, (), ("task",), sliced=("T",), fixed=("Q",)),
        Call(_chosen(k, n), ("J", "x", "task", "b", "inverse"), ("J_1", "x_1")),
    )
    return Routine("attainable", (("J", k * n), ("x", k)), steps, ("J_1", "x_1"))


def _scaled(k: int, n: int) -> Program:
    J, x, longest = ca.SX.sym("J", k * n), ca.SX.sym("x", k), ca.SX(0)
    matrix = as_matrix(J, n)
    for i in range(k):
        longest = ca.fmax(longest, ca.sqrt(ca.sumsqr(matrix[i, :])))
    alive = longest > ZERO_ROW
    scale = ca.if_else(alive, 1 / ca.if_else(alive, longest, 1), 0)
    outputs = [scale * J, x * scale, ca.SX.zeros(k * n), ca.SX.zeros(k * k)]
    return lower(ca.Function("scaled_task", [J, x], list(map(ca.densify, outputs))))


def _outside_in_loops(size: int) -> Program:
    """Return a program that subtracts from a vector its component along q, and returns this component too."""
    vector, q = ca.SX.sym("vector", size), ca.SX.sym("q", size)
    part = ca.dot(q, vector)
    return lower(ca.Function("outside", [vector, q], [vector - part * q, part]))


def _direction_in_loops(k: int, n: int) -> Routine:
    """Return the routine that computes direction number `turn`, in two passes as in `decomposition`."""
    q, alive = ca.SX.sym("q", n), ca.SX.sym("alive")
    length = ca.sqrt(ca.sumsqr(q))
    long = length > CUTOFF
    first = [q * ca.if_else(long, 1 / ca.if_else(long, length, 1), 0), long]
    second = [q * ca.if_else(alive, 1 / ca.if_else(alive, length, 1), 0)]
    steps = (
        Loop(_outside_in_loops(n), k, ("row",), ("q_rough", "parts"), sliced=("Q",)),
        Call(lower(ca.Function("first_pass", [q], first)), ("q_rough",), ("q_unit", "alive")),
        Loop(_outside_in_loops(n), k, ("q_unit",), ("q_clean", "more"), sliced=("Q",)),
        Call(lower(ca.Function("second_pass", [q, alive], second)), ("q_clean", "alive"), ("q",)),
        Loop(_placed(n), k, (), ("Q_next",), sliced=("Q",), fixed=("turn", "q"), index=True),
    )
    return Routine("direction", (("turn", 1), ("Q", k * n), ("row", n)), steps, ("Q_next",))


def _placed(size: int) -> Program:
    at, row, turn, new = ca.SX.sym("at"), ca.SX.sym("row", size), ca.SX.sym("turn"), ca.SX.sym("new", size)
    return lower(ca.Function("placed", [at, row, turn, new], [ca.if_else(ca.eq(at, turn), new, row)]))


def _column(k: int, n: int) -> Program:
    # row i depends on directions 1 … i only; rounding errors in the other entries are dropped
    turn, q, rows = ca.SX.sym("turn"), ca.SX.sym("q", n), ca.SX.sym("rows", k * n)
    values = as_matrix(rows, n) @ q
    return lower(
        ca.Function("column", [turn, q, rows], [ca.vertcat(*(ca.if_else(turn <= i, values[i], 0) for i in range(k)))])
    )


def _orthonormal(k: int) -> Routine:
    """Return the routine that orthonormalises column number `turn`; outputs: P, column of T, 1/diagonal entry of T."""
    turn, p, one, two = ca.SX.sym("turn"), ca.SX.sym("p", k), ca.SX.sym("one", k), ca.SX.sym("two", k)
    length = ca.sqrt(ca.sumsqr(p))
    alive = length > 0
    inverse = ca.if_else(alive, 1 / ca.if_else(alive, length, 1), 0)
    T = ca.vertcat(*(ca.if_else(ca.eq(turn, i), length, one[i] + two[i]) for i in range(k)))
    end = lower(ca.Function("column_end", [turn, p, one, two], [p * inverse, T, inverse]))
    steps = (
        Loop(_outside_in_loops(k), k, ("column",), ("p_rough", "one"), sliced=("P",)),
        Loop(_outside_in_loops(k), k, ("p_rough",), ("p_clean", "two"), sliced=("P",)),
        Call(end, ("turn", "p_clean", "one", "two"), ("p", "T", "inverse")),
        Loop(_placed(k), k, (), ("P_next",), sliced=("P",), fixed=("turn", "p"), index=True),
    )
    return Routine("orthonormal", (("turn", 1), ("P", k * k), ("column", k)), steps, ("P_next", "T", "inverse"))


def _chosen(k: int, n: int) -> Program:
    J, x, task, b = (ca.SX.sym(name, size) for name, size in (("J", k * n), ("x", k), ("task", k * n), ("b", k)))
    inverse, rank = ca.SX.sym("inverse", k), ca.SX(0)
    for entry in ca.vertsplit(inverse):
        rank = rank + (entry > 0)
    full = ca.eq(rank, k)
    outputs = [ca.if_else(full, J, task), ca.if_else(full, x, b)]
    return lower(ca.Function("attainable_part", [J, x, task, b, inverse], outputs))
