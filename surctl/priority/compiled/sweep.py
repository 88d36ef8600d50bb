"""The NSB law, equation (16) of the paper, as compiled projections, and a check that all inputs are finite.

`nsb_symbolic` returns the law for goals alone as one CasADi expression.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca

from surctl.errors import InputError
from surctl.ir import Call, Program, Step, lower
from surctl.ir.procedure import Procedure
from surctl.priority.compiled.projections import checks, projections
from surctl.priority.settings import CUTOFF, ZERO_ROW, Settings
from surctl.priority.shapes import StackShape, SymbolicLevel
from surctl.priority.solver.elimination import LONGEST, LOOPED

_DEPENDENT = 1e-12
"""A row of J is dependent if its squared distance from the rows above is below this fraction of its squared length."""

_ZERO_SQUARE = 1e-30
"""Squared length below which a row counts as zero and its task as inactive (`rowspace.ZERO_ROW` squared)."""


def nsb_symbolic(levels: Sequence[tuple[ca.SX, ca.SX]], *, damping: float = 0.0) -> ca.SX:
    """Return the velocity v (n, 1) of the NSB law, equation (16) of the paper, as a CasADi expression.

    `levels` are pairs of Jacobian J (k, n) and desired rate x (k, 1), highest priority first. The law is computed as w
    ← w + J_λ(x − J w) from the lowest level to the highest. The damped inverse J_λ = Jᵀ(JJᵀ + λ²I)⁻¹, λ = `damping`
    (unit of J), comes from an explicit LDLᵀ factorisation, without loop or branch. So every step minimises λ²‖z − w‖² +
    ‖J z − x‖² over z.

    Without damping, a zero row of J (an inactive task) contributes nothing, and a row of J that is linearly dependent
    on earlier rows of J is ignored. The velocity differs from that of `nsb` only if dependent rows contradict each
    other: `nsb` then takes the mean of their desired values.

    Raises:
        InputError: there is no level, the shapes of J and x are inconsistent, or the damping is negative.

    Example:
        >>> import casadi as ca
        >>> from surctl.priority import nsb_symbolic
        >>> bearing, goal = ca.SX.sym("bearing"), ca.SX.sym("goal", 2)
        >>> away = ca.horzcat(ca.cos(bearing), ca.sin(bearing))
        >>> law = ca.Function("law", [bearing, goal], [nsb_symbolic([(away, ca.SX(0)), (ca.SX.eye(2), goal)])])
        >>> law(0.0, [0.3, 0.4])  # nothing towards the obstacle ahead
        DM([0, 0.4])
    """
    _check(levels, damping)
    w = ca.SX.zeros(levels[0][0].shape[1], 1)
    for J, x in reversed(levels):
        w = projection(w, J, x, damping=damping)
    return ca.densify(w)


def projection(w: ca.SX, J: ca.SX, x: ca.SX, *, damping: float = 0.0) -> ca.SX:
    """Return the z that minimises λ²‖z − w‖² + ‖J z − x‖², with λ = `damping`, w (n, 1), J (k, n), x (k, 1)."""
    return w + J.T @ _solve_gram(J, x - J @ w, damping)


def _solve_gram(J: ca.SX, rhs: ca.SX, damping: float) -> ca.SX:
    """Return the solution y (k, 1) of (J Jᵀ + λ²I) y = rhs by LDLᵀ, λ = `damping`; y is 0 for dependent rows of J."""
    G = ca.densify(J @ J.T + damping**2 * ca.SX.eye(J.shape[0]))
    L, inverse = _factorise(G, damping**2)
    k = G.shape[0]
    y = [rhs[i] for i in range(k)]
    for i in range(k):
        for j in range(i):
            y[i] = y[i] - L[i][j] * y[j]
    y = [y[i] * inverse[i] for i in range(k)]
    for i in reversed(range(k)):
        for j in range(i + 1, k):
            y[i] = y[i] - L[j][i] * y[j]
    return ca.vertcat(*y)


def _factorise(G: ca.SX, least: float) -> tuple[list[list[ca.SX]], list[ca.SX]]:
    """Return the factors L (rows) and 1/D (0 for a zero pivot) of G = L D Lᵀ, with L unit lower triangular."""
    # with damping every pivot is at least λ² (`least`) up to rounding; stating this bound helps proofs about the
    # expression
    k = G.shape[0]
    L: list[list[ca.SX]] = [[ca.SX(0)] * k for _ in range(k)]
    pivots: list[ca.SX] = []
    inverse: list[ca.SX] = []
    for j in range(k):
        pivot = G[j, j]
        for m in range(j):
            pivot = pivot - L[j][m] * L[j][m] * pivots[m]
        if least > 0.0:
            pivot = ca.fmax(pivot, least) if j else pivot  # the first needs no bound: squares plus λ²
            inverse.append(1.0 / pivot)
        else:
            alive = pivot > _DEPENDENT * G[j, j] + _ZERO_SQUARE
            # both branches are finite, so the branch that is not selected cannot spoil the result
            inverse.append(ca.if_else(alive, 1.0 / ca.if_else(alive, pivot, 1.0), 0.0))
        pivots.append(pivot)
        for i in range(j + 1, k):
            entry = G[i, j]
            for m in range(j):
                entry = entry - L[i][m] * L[j][m] * pivots[m]
            L[i][j] = entry * inverse[j]
    return L, inverse


def _check(levels: Sequence[tuple[ca.SX, ca.SX]], damping: float) -> None:
    if not levels:
        raise InputError("has no level", key="stack", remedy="give at least one task")
    if not 0.0 <= damping < float("inf"):
        raise InputError("must be at least 0", key="damping", value=damping, remedy="give 0 for none")
    width = levels[0][0].shape[1]
    for place, (J, x) in enumerate(levels, start=1):
        if J.shape[1] != width or x.shape != (J.shape[0], 1):
            remedy = f"give J of shape (k, {width}) and x of shape (k, 1)"
            raise InputError(f"J has shape {J.shape}, x has shape {x.shape}", key=f"level {place}", remedy=remedy)


HUGE = 1e300
"""Numbers larger than this count as infinite."""


class Decomposition(NamedTuple):
    """Complete orthogonal decomposition scale·J = P T Q of a Jacobian J (k, n).

    Attributes:
        Q: k columns (n, 1), orthonormal basis of the row space of J; column i is zero if row i of J depends on the rows
            above (Golub and Van Loan 2013, 5.4.7).
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
        """Return b = Pᵀ·scale·x (k, 1), for which ‖J y − x‖ and ‖T Q y − b‖ have the same minimisers y."""
        rest, entries = x * self.scale, []
        for p in self.P:
            entries.append(ca.dot(p, rest))
            rest = rest - entries[-1] * p
        return ca.vertcat(*entries)

    def coordinates(self, x: ca.SX) -> ca.SX:
        """Return c (k, 1), where Qᵀc is the shortest y that minimises ‖J y − x‖."""
        c = ca.vertsplit(self.turned(x))
        for j in reversed(range(len(c))):
            for i in range(j + 1, len(c)):
                c[j] = c[j] - self.T[j][i] * c[i]
            c[j] = c[j] * self.inverse[j]
        return ca.vertcat(*c)

    def directions(self) -> ca.SX:
        """Return Q as a matrix (k, n), with one direction in each row."""
        return ca.horzcat(*self.Q).T


