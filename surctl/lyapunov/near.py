"""Why a stated function fails arbitrarily close to the equilibrium: its quadratic part, or the slowest eigenvalue."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.claims import Power, Stability
from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.equilibrium import Linear
from surctl.verification.formula import Node
from surctl.verification.proving import certain_excess

__all__ = ["Failure", "fails_nearby", "slowest", "too_fast"]

Array = NDArray[np.float64]

_SMALL = 1e-9  # eigenvalues within this share of the largest one count as 0
_FASTER = 1e-6  # relative excess of a rate over the fastest decay that counts as rounding
_DISTANCES = (1e-1, 1e-2, 1e-3, 1e-4)  # of the distance from the equilibrium to the box
_NEAR = 1e-3  # a failure at this distance or closer is needed
_UNBOUNDED = 1e300  # a level that no state exceeds


@dataclass(frozen=True)
class Failure:
    """A state close to the equilibrium at which a condition on V fails.

    Attributes:
        values: states and parameters, by name.
        reason: the condition that fails there, and why, in one sentence.
    """

    values: Mapping[str, float]
    reason: str


def slowest(d: Dynamics, linear: Linear) -> tuple[complex, float]:
    """Return the slowest eigenvalue of a stable linearisation, and the rate at which its quadratic function decays.

    No function with a positive definite quadratic part decays faster: that is 2|Re λ|, or 1 − |λ|² in discrete time.
    """
    eigenvalues = np.linalg.eigvals(linear.matrices).reshape(-1)
    if d.discrete:
        value = complex(eigenvalues[np.argmax(np.abs(eigenvalues))])
        return value, 1 - abs(value) ** 2
    value = complex(eigenvalues[np.argmax(eigenvalues.real)])
    return value, -2 * value.real


def too_fast(d: Dynamics, linear: Linear, rate: float | None) -> str:
    """Return why no V with a positive definite quadratic part decays at a rate; empty if it may."""
    if rate is None or linear.verdict != "stable":
        return ""
    value, most = slowest(d, linear)
    if rate <= most * (1 + _FASTER):
        return ""
    text = f"{value.real:.6g}" + (f" ± {abs(value.imag):.6g}i" if abs(value.imag) > _SMALL * abs(value) else "")
    return (
        f"the linearisation has the eigenvalue {text}, so no V with a positive definite quadratic part decays at a "
        f"rate above {most:.6g}"
    )


def fails_nearby(
    d: Dynamics, function: Node, rate: float | None, linear: Linear, *, level: float = _UNBOUNDED
) -> Failure | None:
    """Return a state at which V is negative, or does not decrease as claimed, by its quadratic part; None otherwise.

    The quadratic parts are those of V and of V' + rate V (V⁺ − V + rate V in discrete time) at the equilibrium, for the
    corners of the parameters. Along an eigenvector with the wrong sign, the condition fails at every distance that is
    small enough; interval arithmetic confirms the state.

    Args:
        d: the dynamics.
        function: V, an expression of the states.
        rate: claimed rate; None means any decrease.
        linear: the linearisation.
        level: V must be below it at the state.
    """
    n = len(d.states)
    scales = np.minimum(d.box[1] - d.equilibrium, d.equilibrium - d.box[0])
    z, w = ca.SX.sym("z", n), ca.SX.sym("w", len(d.parameters))
    value, change = ca.vertsplit(d.compiled(function, d.change(function))(ca.DM(d.equilibrium) + ca.DM(scales) * z, w))
    rise = change - value if d.discrete else change
    bend = ca.Function("bend", [z, w], [ca.hessian(-value, z)[0], ca.hessian(rise + (rate or 0.0) * value, z)[0]])
    nothing = Power(0.0, 1)
    claim = Stability(d, function, level, rate or None)
    inequalities = claim.inequalities([1.0] * n, nothing, None if rate else nothing)
    # per unit of time, V changes by about this share: rounding is relative to it, in any unit of time
    fast = 1.0 if d.discrete else max(float(np.abs(np.linalg.eigvals(linear.matrices)).max()), rate or 0.0)
    for corner in d.corners().T:
        size = 0.0
        for k, matrix in enumerate(np.asarray(part) for part in bend(np.zeros(n), corner)):
            if not np.all(np.isfinite(matrix)):
                continue
            size = max(size * fast, float(np.abs(matrix).max()))
            eigenvalues, vectors = np.linalg.eigh(matrix)
            if not eigenvalues[-1] > _SMALL * size:
                continue
            inequality = inequalities[0 if k == 0 else -1]
            point = _confirmed(d, inequality.claim, vectors[:, -1] * scales, corner if k else corner[:0])
            if point is None:
                continue
            fact = "V is negative" if k == 0 else f"V' <= -{rate:g} V fails" if rate else "V' <= 0 fails"
            if d.discrete and k:
                fact = f"V+ - V <= -{rate:g} V fails" if rate else "V+ <= V fails"
            why = too_fast(d, linear, rate) if k else ""
            return Failure(point, f"{fact} close to the equilibrium, at {_text(point)}" + (f": {why}" if why else ""))
    return None


def _confirmed(d: Dynamics, claim: object, along: Array, corner: Array) -> dict[str, float] | None:
    # the farthest state at which the condition fails, if it also fails close to the equilibrium
    steps = [sign * share for share in _DISTANCES for sign in (1.0, -1.0)]
    x = d.equilibrium[:, None] + along[:, None] * np.array(steps)
    points = np.vstack([x, np.repeat(corner[:, None], x.shape[1], axis=1)])
    fails = certain_excess(claim, points) > 0  # type: ignore[arg-type]
    near = [k for k, step in enumerate(steps) if abs(step) <= _NEAR and fails[k]]
    if not near:
        return None
    names = [v.name for v in d.variables][: len(points)]
    return dict(zip(names, map(float, points[:, int(np.argmax(fails))]), strict=True))


def _text(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in values.items())
