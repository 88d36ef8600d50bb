"""Whether the limits in the rates of dynamics, such as a saturation, act inside a region V < level."""

from __future__ import annotations

import numpy as np

from surctl.lyapunov.dynamics import Dynamics
from surctl.verification.falsifier import sobol
from surctl.verification.formula import Node, ordered, values_of

__all__ = ["limits_sentence"]

_SAMPLES, _NEAR = 2048, (1.0, 0.3, 0.1, 0.03, 0.01)
_FEWEST = 64  # samples of a region that say something about it


def limits_sentence(dynamics: Dynamics, function: Node, level: float, whole: Dynamics) -> str:
    """Return a sentence if no limit (min or max) of the rates acts at samples of V < level; empty if one acts.

    A limit acts where another one of its two arguments decides than at the equilibrium.

    Args:
        dynamics: the dynamics of the claim.
        function: V, an expression of the states.
        level: level of the region.
        whole: the same dynamics with the bounds of the problem, to find where a limit acts.

    Example:
        >>> from surctl.lyapunov import Dynamics, State
        >>> from surctl.lyapunov.switching import limits_sentence
        >>> from surctl.verification.formula import parse, variable
        >>> x = {"x": variable("x")}
        >>> held = Dynamics("held", "continuous", (State("x", -2.0, 2.0),), (parse("max(-1, min(1, -2*x))", x),))
        >>> limits_sentence(held, parse("x^2", x), 0.2, held)
        'no limit (min, max) of the rates acts in the region, at 2048 samples of it; one acts at V = 0.25'
        >>> limits_sentence(held, parse("x^2", x), 0.3, held)
        ''
    """
    limits = [node for node in ordered(*dynamics.rates) if node.op in ("min", "max")]
    if not limits:
        return ""
    roots = [function, *(argument for node in limits for argument in node.args)]
    states, rest = len(dynamics.states), dynamics.equilibrium[:, None]
    unit = sobol(states + len(dynamics.parameters), _SAMPLES, 0)
    low, high = dynamics.ranges[:, :, None]
    boxes = (dynamics.box[:, :, None], whole.box[:, :, None])
    spread = [start - rest + (end - start) * unit[:states] for start, end in boxes]
    x = rest + np.hstack([part * near for part in spread for near in _NEAR])
    w = np.tile(low + (high - low) * unit[states:], 2 * len(_NEAR))
    names = [v.name for v in dynamics.variables]
    values = values_of(roots, dict(zip(names, (*x, *w), strict=True)))
    still = values_of(roots, dict(zip(names, (*np.broadcast_to(rest, x.shape), *w), strict=True)))
    acts = np.any((values[1::2] - values[2::2]) * (still[1::2] - still[2::2]) <= 0, axis=0)
    v = values[0]
    inside = v < level
    if inside.sum() < _FEWEST or np.any(acts & inside):
        return ""
    text = f"no limit (min, max) of the rates acts in the region, at {inside.sum()} samples of it; "
    beyond = v[acts & np.isfinite(v)]
    return text + (f"one acts at V = {beyond.min():.3g}" if beyond.size else "none acts in the box either")
