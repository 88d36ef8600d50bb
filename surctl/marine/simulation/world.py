"""The simulated world of one run: obstacles in motion, waves, drift and thrust errors that the seed draws.

The closed loop makes two simplifications. The beam of a sonar is a horizontal fan, as thick at every range as the hull
plus `BAND` above and below, and the sonar detects exactly the obstacles that cross it. (A real beam is thinner near the
hull, and thicker far away, where it would detect a sill that the hull passes over.) An echo sounder measures, without
noise, the vertical distance to the nearest obstacle over or under a disc that is wider than the hull by `FOOTPRINT`;
the limits of the mission's `depths` count as obstacles for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.simulation.scenario import Scenario, Shape
from surctl.marine.vehicle import Vehicle
from surctl.marine.world import WHOLE, Box, Disc, Heights, Prism


@dataclass(frozen=True)
class Body:
    """An obstacle at one instant: its shape and its velocity (2,) [m/s] in the earth frame {E}.

    `moving` states whether the base station (an external sensor for moving obstacles) tracks the obstacle.

    `heights` holds the lowest and the highest z of the obstacle [m].
    """

    name: str
    shape: Shape
    velocity: NDArray[np.float64]
    moving: bool
    heights: Heights = WHOLE


@dataclass(frozen=True)
class WorldDraw:
    """The random choices of a run, which one seed determines.

    Attributes:
        drift_direction: (n, 2) unit vector of the drift of each obstacle.
        drift_phase: (n,) phase of the drift of each obstacle [rad].
        wave_direction, wave_phase: direction and phase of the wave force.
        slow_direction, slow_phase: direction and phase of the slow drift force.
        gain_error, bias: (4,) relative thrust errors per axis in [-1, 1]; the scenario states the scale of both errors.
    """

    drift_direction: NDArray[np.float64]
    drift_phase: NDArray[np.float64]
    wave_direction: NDArray[np.float64]
    wave_phase: float
    slow_direction: NDArray[np.float64]
    slow_phase: float
    gain_error: NDArray[np.float64]
    bias: NDArray[np.float64]


@dataclass(frozen=True)
class World(WorldDraw):
    """A scenario together with the random choices of a run.

    Attributes:
        hull: radius of the vehicle [m]; moving obstacles without a radius of their own have the same radius.
    """

    scenario: Scenario
    hull: float

    def bodies(self, time: float) -> list[Body]:
        """Return the obstacles that are in the water at `time` [s]."""
        still = self._still
        bodies = [still.get(k) or self._body(k, o, time) for k, o in enumerate(self.scenario.obstacles)]
        return [body for body in bodies if body is not None]

    @cached_property
    def _still(self) -> dict[int, Body | None]:
        # by their index in the scenario's list
        obstacles = enumerate(self.scenario.obstacles)
        return {k: self._body(k, o, 0.0) for k, o in obstacles if o.shape != "moving" and o.drift_m == 0}

    def force(self, time: float) -> NDArray[np.float64]:
        """Return the disturbance force and moment (4,) in the earth frame {E} [N, N m]."""
        d = self.scenario.disturbance
        wave = d.wave_force_n * np.sin(2 * np.pi * time / d.wave_period_s + self.wave_phase)
        slow = d.drift_force_n * np.sin(2 * np.pi * time / d.drift_period_s + self.slow_phase)
        return np.array([*(wave * self.wave_direction + slow * self.slow_direction), 0.0, 0.0])

    def thrust(self, command: NDArray[np.float64], limit: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the limited thrust (4,) [N, N m] in the body frame for a command, with the errors of `Disturbance`."""
        d = self.scenario.disturbance
        delivered: NDArray[np.float64] = command * (1 + d.thrust_error * self.gain_error)
        return delivered + d.thrust_bias * self.bias * limit

    def clearance(self, place: NDArray[np.float64], bodies: Sequence[Body]) -> float:
        """Return the signed distance [m] from a hull at `place` (3,) [m] to the nearest obstacle, without walls."""
        x, y, z = place.tolist()
        return min((Prism(b.shape, b.heights).distance(x, y, z) - self.hull for b in bodies), default=float("inf"))

    def wall_clearance(self, position: NDArray[np.float64]) -> float:
        """Return the distance [m] from the hull to the nearest wall."""
        return min(wall.nearest(position)[0] for wall in self.scenario.walls) - self.hull

    def _body(self, k: int, obstacle: Obstacle, time: float) -> Body | None:
        if obstacle.shape == "moving":
            return self._moving(obstacle, np.array(obstacle.centre_m), time)
        rate = 2 * np.pi / obstacle.drift_period_s
        angle, direction = rate * time + self.drift_phase[k], self.drift_direction[k]
        offset = (obstacle.drift_m * np.sin(angle) * direction).tolist()
        centre = obstacle.centre_m[0] + offset[0], obstacle.centre_m[1] + offset[1]
        velocity = obstacle.drift_m * rate * np.cos(angle) * direction
        shape = Box(centre, obstacle.size_m) if obstacle.size_m else Disc(centre, obstacle.radius_m or 0.0)
        return Body(obstacle.name, shape, velocity, moving=False, heights=obstacle.heights)

    def _moving(self, obstacle: Obstacle, centre: NDArray[np.float64], time: float) -> Body | None:
        displacement = np.array(obstacle.to_m) - centre
        distance, speed = float(np.linalg.norm(displacement)), float(obstacle.speed_m_per_s or 0)
        radius = obstacle.radius_m or self.hull
        arrived = speed * time >= distance
        if arrived and obstacle.removed:
            return None
        velocity = np.zeros(2) if arrived else speed * displacement / distance
        place = Disc(centre + (displacement if arrived else velocity * time), radius)
        return Body(obstacle.name, place, velocity, moving=True, heights=obstacle.heights)


