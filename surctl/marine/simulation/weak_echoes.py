"""The weak echoes of a run in the reference loop: edges, cylinders and corners of the site, with a probability."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import numpy as np
from numpy.typing import NDArray

from surctl.marine.sensing import (
    SonarArray,
    corner_points,
    echo_keys,
    echo_number,
    echo_uniform,
    firing_block,
    weak_range,
)
from surctl.marine.simulation.column import beside
from surctl.marine.simulation.world import Body, World

__all__ = ["WeakEchoes"]


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
