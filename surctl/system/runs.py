"""Runs of a system: many at once in compiled code, or one with all its numbers; costs, why and when each run ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Literal, get_args

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, ToolMissing, check_known, nearest
from surctl.ir import Batch, Block, Call, Layout, Port, Recording, Routine, fold, lower_named, to_casadi, without_libm
from surctl.ir.batch import compile_batch
from surctl.ir.folding import fused
from surctl.ir.native import runnable, warn_slower
from surctl.ir.procedure import Procedure
from surctl.ir.routine import nested
from surctl.noise import noise_states
from surctl.plotted import Plotted
from surctl.system.loop import ENDED, LOST, System, once_per_system, periods
from surctl.system.plant import runge_kutta
from surctl.system.sampled import Instant
from surctl.system.values import RunNumbers, run_numbers

Array = NDArray[np.float64]

_FINITE = 1e300  # numbers with a larger absolute value count as infinite
_FIRST = MappingProxyType({"max": -np.inf, "min": np.inf})
_TOGETHER = 500  # largest number of control periods in one call of CasADi's virtual machine
_RECORDED = ("y", "u", "r", "memory", "noise", "tau", "x_next", "status", "k", "costs", "moved", "finer")


@dataclass(frozen=True)
class Runs(Plotted):
    """Results of n runs; `runs["name"]` returns a metric (n,), and `plot()` draws how each metric is distributed.

    Attributes:
        figures: values (n,) of each metric (cost) by name; NaN for a run that produced a number that is not finite, and
            for a run that a stop ended at its start.
        stopped: (n,) reasons for the end of each run: the name of a stop of the system, "time" or "not finite".
        time: (n,) duration of each run [s].
        state: (n, states) plant state at the end of each run.
    """

    PLOT = "surctl.report.system_plots:plot_runs"

    figures: Mapping[str, Array]
    stopped: NDArray[np.str_]
    time: Array
    state: Array

    def __getitem__(self, name: str) -> Array:
        if name not in self.figures:
            raise InputError("no such figure", key=name, remedy=nearest(name, self.figures))
        return self.figures[name]


Engine = Literal["auto", "c", "vm"]


def final_states(
    state: Array,
    parameters: Array,
    *,
    steps: int,
    compiled: Callable[[], Batch],
    machine: Callable[[], ca.Function],
    engine: Engine = "auto",
    threads: int = 1,
) -> tuple[Array, Engine]:
    """Return the states (runs, n) at the end of many runs of a simulation step, and the engine that computed them.

    Args:
        state, parameters, steps, threads: as for `Batch.run`.
        compiled: returns the compiled step.
        machine: returns the step as a CasADi function, for CasADi's virtual machine.
        engine: `c` compiles with the system's C compiler; `vm` uses CasADi's virtual machine; `auto` takes `c`, or `vm`
            with a warning `SlowerEngine` if there is no compiler.

    Raises:
        InputError: the engine is unknown.
        ToolMissing: the engine is `c`, but there is no compiler.
    """
    check_known(engine, get_args(Engine), key="engine")
    if engine != "vm":
        try:
            return compiled().run(state, parameters, steps=steps, threads=threads), "c"
        except ToolMissing as missing:
            if engine == "c":
                raise
            warn_slower(missing)
    step, final = machine(), state.copy()
    left = np.flatnonzero(final[:, 0] == 0)
    for _ in range(steps if left.size else 0):  # all runs advance together
        final[left] = np.asarray(step.map(len(left))(final[left].T, parameters[left].T)).T
        left = left[final[left, 0] == 0]
        if not left.size:
            break
    return final, "vm"


def simulate_system(
    system: System,
    seconds: float,
    values: Mapping[str, ArrayLike] | None = None,
    *,
    threads: int = 1,
    engine: Engine = "auto",
) -> Runs:
    """Simulate many runs of a system with compiled code; the results do not depend on the number of threads.

    Args:
        seconds: duration [s] of a run that no stop ends earlier; it is rounded to a whole number of control periods.
        values: numbers by name, see `run_numbers`: gains, `plant.…`, `reference.…`, `disturbance.…`, `start.…`.
        engine: `c`, `vm` or `auto`, see `final_states`.

    Raises:
        InputError: `run_numbers` finds an error, or the duration is shorter than a control period.
        ToolMissing: the engine is `c`, but there is no C compiler.

    Example:
        >>> from surctl.system import Cost, simulate_system
        >>> from surctl.testing import cart_system
        >>> slow = Cost(lambda s: s.x["speed"] - 0.1, "last_time", "s", "time to a tenth of the speed")
        >>> simulate_system(cart_system(costs={"slow": slow}), 5.0, {"k": [1.0, 2.0, 4.0]})["slow"].round(1)
        array([2.1, 1. , 0.4])
    """
    steps = periods(system, seconds)
    start, constants = _begun(system, run_numbers(system, values))
    ends, _ = final_states(
        start, constants, steps=steps, compiled=lambda: _compiled(system), machine=lambda: _machine(system),
        engine=engine, threads=threads,
    )  # fmt: skip
    return _ended(system, ends)


def simulate_steps(system: System, numbers: RunNumbers, steps: int) -> tuple[dict[str, Array], Runs]:
    """Simulate one run with CasADi's virtual machine; return all its numbers at its n control instants, and its end.

    The numbers are arrays (n, size): plant state `plant` and controller state `controller` at the instant, measured
    outputs `y`, inputs of the controller `u`, references `r`, memory of the sampled blocks and state of the noise
    generator after they are measured, `memory` and `noise`, the results of the controller's step, `tau`, `x_next`,
    `status` and `k` (telemetry), the `costs`, and the plant state at the end of the period, `moved`, and with steps of
    integration that are half as long, `finer`.

    Args:
        numbers: those of one run.
        steps: largest number of control periods.
    """
    state, _ = _layouts(system)
    (start,), (constants,) = _begun(system, numbers)
    period, states = _recorder(system), [start[:, None]]
    tables: list[list[Array]] = []
    while (left := steps - _TOGETHER * len(tables)) > 0 and not states[-1][0].any():
        after, *table = (part.full() for part in period.mapaccum(min(left, _TOGETHER))(states[-1][:, -1], constants))
        states.append(after)
        tables.append(table)
    whole = np.hstack(states)
    stays = whole[0, 1:] != 0
    count = int(stays.argmax()) + 1 if stays.any() else stays.size
    at = {name: np.hstack(parts)[:, :count].T for name, parts in zip(_RECORDED, zip(*tables, strict=True), strict=True)}
    at |= {name: whole[state.slice(name), :count].T for name in ("plant", "controller")}
    return at, _ended(system, whole[:, count][None])


def _begun(system: System, numbers: RunNumbers) -> tuple[Array, Array]:
    """Return states and parameters (runs, n) at the start of runs."""
    state, _ = _layouts(system)
    start = np.tile(state.pack({"controller": system.controller.initial_state()}), (numbers.count, 1))
    start[:, state.slice("plant")] = numbers.start
    start[:, state.slice("memory")] = system.blocks.memory.pack()
    if system.blocks.noise:
        start[:, state.slice("noise")] = noise_states(numbers.seed)
    start[:, state.slice("sums")] = [_FIRST.get(cost.how, 0.0) for cost in system.costs.values()]
    return start, np.hstack([numbers.plant, numbers.reference, numbers.disturbance, numbers.gains, numbers.blocks])


def _ended(system: System, ends: Array) -> Runs:
    """Return the results of runs from their states (runs, n) at the end."""
    state, _ = _layouts(system)
    flag = ends[:, 0]
    count = ends[:, state.slice("count").start]
    reasons = np.array([ENDED, *system.stops, LOST])
    code = np.where(flag < 0, len(reasons) - 1, np.round(flag)).astype(int)
    sums = ends[:, state.slice("sums")]
    moved = count - (flag != 0)
    none = (flag < 0) | (moved == 0)
    figures = {}
    for j, (name, cost) in enumerate(system.costs.items()):
        value = sums[:, j] / (np.maximum(count, 1) if cost.how in ("mean", "rms") else 1.0)
        figures[name] = np.where(none, np.nan, np.sqrt(value) if cost.how == "rms" else value)
    return Runs(figures, reasons[code], moved * system.dt, ends[:, state.slice("plant")])


def _loop_step(system: System, *, recorded: bool = False) -> Block:
    """Return a program or routine that computes the state of a run after one control period.

    Its arguments are the state and the parameters of the run. If `recorded`, it also returns the arrays `_RECORDED`.
    """
    plant, controller = system.plant, system.controller
    state, parameters = _layouts(system)
    s, now = state.symbols("s")
    w, constants = parameters.symbols("w")
    t = now["count"] * system.dt
    reference, d = system.reference_at(t, constants["reference"]), system.disturbance_at(t, constants["disturbance"])
    x, p, q = now["plant"], constants["plant"], constants["blocks"]
    y = plant.measurement(x, d, p)
    memory, noise = system.sensed(Instant(x, d, p, q, now["count"]), now["memory"], now["noise"])
    inputs = {
        "x": now["controller"], "u": system.inputs_of(system.held(y, memory), reference), "p": constants["gains"],
        "memory": memory, "noise": noise, **({"y": system.held(y, memory), "r": reference} if recorded else {}),
    }  # fmt: skip
    before = lower_named("measure", {"s": s, "w": w}, inputs)
    sizes = (system.commands.size, controller.state.size, 1, system.telemetry.size)
    outputs = {name: ca.SX.sym(name, n) for name, n in zip(("tau", "x_next", "status", "k"), sizes, strict=True)}
    carried = {name: ca.SX.sym(name, state.port(name).size) for name in ("memory", "noise")}
    with Recording() as recording:
        tau = outputs["tau"]
        advanced = partial(moved_state, system, x, tau, constants, t, now["count"], carried["memory"], carried["noise"])
        moved, memory, noise = advanced()
        costs, stops = system.evaluated(
            x=x, f=tau, d=constants["disturbance"], r=constants["reference"], p=p, g=constants["gains"],
            k=outputs["k"], t=t, b=carried["memory"],
        )  # fmt: skip
        ended = ca.SX(0)
        for k in range(stops.numel(), 0, -1):
            ended = ca.if_else(stops[k - 1] != 0, k, ended)
        size = ca.fabs(ca.vertcat(moved, memory, tau, outputs["x_next"], costs))
        ended = ca.if_else(ca.sum1(size) <= _FINITE, ended, -1)  # NaN compares as false
        stays = ended != 0
        after = state.join(
            {
                "done": ended,
                "count": now["count"] + 1,
                "plant": ca.if_else(stays, now["plant"], moved),
                "controller": ca.if_else(stays, now["controller"], outputs["x_next"]),
                "memory": memory,
                "noise": noise,
                "sums": _summed(system, now["sums"], costs, t, stays),
            }
        )
        results = {"s_next": after}
        if recorded:
            results |= {"costs": costs, "moved": moved, "finer": advanced(parts=2)[0]}
        move = recording.block("move", {"s": s, "w": w, **outputs, **carried}, results)
    steps = (
        Call(before, ("s", "w"), tuple(inputs)),
        Call(controller.block, ("x", "u", "p"), tuple(outputs)),
        Call(move, ("s", "w", *outputs, *carried), tuple(results)),
    )
    arrays = ("s_next", *(_RECORDED if recorded else ()))
    return Routine("period", (("s", state.size), ("w", parameters.size)), steps, arrays)


def _layouts(system: System) -> tuple[Layout, Layout]:
    # the first entry of the state is the flag that ends a run
    sizes = {
        "plant": system.plant.state.size, "controller": system.controller.state.size,
        "memory": system.blocks.memory.size, "noise": system.blocks.noise, "sums": len(system.costs),
    }  # fmt: skip
    constants = {
        "plant": system.plant.parameters.size, "reference": system.references.size,
        "disturbance": system.plant.disturbances.size, "gains": system.controller.gains.size,
        "blocks": system.blocks.parameters.size,
    }  # fmt: skip
    flags = (Port("done", (1,), "1", "why the run ended"), Port("count", (1,), "1", "control instants so far"))
    return Layout((*flags, *(_stack(n, k) for n, k in sizes.items()))), Layout(
        tuple(_stack(n, k) for n, k in constants.items())
    )


def _stack(name: str, size: int) -> Port:
    return Port(name, (size,), "1", "a vector of ports in their own units")


def moved_state(
    system: System,
    x: ca.SX,
    command: ca.SX,
    constants: Mapping[str, ca.SX],
    t: ca.SX,
    count: ca.SX,
    memory: ca.SX,
    noise: ca.SX,
    *,
    parts: int = 1,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return plant state, memory of the sampled blocks and noise generator's state one control period later.

    The command is constant from `t` [s] on, `constants` are the numbers `plant`, `disturbance` and `blocks` of a run,
    flat, and `count` is the number of the control period. Memory and noise are those after `System.sensed`. Each step
    of integration is divided into `parts`.
    """
    instants, p, q = system.blocks.instants, constants["plant"], constants["blocks"]
    for k in range(instants):
        late = k * system.dt / instants
        at = Instant(x, system.disturbance_at(t + late, constants["disturbance"]), p, q, count, k)
        if k:
            memory, noise = system.sensed(at, memory, noise)
        f, memory, noise = system.driven(command, at, memory, noise)
        x = _integrated(system, x, f, constants, t, late, parts)
    return x, memory, noise


