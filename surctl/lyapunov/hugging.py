"""The smallest box around a region V < level: in it, few boxes of a proof lie outside the region."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.rays import directions, extent
from surctl.verification.formula import Node

__all__ = ["bounded", "hugged"]

Array = NDArray[np.float64]

_RAYS, _POINTS = 512, 40
_MARGIN, _WIDE = 1.02, 1.1  # bounds relative to the extent of the region; in discrete time, a step must end inside
_BITS = 8  # of the distances of the bounds from the equilibrium: a bound is then exactly its decimal notation


def hugged(dynamics: Dynamics, function: Node, level: float) -> Dynamics:
    """Return the dynamics with bounds that are just outside the region V < level around the equilibrium.

    No bound is widened. A proof that V ≥ level on the faces of the box shows that the region does not reach them.

    Args:
        dynamics: the dynamics.
        function: V, an expression of the states.
        level: level of the region.

    Example:
        >>> from surctl.lyapunov import Dynamics, State
        >>> from surctl.lyapunov.hugging import hugged
        >>> from surctl.verification.formula import parse, variable
        >>> x = {"x": variable("x")}
        >>> cubic = Dynamics("cubic", "continuous", (State("x", -2.0, 2.0),), (parse("-x + x^3", x),))
        >>> hugged(cubic, parse("x^2", x), 0.25).box.round(2).tolist()
        [[-0.51], [0.51]]
    """
    d, n = dynamics, len(dynamics.states)
    scales = np.maximum(d.box[1] - d.equilibrium, d.equilibrium - d.box[0])
    z = ca.SX.sym("z", n)
    value = d.compiled(function)(ca.DM(d.equilibrium) + ca.DM(scales) * z, d.corners()[:, 0])
    hessian = ca.hessian(value, z)[0]
    if hessian.is_constant() and np.all(np.linalg.eigvalsh(matrix := np.asarray(ca.DM(hessian)) / 2) > 0):
        # a quadratic form about the equilibrium
        far = np.sqrt(level * np.diag(np.linalg.inv(matrix))) * scales
        return bounded(d, np.array([far, far]))
    from scipy.optimize import minimize

    read = ca.Function("value", [z], [value])
    slope = ca.Function("slope", [z], [ca.gradient(value, z)])
    edge = (d.box - d.equilibrium) / scales
    u = np.hstack([directions(n, _RAYS), np.eye(n), -np.eye(n)])
    radii = extent(np.zeros(n), edge, u)[:, None] * np.linspace(0, 1, _POINTS + 1)[1:]
    along = u[:, :, None] * radii
    v = np.asarray(read(along.reshape(n, -1))).reshape(u.shape[1], -1)
    inside = np.logical_and.accumulate(v < level, axis=1)
    points = np.where(inside, along, 0.0).reshape(n, -1)
    inner = {
        "type": "ineq",
        "fun": lambda at: 1 - float(read(at)) / level,  # V in any unit: tolerances of the search are absolute
        "jac": lambda at: -np.asarray(slope(at)).reshape(-1) / level,
    }
    extents = np.zeros((2, n))
    for k in range(n):
        for side, sign in enumerate((-1.0, 1.0)):
            start = points[:, np.argmax(sign * points[k])]
            toward = -sign * np.eye(n)[k]
            farthest = minimize(
                lambda at, toward=toward: float(toward @ at), start, jac=lambda at, toward=toward: toward,
                constraints=[inner], bounds=edge.T, method="SLSQP",
            )  # fmt: skip
            far = max(sign * start[k], sign * farthest.x[k] if farthest.success else 0.0)
            extents[side, k] = far * scales[k]
    return bounded(d, extents)


def bounded(dynamics: Dynamics, extents: Array) -> Dynamics:
    """Return the dynamics with bounds just outside x* − extents[0] and x* + extents[1] (2, n); no bound is widened."""
    away = extents * (_WIDE if dynamics.discrete else _MARGIN)
    grid = 2.0 ** (np.floor(np.log2(np.maximum(away, 1e-300))) + 1 - _BITS)
    ends = dynamics.equilibrium + np.array([[-1.0], [1.0]]) * np.ceil(away / grid) * grid
    bounds = {}
    for state, low, high in zip(dynamics.states, *ends.tolist(), strict=True):
        low, high = max(low, state.lower), min(high, state.upper)
        if low < state.equilibrium < high:
            bounds[state.name] = (low, high)
    return dynamics.on(bounds)
