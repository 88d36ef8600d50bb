"""Many runs of a case: packed as state and parameter vectors, then simulated in compiled C or in CasADi's machine.

The C text of a loop is in the cache on disk.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, SurctlError, check_known
from surctl.ir import Batch, to_casadi, without_libm
from surctl.ir.batch import batch_source, compile_batch_source
from surctl.ir.cache import cached_bytes, source_digest
from surctl.ir.folding import fused
from surctl.marine.allocation import working_flags
from surctl.marine.control import WORKING, law_options
from surctl.marine.control.build import LAW_SOURCES
from surctl.marine.sensing import FaultChances
from surctl.marine.sensing.sonar.faults import fault_slots
from surctl.marine.sensing.sonar.returns import echo_keys, echo_number
from surctl.marine.simulation.batch.case import VISITED, Case, case_parameters, check_values, law_numbers
from surctl.marine.simulation.batch.loop import Loop, build_loop
from surctl.marine.simulation.batch.structure import BodyKind, Structure
from surctl.marine.simulation.metrics import METRICS, metrics_table
from surctl.marine.simulation.scenario import check_spacing
from surctl.marine.simulation.world import WorldDraw, draw_world
from surctl.marine.vehicle import Vehicle, plant_layout, plant_state
from surctl.noise import noise_states
from surctl.own_code import is_own
from surctl.system.runs import Engine, final_states

Columns = NDArray[np.float64]

NO_END = 1e6  # [m] height of an end beyond the floor or the surface
_LEAST = 16  # waypoints that the parameters hold, a power of two: paths of similar length use the same compiled loop

_VECTORS = {
    "mass": ("m11", "m22", "m33", "m44"),
    "linear_drag": ("Xu", "Yv", "Zw", "Nr"),
    "quadratic_drag": ("Xuu", "Yvv", "Zww", "Nrr"),
    "thrust_limit": ("Fu_max", "Fv_max", "Fw_max", "Fr_max"),
}
"""Vectors of both plant and model, with the vehicle parameters that they contain."""

_BODY = {
    "box": ("size_x", "size_y"),
    "disc": ("radius",),
    "drifting box": ("size_x", "size_y"),
    "drifting disc": ("radius",),
    "mover": ("radius", "to_x", "to_y", "speed"),
}
"""Parameters of each kind of obstacle besides its centre and its drift."""


def structure_of(case: Case, values: Mapping[str, Columns]) -> Structure:
    """Return the loop structure to compile; it lets an obstacle drift if the drift amplitude is positive in any run."""
    kinds = []
    for obstacle in case.scenario.obstacles:
        moved = values.get(f"obstacle.{obstacle.name}.drift", np.asarray(obstacle.drift_m))
        shape = "drifting " * bool(np.any(moved > 0)) + ("box" if obstacle.shape == "box" else "disc")
        kinds.append(cast("BodyKind", "mover" if obstacle.shape == "moving" else shape))
    optional = any(f"obstacle.{obstacle.name}.there" in values for obstacle in case.scenario.obstacles)
    sensors, path, sonars = case.scenario.sensors, case.scenario.path, dict[str, Any]()
    if case.sensing == "sonar":
        chances = zip(sensors.chances.kinds(), sensors.chances.numbers, strict=True)
        struck = any(np.any(values.get(f"sonar.{kind}", chance) > 0) for kind, chance in chances)
        late = any(fault.kind == "delay" for fault in sensors.faults)
        sonars = {"equipment": sensors.on(case.vehicle["radius"]), "faults": len(sensors.faults), "chances": struck}
        sonars |= {"delays": late, "surfaces": case.scenario.surfaces}
    return Structure(
        law=case.law, sensing=case.sensing, bodies=tuple(kinds), optional=optional,
        heights=any(not obstacle.heights.whole for obstacle in case.scenario.obstacles),
        depths=case.scenario.depths is not None, form=case.vehicle.form, actuators=case.vehicle.actuators,
        points=max(_LEAST, 1 << (len(path.waypoints) - 1).bit_length()) if path.fed else 0,
        rises=path.rises is not None,
        **law_options(case), **sonars,
    )  # fmt: skip


class Packed:
    """Runs as vectors, from checked values (n,) by name and seeds (n,).

    Attributes:
        state, parameters: initial states (n, …) and parameters (n, …) of the runs, for `loop`, which is that of the
            structure that `structure_of(case, values)` returns.
        steps: upper limit of their control periods.
    """

    def __init__(self, case: Case, loop: Loop, values: Mapping[str, Columns], seeds: NDArray[np.int64]) -> None:
        self.case, self.loop, self.values, self.seeds = case, loop, values, seeds
        self._known = case_parameters(case)
        self._limits = np.ceil(np.asarray(self._number("scenario.time_limit")) / loop.law.dt)
        self.steps = int(np.max(self._limits))
        self.state, self.parameters = self._states(), self._parameters()

    def _number(self, name: str) -> Columns:
        # (n,) if the runs differ in the parameter, otherwise a scalar
        return np.asarray(self.values.get(name, self._known[name].value), dtype=float)

    def _actual(self, name: str) -> Columns:
        # of the simulated vehicle
        if f"plant.{name}" in self.values:
            return self.values[f"plant.{name}"]
        return self._number(f"vehicle.{name}")

    def _believed(self, name: str) -> Columns:
        # in the controller's model
        model = self.case.model or self.case.vehicle
        return np.asarray(self.values.get(f"vehicle.{name}", model[name]), dtype=float)

    def _states(self) -> Columns:
        layout, case = self.loop.state, self.case
        first = layout.pack(
            {
                "plant": plant_state(case.vehicle.form).pack({"eta": case.scenario.start_pose}),
                **({"law": self.loop.law.initial_state()} if "law" in layout else {}),
            }
        )
        out = np.tile(first, (len(self.seeds), 1))
        out[:, layout.slice("plant").start + 2] = self._number("scenario.depth")
        if "noise" in layout:
            out[:, layout.slice("noise")] = noise_states(self.seeds)
        return out

    def _parameters(self) -> Columns:
        layout = self.loop.parameters
        out = np.empty((len(self.seeds), layout.size))
        self._law(out[:, : self.loop.law.gains.size])
        if self.loop.structure.points:
            scenario = self.case.scenario
            check_spacing(scenario, cap=float(np.max(self._number("scenario.cap"))))
            table = scenario.path.table(visits=scenario.corners == "visit")
            rows = np.minimum(np.arange(self.loop.structure.points), len(table) - 1)  # the last one fills the rest
            out[:, layout.slice("mission")] = table[rows].ravel()
        for name, columns in self._world().items():
            here = layout.slice(name)
            for k, column in enumerate(columns):
                out[:, here.start + k] = column
        return out

    def _law(self, out: Columns) -> None:
        case, layout = self.case, self.loop.law.gains
        model = case.model or case.vehicle
        out[:] = law_numbers(case.scenario, case.gains, model)
        for name in case.gains.specs:
            out[:, layout.slice(name).start] = self._number(name)
        for name in ("depth", "cruise", "cap"):
            out[:, layout.slice(name).start] = self._number(f"scenario.{name}")
        if case.scenario.visit is not None:
            out[:, layout.slice("visit").start] = VISITED * self._number("scenario.arrival_radius")
        for vector, members in _VECTORS.items():
            for k, member in enumerate(members):
                column, reverse = self._believed(member), member.replace("_max", "_reverse")
                if vector == "thrust_limit" and reverse in model.parameters:
                    column = np.minimum(column, self._believed(reverse))  # as in Vehicle.thrust_limit
                if vector == "linear_drag":
                    for name in [name for axis, name in model.form.ahead() if axis == k]:
                        column = column + self._believed(name) * self._number("scenario.cruise")  # as Vehicle.drag_at
                if member == "Fr_max":
                    column = column * self._grown(model)
                out[:, layout.slice(vector).start + k] = column
        out[:, layout.slice("hull").start] = self._believed("radius")
        if "ahead_limit" in layout:
            out[:, layout.slice("ahead_limit").start] = self._believed("Fu_max")  # as in Vehicle.ahead_limit

    def _grown(self, vehicle: Vehicle) -> Columns:
        # yaw moment at the cruise speed over that of the vehicle file, as in Vehicle.at_speed
        if vehicle.actuators is None or not vehicle.actuators.fins:
            return np.ones(())
        speeds, back = np.unique(self._number("scenario.cruise"), return_inverse=True)
        return np.array([vehicle.at_speed(u)["Fr_max"] / vehicle["Fr_max"] for u in speeds.tolist()])[back]

    def _world(self) -> dict[str, Sequence[ArrayLike]]:
        # the numbers of each entry that the law's parameters do not have: each is (n,), or a number if all runs agree
        scenario, structure, draws, number = self.case.scenario, self.loop.structure, self._draws(), self._number
        plant: dict[str, list[ArrayLike]] = {v: [self._actual(m) for m in members] for v, members in _VECTORS.items()}
        most = self.case.vehicle.delivered_limit
        for axis in np.flatnonzero(most > self.case.vehicle.thrust_range[1]).tolist():  # fins act on it
            plant["thrust_limit"][axis] = most[axis]
        plant["thrust_lag"] = [self._actual("thrust_lag")]
        plant["terms"] = [self._actual(name) for name in structure.form.terms]
        leg = scenario.target - scenario.path.waypoints[-2]
        grown = [*([np.ones(())] * 3), self._grown(self.case.vehicle)]
        arrival, bias = number("scenario.arrival_radius"), number("scenario.thrust_bias")
        columns: dict[str, Sequence[ArrayLike]] = {
            "plant": [column for port in plant_layout(structure.form) for column in plant[port.name]],
            "world_hull": [self._actual("radius")],
            "arrival_radius": [arrival],
            "legs": [len(scenario.path.waypoints) - 1],
            "visited": [0.0 if scenario.visit is None else arrival],
            "steps": [self._limits],
            "leg": list(leg / np.linalg.norm(leg)),
            "current": [number("scenario.current_x"), number("scenario.current_y")],
            "wave": self._swing("scenario.wave", draws.wave_direction, draws.wave_phase, amplitude="_force"),
            "drift": self._swing("scenario.drift", draws.slow_direction, draws.slow_phase, amplitude="_force"),
            "thrust_gain": [1 + number("scenario.thrust_error") * draws.gain_error[:, k] for k in range(4)],
            "thrust_bias": [
                bias * draws.bias[:, k] * self._actual(name) * grown[k]
                for k, name in enumerate(_VECTORS["thrust_limit"])
            ],
        }
        if structure.may_fail:
            columns["fault_chances"] = [number(f"sonar.{kind}") for kind in FaultChances.kinds()]
        if structure.draws_echoes:
            columns["echo_key"] = list(echo_keys(self.seeds).T)
            columns["echo_numbers"] = [float(echo_number(o.name)) for o in scenario.obstacles]
        if structure.faults:
            slots = fault_slots(structure.equipment.array, scenario.sensors.faults, structure.faults)
            columns["fault_slots"] = slots.ravel().tolist()
        if self.case.vehicle.actuators is not None and WORKING in self.loop.parameters:
            columns[WORKING] = working_flags(self.case.vehicle.actuators, self.case.failed).tolist()
        if structure.optional:
            columns["there"] = [number(f"obstacle.{o.name}.there") for o in scenario.obstacles]
        if structure.heights:
            ends = [(o.heights.bottom, o.heights.top) for o in scenario.obstacles]
            columns["heights"] = np.clip(np.ravel(ends), -NO_END, NO_END).tolist()
        if structure.points:
            columns["alignment"] = [0.0] * self.loop.parameters.port("alignment").size
        if structure.depths:
            columns["depths"] = scenario.depths or ()
        return columns | {f"body{k}": self._body(k, draws) for k in range(len(structure.bodies))}

    def _body(self, k: int, draws: WorldDraw) -> list[ArrayLike]:
        # the numbers of obstacle k that `body_at` needs
        obstacle, kind = self.case.scenario.obstacles[k], self.loop.structure.bodies[k]
        name = f"obstacle.{obstacle.name}"
        x, y, *others = (self._number(f"{name}.{end}") for end in ("x", "y", *_BODY[kind]))
        if kind != "mover":
            drift = self._swing(f"{name}.drift", draws.drift_direction[:, k], draws.drift_phase[:, k])
            return [x, y, *others, *(drift if kind.startswith("drifting") else ())]
        radius, to_x, to_y, speed = others
        if obstacle.radius_m is None and f"{name}.radius" not in self.values:
            radius = self._actual("radius")
        displacement = np.stack(np.broadcast_arrays(to_x - x, to_y - y))
        distance = np.hypot(*displacement)
        unit = displacement / np.where(distance > 0, distance, 1.0)
        return [x, y, radius, *unit, distance, speed, float(not obstacle.removed)]

    def _swing(self, name: str, direction: Columns, phase: ArrayLike, *, amplitude: str = "") -> list[ArrayLike]:
        # of a sinusoidal motion or force: amplitude along x and y of {E}, rate [rad/s], phase [rad]
        size, rate = self._number(f"{name}{amplitude}"), 2 * np.pi / self._number(f"{name}_period")
        return [size * direction[:, 0], size * direction[:, 1], rate, phase]

    def _draws(self) -> WorldDraw:
        unique, back = np.unique(self.seeds, return_inverse=True)
        draws = [vars(draw_world(len(self.case.scenario.obstacles), seed=int(seed))) for seed in unique]
        parts: dict[str, Any] = {name: np.array([draw[name] for draw in draws])[back] for name in draws[0]}
        return WorldDraw(**parts)


_FURTHER = (
    *(f"surctl.{name}" for name in ("files", "own_code", "units")),
    *(f"surctl.marine.{name}" for name in ("allocation", "simulation", "world")),
)
"""Packages besides `LAW_SOURCES` whose source code determines the programs of a closed loop."""


def loop_sources() -> str:
    """Return a digest of the source code that determines the programs of a closed loop; raises as `source_digest`."""
    return source_digest(*LAW_SOURCES) + source_digest(*_FURTHER)


class StoredLoop(NamedTuple):
    """Digest of the step of a closed loop for many runs, and the C text that `compile_batch_source` compiles."""

    digest: str
    source: str


@cache
def stored_loop(structure: Structure) -> StoredLoop:
    """Return the digest and the C text of a loop, from the cache on disk if a process with this source code stored it.

    A loop with a law of the user's own is built again in every process, because the modules that its file imports may
    have changed. So is a loop with thrusters, whose numbers have no exact text.
    """
    if is_own(structure.law) or structure.actuators is not None:
        return _built(structure)
    try:
        sources = loop_sources()
    except SurctlError:  # the source code is missing or changed since the import, so it cannot identify a cached loop
        return _built(structure)
    key = hashlib.sha256(f"{sources}\0{structure!r}".encode()).hexdigest()
    stored = cached_bytes(key, ".loop", lambda: "\n".join(_built(structure)).encode())
    return StoredLoop(*stored.decode().split("\n", 1))


def _built(structure: Structure) -> StoredLoop:
    step = build_loop(structure).step
    return StoredLoop(step.digest(), batch_source(fused(without_libm(step))))


@dataclass(frozen=True, eq=False)
class BatchResult:
    """Metrics of n runs: `table` (n, len(METRICS)), and the engine that simulated them, `c` or `vm`."""

    table: Columns = field(repr=False)
    engine: Engine

    @property
    def runs(self) -> int:
        """Number of runs n."""
        return len(self.table)

    def column(self, name: str) -> Columns:
        """Return the values (n,) of one metric; if the name is unknown, InputError suggests the most similar name."""
        check_known(name, METRICS, "no such metric", key="metric")
        return self.table[:, list(METRICS).index(name)]


def simulate_batch(
    case: Case,
    values: Mapping[str, ArrayLike] | None = None,
    *,
    seeds: ArrayLike = 0,
    threads: int = 1,
    engine: Engine = "auto",
) -> BatchResult:
    """Simulate one run for each set of parameter values with its seed; a single value or seed holds for all runs.

    The result of a run depends only on its own parameter values and seed, not on `threads` or the other runs. The
    metrics equal those of `simulate` with the same setup and seed, except for the last digits. A run that starts inside
    an obstacle counts as a collision at its start.

    Args:
        values: parameter values by name, see `parameters`: an array (n,) or one number for all runs.
        engine: `c`, `vm` or `auto`, see `surctl.system.runs.final_states`.

    Raises:
        InputError: a parameter or the engine is unknown, a value is out of bounds, a seed is negative, or the shapes
            do not match.
        ToolMissing: the engine is `c`, but there is no compiler.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import Case, load_scenario, simulate_batch
        >>> from surctl.marine.vehicle import load_vehicle
        >>> case = Case(load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default"), law="closed_form")
        >>> runs = simulate_batch(case, {"k_v": [1.0, 1.5, 2.0]}, seeds=7, engine="vm")
        >>> runs.column("time_s").round(2).tolist(), runs.column("min_clearance_m").round(3).tolist()
        ([21.3, 20.35, 20.05], [0.093, 0.096, 0.097])
    """
    columns, run_seeds = broadcast(values or {}, seeds)
    check_values(case, columns)
    loop = build_loop(structure_of(case, columns))
    if len(run_seeds) == 0:
        return BatchResult(np.empty((0, len(METRICS))), "c" if engine == "c" else "vm")
    packed = Packed(case, loop, columns, run_seeds)
    final, used = final_states(
        packed.state, packed.parameters, steps=packed.steps, compiled=lambda: compiled_loop(loop.structure),
        machine=lambda: _machine(loop.structure), engine=engine, threads=threads,
    )  # fmt: skip
    return BatchResult(metrics_table(loop.law, loop.state, final), used)


@cache
def compiled_loop(structure: Structure) -> Batch:
    """Return the compiled loop of a loop structure, compiled now or from the cache of compiled loops.

    Raises:
        ToolMissing: there is no C compiler.
    """
    return compile_batch_source(stored_loop(structure).source)


@cache
def _machine(structure: Structure) -> Any:
    return to_casadi(build_loop(structure).step)


def broadcast(values: Mapping[str, ArrayLike], seeds: ArrayLike) -> tuple[dict[str, Columns], NDArray[np.int64]]:
    """Return values and seeds as arrays (n,) for n runs; raise InputError if they do not match."""
    try:
        arrays = {name: np.asarray(value, dtype=float) for name, value in values.items()}
    except (TypeError, ValueError):
        raise InputError("must be numbers", key="values", value=sorted(values)) from None
    seed = np.asarray(seeds)
    whole = seed.dtype.kind in "iu" or (seed.dtype.kind == "f" and bool(np.all(seed == np.floor(seed))))
    if not whole or np.any(seed < 0):
        raise InputError("must be whole numbers, at least 0", key="seeds", value=seed.ravel()[:3].tolist())
    try:
        shape = np.broadcast_shapes(seed.shape, *(v.shape for v in arrays.values()))
    except ValueError:
        shape = (0, 0)
    if len(shape) > 1:
        sizes = {name: v.shape for name, v in arrays.items()}
        raise InputError("do not match", key="values, seeds", value=sizes, remedy="give arrays (n,) or numbers")
    n = shape[0] if shape else 1
    spread = {name: np.broadcast_to(v, (n,)) for name, v in arrays.items()}
    return spread, np.broadcast_to(seed, (n,)).astype(np.int64)


_TOGETHER = 64  # runs whose signals are in memory at once


@dataclass(frozen=True, eq=False)
class Trace:
    """Signals of one run at its n control steps.

    Attributes:
        plant: (n, …) state of the plant, see `plant_state`: first η (4,), then ν (4,).
        law: (n, nx) state of the law.
        tau: (n, 4) commanded thrust [N, N m].
    """

    plant: Columns
    law: Columns
    tau: Columns


def trace_batch(case: Case, values: Mapping[str, ArrayLike]) -> Iterator[Trace]:
    """Simulate runs as `simulate_batch` does and yield the signals of each run, without its last control step.

    Raises:
        InputError, ToolMissing: as for `simulate_batch`.
    """
    columns, run_seeds = broadcast(values, 0)
    check_values(case, columns)
    loop = build_loop(structure_of(case, columns))
    compiled = compiled_loop(loop.structure)
    slices = [loop.state.slice(name) for name in ("plant", "law", "last_thrust")]
    for first in range(0, len(run_seeds), _TOGETHER):
        some = slice(first, first + _TOGETHER)
        packed = Packed(case, loop, {name: column[some] for name, column in columns.items()}, run_seeds[some])
        state, steps = packed.state, [packed.state]
        while len(steps) <= packed.steps and not state[:, 0].all():
            state = compiled.run(state, packed.parameters, steps=1)  # one thread: to start more takes longer
            steps.append(state)
        done = np.stack([step[:, 0] for step in steps], axis=1) != 0
        plant, law, tau = (np.stack([step[:, here] for step in steps], axis=1) for here in slices)
        for run, count in enumerate((~done[:, 1:]).sum(axis=1)):
            yield Trace(plant[run, :count], law[run, :count], tau[run, 1 : count + 1])
