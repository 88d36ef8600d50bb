"""Close to the equilibrium: where a stated V fails, too fast rates, V that does not change; speeds on faces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.claims import Power, Safety, Stability
from surctl.lyapunov.dynamics import Dynamics, exact
from surctl.lyapunov.equilibrium import Linear
from surctl.verification.falsifier import sobol
from surctl.verification.formula import Node, number, substitute, values_of
from surctl.verification.proving import certain_excess, range_at, vanishes

# Rates at which states move inwards on the faces of the box, for the proof that solutions do not leave it


_SAMPLES = 2048


def inward_speeds(claim: Safety) -> list[float] | None:
    """Return a rate for each face at which the state moves inwards, as samples with B ≤ 0 show; None if one does not.

    In discrete time, there are no rates: the list is empty, or None if the successor of a sample leaves the box.
    """
    d = claim.dynamics
    low, high = (np.concatenate(ends) for ends in zip(d.box, d.ranges, strict=True))
    names, speeds = [v.name for v in d.variables], list[float]()
    wide = low[:, None] + (high - low)[:, None] * sobol(len(low), _SAMPLES, 0)
    if d.discrete:
        barrier, *after = values_of((claim.function, *d.rates), dict(zip(names, wide, strict=True)))
        ends = zip(after, *d.box, strict=True)
        leaves = np.any([(x < bottom) | (x > top) for x, bottom, top in ends], axis=0)
        return None if np.any(leaves & (barrier <= 0)) else speeds
    for k, rate in enumerate(d.rates):
        for end, sign in ((low[k], 1.0), (high[k], -1.0)):
            points = wide.copy()
            points[k] = end
            barrier, moved = values_of((claim.function, rate), dict(zip(names, points, strict=True)))
            least = float((sign * moved[barrier <= 0]).min(initial=1.0))
            if not least > 0:
                return None
            speeds.append(short(1e-3 * least))
    return speeds


def short(value: float, *, digits: int = 3, up: bool = False) -> float:
    """Return a positive number of few digits, not above `value` (not below it if `up`); 1 for 0."""
    if value == 0:
        return 1.0
    size = 10.0 ** (np.floor(np.log10(value)) - digits + 1)
    count = np.ceil(value / size) if up else np.floor(value / size)
    return float(f"{count * size:.6g}")


# States at which a function does not change at all, which no strict decrease allows: found and shown exactly


_SHARES = (0.5, 0.1, 0.01, 0.001)  # of the distance from the equilibrium to a bound


def stationary_state(claim: Stability) -> Mapping[str, float] | None:
    """Return a state of the region, other than the equilibrium, at which V does not change; None if none is found.

    The change of V is shown to be 0 on a line through the equilibrium parallel to an axis, by exact rewriting. So V is
    a first integral, or decreases only in other states, as the energy of a pendulum does.

    Args:
        claim: the claim.

    Example:
        >>> from surctl.lyapunov import Dynamics, Stability, State
        >>> from surctl.lyapunov.near import stationary_state
        >>> from surctl.verification.formula import parse, variable
        >>> names = {"x": variable("x"), "v": variable("v")}
        >>> states = State("x", -2.0, 2.0), State("v", -2.0, 2.0)
        >>> spring = Dynamics("spring", "continuous", states, (parse("v", names), parse("-x - v", names)))
        >>> stationary_state(Stability(spring, parse("x^2 + v^2", names), 1.5))
        {'x': 1.0, 'v': 0.0}
    """
    d = claim.dynamics
    loss = d.change(claim.function)
    if d.discrete:
        loss = loss - claim.function
    fixed = {w.name: exact(w.lower) for w in d.parameters}
    rest = {s.name: float(s.equilibrium) for s in d.states} | {w.name: float(w.lower) for w in d.parameters}
    for s in d.states:
        others = fixed | {o.name: number(o.rest) for o in d.states if o is not s}
        if not vanishes(substitute(loss, others)):
            continue
        for share in _SHARES:
            for end in (s.upper, s.lower):
                point = rest | {s.name: s.equilibrium + share * (end - s.equilibrium)}
                value, change = range_at(claim.function, point), range_at(loss, point)
                if value is not None and change is not None and value[1] < claim.level:
                    return point
    return None


Array = NDArray[np.float64]

_SMALL = 1e-9  # eigenvalues within this share of the largest one count as 0
_FASTER = 1e-6  # relative excess of a rate over the fastest decay that counts as rounding
_DISTANCES = (1e-1, 1e-2, 1e-3, 1e-4)  # of the distance from the equilibrium to the box
_NEAR = 1e-3  # a failure at this distance or closer is needed
_UNBOUNDED = 1e300  # a level that no state exceeds


class Failure(NamedTuple):
    """Which condition on V or B fails, and why, in one sentence; where: states and parameters, by name."""

    reason: str
    values: Mapping[str, float]


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
    bend = bends(d, function, rate or 0.0, scales)
    nothing = Power(0.0, 1)
    claim = Stability(d, function, level, rate or None)
    inequalities = claim.inequalities([1.0] * n, nothing, None if rate else nothing)
    # per unit of time, V changes by about this share: rounding is relative to it, in any unit of time
    fast = 1.0 if d.discrete else max(float(np.abs(np.linalg.eigvals(linear.matrices)).max()), rate or 0.0)
    for corner in d.corners().T:
        size = 0.0
        of_value, of_rise = (np.asarray(part) for part in bend(np.zeros(n), corner))
        for k, matrix in enumerate((-of_value, of_rise)):
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
            return Failure(f"{fact} close to the equilibrium, at {point_text(point)}{f': {why}' * bool(why)}", point)
    return None


def bends(d: Dynamics, function: Node, rate: float, scales: Array) -> ca.Function:
    """Return the second derivatives (n, n) of V and of V' + rate V, or V⁺ − V + rate V, as a function of z and w.

    Args:
        d: the dynamics.
        function: V, an expression of the states.
        rate: the rate.
        scales: lengths (n,) of the states; the state is x* + scales · z.
    """
    z, w = ca.SX.sym("z", len(scales)), ca.SX.sym("w", len(d.parameters))
    value, change = ca.vertsplit(d.compiled(function, d.change(function))(ca.DM(d.equilibrium) + ca.DM(scales) * z, w))
    rise = (change - value if d.discrete else change) + rate * value
    return ca.Function("bends", [z, w], [ca.hessian(value, z)[0], ca.hessian(rise, z)[0]])


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


def point_text(values: Mapping[str, float]) -> str:
    """Return the values of a point as text."""
    return ", ".join(f"{name} = {value:.6g}" for name, value in values.items())
