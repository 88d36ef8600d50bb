"""Exact gradients of a whole closed-loop run with respect to gains, by reverse-mode automatic differentiation.

A run is a fixed number of control steps of the closed-form law and the plant, with true positions (`simulate` with
sensing `truth`): the programs of the compiled loop, without its end. The metrics of a run are not smooth; the
differentiated outputs are smooth surrogates of them (`SURROGATES`). The law itself is piecewise smooth. The law
switches when the passing side, the active limits or the nearest obstacle change. Between two switches the gradient is
exact; at a switch the result is the one-sided gradient. `DifferentiableRun.branches` shows whether two runs switch in
the same way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from types import MappingProxyType

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import Instruction, Program, lower, to_casadi
from surctl.marine.guidance import MAX_WAYPOINTS
from surctl.marine.simulation import Case, advance, build_world
from surctl.marine.simulation.batch import Loop
from surctl.marine.simulation.batch.loop import loop_of
from surctl.marine.simulation.batch.pack import pack, structure_of
from surctl.marine.vehicle import plant_state

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
_TINY = 1e-24  # least value under a root: √ has no slope at 0, and 0 · ∞ would be NaN in an unused branch
_FAR = 100.0  # [m] clearance without obstacles


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
    _loop: Loop = field(repr=False)
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
        start, fixed = self._fixed
        full = fixed.copy()
        for name, value in zip(self.names, values, strict=True):
            full[self._loop.parameters.slice(name)] = value
        _, tally = _step(self._loop)
        return np.asarray(tally(np.column_stack([start, run[:, :-1]]), np.arange(self.steps)[None], full)).ravel()


def prepare(case: Case, names: Sequence[str], *, steps: int, seed: int = 0) -> DifferentiableRun:
    """Prepare a simulation case for the computation of gradients.

    Args:
        case: case with mode nsb (closed form) and true positions.
        names: gains with respect to which the run is differentiated.
        steps: number of control steps, at least 1; a run that arrives earlier stays at the target.
        seed: seed of the obstacles' drift and of the waves.

    Raises:
        InputError: the mode or the sensing has no gradient, a gain is unknown, or the scenario starts inside an
            obstacle or has a path that is fed to the law (`Path.fed`).

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
    scenario, law = case.scenario, case.build()
    law = law.base or law  # the gradient is that of the command, before the allocation
    build_world(scenario, case.vehicle, seed=seed)  # refuses a start inside an obstacle
    if scenario.path.fed:
        remedy = f"use at most {MAX_WAYPOINTS} points, without speeds and depths of legs"
        raise InputError(
            "has no gradient: this path changes the law's parameters during the run",
            file=scenario.source,
            key="path_m",
            remedy=remedy,
        )
    loop = loop_of(replace(structure_of(case, {}), actuators=None), law, single=True)
    packed = pack(case, loop, {}, np.array([seed]))
    start = np.concatenate([packed.state[0, loop.state.slice("plant")], law.initial_state()])
    functions = _functions(loop, tuple(names), steps)
    return DifferentiableRun(case, tuple(names), steps, loop, (start, packed.parameters[0]), *functions)


@cache
def _functions(loop: Loop, names: tuple[str, ...], steps: int) -> tuple[ca.Function, ca.Function]:
    # (gains, start, parameters) → (surrogates, states), and (gains, weights, start, parameters) → gradient
    step, _ = _step(loop)
    gains, weights = ca.MX.sym("gains", len(names)), ca.MX.sym("weights", len(SURROGATES))
    start, w = ca.MX.sym("start", step.size1_in(0)), ca.MX.sym("w", loop.parameters.size)
    place = np.zeros((loop.parameters.size, len(names)))
    for column, name in enumerate(names):
        place[loop.parameters.slice(name), column] = 1
    full = w * (1 - place.sum(axis=1)) + ca.mtimes(place, gains)
    states, terms = step.mapaccum(steps)(start, ca.DM(range(steps)).T, ca.repmat(full, 1, steps))
    clearances = ca.vec(terms[3:, :])
    least = ca.mmin(clearances)
    soft = least - ca.log(ca.sum1(ca.exp(-_SHARPNESS * (clearances - least)))) / _SHARPNESS
    mean = ca.sum2(terms[:3, :]) / steps
    surrogates = ca.vertcat(mean[0], soft, mean[1], mean[2])
    fixed = [start, w]
    run = ca.Function("run", [gains, *fixed], [surrogates, states])
    slope = ca.Function("slope", [gains, weights, *fixed], [ca.gradient(ca.dot(weights, surrogates), gains)])
    return run, slope


@cache
def _step(loop: Loop) -> tuple[ca.Function, ca.Function]:
    """Return two functions of a control step: one computes the next state and cost terms, one the branch number.

    Both have the arguments state of plant and law, number of the step, and parameters of the run. The terms are y_e²,
    thrust², the distance to the target, and the clearances. The branch number is defined by `_tally`.
    """
    law, form = loop.law, loop.structure.form
    size = plant_state(form).size
    state, index, w = (
        ca.SX.sym("state", size + law.state.size),
        ca.SX.sym("index"),
        ca.SX.sym("w", loop.parameters.size),
    )
    known, plant, memory = loop.parameters.split(w), state[:size], state[size:]
    run = ca.SX(loop.state.pack())
    run[loop.state.slice("plant")], run[loop.state.slice("step")] = plant, index
    sense = loop.calls(measured=False)["sense"]
    values = dict(zip((name for name, _ in sense.outputs), to_casadi(sense)(run, w), strict=True))
    tau, memory_next, _, telemetry = law.function(memory, values["u"], w[: law.gains.size])
    after, delivered = plant, known["thrust_gain"] * tau + known["thrust_bias"]
    for disturbance in (values["d0"], values["d1"]):
        after = advance(form)(after, delivered, disturbance, known["plant"])
    clearances = [
        body.clearance(plant[:3]) - known["world_hull"] for body in loop.structure.bodies_at(known, index * law.dt)
    ]
    y_e = telemetry[law.telemetry_slice("path_error")][1]
    going = ca.sqrt(ca.sumsqr(plant[:2] - known["waypoints"][MAX_WAYPOINTS - 1, :].T))
    terms = ca.vertcat(y_e * y_e, ca.sumsqr(tau[:2]), going, *(clearances or [ca.SX(_FAR)]))
    following = ca.vertcat(after, memory_next)
    whole = ca.Function("step", [state, index, w], [following, terms], ["state", "index", "w"], ["next", "terms"])
    smooth = _with_slopes(lower(whole))
    return to_casadi(smooth), _tally(to_casadi(_compared(smooth)))


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
