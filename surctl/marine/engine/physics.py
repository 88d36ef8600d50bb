"""A run in MuJoCo: motion, instability, contacts, distances, echoes of rays; many runs in several processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from math import asin, atan2, cos, inf, pi, sin, sqrt
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.engine.fluid import EngineOptions, body_of, environment
from surctl.marine.engine.mjcf import HULL, OBSTACLE, WALLS, mjcf, mujoco_library, stepper
from surctl.marine.simulation import Contact, OwnPhysics
from surctl.marine.simulation.loop import simulate_case
from surctl.marine.vehicle import PLANT_STATE, plant_state
from surctl.marine.vehicle.motion_log import quaternion
from surctl.marine.world import Wall

if TYPE_CHECKING:
    from surctl.marine.control import Law
    from surctl.marine.sensing import SonarArray
    from surctl.marine.simulation import Body as Obstacle
    from surctl.marine.simulation import Case, Run, ThrusterFault, World
    from surctl.marine.simulation.physics import PhysicsMaker
    from surctl.marine.vehicle import Vehicle

Array = NDArray[np.float64]


def _beam_directions(half: float, *, count: int, fan: bool = False) -> Array:
    """Return `count` unit vectors (n, 3) that fill a cone about the x axis of half angle `half` [rad] evenly.

    A tenth of them is on its rim. With `fan`, they fill only the part of the cone in the horizontal plane.
    """
    if fan:
        angles = np.linspace(-half, half, count)
        return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])
    rim = max(8, count // 10) if count > 8 else 0
    inner = np.arange(count - rim) + 0.5
    along = 1 - inner / max(count - rim, 1) * (1 - cos(half))
    across, turn = np.sqrt(1 - along**2), pi * (1 + sqrt(5)) * inner  # points of a Fibonacci spiral
    edge = np.linspace(0, 2 * pi, rim, endpoint=False)
    rows = [np.column_stack([along, across * np.cos(turn), across * np.sin(turn)])]
    rows.append(np.column_stack([np.full(rim, cos(half)), sin(half) * np.cos(edge), sin(half) * np.sin(edge)]))
    rows[0][0] = 1, 0, 0
    return np.vstack(rows)


class _Rays:
    """The rays of all sonars of an array.

    `faced` (k,) is the least cosine of incidence at which each geom of the model answers, above 1 if it is silent;
    None: all answer as the `incidence_limit` of the array and the options say.
    """

    def __init__(self, array: SonarArray, options: EngineOptions, faced: Array | None = None) -> None:
        self._mujoco, self._options, self._faced = mujoco_library(), options, faced
        self._limit = None if array.incidence_limit is None else cos(array.incidence_limit)
        self._cutoff = array.maximum + 1.0
        fan = options.rays == "fan"
        self._beams: list[tuple[Array, Array]] = []  # apex (3,) and directions (n, 3) in the frame of the hull
        for sensor, azimuth in enumerate(array.azimuths):
            x, y, _ = array.apex(sensor, position=(0.0, 0.0), heading=0.0)
            cones = array.cones[sensor]
            if not fan and array.elevation != 0.0 and cones == ((0.0, array.half_angle),):
                cones = ((0.0, 0.5 * array.beam_angle),)
            rise = np.eye(3) if fan else _about_y(-array.elevation)
            parts = [
                _beam_directions(half, count=options.count, fan=fan) @ (_about_z(azimuth + offset) @ rise).T
                for offset, half in cones
            ]
            self._beams.append((np.array([x, y, 0.0]), np.vstack(parts)))
        surface = options.surface_echo or faced is not None
        self._groups = np.array([1, 1, 1, int(surface), 1, 1], dtype=np.uint8)

    def nearest(self, model: Any, data: Any, body: int, sensor: int) -> float:
        """Return the distance [m] of the nearest echo of a sonar of the hull `body`, inf if there is none."""
        distances = self.hits(model, data, body, sensor)[1]
        return float(distances.min(initial=inf))

    def hits(self, model: Any, data: Any, body: int, sensor: int) -> tuple[Array, Array, Array]:
        """Return the apex (3,), the distances (n,) of all rays [m], inf without an echo, and their directions (n, 3).

        Apex and directions are in the earth frame {E}.
        """
        apex, beam = self._beams[sensor]
        rotation = data.xmat[body].reshape(3, 3)
        if self._options.rays == "fan":
            heading = np.arctan2(rotation[1, 0], rotation[0, 0])
            rotation = _about_z(float(heading))
        directions = np.ascontiguousarray(beam @ rotation.T)
        origin = data.xpos[body] + rotation @ apex
        count = len(directions)
        geoms, distances, normals = np.full(count, -1, dtype=np.int32), np.full(count, -1.0), np.zeros(3 * count)
        self._mujoco.mj_multiRay(
            model, data, origin, directions.ravel(), self._groups, 1, body, geoms, distances, normals, count,
            self._cutoff,
        )  # fmt: skip
        audible = distances >= 0
        if self._faced is None and not self._options.floor:
            audible &= geoms != model.geom("floor").id
        least = self._limit if self._faced is None else self._faced[geoms]
        if least is not None:
            audible &= -np.einsum("ij,ij->i", normals.reshape(-1, 3), directions) >= least
        return origin, np.where(audible, distances, inf), directions


def _about_y(angle: float) -> Array:
    return np.array([[cos(angle), 0.0, sin(angle)], [0.0, 1.0, 0.0], [-sin(angle), 0.0, cos(angle)]])


def _about_z(angle: float) -> Array:
    return np.array([[cos(angle), -sin(angle), 0.0], [sin(angle), cos(angle), 0.0], [0.0, 0.0, 1.0]])


Vector = NDArray[np.float64]

_PERIOD = 0.025  # [s] of `advance`
AWAY = (0.0, 0.0, 500.0)
"""Where an obstacle is [m] that is not in the water."""
_FARTHEST = 1e9  # [m] distances are measured up to here, which is every distance


@dataclass(frozen=True)
class mujoco_physics:  # noqa: N801  # a function that can be sent to other processes
    """The physics of a run in MuJoCo, for the argument `physics` of `simulate`.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.engine import mujoco_physics
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> scenario, boat = load_scenario("pool-behind"), load_vehicle("sur400")
        >>> run = simulate(scenario, boat, gains=load_gains("default"), physics=mujoco_physics())
        >>> run.plant, run.metrics.stopped_because, round(run.metrics.time_s, 1), list(run.contacts)
        ('mujoco, 4 DoF', 'reached', 11.3, [])
    """

    options: EngineOptions = field(default_factory=EngineOptions)

    def __call__(self, world: World, vehicle: Vehicle, array: SonarArray) -> MujocoPhysics:
        """Return the physics of one run."""
        return MujocoPhysics(world, vehicle, array, self.options)


class MujocoPhysics:
    """The physics of one run in MuJoCo; see `surctl.marine.simulation.Physics`.

    Attributes:
        name: `mujoco`, the degrees of freedom, and the options that are not the default.
        body: the rigid body and the force of the water.
        model, data: the model and its state in MuJoCo.
    """

    def __init__(self, world: World, vehicle: Vehicle, array: SonarArray, options: EngineOptions) -> None:
        self._mujoco = mujoco_library()
        self.world, self.body, self._vehicle = world, body_of(vehicle, options), vehicle.name
        options = self.body.options
        others = [part for part in options.text().split(",") if part and not part.startswith("dof=")]
        self.name = ", ".join(["mujoco", f"{options.dof} DoF", *others])
        scenario = world.scenario
        self.model = self._mujoco.MjModel.from_xml_string(mjcf(scenario, vehicle, options=options))
        self.data = self._mujoco.MjData(self.model)
        self._count = max(1, int(np.ceil(_PERIOD / options.step - 1e-9)))
        self.model.opt.timestep = _PERIOD / self._count
        self._layout = plant_state(self.body.form) if options.dof == 6 else PLANT_STATE
        self._range = vehicle.delivered_range
        self._lagged = vehicle["thrust_lag"] > 0
        self._hull = self.model.geom(HULL).id
        self._body = self.model.body(HULL).id
        self._walls = [self.model.geom(name).id for name in WALLS]
        self._open = list(self._walls)
        self._geoms = {o.name: self.model.geom(OBSTACLE + o.name).id for o in scenario.obstacles}
        self._mocap = {o.name: int(self.model.body(OBSTACLE + o.name).mocapid[0]) for o in scenario.obstacles}
        self._heights = {name: float(self.data.mocap_pos[k, 2]) for name, k in self._mocap.items()}
        self._contacts: dict[str, Contact] = {}
        self._placed: list[tuple[str, tuple[float, ...]]] | None = None
        # views of MuJoCo's arrays, which stay where they are
        self._qpos, self._qvel, self._command = self.data.qpos, self.data.qvel, self.data.ctrl
        self._acting = self.data.act if self._lagged else self.data.ctrl  # thrust that acts on the hull now
        # force and yaw moment of the thrusters' force components, which the actuators after the first four are
        self._single = np.zeros((4, 0)) if vehicle.actuators is None else vehicle.actuators.matrix
        bad = self._mujoco.mjtWarning  # after each of these MuJoCo would begin again from its first state
        self._diverged = [self.data.warning[k] for k in (bad.mjWARN_BADQPOS, bad.mjWARN_BADQVEL, bad.mjWARN_BADQACC)]
        self._mocap_pos, self._xmat = self.data.mocap_pos, self.data.xmat[self._body].reshape(3, 3)
        self._turns = 0.0
        self._outer = environment(self.body, scenario, world.hull)
        self._rays = _Rays(array, options, self._faced(options))
        self._p = np.array(self.body.parameters)
        self._step = stepper(self.body)(
            self.model, self.data, self._count, thrust=self._acting, parameters=self._p, environment=self._outer
        )
        self.state = self._layout.pack({"eta": scenario.start_pose})
        self._start_inside()

    @property
    def contacts(self) -> Sequence[Contact]:
        """The contacts of the hull until now: the first one with each obstacle or wall."""
        return tuple(self._contacts.values())

    @property
    def state(self) -> Vector:
        """The plant's state, see `Physics`."""
        return self._state

    @state.setter
    def state(self, value: Vector) -> None:
        value = np.array(value, dtype=float)
        parts = self._layout.unpack(value)
        eta, nu, data = parts["eta"], parts["nu"], self.data
        self._turns = float(eta[3])
        c, s = np.cos(eta[3]), np.sin(eta[3])
        data.qvel[:3] = c * nu[0] - s * nu[1], s * nu[0] + c * nu[1], nu[2]
        if self.body.options.dof == 4:
            data.qpos[:] = eta
            data.qvel[3] = nu[3]
        else:
            roll, pitch, p, q = parts["tilt"].tolist()
            data.qpos[:3], data.qpos[3:] = eta[:3], quaternion(roll, pitch, float(eta[3]))
            r = (nu[3] * np.cos(pitch) - q * np.sin(roll)) / np.cos(roll)
            data.qvel[3:] = p, q, r
        self._acting[4:] = np.linalg.pinv(self._single) @ parts["tau"]
        self._acting[:4] = parts["tau"] - self._single @ self._acting[4:]
        self._refresh()
        self._state = value

    def advance(self, thrust: Vector, time: float, components: Vector | None = None) -> Vector:
        """Move the hull on by 25 ms from `time` [s] with the commanded thrust (4,), and return the state.

        The force `components` (N,) of the thrusters act at their places, and the rest of the thrust at (xt, yt, zt).

        Raises:
            InputError: the motion becomes unstable: the step of the integration is too long for this vehicle.
        """
        self._outer[3:7] = self.world.force(time)
        self._command[:4] = np.minimum(np.maximum(thrust, self._range[0]), self._range[1])
        if self._single.size:
            self._command[4:] = 0.0 if components is None or not components.size else components
            self._command[:4] -= self._single @ self._command[4:]
        self._step()
        if any(warning.number for warning in self._diverged):
            problem = f"becomes unstable at {time:.2f} s"
            remedy = f"give a smaller step, or check masses, inertia and drag of {self._vehicle}"
            raise InputError(problem, key="--plant mujoco:step", value=self.model.opt.timestep, remedy=remedy)
        self._touch(time + _PERIOD)
        self._refresh()
        self._state = self._read()
        return self._state

    def clearance(self, bodies: Sequence[Obstacle]) -> tuple[float, float]:
        """Return the distance [m] from the hull to the nearest of the obstacles, and to the nearest wall."""
        self._place(bodies)
        obstacles = (self._distance(self._geoms[body.name]) for body in bodies)
        return min(obstacles, default=float("inf")), min(map(self._distance, self._walls))

    def echo(self, sensor: int, bodies: Sequence[Obstacle]) -> float:
        """Return the distance [m] from a sonar's apex to the nearest point that reflects, inf if there is none."""
        self._place(bodies)
        return self._rays.nearest(self.model, self.data, self._body, sensor)

    def _faced(self, options: EngineOptions) -> Vector | None:
        # least cosine of incidence at which each geom answers a sonar; None if all answer alike
        scenario, surfaces = self.world.scenario, self.world.scenario.surfaces
        if surfaces is None:
            return None
        faced = np.full(self.model.ngeom, 2.0)
        for obstacle, reflector in zip(scenario.obstacles, surfaces.obstacles, strict=True):
            faced[self._geoms[obstacle.name]] = reflector.faced(curved=obstacle.size_m is None)
        for wall, reflector in zip(self._walls, surfaces.walls, strict=True):
            faced[wall] = reflector.faced(curved=False)
        ideal = -1.0  # the options add echoes from surface and floor
        faced[self.model.geom("surface").id] = ideal if options.surface_echo else surfaces.surface.faced(curved=False)
        faced[self.model.geom("floor").id] = ideal if options.floor else surfaces.floor.faced(curved=False)
        return faced

    def _distance(self, geom: int) -> float:
        distance = self._mujoco.mj_geomDistance(self.model, self.data, self._hull, geom, _FARTHEST, None)
        return float(distance)

    def _refresh(self) -> None:
        self._mujoco.mj_kinematics(self.model, self.data)

    def _place(self, bodies: Sequence[Obstacle]) -> None:
        places = [(body.name, tuple(body.shape.center)) for body in bodies if not isinstance(body.shape, Wall)]
        if places == self._placed:
            return
        there, self._placed = dict(places), places
        for name, k in self._mocap.items():
            self._mocap_pos[k] = (*there[name], self._heights[name]) if name in there else AWAY
        self._refresh()

    def _start_inside(self) -> None:
        # a wall counts only once the hull has been clear of it, as in `Loop`
        for wall in self._walls:
            inside = self._distance(wall) <= 0
            self.model.geom_conaffinity[wall] = self.model.geom_contype[wall] = 0 if inside else 1
        self._open = [wall for wall in self._walls if self.model.geom_contype[wall]]

    def _touch(self, time: float) -> None:
        for wall in self._walls if len(self._open) < len(self._walls) else ():
            if wall not in self._open and self._distance(wall) > 0:
                self.model.geom_conaffinity[wall] = self.model.geom_contype[wall] = 1
                self._open.append(wall)
        for k in range(self.data.ncon):
            pair = self.data.contact[k].geom
            if self._hull in pair:
                other = int(pair[0] if pair[1] == self._hull else pair[1])
                what = self.model.geom(other).name
                self._contacts.setdefault(what, Contact(round(time, 9), what))

    def _read(self) -> Vector:
        place, velocity, tilt = self._qpos.tolist(), self._qvel.tolist(), []
        if self.body.options.dof == 4:
            heading, rate = place[3], velocity[3]
        else:
            R, (p, q, r) = self._xmat.tolist(), velocity[3:]
            pitch, roll = -asin(min(max(R[2][0], -1.0), 1.0)), atan2(R[2][1], R[2][2])
            self._turns += (atan2(R[1][0], R[0][0]) - self._turns + pi) % (2 * pi) - pi
            heading, rate = self._turns, (q * sin(roll) + r * cos(roll)) / cos(pitch)
            tilt = [roll, pitch, p, q]
        (x, y, z), c, s = velocity[:3], cos(heading), sin(heading)
        nu = c * x + s * y, c * y - s * x, z, rate
        thrust = self._acting[:4] + self._single @ self._acting[4:] if self._single.size else self._acting
        return np.array([*place[:3], heading, *nu, *thrust.tolist(), *tilt])


