"""Exact gradients of a whole closed-loop run with respect to gains, by reverse-mode automatic differentiation.

A run is a fixed number of control steps of the closed-form law and the plant, with true positions (`simulate` with
sensing `truth`). The positions of the obstacles at each step are fixed in advance and do not depend on the gains. The
metrics of a run are not smooth; the differentiated outputs are smooth surrogates of them (`SURROGATES`). The law itself
is piecewise smooth. The law switches when the passing side, the active limits or the nearest obstacle change. Between
two switches the gradient is exact; at a switch the result is the one-sided gradient. `DifferentiableRun.branches` shows
whether two runs switch in the same way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from types import MappingProxyType

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import Instruction, Program, lower, to_casadi
from surctl.marine.control import CONTACT_SLOTS, Law
from surctl.marine.guidance import MAX_WAYPOINTS
from surctl.marine.sensing import SonarArray
from surctl.marine.simulation import Case, World, advance, build_world, law_numbers
from surctl.marine.vehicle import PLANT_DISTURBANCE, PlantForm, plant_parameters, plant_state
from surctl.marine.vehicle.dynamics import PAPER
from surctl.marine.world import Box, Disc

__all__ = ["SURROGATES", "DifferentiableRun", "prepare"]

Array = NDArray[np.float64]

SURROGATES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "deviation": ("m^2", "mean square of the cross-track error"),
        "clearance": ("m", "soft minimum of the clearance over time and obstacles, without walls"),
        "effort": ("N^2", "mean square of the horizontal thrust"),
        "remaining": ("m", "mean distance to the target over the whole horizon; a late arrival increases it"),
    }
)
"""Smooth substitutes for the metrics: name → (unit, meaning)."""

_SHARPNESS = 60.0  # [1/m] of the soft minimum, which is log(n)/60 m below n equal samples: 0.1 m for n = 1000
_ROW = 8  # numbers of a body: centre x, y, half sides x, y (0 for a disc), radius, velocity x, y, valid
_TINY = 1e-24  # least value under a root: √ has no slope at 0, and 0 · ∞ would be NaN in an unused branch
_FAR = 100.0  # [m] position of an empty slot
_HALVES = 2  # plant intervals of 25 ms in one control step


@dataclass(frozen=True, eq=False)
class DifferentiableRun:
    """A simulation case prepared for differentiation: surrogates of its run, and their gradient with respect to gains.

    Attributes:
        case: the simulated case; it supplies the gains that are not in `names`.
        names: names of the variable gains, in the order of every vector of gains.
        steps: number of control steps of the run.
    """

    case: Case
    names: tuple[str, ...]
    steps: int
    _fixed: tuple[Array, ...] = field(repr=False)
    _run: ca.Function = field(repr=False)
    _slope: ca.Function = field(repr=False)

    def surrogates(self, values: Array) -> dict[str, float]:
        """Return the `SURROGATES` of the run with the gains `values` (k,)."""
        return dict(zip(SURROGATES, np.asarray(self._run(values, *self._fixed)[0]).ravel().tolist(), strict=True))

    def gradient(self, values: Array, weights: Mapping[str, float]) -> Array:
        """Return the gradient (k,) of Σ weight · surrogate with respect to the gains."""
        seed = np.array([float(weights.get(name, 0.0)) for name in SURROGATES])
        return np.asarray(self._slope(values, seed, *self._fixed)).ravel()

    def track(self, values: Array) -> Array:
        """Return the plant states (steps, …) at the end of each control step, in the order of `plant_state`."""
        return np.asarray(self._run(values, *self._fixed)[1]).T[:, : plant_state(self.case.vehicle.form).size]

    def branches(self, values: Array) -> Array:
        """Return one number per control step (steps,).

        If two runs have equal numbers at a step, all comparisons in this step had equal outcomes.
        """
        run = np.asarray(self._run(values, *self._fixed)[1])
        start, data, p, plant = self._fixed
        before = np.column_stack([start, run[:, :-1]])
        law = self.case.build()
        law = law.base or law  # the gradient is that of the command, before the allocation
        full = p.copy()
        for name, value in zip(self.names, values, strict=True):
            full[law.gains.slice(name)] = value
        tally = _step(law)[1]
        return np.asarray(tally(before, data, full, plant)).ravel()


def prepare(case: Case, names: Sequence[str], *, steps: int, seed: int = 0) -> DifferentiableRun:
    """Prepare a simulation case for the computation of gradients.

    Args:
        case: case with mode nsb (closed form), true positions, and any law except `closed_form`: the law must have
            inputs for `CONTACT_SLOTS` obstacle points.
        names: gains with respect to which the run is differentiated.
        steps: number of control steps, at least 1; a run that arrives earlier stays at the target.
        seed: seed of the obstacles' drift and of the waves.

    Raises:
        InputError: the mode, the sensing or the law has no gradient, a gain is unknown, or the scenario starts inside
            an obstacle, has too many obstacles or a path that is fed to the law (`Path.fed`).

    Example:
        >>> import numpy as np
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, prepare
        >>> [case] = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="paper")
        >>> run = prepare(case, ["k_v", "k1"], steps=60)
        >>> round(run.surrogates(np.array([1.5, 0.3]))["effort"], 2)  # N^2
        19.19
        >>> run.gradient(np.array([1.5, 0.3]), {"effort": 1.0}).round(2).tolist()
        [1.25, 17.21]
    """
    for key, value, only in (("mode", case.mode, "nsb"), ("sensing", case.sensing, "truth")):
        if value != only:
            raise InputError("has no gradient", key=key, value=value, remedy=f"use {only}")
    if steps < 1 or not names:
        raise InputError("has nothing to differentiate", key="steps, names", value=(steps, tuple(names)))
    for name in names:
        case.gains[name]  # raises InputError if the gain is unknown
    law = case.build()
    law = law.base or law
    slots = [port.shape[0] for port in law.inputs if port.name == "contacts"]
    if slots != [CONTACT_SLOTS]:
        remedy = f"use a law with {CONTACT_SLOTS} contact slots"
        raise InputError("has no gradient", key="law", value=case.law, remedy=remedy)
    scenario = case.scenario
    world = build_world(scenario, case.vehicle, seed=seed)
    if scenario.path.fed:
        remedy = f"use at most {MAX_WAYPOINTS} points, without speeds and depths of legs"
        raise InputError(
            "has no gradient: this path changes the law's parameters during the run",
            file=scenario.source,
            key="path_m",
            remedy=remedy,
        )
    if len(scenario.obstacles) > CONTACT_SLOTS:
        raise InputError(f"has more than {CONTACT_SLOTS} obstacles", file=scenario.source, key="obstacles")
    p = law_numbers(scenario, case.gains, case.model or case.vehicle)
    start = np.concatenate([plant_state(case.vehicle.form).pack({"eta": scenario.start_pose}), law.initial_state()])
    plant = [*plant_parameters(case.vehicle), *scenario.disturbance.current_m_per_s, *scenario.target]
    limit = case.vehicle.thrust_range[1]
    bias = world.thrust(np.zeros(4), limit)
    drive = [*(world.thrust(np.ones(4), limit) - bias), *bias]
    fixed = (start, _data(world, steps=steps, dt=law.dt).T, p, np.array([*plant, case.vehicle["radius"], *drive]))
    return DifferentiableRun(case, tuple(names), steps, fixed, *_functions(law, tuple(names), steps, case.vehicle.form))


def _data(world: World, *, steps: int, dt: float) -> Array:
    # (steps, 8 · slots + 4): the obstacles, and the wave force in the two halves of the step
    rows = np.zeros((steps, CONTACT_SLOTS, _ROW))
    rows[:, :, :2] = _FAR
    forces = np.zeros((steps, 2 * _HALVES))
    for step in range(steps):
        for row, body in zip(rows[step], world.bodies(step * dt), strict=False):
            shape = body.shape
            assert isinstance(shape, Disc | Box)  # walls are no bodies
            size = (0.0, 0.0, shape.radius) if isinstance(shape, Disc) else (*np.asarray(shape.size) / 2, 0.0)
            row[:] = [*shape.center, *size, *body.velocity, 1.0]
        for half in range(_HALVES):
            forces[step, 2 * half : 2 * half + 2] = world.force((step + half / _HALVES) * dt)[:2]
    return np.hstack([rows.reshape(steps, -1), forces])


@cache
def _functions(law: Law, names: tuple[str, ...], steps: int, form: PlantForm) -> tuple[ca.Function, ca.Function]:
    # (gains, fixed …) → (surrogates, states), and (gains, weights, fixed …) → gradient
    step, _ = _step(law, form)
    gains, weights = ca.MX.sym("gains", len(names)), ca.MX.sym("weights", len(SURROGATES))
    start, p, plant = (ca.MX.sym(n, step.size1_in(i)) for n, i in (("start", 0), ("p", 2), ("plant", 3)))
    data = ca.MX.sym("data", step.size1_in(1), steps)
    place = np.zeros((law.gains.size, len(names)))
    for column, name in enumerate(names):
        place[law.gains.slice(name), column] = 1
    full = p * (1 - place.sum(axis=1)) + ca.mtimes(place, gains)
    states, terms = step.mapaccum(steps)(start, data, ca.repmat(full, 1, steps), ca.repmat(plant, 1, steps))
    clearances = ca.vec(terms[3:, :])
    least = ca.mmin(clearances)
    soft = least - ca.log(ca.sum1(ca.exp(-_SHARPNESS * (clearances - least)))) / _SHARPNESS
    mean = ca.sum2(terms[:3, :]) / steps
    surrogates = ca.vertcat(mean[0], soft, mean[1], mean[2])
    fixed = [start, data, p, plant]
    run = ca.Function("run", [gains, *fixed], [surrogates, states])
    slope = ca.Function("slope", [gains, weights, *fixed], [ca.gradient(ca.dot(weights, surrogates), gains)])
    return run, slope


@cache
def _step(law: Law, form: PlantForm = PAPER) -> tuple[ca.Function, ca.Function]:
    """Return two functions of a control step: one computes the next state and cost terms, one the branch number.

    Both have the arguments state, data of the step, gains p, and plant parameters.

    The terms are y_e², thrust², the distance to the target, and the clearances. The branch number is defined by
    `_tally`.
    """
    size = plant_state(form).size
    state = ca.SX.sym("state", size + law.state.size)
    data = ca.SX.sym("data", CONTACT_SLOTS * _ROW + 2 * _HALVES)
    # plant parameters, current x, y, target x, y, hull radius, gains and biases of the thrust
    ends = np.cumsum([0, advance(form).size1_in(3), 2, 2, 1, 4, 4]).tolist()
    p, world = ca.SX.sym("p", law.gains.size), ca.SX.sym("plant", ends[-1])
    plant, current, target, hull, gain, bias = ca.vertsplit(world, ends)
    body, memory = state[:size], state[size:]
    position = body[:2]
    contacts, clearances = [], []
    for k in range(CONTACT_SLOTS):
        row = data[k * _ROW : (k + 1) * _ROW]
        # the nearest point of the box, or the centre of the disc
        point = row[:2] + ca.fmin(ca.fmax(position - row[:2], -row[2:4]), row[2:4])
        contacts.append(ca.horzcat(point.T, row[4], row[5:7].T, row[7]))
        clearances.append(ca.sqrt(ca.sumsqr(point - position)) - row[4] - hull)
    inputs = law.inputs.join(
        {
            "eta": body[:4],
            "nu": body[4:8],
            "contacts": ca.vertcat(*contacts),
            "samples": ca.SX.ones(4, 5) * SonarArray().maximum,
            "fresh": ca.SX.zeros(4),
        }
    )
    tau, memory_next, _, telemetry = law.function(memory, inputs, p)
    after, delivered = body, gain * tau + bias
    for half in range(_HALVES):
        force = data[CONTACT_SLOTS * _ROW + 2 * half : CONTACT_SLOTS * _ROW + 2 * half + 2]
        after = advance(form)(after, delivered, PLANT_DISTURBANCE.join(_disturbance(current, force)), plant)
    y_e = telemetry[law.telemetry_slice("path_error")][1]
    going = ca.sqrt(ca.sumsqr(position - target))
    terms = ca.vertcat(y_e * y_e, ca.sumsqr(tau[:2]), going, *clearances)
    arguments = [state, data, p, world]
    names = ["state", "data", "p", "plant"]
    whole = ca.Function(
        "step", arguments, [ca.vertcat(after, memory_next), terms], names, ["next", "terms"], {"cse": True}
    )
    smooth = _with_slopes(lower(whole))
    return to_casadi(smooth), _tally(to_casadi(_compared(smooth)))


def _disturbance(current: ca.SX, force: ca.SX) -> dict[str, ca.SX]:
    return {"current": ca.vertcat(current, 0), "force": ca.vertcat(force, 0, 0)}


def _with_slopes(program: Program) -> Program:
    """Replace √x by √max(x, tiny), so that no branch of the program has an infinite slope.

    The results of the program change by at most 1e-12.
    """
    instructions: list[Instruction] = [Instruction("const", (), _TINY)]
    new: list[int] = []
    for instruction in program.instructions:
        args = instruction.args
        if instruction.op not in ("const", "input"):
            args = tuple(new[a] for a in args)
        if instruction.op == "sqrt":
            instructions.append(Instruction("fmax", (args[0], 0)))
            args = (len(instructions) - 1,)
        instructions.append(Instruction(instruction.op, args, instruction.value))
        new.append(len(instructions) - 1)
    refs = tuple(tuple(new[r] for r in group) for group in program.output_refs)
    return Program(program.name, program.inputs, program.outputs, tuple(instructions), refs)


def _compared(program: Program) -> Program:
    """Return a program whose outputs are the outcomes of all comparisons, also of those in minima and maxima."""
    instructions, outcomes = list(program.instructions), []
    for at, instruction in enumerate(program.instructions):
        if instruction.op in ("lt", "le", "eq", "ne"):
            outcomes.append(at)
        elif instruction.op in ("fmin", "fmax"):
            instructions.append(Instruction("lt", instruction.args))
            outcomes.append(len(instructions) - 1)
    return Program("compared", program.inputs, (("outcomes", len(outcomes)),), tuple(instructions), (tuple(outcomes),))


def _tally(compared: ca.Function) -> ca.Function:
    # with random weights, sums of different outcomes rarely agree by coincidence
    inputs = [ca.SX.sym(f"i{k}", compared.size1_in(k)) for k in range(compared.n_in())]
    outcomes = compared(*inputs)
    weights = np.random.default_rng(0).uniform(1, 2, outcomes.numel())
    return ca.Function("tally", inputs, [ca.dot(ca.DM(weights), outcomes)])
