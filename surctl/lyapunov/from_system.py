"""Dynamics of a `System`, continuous or sampled, for its region: what rests without bounds, what is not covered."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from surctl.errors import InputError, NotApplicable, UnsupportedOperation, nearest
from surctl.lyapunov.dynamics import Command, Dynamics, Range, Sampling, State, exact
from surctl.lyapunov.equilibrium import refined
from surctl.lyapunov.shifts import shifted
from surctl.system import System, entry_labels, entry_units, find_equilibrium
from surctl.system.sampled import Instant
from surctl.system.values import checked_ranges, place_of, run_numbers, unit_of
from surctl.units import as_range
from surctl.verification.formula import (
    IDENTIFIER,
    Node,
    Statement,
    exact_values,
    from_casadi,
    number,
    rebuilt,
    substitute,
)
from surctl.verification.proving import prove_cases

NOT_COVERED = "the control law in continuous time: sampling, hold and delay are not covered"
"""What a claim about the dynamics of `continuous_dynamics` does not cover."""

HELD_COMMANDS = "the sampled loop with held commands (computing delay and rounding are not covered)"
"""What a claim about the sampled form of these dynamics (`Dynamics.sampling`) does not cover."""

_AS_FLOW = "; the controller state z follows z' = (z+ - z) / period"

_ROUNDING, _POINTS = 1e-12, 100
_PROOF = 2.0  # largest processor time of a proof that a state stays at rest [s]

Bounds = tuple[float, float]


def continuous_dynamics(
    system: System,
    within: Mapping[str, Bounds],
    *,
    values: Mapping[str, ArrayLike] | None = None,
    ranges: Mapping[str, Bounds] | None = None,
) -> Dynamics:
    """Return the dynamics x' = f(x, w) of plant and controller, as if the command followed the measurement at once.

    Every number of plant, law and equilibrium is the double of the instruction list, to the bit: 0.1 is not 1/10. The
    bounds are decimals.

    A state z of the controller follows z' = (z⁺ - z) / period, which is the law that the controller samples.

    A claim that is proved about these dynamics does not cover the sampling of the controller: see `NOT_COVERED`. The
    dynamics state the digests and all numbers of plant and controller, so that `surctl check --bundle` can compare a
    certificate with an exported controller.

    Args:
        system: the closed loop; reference and disturbance do not depend on time.
        within: lower and upper bound of every state of the plant that moves, by the labels of `entry_labels`, such as
            "angle", and of every state of the controller, as "controller.sum". A state with equal bounds stays at this
            value, and a state without bounds at its equilibrium; the rate of such a state must be 0, up to rounding,
            whatever the other states are.
        values: numbers of one run as in `simulate_system`: gains, `plant.NAME`, `reference.NAME` and
            `disturbance.NAME`, by default as there. The equilibrium is that of `find_equilibrium` with these numbers:
            `start.NAME` is where its search begins. Without one, it is NaN; a bound needs none.
        ranges: lower and upper bound of single numbers, by the same names; each may vary in time between its bounds.

    Raises:
        InputError: a name is unknown, or a state with equal or without bounds moves.
        NotApplicable: the loop depends on time, has sampled blocks, a law that is not symbolic, or an operation that
            the claim grammar lacks.

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
    return _dynamics(system, within, values, ranges, sampled=False)


def sampled_dynamics(
    system: System,
    within: Mapping[str, Bounds],
    *,
    values: Mapping[str, ArrayLike] | None = None,
    ranges: Mapping[str, Bounds] | None = None,
) -> Dynamics:
    """Return the dynamics of `continuous_dynamics` with the sampled form of the loop, whose commands are held.

    `find_stability` then proves a region of the sampled loop, also between the sampling instants. It falls back to the
    law in continuous time if it proves none, or if a function or level is stated.

    Args:
        system, within, values: as in `continuous_dynamics`.
        ranges: as there; they take the place of those of the system.

    Raises:
        InputError, NotApplicable: as in `continuous_dynamics`, or the loop has no equilibrium.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.lyapunov import find_stability, sampled_dynamics
        >>> from surctl.system import Controller, Plant, System
        >>> speed, force = Port("speed", (1,), "m/s", "of the cart"), Port("force", (1,), "N", "on the cart")
        >>> mass = Port("mass", (1,), "kg", "of the cart", 2.0)
        >>> cart = Plant(
        ...     "cart", Layout((speed,)), Layout((force,)), parameters=Layout((mass,)),
        ...     ode=lambda x, f, d, p: {"speed": f["force"] / p["mass"]},
        ... )
        >>> law = Controller("brake", 0.1, cart.state, cart.inputs, lambda x, u, p: -4 * u["speed"])
        >>> system = System(cart, law, ranges={"plant.mass": (1.8, 2.2)})
        >>> find_stability(sampled_dynamics(system, {"speed": (-1.0, 1.0)})).decision.claim.plain()["time"]
        'sampled'
    """
    return _dynamics(system, within, values, {**system.ranges, **(ranges or {})}, sampled=True)


