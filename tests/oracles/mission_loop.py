"""The closed loop of a mission, written in NumPy independently of the compiled loop; noise from a seed.

The law runs every 50 ms and sonars fire every 25 ms. Between firings, the physics of the run (`Physics`) moves the
hull; surctl's own plant is integrated by RK4 with steps of 10 ms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.marine.control import (
    CONTACT_SLOTS,
    NONFINITE,
    WORKING,
    Gains,
    Law,
    build_law,
    check_forces,
    default_law,
    law_source,
)
from surctl.marine.sensing import OwnState, SonarArray
from surctl.marine.sensing.sonar.returns import echo_keys, echo_number
from surctl.marine.simulation.batch.case import law_numbers
from surctl.marine.simulation.loop import Stepper
from surctl.marine.simulation.metrics import GONE, LINK_LOST, STANDSTILL, STOPPED_LIMIT
from surctl.marine.simulation.physics import OwnPhysics, PhysicsMaker
from surctl.marine.simulation.run import SENSING, Record, Run, Sensing
from surctl.marine.simulation.scenario import Scenario, check_spacing
from surctl.marine.simulation.sensors import FIRING, firing_plan
from surctl.marine.simulation.thruster_faults import ThrusterFault, Thrusters
from surctl.marine.simulation.world import FOOTPRINT, LONGEST, Body, World, beside, build_world
from surctl.marine.vehicle import Vehicle
from surctl.marine.world import Disc
from surctl.system import ControllerStep
from tests.oracles.echoes import (
    certain_range,
    corner_points,
    echo_uniform,
    fault_state,
    faulty,
    firing_block,
    true_range,
    weak_range,
)
from tests.oracles.measurements import delayed, fix, imu, measure, message, observe
from tests.oracles.mission_window import Feeder
from tests.oracles.noise_stream import NoiseStream
from tests.oracles.path_follower import PlainFollower
from tests.oracles.run_metrics import measure as metrics_of

__all__ = ["Loop", "WeakEchoes", "certain_echo", "column", "feeder_of", "simulate"]


class WeakEchoes:
    """The weak echoes of one run; every firing has its own random numbers, independent of all other firings.

    Args:
        world: the world of the run.
        array: the sonars on the hull.
        seed: seed of the run.
    """

    def __init__(self, world: World, array: SonarArray, *, seed: int) -> None:
        scenario = world.scenario
        surfaces = scenario.surfaces
        self._hull, self._array, self._key = world.hull, array, echo_keys([seed])[0]
        self._known = {}
        self._corners: list[tuple[float, float]] = []
        if surfaces is not None:
            names = [obstacle.name for obstacle in scenario.obstacles]
            pairs = zip(names, surfaces.obstacles, strict=True)
            self._known = {name: (echo_number(name), reflector) for name, reflector in pairs}
            self._corners = corner_points(scenario.walls, surfaces)
        self._any = surfaces is not None and (surfaces.weak or bool(self._corners))

    def nearest(self, sensor: int, state: NDArray[np.float64], bodies: Sequence[Body], *, instant: int) -> float:
        """Return the distance [m] from a sensor's apex to the nearest detected weak echo; inf if there is none.

        Args:
            sensor: index of the sensor that fires.
            state: state of the plant, which begins with x, y, z [m] and ψ [rad].
            bodies: the obstacles that are in the water.
            instant: number of the firing instant.
        """
        if not self._any:
            return inf
        block = firing_block(self._key, instant, sensor)
        audible = [(self._known[body.name], body.shape) for body in beside(bodies, float(state[2]), self._hull)]
        return weak_range(
            self._array,
            sensor,
            position=state[:2],
            heading=float(state[3]),
            bodies=[(number, shape, reflector) for (number, reflector), shape in audible],
            corners=self._corners,
            uniform=lambda echo: echo_uniform(self._key, block, echo),
        )


Vector: TypeAlias = NDArray[np.float64]


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
    """Return the run that `surctl.marine.simulation.simulate` returns for these arguments."""
    if sensing not in SENSING:
        raise InputError("is not known", key="sensing", value=sensing, remedy=nearest(str(sensing), SENSING))
    sonar = sensing == "sonar"
    law = law or build_law(
        default_law(vehicle),
        sonar=sonar,
        equipment=scenario.sensors.on(vehicle["radius"]),
        depths=scenario.depths is not None,
        actuators=vehicle.actuators,
    )
    check_forces(law.ref, vehicle)
    thrusters = Thrusters.of(vehicle, law, thruster_faults)
    if sonar != ("samples" in law.inputs):
        raise InputError(
            "does not fit a law that uses " + ("no sonars" if sonar else "sonars"),
            key="sensing",
            value=sensing,
            remedy="build the law with sonar=" + str(sonar),
        )
    if abs(law.dt / FIRING - round(law.dt / FIRING)) > 1e-9 or law.dt < FIRING:
        problem = f"is not a multiple of the sonar's firing period of {FIRING:g} s"
        raise InputError(problem, key="dt", value=law.dt, remedy="use 0.05")
    world = build_world(scenario, vehicle, seed=seed)
    gains = gains.with_own(law_source(law.ref).gains)
    p = law_numbers(scenario, gains, model or vehicle)
    loop = Loop(world, vehicle, law, p, sensing, NoiseStream(seed), stepper or law.step, thrusters, physics, seed)
    reason, record = loop.run(watch), loop.record()
    metrics = metrics_of(scenario, law, record, reason=reason, least=loop.least)
    plant = loop.physics
    return Run(
        scenario, vehicle, gains, law, sensing, seed, metrics, record, stepper is not None, plant.name,
        tuple(plant.contacts),
    )  # fmt: skip


class _StepNoise(NamedTuple):
    """The random numbers of one control step.

    Normally distributed numbers: (instants, k, samples) for the k sonars that fire at each firing instant; (6,) for
    position measurement and IMU; (slots, 4) for the obstacles in a message of the base station; one number for the loss
    of the message. Uniformly distributed numbers: (instants, k, 2) for faults of the sonars.
    """

    samples: NDArray[np.float64]
    uniforms: NDArray[np.float64]
    own_state: NDArray[np.float64]
    movers: NDArray[np.float64]
    loss: float


class Loop:
    """The state of a run while it is simulated."""

    def __init__(
        self,
        world: World,
        vehicle: Vehicle,
        law: Law,
        p: NDArray[np.float64],
        sensing: Sensing,
        noise: NoiseStream,
        stepper: Stepper,
        thrusters: Thrusters | None = None,
        physics: PhysicsMaker = OwnPhysics,
        seed: int = 0,
    ) -> None:
        self.stepper = stepper
        self.thrusters = thrusters or Thrusters.of(vehicle, law)
        self.world, self.law, self.p, self.sensing, self.noise = world, law, p, sensing, noise
        self.limit = vehicle.at_speed(world.scenario.cruise).thrust_range[1]
        self.sensors = world.scenario.sensors
        self.station = self.sensors.equipment.station
        self.array = self.sensors.array_on(world.hull)
        self.firings = firing_plan(self.array)
        self.physics = physics(world, vehicle, self.array)
        self.weak = WeakEchoes(world, self.array, seed=seed)
        self.state = self.physics.state
        self.law_state = law.initial_state()
        self.feeder = feeder_of(world.scenario, law, p)
        self.fed: list[Vector] = []
        self.faults = fault_state(self.array)
        self.fresh = np.zeros(self.array.size)
        self.instant = 0
        self.movers = [o.name for o in world.scenario.obstacles if o.shape == "moving"]
        self.slots = min(CONTACT_SLOTS, len(self.movers))
        own = self.sensors.equipment.own
        self.places = np.tile(self.state[:3], (own.fixes.late(law.dt) if own else 0, 1))
        self.messages = np.zeros((self.station.messages.late(law.dt), self.slots * 6))
        self.least = float("inf")
        self.clear_of_walls = False
        self.follower = PlainFollower(world.scenario.path, visit=world.scenario.visit)
        self.rows: list[tuple[object, ...]] = []

    def run(self, watch: Callable[[float], object] = lambda _: None) -> str:
        """Simulate the run to its end and return the reason why it ended; `watch` receives each time [s]."""
        scenario, dt, stopped, standing, gone = self.world.scenario, self.law.dt, 0, 0, 0
        for index in range(int(np.ceil(scenario.time_limit / dt))):
            time = index * dt
            watch(time)
            bodies = self.world.bodies(time)
            noise = self._draw()
            self._listen(bodies, noise, 0)
            clearance, free = self._clearance(bodies)
            u = self._inputs(bodies, noise, index)
            p = self._fed()
            step = self.stepper(self.law_state, u, p)
            self.rows.append(
                (time, self.state, step.tau, clearance, self.law_state, u, step.status, step.telemetry, bodies)
            )
            if free <= 0:
                return "collision"
            self.follower.move(*self.state[:2].tolist())
            if self.follower.last and self._left() <= scenario.arrival_radius:
                return "reached"
            if step.status == NONFINITE:
                return "fault"
            gone += step.status == GONE
            if gone >= round(STOPPED_LIMIT / dt):
                return LINK_LOST
            if self.law.perception is not None:
                stopped = stopped + 1 if step.telemetry[self.law.telemetry_slice("stopped")][0] > 0.5 else 0
            if stopped >= round(STOPPED_LIMIT / dt):
                return "standstill"
            if "trapped" in self.law.outputs:
                standing += int(step.telemetry[self.law.telemetry_slice("trapped")][0] > 0.5)
            if standing >= round(STANDSTILL / dt):
                return "dead end"
            self.law_state = step.x_next
            self._advance(time, step, noise)
        return LINK_LOST if gone else "time limit"

    def record(self) -> Record:
        """Return the recorded control steps as arrays."""
        time, state, tau, clearance, x, u, status, telemetry, bodies = zip(*self.rows, strict=True)
        states = np.array(state)
        return Record(
            np.array(time),
            states[:, :4],
            states[:, 4:8],
            np.array(tau),
            np.array(clearance),
            np.array(x),
            np.array(u),
            self.p,
            np.array(status),
            np.array(telemetry),
            bodies,
            np.array(self.fed) if self.feeder else None,
            states[:, 12:14] if states.shape[1] > 12 else None,
        )

    def _fed(self) -> Vector:
        if self.feeder is None:
            return self.p
        self.law_state, p = self.feeder.feed(self.law_state)
        self.fed.append(p)
        return p

    def _draw(self) -> _StepNoise:
        # in a fixed order: sonar firings, own state, then every moving obstacle
        instants, wide, size = round(self.law.dt / FIRING), len(self.firings.sensors[0]), self.array.samples
        firings = instants * wide * size
        # an even number, because the generator makes normal numbers in pairs
        count = firings + firings % 2 + 8 + 4 * self.slots
        listens = self.sensing == "sonar"
        numbers = self.noise.normals(count) if listens else np.zeros(count)
        chances = 2 * instants * wide
        may_fail = bool(self.sensors.faults) or any(self.sensors.chances.numbers)
        uniforms = self.noise.uniforms(chances) if listens and may_fail else np.full(chances, 0.5)
        samples, rest = numbers[:firings].reshape(instants, wide, size), numbers[firings + firings % 2 :]
        movers, own = rest[7:-1].reshape(self.slots, 4), rest[:6]
        return _StepNoise(samples, uniforms.reshape(instants, wide, 2), own, movers, float(rest[6]))

    def _advance(self, time: float, step: ControllerStep, noise: _StepNoise) -> None:
        psi, (east, north) = self.state[3], self.world.scenario.disturbance.current_m_per_s
        speed = float(self.state[4] - (np.cos(psi) * east + np.sin(psi) * north))
        shown = None if step.status < 0 else step.telemetry  # a step without command repeats an older telemetry
        achieved, components = self.thrusters.achieved(step.tau, time, telemetry=shown, speed=speed)
        thrust = self.world.thrust(achieved, self.limit)
        half = round(self.law.dt / FIRING)
        for k in range(half):
            self.state = self.physics.advance(thrust, time + k * FIRING, components)
            if k < half - 1:
                between = time + (k + 1) * FIRING
                bodies = self.world.bodies(between)
                self._listen(bodies, noise, k + 1)
                self._clearance(bodies)

    def _listen(self, bodies: Sequence[Body], noise: _StepNoise, instant: int) -> None:
        if self.sensing == "truth":
            return
        time = self.instant * FIRING
        for k, sensor in enumerate(self.firings.at(self.instant)):
            samples, self.faults = faulty(
                self.array,
                self.faults,
                sensor,
                time=time,
                distance=min(
                    self._echo(sensor, bodies),
                    self.weak.nearest(sensor, self.state, bodies, instant=self.instant),
                ),
                noise=noise.samples[instant, k],
                faults=self.sensors.faults,
                chances=self.sensors.chances,
                uniforms=noise.uniforms[instant, k],
            )
            if samples is not None:
                self.fresh[sensor] = 1.0
        self.instant += 1

    def _echo(self, sensor: int, bodies: Sequence[Body]) -> float:
        if isinstance(self.physics, OwnPhysics):
            return certain_echo(self.world, self.array, sensor, self.state, bodies)
        return self.physics.echo(sensor, bodies)

    def _left(self) -> float:
        # horizontal if the mission has only one depth
        scenario = self.world.scenario
        level = float(np.hypot(*(self.state[:2] - scenario.target)))
        if scenario.depths is None and scenario.path.rises is None:
            return level
        return float(np.hypot(level, self.state[2] - scenario.end_depth))

    def _clearance(self, bodies: Sequence[Body]) -> tuple[float, float]:
        # and the one that decides on a collision: without walls until the hull was clear of them
        clearance, wall = self.physics.clearance(bodies)
        self.clear_of_walls = self.clear_of_walls or wall > 0
        self.least = min(self.least, clearance, wall)
        return min(clearance, wall), min(clearance, wall) if self.clear_of_walls else clearance

    def _inputs(self, bodies: Sequence[Body], noise: _StepNoise, index: int) -> NDArray[np.float64]:
        eta, nu = self.state[:4], self.state[4:8]
        inputs: dict[str, object] = {"samples": self.faults.last, "fresh": self.fresh}
        if self.sensing == "truth":
            inputs |= {"eta": eta, "nu": nu, "contacts": self._all_contacts(beside(bodies, eta[2], self.world.hull))}
        else:
            inputs |= self._measurements(self._mover_rows(bodies), noise, index)
        inputs[WORKING] = self.thrusters.working(index * self.law.dt)
        inputs["column"] = column(self.world.scenario, bodies, eta[:3], self.world.hull)
        self.fresh = np.zeros(self.array.size)
        return self.law.inputs.pack({name: value for name, value in inputs.items() if name in self.law.inputs})

    def _measurements(self, rows: NDArray[np.float64], noise: _StepNoise, index: int) -> dict[str, object]:
        # camera, IMU and base station; without delay if the law has no perception
        eta, nu, own = self.state[:4], self.state[4:8], self.sensors.equipment.own
        contacts = np.zeros((CONTACT_SLOTS, 6))
        if self.law.perception is None:
            contacts[: self.slots] = rows
            observed = contacts[: self.slots]
            observed[:, :2], observed[:, 3:5] = observe(
                self.station, observed[:, :2], observed[:, 3:5], noise=noise.movers
            )
            observed[rows[:, 5] < 0.5] = 0.0
            pose, _ = measure(own or OwnState(position_sd=0.0, yaw_sd=0.0), eta, nu, noise=noise.own_state[:4])
            return {"eta": pose, "nu": nu, "contacts": contacts}
        then, self.messages = delayed(self.messages, rows.ravel())
        sent, arrived = message(
            self.station, then.reshape(-1, 6), index, noise=noise.movers, chance=noise.loss, dt=self.law.dt
        )
        contacts[: self.slots] = sent
        inputs: dict[str, object] = {"contacts": contacts, "contacts_fresh": arrived}
        if own is None:
            return {**inputs, "eta": eta, "nu": nu}
        place, self.places = delayed(self.places, self.state[:3])
        place, fresh = fix(own, place, index, noise=noise.own_state[:4], dt=self.law.dt)
        yaw, rate = imu(own, eta, nu, noise=noise.own_state[4:])
        return {**inputs, "fix": place, "fix_fresh": fresh, "yaw": yaw, "yaw_rate": rate}

    def _mover_rows(self, bodies: Sequence[Body]) -> NDArray[np.float64]:
        # zero for an absent obstacle; only the nearest obstacles if there are too many
        there = {b.name: b for b in bodies if b.moving}
        named = self.movers
        if len(named) > self.slots:
            near = {b.name: b.shape.nearest(self.state[:2])[0] for b in there.values()}
            chosen = sorted(named, key=lambda name: near.get(name, np.inf))[: self.slots]
            named = [name for name in named if name in chosen]
        rows = np.zeros((self.slots, 6))
        for row, name in zip(rows, named, strict=True):
            if name in there:
                row[:] = self._contact(there[name])
        return rows

    def _all_contacts(self, bodies: Sequence[Body]) -> NDArray[np.float64]:
        slots = self.law.inputs.port("contacts").shape[0] if "contacts" in self.law.inputs else 0
        contacts, listed = np.zeros((slots, 6)), list(bodies)
        if len(listed) > slots:
            by_distance = sorted(listed, key=lambda b: b.shape.nearest(self.state[:2])[0])
            chosen = {b.name for b in by_distance[:slots]}
            listed = [b for b in listed if b.name in chosen]
        for row, body in zip(contacts, listed, strict=False):
            row[:] = self._contact(body)
        return contacts

    def _contact(self, body: Body) -> list[float]:
        if isinstance(body.shape, Disc):
            return [*body.shape.center, body.shape.radius, *body.velocity, 1.0]
        return [*body.shape.nearest(self.state[:2])[1], 0.0, *body.velocity, 1.0]


def certain_echo(world: World, array: SonarArray, sensor: int, state: Vector, bodies: Sequence[Body]) -> float:
    """Return the distance [m] from a sonar's apex to the nearest point that reflects, inf if there is none."""
    audible, surfaces, walls = (
        beside(bodies, float(state[2]), world.hull),
        world.scenario.surfaces,
        world.scenario.walls,
    )
    heading = float(state[3])
    if surfaces is None:
        shapes = [*(b.shape for b in audible), *walls]
        return true_range(array, sensor, position=state[:2], heading=heading, shapes=shapes)
    names = [obstacle.name for obstacle in world.scenario.obstacles]
    reflectors = dict(zip(names, surfaces.obstacles, strict=True))
    upright = [(b.shape, reflectors[b.name]) for b in audible] + list(zip(walls, surfaces.walls, strict=True))
    return certain_range(array, sensor, place=state[:3].tolist(), heading=heading, shapes=upright, surfaces=surfaces)