def _integrated(
    system: System, x: ca.SX, f: ca.SX, constants: Mapping[str, ca.SX], t: ca.SX, late: float, parts: int
) -> ca.SX:
    """Return the plant state at the next instant, by fourth-order Runge-Kutta steps with constant inputs f.

    `late` is the time [s] from the beginning t of the control period to the instant.
    """
    instants = system.blocks.instants
    steps = parts * -(-system.substeps // instants)
    h = system.dt / (steps * instants)

    def derivative(state: ca.SX, late: ca.SX) -> ca.SX:
        disturbance = system.disturbance_at(t + late, constants["disturbance"])
        return system.plant.derivative(state, f, disturbance, constants["plant"])

    def substep(state: ca.SX, late: ca.SX) -> ca.SX:
        after: ca.SX = runge_kutta(derivative, state, h, late)
        return after

    moved: ca.SX = fold("substep", substep, x, late + ca.SX([k * h for k in range(steps)]))
    return moved


def _summed(system: System, sums: ca.SX, costs: ca.SX, t: ca.SX, ended: ca.SX) -> ca.SX:
    """Return the number of each cost after one more control instant t [s]; `ended`: no period follows it."""
    after = []
    for k, cost in enumerate(system.costs.values()):
        old, value = sums[k], costs[k]
        after.append(
            {
                "integral": ca.if_else(ended, old, old + system.dt * value),
                "mean": old + value,
                "rms": old + value * value,
                "max": ca.fmax(old, value),
                "min": ca.fmin(old, value),
                "final": value,
                "last_time": ca.if_else(value > 0, t, old),
            }[cost.how]
        )
    return ca.vertcat(ca.SX(0, 1), *after)


@once_per_system
def loop_program(system: System) -> Block:
    """Return what `simulate_system` compiles; its digest identifies all computations of a run, costs and stops too."""
    return fused(without_libm(_loop_step(system)))


@once_per_system
def _machine(system: System) -> ca.Function:
    return to_casadi(_loop_step(system))


@once_per_system
def _recorder(system: System) -> ca.Function:
    step = _loop_step(system, recorded=True)
    for inner in nested(step).values():
        if isinstance(inner, Procedure):
            runnable(inner, quick=True)  # what is wrong with the compiler is said before CasADi calls it
    return to_casadi(step)


@once_per_system
def _compiled(system: System) -> Batch:
    return compile_batch(loop_program(system))