def _dynamics(
    system: System,
    within: Mapping[str, Bounds],
    values: Mapping[str, ArrayLike] | None,
    ranges: Mapping[str, Bounds] | None,
    *,
    sampled: bool,
) -> Dynamics:
    plant, controller = system.plant, system.controller
    if blocks := system.blocks.all:
        raise NotApplicable("it has sampled blocks, which regions do not cover", to="the loop", key=blocks[0].name)
    action = getattr(controller, "action", None)
    if action is None:
        raise NotApplicable("its controller is compiled, without a symbolic law", to="the loop", key=controller.name)
    labels = entry_labels(plant.state) + entry_labels(controller.state, "controller.")
    units = entry_units(plant.state) + entry_units(controller.state)
    if not isinstance(cast("object", within), Mapping):
        raise InputError("is not a dict of ranges", key="within", value=within, remedy='write {"angle": (-1, 1)}')
    for label in within:
        if label not in labels:
            raise InputError("is not a state of the system", key=f"within.{label}", remedy=nearest(label, labels))
    within = {label: as_range(ends, key=f"within.{label}") for label, ends in within.items()}
    numbers = run_numbers(system, values)
    if numbers.count != 1:
        raise InputError("has several runs", key="values", remedy="give one number for each name")
    groups = ("plant", "gains", "reference", "disturbance")
    constants = _Constants()
    flat = {group: constants.column(getattr(numbers, group)[0].tolist()) for group in groups}
    free, parameters = [], []
    for name, (low, high) in checked_ranges(system, ranges or {}, key="").items():
        group, place = place_of(system, name)
        if group == "start":
            raise InputError("is a state", key=name, remedy=f"write within.{name.removeprefix('start.')}")
        free.append(ca.SX.sym(name))
        flat[group][place] = free[-1]
        nominal = getattr(numbers, group)[0][place].item()
        parameters.append(Range(_identifier(name), low, high, unit_of(system, name), typed=name, nominal=nominal))
    t = ca.SX.sym("t")
    moves = [k for k, label in enumerate(labels) if label in within and within[label][0] != within[label][1]]
    try:
        at = find_equilibrium(system, values)
        rest = [*at.x.tolist(), *at.z.tolist()]
    except InputError as error:
        if sampled or len(moves) < len(labels):  # a bound or a barrier needs no equilibrium
            raise NotApplicable(error.problem, to="the loop", key=error.key) from None
        rest = [math.nan] * len(labels)
    symbols = ca.SX.sym("x", len(moves))
    whole = constants.column([0.0 if k in moves else within.get(label, [rest[k]])[0] for k, label in enumerate(labels)])
    whole[moves] = symbols
    x, z = ca.vertsplit(whole, [0, plant.state.size, whole.numel()])
    reference = system.reference_at(t, flat["reference"])
    disturbance = system.disturbance_at(t, flat["disturbance"])
    y = plant.measurement(x, disturbance, flat["plant"])
    command, after, *_ = action(z, system.inputs_of(y, reference), flat["gains"])
    empty = ca.SX(0, 1)
    f, _, _ = system.driven(command, Instant(x, disturbance, flat["plant"], empty), empty, empty)
    flow = plant.derivative(x, f, disturbance, flat["plant"])
    rates = ca.densify(ca.vertcat(flow, (after - z) / constants.column([system.dt])))
    if ca.depends_on(rates, t):
        raise NotApplicable("its reference or disturbance depends on time", to="the loop", key=plant.name)
    states = []
    for k in moves:
        low, high = within[labels[k]]
        name = _identifier(labels[k])
        states.append(State(name, low, high, units[k], "", rest[k], to_the_bit=True, typed=labels[k]))
    names = [v.name for v in (*states, *parameters)]
    nodes = constants.expressions(ca.vertcat(symbols, *free), names, rates[moves])
    vectors = {"state": whole, **flat, "reference": reference, "disturbance": disturbance}
    about = _about(system, {key: constants.put(vector) for key, vector in vectors.items()})
    limits = NOT_COVERED + _AS_FLOW * bool(controller.state.size)
    resting = {label: constants.put(rates[k]) for k, label in enumerate(labels) if k not in moves}
    limits += _check_rest(resting, ca.vertcat(symbols, *free), [*states, *parameters], within)
    flat["reference"], flat["disturbance"] = reference, disturbance
    dynamics = Dynamics(plant.name, "continuous", tuple(states), tuple(nodes), tuple(parameters), limits, about)
    dynamics = refined(dynamics)
    if not sampled:
        return dynamics
    inputs = ca.vertcat(symbols, *free)
    sampling = _sampling(system, moves, whole, flat, f, after, inputs, dynamics.variables, constants)
    dynamics = replace(dynamics, sampling=sampling)
    return dynamics if dynamics.rests() else shifted(dynamics) or dynamics


