"""States at which a function does not change at all, which no strict decrease allows: found and shown exactly."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

from surctl.lyapunov.claims import Stability
from surctl.verification.formula import Node, number, substitute
from surctl.verification.proving import range_at, vanishes

__all__ = ["stationary_state"]

_SHARES = (0.5, 0.1, 0.01, 0.001)  # of the distance from the equilibrium to a bound


def stationary_state(claim: Stability) -> Mapping[str, float] | None:
    """Return a state of the region, other than the equilibrium, at which V does not change; None if none is found.

    The change of V is shown to be 0 on a line through the equilibrium parallel to an axis, by exact rewriting. So V is
    a first integral, or decreases only in other states, as the energy of a pendulum does.

    Args:
        claim: the claim.

    Example:
        >>> from surctl.lyapunov import Dynamics, Stability, State
        >>> from surctl.lyapunov.stationary import stationary_state
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
    fixed = {w.name: _exact(w.lower) for w in d.parameters}
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


def _exact(value: float) -> Node:
    return number(Fraction(repr(float(value))))
