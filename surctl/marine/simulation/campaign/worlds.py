"""The runs of a campaign: drawn vehicles and obstacles (`[uncertainty]`), or random worlds in the paper's tank."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from math import dist
from pathlib import Path as FilePath
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, SurctlError
from surctl.files import read_toml
from surctl.marine.simulation.batch.case import Case
from surctl.marine.simulation.fit import findings
from surctl.marine.simulation.loop import simulate_case
from surctl.marine.simulation.motion import closest
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.simulation.run import Run
from surctl.marine.simulation.scenario import Scenario, scenario_from_table
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle

Columns = Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class SampledRun:
    """One random run of a campaign, with the `seed` of all random choices except those in `draw`.

    Attributes:
        case: the setup with the scenario of this run; its vehicle is the law's model unless `case.model` is set.
        draw: parameters in which the simulated vehicle differs from the vehicle of `case`, by name, in its file's
            units.
    """

    case: Case
    seed: int = 0
    draw: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def simulate(self) -> Run:
        """Simulate the run with `simulate`, that is, without compiled code."""
        return simulate_case(self.case, seed=self.seed, draw=self.draw)


@dataclass(frozen=True)
class Plan(ABC):
    """The runs of a campaign, which are drawn from seeds: run k has the seed `first` + k, and depends only on k.

    Attributes:
        case: the setup whose loop is compiled; the runs differ from this setup only in the drawn values.
        first: seed of the first run, at least 0.
    """

    case: Case
    first: int = 0

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.case.scenario.name

    def seeds(self, first: int, count: int) -> NDArray[np.int64]:
        """Return the seeds (count,) of the runs from number `first` on."""
        return np.arange(self.first + first, self.first + first + count)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that the plan draws at random."""
        return tuple(self._row(0))

    def values(self, first: int, count: int) -> Columns:
        """Return the drawn values (count,) of the runs from number `first` on, by parameter name."""
        rows = [self._row(k) for k in range(first, first + count)]
        return {name: np.array([row[name] for row in rows]) for name in self.names}

    def run(self, k: int) -> SampledRun:
        """Return run number k as a single run, which can be simulated without compiled code."""
        return SampledRun(replace(self.case, scenario=self.world(k)), self.first + k, self._plant(k))

    def settings(self) -> Mapping[str, object]:
        """Return the settings, besides the setup, that the runs depend on, as plain data."""
        return {"first seed": self.first, "draws": self._draws}

    @abstractmethod
    def world(self, k: int) -> Scenario:
        """Return the scenario of run number k."""

    @property
    @abstractmethod
    def _draws(self) -> str:
        """Return what the plan draws at random, in words."""

    @property
    @abstractmethod
    def _draws_plant(self) -> bool:
        """Return whether the parameters of the simulated vehicle are drawn, see `draw_plant`."""

    @abstractmethod
    def _obstacle_values(self, k: int) -> Mapping[str, float]:
        """Return the drawn values of the obstacles of run number k, by parameter name."""

    def _plant(self, k: int) -> dict[str, float]:
        return draw_plant(self.case.vehicle, seed=self.first + k) if self._draws_plant else {}

    def _row(self, k: int) -> dict[str, float]:
        # the drawn values of a run, by parameter name
        return {**{f"plant.{name}": value for name, value in self._plant(k).items()}, **self._obstacle_values(k)}


def draw_plant(vehicle: Vehicle, *, seed: int) -> dict[str, float]:
    """Draw vehicle parameters uniformly within their stated ranges; other parameters keep their values."""
    rng = np.random.default_rng([seed, 3])
    ranges = {name: p.range for name, p in vehicle.parameters.items() if p.range is not None}
    return {name: float(rng.uniform(*ends)) for name, ends in ranges.items()}


@dataclass(frozen=True)
class MonteCarlo(Plan):
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

    _draws = "plant and obstacles"

    @property
    def _draws_plant(self) -> bool:
        return self.case.scenario.uncertainty.vehicle

    def world(self, k: int) -> Scenario:
        """Return the scenario of run number k."""
        return replace(self.case.scenario, obstacles=tuple(self._obstacles(k)))

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

    def _obstacle_values(self, k: int) -> dict[str, float]:
        values: dict[str, float] = {}
        for o in self._obstacles(k):
            speed = {} if o.speed_m_per_s is None else {"speed": o.speed_m_per_s}
            values |= _named(o, _shape(o) | speed)
        return values


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