def _sampling(
    system: System,
    moves: Sequence[int],
    whole: ca.SX,
    flat: Mapping[str, ca.SX],
    f: ca.SX,
    after: ca.SX,
    symbols: ca.SX,
    variables: Sequence[State | Range],
    constants: _Constants,
) -> Sampling | None:
    """Return the sampled form of the loop; None if a held command may move a state that rests."""
    plant, names = system.plant, [v.name for v in variables]
    x, _ = ca.vertsplit(whole, [0, plant.state.size, whole.numel()])
    held = ca.SX.sym("held", plant.inputs.size)
    flow = ca.densify(plant.derivative(x, held, flat["disturbance"], flat["plant"]))
    moving, steps = [k for k in moves if k < x.numel()], [k - x.numel() for k in moves if k >= x.numel()]
    if not all(ca.simplify(constants.put(flow[k])).is_zero() for k in set(range(x.numel())) - set(moving)):
        return None
    labels = [_identifier(label) for label in entry_labels(plant.inputs)]
    if not set(labels).isdisjoint(names):
        labels = [_identifier(f"command_{label}") for label in labels]
    at = [s.rest if isinstance(s, State) else Fraction(s.upper) for s in variables]
    # converted together, so that a limit that both contain is the same expression
    values = constants.expressions(symbols, names, ca.vertcat(f, after[steps]))
    rates = constants.expressions(ca.vertcat(symbols, held), [*names, *labels], flow[moving])
    own, m = [v.name for v in variables if isinstance(v, State)], held.numel()
    resting = exact_values(values[:m], dict(zip(names, at, strict=True)))
    if resting is None:
        rough = ca.Function("rests", [symbols], [constants.put(f)])([float(x) for x in at])
        resting = [Fraction(float(rest)) for rest in np.asarray(rough).ravel()]
    return Sampling(
        system.dt,
        dict(zip(own, rates, strict=False)),
        dict(zip(own[len(moving) :], values[m:], strict=True)),
        tuple(
            Command(label, value, rest, unit)
            for label, value, rest, unit in zip(labels, values, resting, entry_units(plant.inputs), strict=False)
        ),
    )


class _Constants:
    """Numbers as symbols, because CasADi would evaluate operations of numbers with rounding errors."""

    def __init__(self) -> None:
        self._symbols: dict[float, ca.SX] = {}

    def column(self, values: Sequence[float]) -> ca.SX:
        """Return a column of numbers; operations with 0, 1 and -1 are exact."""
        return ca.vertcat(ca.SX(0, 1), *(
            ca.SX(value) if value in (0.0, 1.0, -1.0) else self._symbols.setdefault(value, ca.SX.sym(f"number{value}"))
            for value in values
        ))  # fmt: skip

    def put(self, expression: ca.SX) -> ca.SX:
        """Return an expression with the numbers themselves, computed in doubles."""
        return ca.substitute(expression, ca.vertcat(*self._symbols.values()), ca.DM([*self._symbols]))

    def expressions(self, symbols: ca.SX, names: Sequence[str], column: ca.SX) -> list[Node]:
        """Return the exact expressions of a column."""
        by = {f"number{value}": number(Fraction(value)) for value in self._symbols}
        whole = ca.vertcat(symbols, *self._symbols.values())
        nodes = _exact(whole, [*names, *by], ca.vertsplit(ca.densify(column)))
        return [rebuilt(substitute(node, by), _signed) for node in nodes]