def draw_world(obstacles: int, *, seed: int) -> WorldDraw:
    """Return the random choices that a seed determines for the given number of obstacles."""
    turns = (2 * np.pi * np.random.default_rng([seed, 1]).random(2 * obstacles + 2)).tolist()
    drifts, wave, phases, wave_phase = turns[:obstacles], turns[obstacles], turns[obstacles + 1 : -1], turns[-1]
    # use math.sin: the last digit of numpy's sine depends on the length of the array
    directions = np.array([(cos(angle), sin(angle)) for angle in (*drifts, wave)])
    slow, slow_phase, *errors = np.random.default_rng([seed, 2]).random(10).tolist()
    slow_direction = np.array([cos(2 * np.pi * slow), sin(2 * np.pi * slow)])
    shares = 2 * np.array(errors) - 1
    return WorldDraw(
        directions[:-1],
        np.array(phases),
        directions[-1],
        wave_phase,
        slow_direction,
        2 * np.pi * slow_phase,
        shares[:4],
        shares[4:],
    )


def build_world(scenario: Scenario, vehicle: Vehicle, *, seed: int) -> World:
    """Return the world of a scenario and seed; InputError if the hull starts inside an obstacle."""
    world = World(**vars(draw_world(len(scenario.obstacles), seed=seed)), scenario=scenario, hull=vehicle["radius"])
    for body in world.bodies(0.0):
        clearance = world.clearance(scenario.start_pose[:3], [body])
        if clearance <= 0:
            raise InputError(
                f"the {world.hull:g} m hull of {vehicle.name} starts {-clearance:.3f} m inside obstacle {body.name!r}",
                file=scenario.source,
                key="path_m",
                value=scenario.start.tolist(),
                remedy="move the start or the obstacle, or use a smaller vehicle",
            )
    return world


BAND = 0.05
"""Thickness [m] of a sonar's fan beyond the hull, above and below (*chosen*)."""

FOOTPRINT = 0.03
"""Radius [m] of an echo sounder's footprint beyond the hull, at every range.

It is *chosen* smaller than the distance that the robot keeps from a wall, so that the robot can change its depth along
a wall. The sonars detect obstacles beside the hull that are nearer.
"""

LONGEST = 10.0
"""Longest range [m] of an echo sounder, from the hull (*chosen*)."""


def beside(bodies: Sequence[Body], z: float, hull: float) -> list[Body]:
    """Return the obstacles that a hull of radius `hull` [m] at height `z` [m] can touch when it moves horizontally."""
    return [body for body in bodies if body.heights.crosses(z, hull + BAND)]
