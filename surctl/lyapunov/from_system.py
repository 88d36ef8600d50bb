"""Dynamics of a closed loop of `surctl.system`, with its controller as a law in continuous time."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import casadi as ca
from numpy.typing import ArrayLike

from surctl.errors import InputError, nearest
from surctl.lyapunov.dynamics import Dynamics, Range, State
from surctl.system import System, entry_labels, entry_units
from surctl.system.values import check_scalar, place_of, run_numbers, unit_of
from surctl.verification.formula import IDENTIFIER, from_casadi

__all__ = ["NOT_COVERED", "continuous_dynamics"]

NOT_COVERED = "the control law in continuous time: sampling, hold and delay are not covered"
"""What a claim about the dynamics of `continuous_dynamics` does not cover."""

Bounds = tuple[float, float]


def continuous_dynamics(
    system: System,
    within: Mapping[str, Bounds],
    *,
    values: Mapping[str, ArrayLike] | None = None,
    ranges: Mapping[str, Bounds] | None = None,
) -> Dynamics:
    """Return the dynamics x' = f(x, w) of plant and controller, as if the command followed the measurement at once.

    A claim that is proved about these dynamics does not cover the sampling of the controller: see `NOT_COVERED`. If all
    gains have values, the dynamics state the digests of plant and controller, so that `surctl check --bundle` can
    compare a certificate with an exported controller.

    Args:
        system: the closed loop; its controller has no state, and reference and disturbance do not depend on time.
        within: lower and upper bound of every state of the plant, by the labels of `entry_labels`, such as "angle".
        values: numbers of one run as in `simulate_system`: gains, `plant.NAME`, `reference.NAME` and
            `disturbance.NAME`, by default as there; `start.NAME` is the equilibrium, by default 0.
        ranges: lower and upper bound of single numbers, by the same names; each may vary in time between its bounds.

    Raises:
        InputError: the controller has a state, an expression depends on time, a bound is missing, or a name is unknown.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.lyapunov import continuous_dynamics
        >>> from surctl.system import Controller, Plant, System
        >>> position, speed = Port("position", (1,), "m", "of the cart"), Port("speed", (1,), "m/s", "of the cart")
        >>> force, mass = Port("force", (1,), "N", "on the cart"), Port("mass", (1,), "kg", "of the cart", 2.0)
        >>> cart = Plant(
        ...     "cart", Layout((position, speed)), Layout((force,)), parameters=Layout((mass,)),
        ...     ode=lambda x, f, d, p: {"position": x["speed"], "speed": f["force"] / p["mass"]},
        ... )
        >>> law = Controller("pd", 0.01, cart.state, cart.inputs, lambda x, u, p: -4 * u["position"] - 4 * u["speed"])
        >>> within = {"position": (-1.0, 1.0), "speed": (-1.0, 1.0)}
        >>> loop = continuous_dynamics(System(cart, law), within, ranges={"plant.mass": (1.8, 2.2)})
        >>> loop.names, [w.name for w in loop.parameters]
        (('position', 'speed'), ['plant_mass'])
    """
    plant, controller = system.plant, system.controller
    action = getattr(controller, "action", None)
    if controller.state.size or action is None:
        raise InputError(
            "has a state of its own, so that its command is no function of the measurement", key=controller.name,
            remedy="write plant and controller as one map x+ = f(x) in discrete time",
        )  # fmt: skip
    labels, units = entry_labels(plant.state), entry_units(plant.state)
    for label in within:
        if label not in labels:
            raise InputError("is not a state of the plant", key=f"within.{label}", remedy=nearest(label, labels))
    missing = [label for label in labels if label not in within]
    if missing:
        raise InputError("is missing", key=f"within.{missing[0]}", remedy="give the lower and upper bound of the state")
    # start at 0, not at the defaults of the plant's state: the start is the equilibrium
    rest = {f"start.{port.name}": 0.0 for port in plant.state}
    numbers = run_numbers(system, {**rest, **(values or {})})
    if numbers.count != 1:
        raise InputError("has several runs", key="values", remedy="give one number for each name")
    groups = ("plant", "gains", "reference", "disturbance")
    flat = {group: ca.SX(getattr(numbers, group)[0].tolist()) for group in groups}
    free, parameters = [], []
    for name, (low, high) in (ranges or {}).items():
        check_scalar(system, name)
        group, place = place_of(system, name)
        if group == "start":
            raise InputError("is a state", key=name, remedy=f"write within.{name.removeprefix('start.')}")
        free.append(ca.SX.sym(name))
        flat[group][place] = free[-1]
        parameters.append(Range(_identifier(name), float(low), float(high), unit_of(system, name)))
    x, t = ca.SX.sym("x", plant.state.size), ca.SX.sym("t")
    reference = system.reference_at(t, flat["reference"])
    disturbance = system.disturbance_at(t, flat["disturbance"])
    y = plant.measurement(x, disturbance, flat["plant"])
    command = action(ca.SX(0, 1), system.inputs_of(y, reference), flat["gains"])[0]
    rates = plant.derivative(x, system.applied(command), disturbance, flat["plant"])
    if ca.depends_on(rates, t):
        remedy = "use a constant reference and disturbance"
        raise InputError("depends on time", key=f"{plant.name}.reference", remedy=remedy)
    states = []
    for label, unit, at in zip(labels, units, numbers.start[0].tolist(), strict=True):
        low, high = within[label]
        states.append(State(_identifier(label), float(low), float(high), unit, "", at))
    names = [v.name for v in (*states, *parameters)]
    nodes = from_casadi(ca.vertcat(x, *free), names, ca.vertsplit(rates))
    gains = {port.name: numbers.gains[0, controller.gains.slice(port.name)].tolist() for port in controller.gains}
    about: dict[str, Any] = {"plant": plant.digest(), "controller": controller.block.digest(), "gains": gains}
    if any(place_of(system, name)[0] == "gains" for name in ranges or {}):
        about = {}
    return Dynamics(plant.name, "continuous", tuple(states), tuple(nodes), tuple(parameters), NOT_COVERED, about)


def _identifier(label: str) -> str:
    name = re.sub(r"\W+", "_", label).strip("_")
    if not IDENTIFIER.fullmatch(name):
        raise InputError(
            "is not a name of the claim grammar", key=label, remedy="begin with a letter; at most 40 characters"
        )
    return name