def _exact(symbols: ca.SX, names: Sequence[str], expressions: Sequence[ca.SX]) -> list[Node]:
    """Return the exact expressions of a loop."""
    try:
        return from_casadi(symbols, names, expressions, to_the_bit=True)
    except UnsupportedOperation as error:
        raise NotApplicable(f"{error.problem}: {error.remedy}", to="the loop") from None


def _signed(node: Node, args: tuple[Node, ...]) -> Node:
    return _negative(*args) if node.op == "neg" else Node(node.op, args, node.value, node.name)


def _negative(node: Node) -> Node:
    """Return −node, with the sign at the numbers of sums and products that begin with one."""
    first = node.args[0] if node.args else node
    if node.op == "num":
        return number(-node.value)
    if node.op == "mul" and first.op == "num":
        return number(-first.value) * node.args[1]
    if node.op == "add" and (signed := _negative(first)).op != "neg":
        return signed - node.args[1]
    return -node


def _about(system: System, flat: Mapping[str, ca.SX]) -> dict[str, Any]:
    """Return which loop the dynamics are about: its digests, and each entry of its vectors, a number or a name.

    The result is empty if a reference or disturbance is neither a number nor a parameter, and so has no entry.
    """
    plant, controller = system.plant, system.controller
    x, z = ca.vertsplit(flat["state"], [0, plant.state.size, flat["state"].numel()])
    labels = iter(entry_labels(plant.state) + entry_labels(controller.state, "controller."))
    try:
        return {
            "plant": plant.digest(),
            "controller": controller.block.digest(),
            "period_s": system.dt,
            "plant_state": _entries(x, labels),
            "controller_state": _entries(z, labels),
            "gains": {p.name: _entries(flat["gains"][controller.gains.slice(p.name)]) for p in controller.gains},
            "parameters": _entries(flat["plant"]),
            "reference": _entries(flat["reference"]),
            "disturbance": _entries(flat["disturbance"]),
        }
    except ValueError:
        return {}


def _entries(vector: ca.SX, labels: Iterator[str] | None = None) -> list[float | str]:
    entries: list[float | str] = []
    for k in range(vector.numel()):
        entry, label = vector[k], "" if labels is None else next(labels)
        if entry.is_constant():
            entries.append(float(entry))
        elif entry.is_symbolic():
            entries.append(_identifier(label or entry.name()))
        else:
            raise ValueError("an entry is an expression")
    return entries


def _check_rest(
    resting: Mapping[str, ca.SX], symbols: ca.SX, variables: Sequence[State | Range], within: Mapping[str, Bounds]
) -> str:
    """Return what a claim leaves out of the states that rest: nothing, or the rounding errors of their rates.

    Raises:
        InputError: a rate is not 0.
    """
    apart = {label: rate for label, rate in resting.items() if not ca.simplify(rate).is_zero()}
    if not apart:
        return ""
    low, high = np.array([[v.lower, v.upper] for v in variables]).T[:, :, None]
    points = low + (high - low) * np.random.default_rng(0).random((len(variables), _POINTS))
    rates = np.asarray(ca.Function("rates", [symbols], [ca.vertcat(*apart.values())])(points))
    for label, row in zip(apart, np.abs(rates).max(axis=1), strict=True):
        if not row <= _ROUNDING:
            problem = "has equal bounds, but moves" if label in within else "is missing, but the state moves"
            raise InputError(problem, key=f"within.{label}", remedy="give the lower and upper bound of the state")
    # points miss a rate that differs from 0 in a small part of the box
    names = tuple(v.name for v in variables)
    for label, rate in zip(apart, _exact(symbols, names, list(apart.values())), strict=True):
        for side in (rate, -rate):
            statement = Statement(names, low[:, 0], high[:, 0], side, exact(_ROUNDING), ())
            if prove_cases(statement, label, time_limit=_PROOF).remaining:
                problem = "is not shown to stay at rest in the whole box"
                raise InputError(problem, key=f"within.{label}", remedy="give the lower and upper bound of the state")
    return f"; {', '.join(apart)} stay at rest up to rounding (rates of at most {_ROUNDING:g})"


def _identifier(label: str) -> str:
    name = re.sub(r"\W+", "_", label).strip("_")
    if not IDENTIFIER.fullmatch(name):
        raise InputError(
            "is not a name of the claim grammar", key=label, remedy="begin with a letter; at most 40 characters"
        )
    return name
