"""The claim of an example: a region of attraction is searched and proved, and its certificate is checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.certcheck import check_document
from surctl.lyapunov import Dynamics, Stability, continuous_dynamics, decide_motion, find_stability
from surctl.system import System, entry_labels
from surctl.system.values import run_numbers
from surctl.verification.formula import from_casadi

SECONDS = 20.0  # limit of the processor time of search and proof

Within = Mapping[str, tuple[float, float]]


def motion(system: System, within: Within, values: Mapping[str, ArrayLike], **options: bool) -> Dynamics:
    """Return the motion of some states with the law in continuous time, while the others stay at rest.

    Args:
        system: the closed loop.
        within: lower and upper bound of the states that move, as in `continuous_dynamics`.
        values: numbers of one run; `start.…` is the equilibrium.
        options: further arguments of the controller's law.
    """
    law = replace(system.controller, law=partial(system.controller.law, **options))
    start = dict(zip(entry_labels(system.plant.state), run_numbers(system, values).start[0].tolist(), strict=True))
    rest = start | dict(zip(entry_labels(law.state, "controller."), law.initial_state().tolist(), strict=True))
    return continuous_dynamics(
        replace(system, controller=law, reference=None, disturbance=None),
        {label: (value, value) for label, value in rest.items()} | dict(within),
        values={**values, **{f"start.{label}": value for label, value in start.items()}},
    )


def print_claim(dynamics: Dynamics, about: str, seconds: float = SECONDS, *, first: bool = False) -> bool:
    """Search and prove a region of attraction, print the verdict; return whether the checker accepts the proof.

    With `first` the first region that is proved is enough.
    """
    result = find_stability(dynamics, degree=2, time_limit=seconds, first=first)
    if result.verdict != "proved" or result.decision is None or result.claim is None:
        print(f"claim, {about}: {result.verdict}, {result.reason}")
        return False
    checked = check_document(dict(result.decision.document))
    function, share, alone = dynamics.compiled(result.claim.function), np.linspace(0, 1, 1001), []
    for k, s in enumerate(dynamics.states):
        along = dynamics.equilibrium[:, None] + np.eye(len(dynamics.states))[:, [k]] * (s.upper - s.equilibrium) * share
        inside = np.asarray(function(along, np.zeros((0, share.size)))).ravel() < result.claim.level
        alone.append(f"{s.name} {share[inside].max() * (s.upper - s.equilibrium):.3g} {s.unit}")
    print(f"claim, {about}: proved, every solution converges that starts with one state off by {', '.join(alone)}")
    print(f"level {result.ratio:.2f} of the least with a counterexample; checker: {checked.reason or 'accepted'}")
    return bool(checked.accepted)


def print_refuted(dynamics: Dynamics, P: NDArray[np.float64], about: str) -> bool:
    """Decide whether V = xᵀ P x decreases in its largest ellipsoid in the box; return whether this is refuted."""
    x = ca.SX.sym("x", len(P))
    (V,) = from_casadi(x, dynamics.names, [ca.bilin(ca.DM(P), x, x)])
    level = 0.99 * float((dynamics.box[1] ** 2 / np.diag(np.linalg.inv(P))).min())
    decision = decide_motion(Stability(dynamics, V, level), time_limit=SECONDS)
    print(f"claim, {about}: {decision.verdict}, {decision.reason}")
    return decision.verdict == "refuted"
