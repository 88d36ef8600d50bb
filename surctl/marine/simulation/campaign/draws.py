"""Random draws of a Monte Carlo campaign: the simulated vehicle and the obstacles of a scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.simulation.campaign.plan import SampledRun, SeededPlan
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle

__all__ = ["MonteCarlo", "draw_plant", "obstacle_values"]


def draw_plant(vehicle: Vehicle, *, seed: int) -> dict[str, float]:
    """Draw vehicle parameters uniformly within their stated ranges; other parameters keep their values."""
    rng = np.random.default_rng([seed, 3])
    ranges = {name: p.range for name, p in vehicle.parameters.items() if p.range is not None}
    return {name: float(rng.uniform(*ends)) for name, ends in ranges.items()}


@dataclass(frozen=True)
class MonteCarlo(SeededPlan):
    """Runs of a scenario with random plants, obstacles and seeds, see `Uncertainty`.

    Raises:
        InputError: an obstacle of the largest possible size covers the start.
    """

    def __post_init__(self) -> None:
        """Check that every possible draw can be simulated."""
        u = self.case.scenario.uncertainty
        grown = [_scaled(o, self.case.vehicle, 1 + u.obstacle_size, 1.0) for o in self.case.scenario.obstacles]
        try:
            build_world(replace(self.case.scenario, obstacles=tuple(grown)), self.case.vehicle, seed=self.first)
        except InputError as error:
            raise InputError(
                f"makes the scenario impossible at the largest obstacle size: {error.problem}",
                file=self.case.scenario.source or self.case.scenario.name,
                key="uncertainty.obstacle_size",
                value=u.obstacle_size,
                remedy="lower it",
            ) from None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the drawn parameters, see `Plan.names`."""
        return tuple(self._row(0))

    def values(self, first: int, count: int) -> Mapping[str, NDArray[np.float64]]:
        """Return the drawn values of `count` runs, see `Plan.values`."""
        rows = [self._row(k) for k in range(first, first + count)]
        return {name: np.array([row[name] for row in rows]) for name in (rows[0] if rows else ())}

    def run(self, k: int) -> SampledRun:
        """Return run number k, see `Plan.run`."""
        scenario = replace(self.case.scenario, obstacles=tuple(self._obstacles(k)))
        return SampledRun(replace(self.case, scenario=scenario), self.first + k, self._plant(k))

    def settings(self) -> Mapping[str, object]:
        """Return the settings of the random draws, see `Plan.settings`."""
        return {"first seed": self.first, "draws": "plant and obstacles"}

    def _plant(self, k: int) -> dict[str, float]:
        if not self.case.scenario.uncertainty.vehicle:
            return {}
        return draw_plant(self.case.vehicle, seed=self.first + k)

    def _obstacles(self, k: int) -> list[Obstacle]:
        # every obstacle uses two random numbers, whatever its shape
        scenario, rng = self.case.scenario, np.random.default_rng([self.first + k, 4])
        u, shares = scenario.uncertainty, rng.uniform(-1, 1, (len(scenario.obstacles), 2)).tolist()
        if not (u.obstacle_size or u.obstacle_speed):
            return list(scenario.obstacles)
        return [
            _scaled(o, self.case.vehicle, 1 + u.obstacle_size * size, 1 + u.obstacle_speed * speed)
            for o, (size, speed) in zip(scenario.obstacles, shares, strict=True)
        ]

    def _row(self, k: int) -> dict[str, float]:
        row = {f"plant.{name}": value for name, value in self._plant(k).items()}
        return row | obstacle_values(self._obstacles(k))


def _scaled(obstacle: Obstacle, vehicle: Vehicle, size: float, speed: float) -> Obstacle:
    # a moving obstacle without a radius has the radius of the hull
    changes: dict[str, object] = {}
    if obstacle.size_m is not None:
        changes["size_m"] = (obstacle.size_m[0] * size, obstacle.size_m[1] * size)
    else:
        changes["radius_m"] = (obstacle.radius_m or vehicle["radius"]) * size
    if obstacle.speed_m_per_s is not None:
        changes["speed_m_per_s"] = obstacle.speed_m_per_s * speed
    return obstacle.model_copy(update=changes)


def obstacle_values(obstacles: Sequence[Obstacle]) -> dict[str, float]:
    """Return the sizes and speeds of the drawn obstacles by parameter name."""
    values: dict[str, float] = {}
    for o in obstacles:
        if o.size_m is not None:
            values |= {f"obstacle.{o.name}.size_x": o.size_m[0], f"obstacle.{o.name}.size_y": o.size_m[1]}
        elif o.radius_m is not None:
            values[f"obstacle.{o.name}.radius"] = o.radius_m
        if o.speed_m_per_s is not None:
            values[f"obstacle.{o.name}.speed"] = o.speed_m_per_s
    return values