# Runs of one case with many seeds, in one process or in several


@dataclass(frozen=True)
class BatchCase:
    """What a process needs to simulate a case.

    Attributes:
        case: scenario, vehicle, gains and law.
        fallback: fallback of the law, as for `build_law`.
        thruster_faults: failures of thrusters.
        physics: makes the physics of a run.
        stepper: makes what computes the control steps of a run in place of the law, for example
            `surctl.marine.export.CompiledLaw`; None: the law in Python.
    """

    case: Case
    physics: PhysicsMaker = OwnPhysics
    fallback: str = "exact"
    thruster_faults: tuple[ThrusterFault, ...] = ()
    stepper: Callable[[Law], Any] | None = None


def simulate_seeds(batch_case: BatchCase, seeds: Sequence[int], *, processes: int = 1) -> Iterator[Run]:
    """Yield the runs of a case with the given seeds in their order; each process builds the law once.

    The runs do not depend on the number of processes.
    """
    return (run for run, _ in simulate_with_steppers(batch_case, seeds, processes=processes, compared=False))


def simulate_with_steppers(
    batch_case: BatchCase, seeds: Sequence[int], *, processes: int = 1, compared: bool = True
) -> Iterator[tuple[Run, Any]]:
    """Yield the runs as `simulate_seeds` does, each with the report of its stepper.

    The report is None without a stepper; and if not `compared`, because it repeats each step in Python.
    """
    if processes < 1:
        raise InputError("must be at least 1", key="processes", value=processes, remedy="give 1 or more")
    if processes == 1 or len(seeds) == 1:
        for seed in seeds:
            yield _simulated(batch_case, compared, seed)
        return
    law = batch_case.case.build(batch_case.fallback)
    # started afresh: a copy of this process would share its threads' locks and its connection to the display
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for run, report in pool.map(partial(_in_process, batch_case, compared), seeds):
            yield replace(run, law=law), report


def _in_process(batch_case: BatchCase, compared: bool, seed: int) -> tuple[Run, Any]:
    run, report = _simulated(batch_case, compared, seed)
    return replace(run, law=None), report  # type: ignore[arg-type]  # a law cannot be sent


def _simulated(batch_case: BatchCase, compared: bool, seed: int) -> tuple[Run, Any]:
    law = batch_case.case.build(batch_case.fallback)  # each process builds it once
    stepper = None if batch_case.stepper is None else batch_case.stepper(law)
    options: dict[str, Any] = {"thruster_faults": batch_case.thruster_faults, "physics": batch_case.physics}
    run = simulate_case(batch_case.case, seed=seed, law=law, stepper=stepper, **options)
    return run, stepper.report() if stepper is not None and compared else None
