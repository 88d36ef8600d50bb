"""The physics of a run: the interface for another engine, and surctl's own plant (RK4, distances, echoes)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from math import inf
from typing import NamedTuple, Protocol, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import on_vectors
from surctl.marine.sensing import Reflector, SonarArray, Surfaces
from surctl.marine.sensing.sonar.echo import beam_of, echo_range
from surctl.marine.sensing.sonar.returns import certain_range_symbols
from surctl.marine.sensing.sonar.solids import SolidBox, SolidDisc, SolidWalls
from surctl.marine.simulation.sensors import FIRING
from surctl.marine.simulation.world import Body, World, beside
from surctl.marine.vehicle import PLANT_DISTURBANCE, PlantForm, Vehicle, build_plant, plant_parameters, plant_state
from surctl.marine.vehicle.dynamics import PAPER
from surctl.marine.world import Box, Disc
from surctl.system.plant import runge_kutta

_RK4_STEPS = (0.010, 0.010, 0.005)


@cache
def advance(form: PlantForm = PAPER) -> ca.Function:
    """Return a CasADi function that integrates the plant over 25 ms by RK4, in steps of 10, 10 and 5 ms.

    From the plant state x, the commanded thrust, the disturbance d and the plant parameters p it computes the next
    state; `form` says which optional terms the dynamics have.
    """
    ode = build_plant(form).ode
    x, tau, d, p = (ca.SX.sym(n, ode.numel_in(i)) for i, n in enumerate(("x", "tau", "d", "p")))
    state = x
    for h in _RK4_STEPS:
        state = runge_kutta(lambda x, _: ode(x, tau, d, p), state, h)
    return ca.Function("advance", [x, tau, d, p], [state], {"cse": True})


@cache
def advanced(form: PlantForm) -> Callable[..., list[NDArray[np.float64]]]:
    """Return `advance` as a function of NumPy vectors."""
    return on_vectors(advance(form))


Vector: TypeAlias = NDArray[np.float64]


class Contact(NamedTuple):
    """A contact of the hull: its time [s], and the name of the obstacle or wall that the hull touches."""

    time: float
    what: str


class Physics(Protocol):
    """The physics of one run: it moves the hull, and measures its distances from obstacles and walls.

    The closed loop calls `advance` every 25 ms, and reads the state from `state`.

    Attributes:
        name: name of the physics in results, such as `own`.
        state: the plant's state as a flat vector: position and heading η (4,), velocity ν (4,) in the heading frame,
            thrust after its lag (4,), and, if the hull rolls and pitches, `TILT_STATE` (4,). It may be assigned to.
        contacts: the contacts of the hull until now, one for each obstacle or wall.
    """

    name: str
    state: Vector

    @property
    def contacts(self) -> Sequence[Contact]:
        """Return the contacts of the hull until now."""

    def advance(self, thrust: Vector, time: float, components: Vector | None = None) -> Vector:
        """Move the hull on by 25 ms from `time` [s] with the commanded thrust (4,), and return the state.

        `components` are the force components [N] of the vehicle's thrusters before their lag, as in
        `Actuators.matrix`. They are a part of `thrust`; none (0,) or None if they are not known.
        """

    def clearance(self, bodies: Sequence[Body]) -> tuple[float, float]:
        """Return the distance [m] from the hull to the nearest of the obstacles, and to the nearest wall."""

    def echo(self, sensor: int, bodies: Sequence[Body]) -> float:
        """Return the distance [m] from a sonar's apex to the nearest point that reflects, inf if there is none.

        Echoes with a probability do not count here: the closed loop adds them to every physics.
        """


PhysicsMaker: TypeAlias = Callable[[World, Vehicle, SonarArray], Physics]
"""What makes the physics of a world with a vehicle and its sonars."""


class OwnPhysics:
    """surctl's own plant: the vehicle's equations of motion by RK4, and distances in the plane."""

    name = "own"
    contacts: Sequence[Contact] = ()

    def __init__(self, world: World, vehicle: Vehicle, array: SonarArray) -> None:
        self.world, self.array, self.surfaces = world, array, world.scenario.surfaces
        names = [obstacle.name for obstacle in world.scenario.obstacles]
        self._reflectors = {} if self.surfaces is None else dict(zip(names, self.surfaces.obstacles, strict=True))
        self.plant, self.move = plant_parameters(vehicle), advanced(vehicle.form)
        self.state = plant_state(vehicle.form).pack({"eta": world.scenario.start_pose})
        self._current = [*world.scenario.disturbance.current_m_per_s, 0.0]

    def advance(self, thrust: Vector, time: float, components: Vector | None = None) -> Vector:
        """Move the hull on by 25 ms from `time` [s] with the commanded thrust (4,), and return the state.

        The plant has the force and yaw moment of the thrusters only; it has no use for their `components`.
        """
        d = PLANT_DISTURBANCE.pack({"current": self._current, "force": self.world.force(time)})
        (self.state,) = self.move(self.state, thrust, d, self.plant)
        return self.state

    def clearance(self, bodies: Sequence[Body]) -> tuple[float, float]:
        """Return the distance [m] from the hull to the nearest of the obstacles, and to the nearest wall."""
        return self.world.clearance(self.state[:3], bodies), self.world.wall_clearance(self.state[:2])

    def echo(self, sensor: int, bodies: Sequence[Body]) -> float:
        """Return the distance [m] from a sonar's apex to the nearest point that reflects, inf if there is none."""
        audible, numbers, kinds = beside(bodies, float(self.state[2]), self.world.hull), [], []
        for body in audible:
            assert isinstance(body.shape, Disc | Box)  # walls are no bodies
            size = [body.shape.radius] if isinstance(body.shape, Disc) else body.shape.size
            numbers += [*body.shape.center, *size]
            kinds.append((len(size), self._reflectors.get(body.name)))
        f = _sight(self.array, self.surfaces, tuple(kinds))
        length, width, _ = self.world.scenario.site
        (distance,) = f(self.state[:4], [sensor], [0.0, length, 0.0, width], numbers)[0]
        return float(distance) if distance < 2.0 * self.array.maximum else inf