def _shape(obstacle: Obstacle) -> dict[str, float]:
    # empty if the radius is that of the hull
    if obstacle.size_m is not None:
        return {"size_x": obstacle.size_m[0], "size_y": obstacle.size_m[1]}
    return {} if obstacle.radius_m is None else {"radius": obstacle.radius_m}


def _named(obstacle: Obstacle, values: Mapping[str, float]) -> dict[str, float]:
    return {f"obstacle.{obstacle.name}.{name}": value for name, value in values.items()}


WORLDS_VEHICLE = "sur540-flooded"
"""Default vehicle in random worlds."""

_FASTEST_MOVER = 0.15
"""Largest speed of a moving obstacle [m/s]."""

_SLOWEST = 0.03
"""Smallest speed of a moving obstacle [m/s] (*chosen*)."""

_BOXES, _CYLINDERS, _MOVERS = 2, 2, 4
_EDGES = (0.2, 1.6)  # [m] edge lengths of a box (*chosen*; the paper's boxes are 0.3 by 1.6)
_RADII = (0.1, 0.4)  # [m] radii of a cylinder (*chosen*)
_BALLS = (0.15, 0.35)  # [m] radii of a moving obstacle (*chosen*; the paper's are as large as the robot)
_NEAR = 1.0  # [m] from a moving obstacle's start to the hull, and from its end to the target (*chosen*)
_BETWEEN = 0.1  # [m] extra gap for a hull between two moving obstacles (*chosen*)
_LEAST_DISTANCE = 1.0  # [m] shortest path of a moving obstacle (*chosen*)
_TRIES = 100_000


def random_world(vehicle: Vehicle, *, seed: int) -> Scenario:
    """Return a random world with 1 to 8 obstacles, half of them moving.

    If the number of obstacles is odd, chance decides whether there is one more still or one more moving obstacle.

    The path goes straight through the 10 x 5 m tank, as in the paper. Still obstacles lie inside the tank and do not
    overlap. A moving obstacle goes in a straight line clear of the still obstacles, starts away from the robot, ends
    away from the target, and is removed at its end. Two moving obstacles always leave a gap that is 0.1 m wider than
    the hull. A moving obstacle may press the hull against a wall or a still obstacle. The function `findings` reports
    no error for such a world: the hull fits at the start, at the target, and in the tightest gap of the path.

    Raises:
        SurctlError: no random world fits this vehicle.
    """
    rng = np.random.default_rng([seed, 5])
    count = int(rng.integers(1, 9))
    movers = (count + int(rng.integers(0, 2))) // 2
    name, site = f"world-{seed}", np.array([_tank()["site"][edge] for edge in ("length_m", "width_m")])
    for _ in range(_TRIES):
        still = _still(rng, count - movers, site)
        world = _feasible(vehicle, still, name)
        moving = None if world is None else _moving(rng, movers, world, vehicle)
        if moving is not None and (world := _feasible(vehicle, [*still, *moving], name)) is not None:
            return world
    raise SurctlError(f"{vehicle.name} fits no random world of seed {seed}")


@cache
def _tank() -> dict[str, Any]:
    return read_toml(FilePath(__file__).with_name("tank.toml"))


def _world(vehicle: Vehicle, obstacles: Sequence[Obstacle] = (), **about: str) -> Scenario:
    """Return the tank with the given obstacles."""
    table = _tank() | {"vehicle": vehicle.name, "obstacles": obstacles, **about}
    return scenario_from_table(table, source="")


def world_template(vehicle: Vehicle) -> Scenario:
    """Return a scenario with every possible obstacle of a random world; one compiled loop simulates all worlds."""
    middle, motion = (5.0, 2.5), {"to_m": (1.0, 1.0), "speed_m_per_s": 0.1}
    obstacles = (
        *(_obstacle("box", k, centre_m=middle, size_m=(1.0, 1.0)) for k in range(_BOXES)),
        *(_obstacle("cylinder", k, centre_m=middle, radius_m=1.0) for k in range(_CYLINDERS)),
        *(_obstacle("mover", k, centre_m=middle, radius_m=1.0, **motion) for k in range(_MOVERS)),
    )
    return replace(_world(vehicle), obstacles=obstacles)


