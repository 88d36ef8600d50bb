"""Equilibria that constant parameters move: the middle of all of them, and radii that contain them."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import Rejected
from surctl.certcheck.enclosure import Undefined
from surctl.certcheck.patience import patient
from surctl.certcheck.radii import require_rest
from surctl.lyapunov.dynamics import Command, Dynamics
from surctl.verification.formula import text_of, variable

Array = NDArray[np.float64]

_REST, _STEPS = 1e-9, 20  # residual of a zero, relative to the rates in the box; steps of Newton's method
_TRIALS, _STAGES, _SHORT = 64, 4, 6  # drawn parameters; steps to them from their middle; digits of the middle
_LARGER = (1.02, 1.2, 1.7)  # radii that are tried, relative to those of the drawn equilibria
_TIME = 2.0  # processor time for each of them [s]
_LEAST = 1e-7  # radius of a state whose equilibrium does not move, relative to the box


def shifted(dynamics: Dynamics) -> Dynamics | None:
    """Return the dynamics about the middle of the equilibria of all constant parameters, with radii that contain them.

    The checker's rule shows that each parameter has an equilibrium within the radii; a claim about these dynamics is
    one for constant parameters. Returns None if the equilibria are not zeros, or the rule does not show it.
    """
    d = dynamics
    x, w = ca.SX.sym("x", len(d.states)), ca.SX.sym("w", len(d.parameters))
    rates = d.compiled(*d.rates)(x, w) - (x if d.discrete else 0)
    commands = () if d.sampling is None else d.sampling.commands
    newton = ca.Function(
        "newton", [x, w], [rates, ca.jacobian(rates, x), d.compiled(*(c.value for c in commands))(x, w)]
    )
    low, high = d.ranges[:, :, None]
    random = low + (high - low) * np.random.default_rng(0).random((len(low), _TRIALS))
    still, zeros = _REST * np.maximum(d.size(), 1e-300), list[Array]()
    for draw in np.hstack([d.corners(most=6), random]).T:
        at = d.equilibrium
        for share in np.linspace(0, 1, _STAGES + 1)[1:]:
            p = d.ranges.mean(axis=0) * (1 - share) + draw * share
            for _ in range(_STEPS):
                error, slope, held = (np.asarray(one) for one in newton(at, p))
                if not (np.isfinite(error).all() and np.isfinite(slope).all()):
                    return None
                if np.all(np.abs(error[:, 0]) <= still):
                    break
                at = at - np.linalg.lstsq(slope, error[:, 0], rcond=None)[0]
            else:
                return None
        zeros.append(np.concatenate([at, held.ravel()]))
    ends = np.array([np.min(zeros, axis=0), np.max(zeros, axis=0)])
    units = np.concatenate([d.box[1] - d.box[0], np.maximum(np.abs(ends[:, len(d.states) :]).max(axis=0), 1e-9)])
    rounded = np.array([float(f"{x:.{_SHORT}g}") for x in ends.mean(axis=0)])
    middle = np.where(np.abs(rounded) > _LEAST * units, rounded, 0.0)
    most = np.maximum(np.abs(ends - middle).max(axis=0), _LEAST * units)
    exactly = [Fraction(repr(v)) for v in middle.tolist()]
    states = tuple(replace(s, equilibrium=float(v), exact=v) for s, v in zip(d.states, exactly, strict=False))
    moved = replace(d, states=states)
    if d.sampling is not None:
        at_rest = tuple(replace(c, rest=v) for c, v in zip(commands, exactly[len(states) :], strict=True))
        moved = replace(moved, sampling=replace(d.sampling, commands=at_rest))
    names = [*d.names, *(c.name for c in commands)]
    for factor in _LARGER:
        radii = [float(f"{factor * r:.3g}") for r in most.tolist()]
        trial = replace(moved, shifts=dict(zip(names, radii, strict=True)))
        if np.all(trial.freedom > 0) and _shown(trial):
            return trial
    return None


def _shown(d: Dynamics) -> bool:
    """Return whether the checker's rule shows that every parameter has an equilibrium within the radii."""
    texts = [
        text_of(rate - variable(s.name)) if d.discrete else text_of(rate)
        for s, rate in zip(d.states, d.rates, strict=True)
    ]
    centre, commands = [s.rest for s in d.states], tuple[Command, ...]()
    if d.sampling is not None:
        flow, after, commands = d.sampling.flow, d.sampling.next, d.sampling.commands
        texts = [text_of(flow[s.name] if s.name in flow else after[s.name] - variable(s.name)) for s in d.states]
        texts += [text_of(c.value - variable(c.name)) for c in commands]
        centre += [c.rest for c in commands]
    names = [*d.names, *(c.name for c in commands), *(p.name for p in d.parameters)]
    ranges = [(p.lower, p.upper) for p in d.parameters]
    try:
        with patient(_TIME):
            require_rest(names, ranges, texts, centre, [Fraction(repr(r)) for r in d.shifts.values()])
    except (Rejected, Undefined):
        return False
    return True
