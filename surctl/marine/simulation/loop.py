"""One run, step by step with the programs of the compiled loop: other law or physics, failed thrusters, lost link.

The law runs every 50 ms and sonars fire every 25 ms. Between firings, the physics of the run (`Physics`) moves the
hull; surctl's own plant is integrated by RK4 with steps of 10 ms. Law, thrusters and physics may be replaced.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, SurctlError, nearest
from surctl.ir import on_vectors, to_casadi
from surctl.ir.cache import cached_bytes
from surctl.marine.control import NONFINITE, WORKING, Gains, Law, check_forces, law_options
from surctl.marine.guidance import ROW
from surctl.marine.simulation.batch.case import Case, vehicle_law
from surctl.marine.simulation.batch.engines import Packed, loop_sources, structure_of
from surctl.marine.simulation.batch.loop import Loop, loop_of
from surctl.marine.simulation.batch.structure import ROWS, Structure
from surctl.marine.simulation.metrics import (
    ABSENT,
    GONE,
    LINK_LOST,
    METRICS,
    STOPPED_LIMIT,
    STOPS,
    Metrics,
    metrics_table,
)
from surctl.marine.simulation.physics import Contact, OwnPhysics, PhysicsMaker, advanced
from surctl.marine.simulation.run import SENSING, Record, Run, Sensing
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.sensors import FIRING, firing_plan
from surctl.marine.simulation.thruster_faults import ThrusterFault, Thrusters
from surctl.marine.simulation.world import World, build_world
from surctl.marine.vehicle import Vehicle
from surctl.system import ControllerStep

Vector: TypeAlias = NDArray[np.float64]
Values: TypeAlias = dict[str, Vector]


Stepper: TypeAlias = Callable[[Vector, Vector, Vector], ControllerStep]
"""What takes the place of a law in a run, such as its C in another process: a step from state x, inputs u, gains p."""


def simulate(
    scenario: Scenario,
    vehicle: Vehicle,
    *,
    gains: Gains,
    law: Law | None = None,
    sensing: Sensing | str = "truth",
    seed: int = 0,
    model: Vehicle | None = None,
    stepper: Stepper | None = None,
    thruster_faults: Sequence[ThrusterFault] = (),
    physics: PhysicsMaker = OwnPhysics,
    watch: Callable[[float], object] = lambda _: None,
) -> Run:
    """Simulate one scenario and return the run.

    Args:
        scenario: the mission.
        law: the law; default: `vehicle_law`, with sonars if `sensing` is `sonar`. A law without allocation commands a
            force on each axis, which the simulation then allocates to the vehicle's thrusters.
        sensing: `truth`: the law receives the exact positions of all obstacles and its exact pose; `sonar`: the law
            receives the echoes of its sonars, and noisy measurements of the moving obstacles and of its pose.
        model: vehicle model of the controller; default: the simulated vehicle.
        stepper: function that replaces the law, for instance by a program in another process or precision; from the
            law's state x, inputs u and parameters p it returns a control step.
        thruster_faults: failures of thrusters, which the law knows as soon as they begin.
        physics: makes what moves the hull and measures distances; default: surctl's own plant.
        watch: function that receives the simulated time [s] before each control step.

    Raises:
        InputError: `sensing` is unknown or does not fit the law, or the hull starts inside an obstacle.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=load_gains("default"))
        >>> run.metrics.stopped_because, round(run.metrics.time_s, 2), round(run.metrics.min_clearance_m, 2)
        ('reached', 11.35, 0.08)
    """
    if sensing not in SENSING:
        raise InputError("is not known", key="sensing", value=sensing, remedy=nearest(str(sensing), SENSING))
    sonar = sensing == "sonar"
    law = law or vehicle_law(vehicle, scenario=scenario, sonar=sonar)
    check_forces(law.ref, vehicle)
    thrusters = Thrusters.of(vehicle, law, thruster_faults)
    if sonar != ("samples" in law.inputs):
        problem = "does not fit a law that uses " + ("no sonars" if sonar else "sonars")
        raise InputError(problem, key="sensing", value=sensing, remedy="build the law with sonar=" + str(sonar))
    if abs(law.dt - 2 * FIRING) > 1e-9:
        raise InputError("is not two firing periods of the sonars", key="dt", value=law.dt, remedy="use 0.05")
    world = build_world(scenario, vehicle, seed=seed)
    array = scenario.sensors.array_on(world.hull)
    other = None if physics is OwnPhysics else physics(world, vehicle, array)
    case = Case(scenario, vehicle, gains, law.ref, sensing=sensing, model=model, **law_options(law))
    run = SingleRun(case, law, seed=seed, measured=other is not None)
    firings = firing_plan(array)
    rows, fed, gone, before = list[tuple[object, ...]](), list[Vector](), 0, tuple[Contact, ...]()

    def measured(time: float, instant: int) -> Values:
        # what another physics measures in the present state
        assert other is not None
        bodies, far = world.bodies(time), 2.0 * array.maximum
        listens = firings.sensors[instant % firings.period] if sonar else ()
        echoes = [far if sensor is None else min(other.echo(sensor, bodies), far) for sensor in listens]
        return {"echo": np.array(echoes), "clearance": np.array(other.clearance(bodies))}

    for index in range(run.steps):
        time = index * law.dt
        watch(time)
        if WORKING in law.inputs:
            run.part(WORKING)[:] = thrusters.working(time)
        ranges = measured(time, 2 * index) if other is not None else {}
        values = run.sense(ranges)
        step = (stepper or law.step)(values["x"], values["u"], values["p"])
        state = run.plant if other is None else other.state
        clearance = values["clearance"].min()
        rows.append((time, state, step.tau, clearance, values["x"], values["u"], step.status, step.telemetry))
        fed.append(values["p"])
        thrust, components = run.thrust(step, thrusters, time, state)
        if other is None:
            run.move(values, thrust)
        else:
            before = tuple(other.contacts)
            values["plant_between"] = run.padded(other.advance(thrust, time, components))
            values |= measured(time + FIRING, 2 * index + 1)
            between = values.pop("clearance")
            values |= run.call["between"](values) | {"clearance": ranges["clearance"], "clearance_between": between}
            values["plant_next"] = run.padded(other.advance(thrust, time + FIRING, components))
        gone += step.status == GONE
        if gone >= round(STOPPED_LIMIT / law.dt):
            run.part("steps")[:] = index + 1
        run.close(values, step)
        if run.state[0] > 0:
            break
    stop = STOPS[int(run.state[run.loop.state.slice("stop")][0])]
    reason = LINK_LOST if gone and stop == "time limit" else stop
    # without those of the period after the last one
    contacts = before if other is None or stop != "time limit" else tuple(other.contacts)
    return Run(
        scenario, vehicle, run.gains, law, sensing, seed, run.metrics(reason), _record(world, run, rows, fed),
        stepper is not None, OwnPhysics.name if other is None else other.name, contacts,
    )  # fmt: skip


def simulate_case(
    case: Case, *, seed: int = 0, draw: Mapping[str, float] | None = None, law: Law | None = None, **options: Any
) -> Run:
    """Simulate a case by `simulate` with its further `options`.

    `draw` are parameters in which the simulated vehicle differs from that of the case, in its file's units; the law has
    the model of the case. `law` is the law of the case, if it was built before.
    """
    vehicle, law = case.vehicle.with_values(draw) if draw else case.vehicle, law or case.build()
    about: dict[str, Any] = {"gains": case.gains, "sensing": case.sensing, "model": case.model or case.vehicle}
    return simulate(case.scenario, vehicle, law=law, seed=seed, **about, **options)


def _record(world: World, run: SingleRun, rows: Sequence[tuple[object, ...]], fed: Sequence[Vector]) -> Record:
    time, state, tau, clearance, x, u, status, telemetry = zip(*rows, strict=True)
    states, clear = np.array(state), np.array(clearance)
    return Record(
        np.array(time),
        states[:, :4],
        states[:, 4:8],
        np.array(tau),
        np.where(clear < 0.5 * ABSENT, clear, np.inf),
        np.array(x),
        np.array(u),
        run.law_parameters,
        np.array(status),
        np.array(telemetry),
        [world.bodies(at) for at in time],
        np.array(fed) if run.fed else None,
        states[:, 12:14] if states.shape[1] > 12 else None,
    )


_Program: TypeAlias = Callable[[Mapping[str, Vector]], Values]


def _program(inputs: Sequence[str], outputs: Sequence[str], function: str) -> _Program:
    # a program of the loop as a function of arrays by name
    run = on_vectors(ca.Function.deserialize(function))
    return lambda values: dict(zip(outputs, run(*(values[name] for name in inputs)), strict=True))


@cache
def _programs(structure: Structure, law: Law, *, measured: bool) -> tuple[Loop, dict[str, _Program]]:
    """Return the loop of single runs and its programs, from the cache on disk if they are there."""
    loop = loop_of(structure, law, single=True)

    def build() -> bytes:
        blocks = loop.calls(measured=measured)
        stored = {
            name: ([n for n, _ in block.inputs], [n for n, _ in block.outputs], to_casadi(block).expand().serialize())
            for name, block in blocks.items()
        }
        return json.dumps(stored).encode()

    try:
        layouts = [tuple(layout) for layout in (loop.state, loop.parameters, law.inputs, law.outputs, law.state)]
        text = f"{loop_sources()}\0{structure!r}\0{layouts!r}\0{law.dt}\0{law.perception is None}\0{measured}"
        stored = cached_bytes(hashlib.sha256(text.encode()).hexdigest(), ".single", build)
    except SurctlError:  # the source code is missing or changed since the import, so it cannot identify stored programs
        stored = build()
    return loop, {name: _program(*parts) for name, parts in json.loads(stored).items()}


class SingleRun:
    """One run of the mission loop, stepped from outside; with `measured`, another physics measures the distances."""

    def __init__(self, case: Case, law: Law, *, seed: int, measured: bool = False) -> None:
        # the thrusters are no part of these programs
        structure = replace(structure_of(case, {}), actuators=None)
        self.loop, self.call = _programs(structure, law, measured=measured)
        packed = Packed(case, self.loop, {}, np.array([seed]))
        self.gains = case.gains
        self.law, self.state, self.parameters = law, packed.state[0], packed.parameters[0]
        self.law_state, self.steps = law.initial_state(), packed.steps
        self.fed = structure.points > 0
        self._gain, self._bias, self._current = map(self.part, ("thrust_gain", "thrust_bias", "current"))
        self.law_parameters = self.parameters[: law.gains.size].copy()
        self._move, self._plant = advanced(structure.form), self.part("plant")

    def part(self, name: str) -> Vector:
        """Return an entry of the parameters as a view."""
        part: Vector = self.parameters[self.loop.parameters.slice(name)]
        return part

    def sense(self, measured: Mapping[str, Vector] | None = None) -> Values:
        """Return what a control period begins with: the law's state x, its inputs u, its parameters p, and the rest."""
        values: Values = {"s": self.state, "w": self.parameters, "x": self.law_state, "law_state": self.law_state}
        if not self.fed:
            values["p"] = self.parameters[: self.law.gains.size]
        else:
            places = self.call["places"](values)
            for name in ROWS:
                at = ROW * int(places[f"at_{name}"][0])
                values[name] = self.parameters[at : at + ROW]
            values |= self.call["feed"](values)
        more = dict(measured or {})
        return values | self.call["sense"](values | more) | more

    @property
    def plant(self) -> Vector:
        """State of the plant."""
        plant: Vector = self.state[self.loop.state.slice("plant")]
        return plant

    def padded(self, plant: Vector) -> Vector:
        """Return the state of another physics with the size of the plant's own: a hull that does not tilt has less."""
        return np.concatenate([plant, np.zeros(len(self.plant) - len(plant))])

    def metrics(self, reason: str) -> Metrics:
        """Return the metrics of the run, which ended for a reason."""
        [values] = metrics_table(self.loop.law, self.loop.state, self.state[None]).tolist()
        row = dict(zip(METRICS, values, strict=True))
        row["stopped_because"], row["reached"] = reason, row["reached"] > 0.5
        del row["collided"], row["stopped"]
        return Metrics(**row)

    def at(self, plant: Vector, index: int, *, p: Vector | None = None) -> Values:
        """Return what a control period begins with at a state of the plant and a number of the period.

        `p` are other parameters of the law. This is for true positions and for paths that are not fed.
        """
        layout = self.loop.state
        self.state[layout.slice("plant")], self.state[layout.slice("step")] = plant, index
        if p is not None:
            self.parameters[: len(p)] = p
        return self.sense()

    def thrust(self, step: ControllerStep, thrusters: Thrusters, time: float, plant: Vector) -> tuple[Vector, Vector]:
        """Return the thrust (4,) with the errors of the scenario, and the force components of the thrusters (N,)."""
        shown = None if step.status < 0 else step.telemetry  # a step without command repeats an older telemetry
        speed = float(plant[4] - (np.cos(plant[3]) * self._current[0] + np.sin(plant[3]) * self._current[1]))
        delivered, components = thrusters.achieved(step.tau, time, telemetry=shown, speed=speed)
        return delivered * self._gain + self._bias, components

    def move(self, values: Values, thrust: Vector) -> None:
        """Move surctl's own plant through the control period, and sense in its middle; the results join `values`."""
        values["plant_between"] = self._move(values["plant"], thrust, values["d0"], self._plant)[0]
        values |= self.call["between"](values)
        values["plant_next"] = self._move(values["plant_between"], thrust, values["d1"], self._plant)[0]

    def close(self, values: Values, step: ControllerStep) -> None:
        """End the control period: the next state of the run and of its law."""
        values["total"] = np.array([np.nan if step.status == NONFINITE else 0.0])
        values |= {"tau": step.tau, "telemetry": step.telemetry, "status": np.array([float(step.status)])}
        self.state, self.law_state = self.call["close"](values)["s_next"], step.x_next