@dataclass(frozen=True)
class RandomWorlds(Plan):
    """Plan of runs in random worlds, which one compiled loop simulates; the seed of a run determines its world.

    The simulation setup has the scenario of `world_template`, with sensors, time limit and other settings that all
    worlds share. With `plant`, the parameters of the simulated vehicle are drawn too, see `draw_plant`.
    """

    plant: bool = False
    _known: dict[int, Scenario] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check that the scenario has no waves."""
        if force := self.case.scenario.disturbance.wave_force_n:
            problem = "must be 0, since random worlds have no waves"
            raise InputError(problem, key="disturbance.wave_force_n", value=force, remedy="write 0")

    @property
    def _draws(self) -> str:
        return "worlds and plant" if self.plant else "worlds"

    @property
    def _draws_plant(self) -> bool:
        return self.plant

    def world(self, k: int) -> Scenario:
        """Return the scenario of run number k, which is drawn once and cached."""
        if k not in self._known:
            world = random_world(self.case.vehicle, seed=self.first + k)
            self._known[k] = replace(self.case.scenario, name=world.name, obstacles=world.obstacles)
        return self._known[k]

    def _obstacle_values(self, k: int) -> dict[str, float]:
        values: dict[str, float] = {}
        there = {o.name: o for o in self.world(k).obstacles}
        for slot in self.case.scenario.obstacles:
            o = there.get(slot.name, slot)
            place = {"there": float(slot.name in there), "x": o.centre_m[0], "y": o.centre_m[1]}
            end = {} if o.to_m is None else {"to_x": o.to_m[0], "to_y": o.to_m[1], "speed": o.speed_m_per_s or 0.0}
            values |= _named(slot, place | _shape(o) | end)
        return values


def _obstacle(kind: str, k: int, **values: Any) -> Obstacle:
    shape = "moving" if kind == "mover" else kind
    return Obstacle.model_validate({"name": f"{kind}-{k + 1}", "shape": shape, **values})


def _still(rng: np.random.Generator, count: int, site: NDArray[np.float64]) -> list[Obstacle]:
    boxes = (count + 1) // 2
    obstacles = list[Obstacle]()
    for k in range(count):
        size = rng.uniform(*_EDGES, 2) if k < boxes else np.full(2, 2 * rng.uniform(*_RADII))
        centre = _millimetres(rng.uniform(size / 2, site - size / 2))
        if k < boxes:
            obstacles.append(_obstacle("box", k, centre_m=centre, size_m=_millimetres(size)))
        else:
            obstacles.append(_obstacle("cylinder", k - boxes, centre_m=centre, radius_m=round(size[0] / 2, 3)))
    return obstacles


def _moving(rng: np.random.Generator, count: int, scenario: Scenario, vehicle: Vehicle) -> list[Obstacle] | None:
    # None if one of the obstacles does not fit
    obstacles: list[Obstacle] = []
    first, last = scenario.path.waypoints[[0, -1]].tolist()
    for k in range(count):
        for _ in range(200):
            radius = round(float(rng.uniform(*_BALLS)), 3)
            inside = [(radius, edge - radius) for edge in scenario.site[:2]]
            start, end = ([round(float(rng.uniform(*ends)), 3) for ends in inside] for _ in range(2))
            speed = round(float(rng.uniform(_SLOWEST, _FASTEST_MOVER)), 4)
            away = radius + vehicle["radius"] + _NEAR
            if dist(start, first) < away or dist(end, last) < away or dist(start, end) < _LEAST_DISTANCE:
                continue
            path = np.linspace(start, end, 100).tolist()
            if any(o.distance((x, y)) <= radius for o in scenario.obstacles for x, y in path):
                continue
            one = _obstacle("mover", k, centre_m=start, to_m=end, radius_m=radius, speed_m_per_s=speed)
            if all(_leaves_gap(one, other, scenario, vehicle) for other in obstacles):
                break
        else:
            return None
        obstacles.append(one)
    return obstacles


def _leaves_gap(one: Obstacle, other: Obstacle, scenario: Scenario, vehicle: Vehicle) -> bool:
    # whether a hull fits between the obstacles whenever both are in the water
    wide = (one.radius_m or 0.0) + (other.radius_m or 0.0) + 2 * vehicle["radius"] + _BETWEEN
    return closest(one, other, until=scenario.time_limit) >= wide


def _millimetres(vector: NDArray[np.float64]) -> list[float]:
    return [round(float(value), 3) for value in vector]


def _feasible(vehicle: Vehicle, obstacles: Sequence[Obstacle], name: str) -> Scenario | None:
    try:
        scenario = _world(vehicle, obstacles, name=name)
        results = findings(scenario, vehicle)
    except InputError:
        return None
    return None if any(f.level == "error" for f in results) else scenario