def column(
    scenario: Scenario, bodies: Sequence[Body], place: NDArray[np.float64] | Sequence[float], hull: float
) -> tuple[float, float]:
    """Return the free water [m] above and below a hull, within the mission's `depths`; 0 without `depths`.

    Args:
        scenario: the mission.
        bodies: obstacles of the scenario at the present instant.
        place: (3,) position of the hull's centre in the earth frame {E} [m].
        hull: radius of the hull [m].
    """
    if scenario.depths is None:
        return 0.0, 0.0
    x, y, z = (float(value) for value in place)
    above = below = LONGEST
    for body in bodies:
        if body.heights.whole or body.shape.foot(x, y)[0] >= hull + FOOTPRINT:
            continue
        above = min(above, body.heights.bottom - z - hull if body.heights.bottom > z else inf)
        below = min(below, z - hull - body.heights.top if body.heights.top < z else inf)
    lowest, highest = scenario.depths
    return max(0.0, min(above, highest - hull - z)), max(0.0, min(below, z - hull - lowest))


def feeder_of(scenario: Scenario, law: Law, p: NDArray[np.float64]) -> Feeder | None:
    """Return what feeds a law with the mission's window before each step; None if the parameters stay as they are.

    Args:
        scenario: the mission.
        law: the law.
        p: its parameters from `law_numbers`.

    Raises:
        InputError: two points of the path are too close together, see `check_spacing`.
    """
    if not scenario.path.fed:
        return None
    check_spacing(scenario, cap=scenario.cap)
    return Feeder(scenario.path.table(visits=scenario.corners == "visit"), law.state, law.gains, p)
