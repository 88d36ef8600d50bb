"""The NSB law as one CasADi expression, from which C code is generated."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from surctl.errors import InputError

__all__ = ["nsb_symbolic", "projection"]

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
            raise InputError(
                f"J has shape {J.shape}, x has shape {x.shape}",
                key=f"level {place}",
                remedy=f"give J of shape (k, {width}) and x of shape (k, 1)",
            )
