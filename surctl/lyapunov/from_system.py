"""Dynamics of a closed loop of `surctl.system`, with its controller as a law in continuous time."""

from __future__ import annotations

import re
from collections.abc import Mapping

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.ir import Layout
from surctl.lyapunov.dynamics import Dynamics, Range, State
from surctl.system import System, entry_labels, entry_units
from surctl.verification.formula import IDENTIFIER, from_casadi

__all__ = ["NOT_COVERED", "continuous_dynamics"]

NOT_COVERED = "continuous-time law; sampling, hold and delay are not covered"
"""What a claim about the dynamics of `continuous_dynamics` does not cover."""

Bounds = tuple[float, float]


def continuous_dynamics(
    system: System,
    bounds: Mapping[str, Bounds],
    *,
    equilibrium: Mapping[str, float] | None = None,
    values: Mapping[str, float | Bounds] | None = None,
) -> Dynamics:
    """Return the dynamics x' = f(x, w) of plant and controller, as if the command followed the measurement at once.

    The claim that is proved about these dynamics does not cover the sampling of the controller: see `NOT_COVERED`.

    Args:
        system: the closed loop; its controller has no state, and reference and disturbance do not depend on time.
        bounds: lower and upper bound of every state of the plant, by the labels of `entry_labels`, such as "angle".
        equilibrium: value of the states at the equilibrium, by label; 0 for the others.
        values: number, or lower and upper bound, of gains, parameters, references and disturbances, by label; by
            default the nominal value of a gain or parameter, and 0 for a reference or disturbance. A value with bounds
            may vary in time between them.

    Raises:
        InputError: the controller has a state, an expression depends on time, a bound is missing, or a name is unknown.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Layout, Port
        >>> from surctl.lyapunov import continuous_dynamics, find_stability
        >>> from surctl.system import Controller, Plant, System
        >>> cart = Plant(
        ...     "cart",
        ...     state=Layout((Port("position", (1,), "m", ""), Port("speed", (1,), "m/s", ""))),
        ...     inputs=Layout((Port("force", (1,), "N", ""),)),
        ...     parameters=Layout((Port("mass", (1,), "kg", "", 2.0),)),
        ...     ode=lambda x, f, d, p: {"position": x["speed"], "speed": f["force"] / p["mass"]},
        ... )
        >>> law = Controller(
        ...     "pd",
        ...     dt=0.01,
        ...     inputs=cart.state,
        ...     command=cart.inputs,
        ...     law=lambda x, u, p: -4 * u["position"] - 4 * u["speed"],
        ... )
        >>> bounds = {"position": (-1.0, 1.0), "speed": (-1.0, 1.0)}
        >>> d = continuous_dynamics(System(cart, law), bounds, values={"mass": (1.8, 2.2)})
        >>> [w.name for w in d.parameters], d.source
        (['mass'], 'continuous-time law; sampling, hold and delay are not covered')
    """
    plant, controller = system.plant, system.controller
    name = plant.name
    action = getattr(controller, "action", None)
    if controller.state.size or action is None:
        raise InputError(
            "has a state of its own, so that its command is no function of the measurement", key=controller.name,
            remedy="write plant and controller as one map x+ = f(x) in discrete time",
        )  # fmt: skip
    x, t = ca.SX.sym("x", plant.state.size), ca.SX.sym("t")
    parts: dict[str, tuple[Layout, float | None]] = {
        "p": (plant.parameters, None), "g": (controller.gains, None), "r": (system.references, 0.0),
        "d": (plant.disturbances, 0.0),
    }  # fmt: skip
    chosen, ranges, free = dict(values or {}), [], []
    flat: dict[str, ca.SX] = {}
    for part, (layout, fallback) in parts.items():
        entries = []
        nominal = np.zeros(layout.size) if fallback is not None else layout.pack()
        for label, unit, usual in zip(entry_labels(layout), entry_units(layout), nominal, strict=True):
            value = chosen.pop(label, float(usual))
            if isinstance(value, tuple | list):
                low, high = value
                free.append(ca.SX.sym(label))
                ranges.append(Range(_name(label), float(low), float(high), unit))
                entries.append(free[-1])
            else:
                entries.append(ca.SX(float(value)))
        flat[part] = ca.vertcat(ca.SX(0, 1), *entries)
    labels = entry_labels(plant.state)
    starts = dict(equilibrium or {})
    for given, where in ((chosen, "values"), (bounds, "bounds"), (starts, "equilibrium")):
        unknown = [label for label in given if where == "values" or label not in labels]
        if unknown:
            raise InputError("is not known", key=f"{where}.{unknown[0]}", remedy=f"states: {', '.join(labels)}")
    missing = [label for label in labels if label not in bounds]
    if missing:
        raise InputError("is missing", key=f"bounds.{missing[0]}", remedy="give the lower and upper bound of the state")
    reference, disturbance = system.reference_at(t, flat["r"]), system.disturbance_at(t, flat["d"])
    y = plant.measurement(x, disturbance, flat["p"])
    command = action(ca.SX(0, 1), system.inputs_of(y, reference), flat["g"])[0]
    rates = plant.derivative(x, system.applied(command), disturbance, flat["p"])
    if ca.depends_on(rates, t):
        raise InputError("depends on time", key=f"{name}.reference", remedy="use a constant reference and disturbance")
    states = tuple(
        _state(label, bounds[label], unit, starts.get(label, 0.0))
        for label, unit in zip(labels, entry_units(plant.state), strict=True)
    )
    names = [s.name for s in states] + [w.name for w in ranges]
    nodes = from_casadi(ca.vertcat(x, *free), names, ca.vertsplit(rates))
    return Dynamics(name, "continuous", states, tuple(nodes), tuple(ranges), source=NOT_COVERED)


def _state(label: str, bounds: Bounds, unit: str, equilibrium: float) -> State:
    return State(_name(label), float(bounds[0]), float(bounds[1]), unit, equilibrium=float(equilibrium))


def _name(label: str) -> str:
    name = re.sub(r"\W+", "_", label).strip("_")
    if not IDENTIFIER.fullmatch(name):
        raise InputError(
            "is no name of the claim grammar", key=label, remedy="begin with a letter; at most 40 characters"
        )
    return name