@cache
def _sight(
    array: SonarArray, surfaces: Surfaces | None, kinds: tuple[tuple[int, Reflector | None], ...]
) -> Callable[..., list[NDArray[np.float64]]]:
    """Return the distance to the nearest certain echo from pose (4,), sensor, walls (4,) and numbers of the obstacles.

    `kinds` has for each obstacle the size of its dimensions, 1 for a disc and 2 for a box, and its reflector.
    """
    pose, sensor, edges = (ca.SX.sym(name, size) for name, size in (("pose", 4), ("sensor", 1), ("walls", 4)))
    numbers = ca.SX.sym("numbers", sum(2 + size for size, _ in kinds))
    parts = ca.vertsplit(numbers, np.cumsum([0, *(2 + size for size, _ in kinds)]).tolist()) if kinds else []
    solids = [(SolidDisc if part.numel() == 3 else SolidBox)(part[:2], part[2:]) for part in parts]
    beam = beam_of(array, range(array.size), sensor, position=pose[:2], heading=pose[3])
    if surfaces is None:
        distance = echo_range(array, beam, [*solids, SolidWalls(edges)])
    else:
        upright = [(solid, reflector or Reflector()) for solid, (_, reflector) in zip(solids, kinds, strict=True)]
        distance = certain_range_symbols(array, beam, upright, SolidWalls(edges), z=pose[2], surfaces=surfaces)
    return on_vectors(ca.Function("sight", [pose, sensor, edges, numbers], [distance], {"cse": True}))


assert FIRING == 0.025  # [s] the period of `advance`, which `stepping` integrates