def decompose(J: ca.SX) -> Decomposition:
    """Return the decomposition of J (k, n).

    A row of J counts as linearly dependent if its part orthogonal to the rows above is shorter than `CUTOFF`·‖J‖.
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
        Q.append(_direction(row, Q))
    # row i depends on directions 1 … i only; rounding errors in the other entries are dropped
    left = [[ca.dot(rows[i], Q[j]) if j <= i else ca.SX(0) for j in range(k)] for i in range(k)]
    P, T, inverse = _orthonormal_columns(left)
    return Decomposition(Q, P, T, inverse, scale)


def _direction(row: ca.SX, Q: list[ca.SX]) -> ca.SX:
    """Return the unit vector along the part of a row that is orthogonal to the directions Q, or 0 if this part is 0."""
    # two orthogonalisation passes suffice (Parlett 1998, 6.9)
    q = _outside(row, Q)
    length = ca.sqrt(ca.sumsqr(q))
    alive = length > CUTOFF
    q = q * ca.if_else(alive, 1 / ca.if_else(alive, length, 1), 0)
    if not Q:
        return q
    q = _outside(q, Q)
    again = ca.sqrt(ca.sumsqr(q))
    return q * ca.if_else(alive, 1 / ca.if_else(alive, again, 1), 0)


def _outside(vector: ca.SX, Q: list[ca.SX]) -> ca.SX:
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


def _project(w: ca.SX, level: SymbolicLevel, *, damping: float) -> ca.SX:
    """Return the velocity nearest to w (n, 1) among those that meet the level best; w itself if w meets the level.

    With damping, the formula is that of `symbolic.projection`. Without damping, linearly dependent or contradicting
    rows of the Jacobian are met in the least-squares sense, as with the pseudo-inverse.
    """
    if level.J.shape[0] == 1 or damping > 0.0:
        return projection(w, level.J, level.desired(w), damping=damping)
    parts = decompose(level.J)
    return w + parts.directions().T @ parts.coordinates(level.lower - level.J @ w)


def sweep(shape: StackShape, *, damping: float, highest: int = 0) -> Program | Procedure:
    """Return a program that projects w (n,) on one level after another, from the lowest up to level index `highest`.

    The inputs are w and the arrays J, lower, upper of all levels; the output is the projected w.
    """
    if shape.n >= LOOPED:
        return projections(shape, damping=damping, highest=highest)
    flat, levels = shape.symbols()
    start = ca.SX.sym("w", shape.n)
    w = start
    for level in reversed(levels[highest:]):
        w = _project(w, level, damping=damping)
    return lower(ca.Function("sweep", [start, *flat], [ca.densify(w)]))


def swept(shape: StackShape, settings: Settings) -> tuple[Step, ...]:
    """Return the steps that compute the velocity after a sweep over all levels, from v = 0."""
    return (Call(sweep(shape, damping=settings.damping), ("zero", "J", "lower", "upper"), ("swept",)),)


def gate(shape: StackShape) -> Program | Procedure:
    """Return a program that checks the levels of a step, from the arrays J, lower and upper.

    Outputs: sound (1,), which is 1 if all numbers are finite, lower = upper for levels with one desired value, and
    lower ≤ upper for set-based levels; zero (n,) and none (1,), which are 0.
    """
    if shape.n >= LOOPED:
        return checks(shape)
    # each test is the condition that must hold, because every comparison with a NaN is false
    flat, levels = shape.symbols()
    sound = ca.SX(1)
    for level in levels:
        for entry in ca.vertsplit(ca.vec(level.J)):
            sound = ca.if_else(ca.fabs(entry) <= LONGEST, sound, 0)
        for low, high in zip(ca.vertsplit(level.lower), ca.vertsplit(level.upper), strict=True):
            if level.is_set:
                sound = ca.if_else(low <= high, ca.if_else(low <= HUGE, ca.if_else(high >= -HUGE, sound, 0), 0), 0)
            else:
                sound = ca.if_else(ca.fabs(low) <= HUGE, ca.if_else(ca.eq(low, high), sound, 0), 0)
    return lower(ca.Function("gate", flat, [sound, ca.SX.zeros(shape.n), ca.SX.zeros(1)]))


def into(value: ca.SX, low: ca.SX, high: ca.SX) -> ca.SX:
    """Return the value with each entry clipped to its bounds; an entry is 0 if it would not be finite."""
    moved = []
    for i in range(value.numel()):
        above = ca.if_else(value[i] >= low[i], value[i], low[i])
        inside = ca.if_else(above <= high[i], above, high[i])
        moved.append(ca.if_else(ca.fabs(inside) <= HUGE, inside, 0))
    return ca.vertcat(*moved)
