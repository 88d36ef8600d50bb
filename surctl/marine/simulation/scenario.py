"""Scenario files and their checks: site, speeds, depths, disturbances, `[uncertainty]` (path: `route`; `sensors`)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import ceil
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from surctl.errors import InputError, check_once, mistakes_in
from surctl.files import Strict, pick, read_toml, validate
from surctl.marine.guidance import MAX_WAYPOINTS, VISIT, Follower, Path
from surctl.marine.sensing import Surfaces
from surctl.marine.simulation.obstacle import NotNegative, Obstacle, Positive
from surctl.marine.simulation.reflectors import Reflectors, ReflectorTable, WallTable
from surctl.marine.simulation.route import PERIOD, Corner, Route
from surctl.marine.simulation.sensors import (
    OwnStateTable,
    Sensors,
    SonarTable,
    StationTable,
    sensor_tables,
    sensors_from_tables,
)
from surctl.marine.world import Box, Disc, Wall, site_walls

Share = Annotated[float, Field(ge=0, lt=1)]


class Disturbance(Strict):
    """Disturbances: waves, slow drift force, constant current, and thrust errors.

    Waves and slow drift are sinusoidal forces in the earth frame {E}; the seed determines their directions and phases.

    For a command τ, an axis with the thrust limit τ_max delivers the thrust (1 + g)·τ + b·τ_max, clipped to ±τ_max. The
    gain error g and the bias b are drawn once per run, uniformly within ±`thrust_error` and ±`thrust_bias`.
    """

    wave_force_n: NotNegative = 0.0
    wave_period_s: Positive = 3.0
    drift_force_n: NotNegative = 0.0
    drift_period_s: Positive = 40.0
    thrust_error: Share = 0.0
    thrust_bias: Share = 0.0
    current_m_per_s: tuple[float, float] = (0.0, 0.0)

    @property
    def seeded(self) -> bool:
        """Whether any disturbance depends on the random seed."""
        return any((self.wave_force_n, self.drift_force_n, self.thrust_error, self.thrust_bias))


_OF = {
    "time_kind": "time_s",
    "time_of": "time_s",
    "position_error_kind": "position_error_m",
    "position_error_of": "position_error_m",
}


class PaperFigure(Strict):
    """The numbers that the paper reports for a scenario; numbers that the paper does not state are left out.

    Attributes:
        result: the result in words; empty if the paper has no such scenario.
        time_s, position_error_m: time to the target, and position error E_p to the reference path outside avoidance.
            `…_kind` says whether a number is approximate or an upper limit; `…_of` whether the paper states it for this
            run, for every run of a series, or for the mean of a series.
        detected_s: approximate time at which the robot detects the moving obstacle.
        passed_s: approximate time from which the moving obstacles are behind the robot.
        transients_s: approximate times at which avoidance disturbs the path tracking.
    """

    result: str = ""
    time_s: Positive | None = None
    time_kind: Literal["about", "less than"] = "about"
    time_of: Literal["run", "series", "series mean"] = "run"
    position_error_m: Positive | None = None
    position_error_kind: Literal["about", "less than"] = "less than"
    position_error_of: Literal["run", "series", "series mean"] = "series"
    detected_s: Positive | None = None
    passed_s: Positive | None = None
    transients_s: tuple[Positive, ...] = ()

    @model_validator(mode="after")
    def _of_something(self) -> PaperFigure:
        for key, figure in _OF.items():
            if key in self.model_fields_set and getattr(self, figure) is None:
                raise ValueError(f"{key} describes {figure}, which is missing; add {figure} or remove {key}")
        return self


class Uncertainty(Strict):
    """The table `[uncertainty]` of a scenario file, which controls the random draws of a Monte Carlo campaign.

    All parameters are drawn uniformly and independently.

    Attributes:
        vehicle: whether the simulated vehicle's parameters are drawn within the ranges of its file; the law keeps the
            file's values.
        obstacle_size: largest relative error of an obstacle's size (design choice), the same for both edges of a box.
        obstacle_speed: largest relative error of a moving obstacle's speed (design choice).
    """

    vehicle: bool = True
    obstacle_size: Share = 0.1
    obstacle_speed: Share = 0.2


LIBRARY = FilePath(__file__).parent / "library"

Shape = Box | Disc | Wall

_DEPTHS = "z points up: write a value above {:g} and below 0, such as -0.1 for a boat at the surface"


class _Site(Strict):
    length_m: Positive
    width_m: Positive
    depth_m: Positive
    walls: str | WallTable | None = None
    surface: str | None = None
    floor: str | None = None


class _ScenarioFile(Route):
    kind: Literal["scenario"]
    name: str = Field(min_length=1)
    title: str = Field(min_length=1)
    provenance: str = Field(min_length=1)
    vehicle: str
    depth_m: float
    cruise_m_per_s: Positive
    cap_m_per_s: Positive
    arrival_m: Positive = 0.10
    time_limit_s: Positive | None = None
    launch_m: NotNegative = 0.0
    depths_m: tuple[float, float] | None = None
    corners: Corner = "pass"
    site: _Site
    obstacles: tuple[Obstacle, ...] = ()
    disturbance: Disturbance = Disturbance()
    sonar: SonarTable = SonarTable()
    reflectors: dict[str, ReflectorTable] = Field(default_factory=dict)
    base_station: StationTable = StationTable()
    own_state: OwnStateTable = OwnStateTable()
    uncertainty: Uncertainty = Uncertainty()
    paper: PaperFigure = PaperFigure()


@dataclass(frozen=True)
class Scenario:
    """One mission at one site, as read from a scenario file.

    Attributes:
        path: horizontal reference path in the earth frame {E}.
        depth: z of the path [m], negative below the surface.
        cruise: desired cruise speed U_d [m/s].
        cap: speed cap, the largest horizontal speed that the law may command [m/s].
        arrival_radius: distance to the target [m] within which the robot counts as arrived.
        site: length along x, width along y, and depth of the site [m]; one corner of the floor plan is the origin.
        vehicle: name or path of the vehicle that is used by default in the mission.
        launch: distance around the hull [m] in which the operator ensures free water at the start. A law with sonars
            relies on this free water, so an obstacle within this distance is an error. The distance is 0.5 m in the
            built-in missions, or less if an obstacle is nearer.
        sensors: sonars and their faults, base station, and measurement of the own state.
        uncertainty: ranges from which a Monte Carlo campaign draws parameters.
        depths: lowest and highest z [m] that the hull may use if it can reach the target only at another depth than the
            path's; None: the robot keeps to the path's depth. With `depths` the robot has two echo sounders, one
            upwards and one downwards.
        corners: `pass`: the robot may skip corners of the path on a detour; `visit`: the robot must come within
            `arrival_radius` of every corner, in order, before it can arrive. If the path has kinds of corners, these
            hold instead.
        route: the entries of the file that describe the path; None if the scenario is not from a file.
        reflectors: how walls, water surface and floor answer a sonar, and the kinds of reflectors of the file.
    """

    name: str
    title: str
    provenance: str
    vehicle: str
    path: Path
    depth: float
    cruise: float
    cap: float
    arrival_radius: float
    time_limit: float
    site: tuple[float, float, float]
    obstacles: tuple[Obstacle, ...]
    disturbance: Disturbance
    paper: PaperFigure
    source: str = ""
    sensors: Sensors = field(default_factory=Sensors)
    launch: float = 0.0
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    depths: tuple[float, float] | None = None
    corners: Corner = "pass"
    route: Route | None = None
    reflectors: Reflectors = field(default_factory=Reflectors)

    @cached_property
    def walls(self) -> tuple[Wall, ...]:
        """The four walls of the site, cached because a run needs the walls at every step."""
        return site_walls(self.site[1], self.site[0])

    @property
    def deepest(self) -> float:
        """Lowest z [m] to which the path and `depths` take the robot."""
        lowest = self.depth_range[0]
        return lowest if self.depths is None else min(lowest, self.depths[0])

    @cached_property
    def surfaces(self) -> Surfaces | None:
        """How each surface answers a sonar; None if all answer alike, as the `incidence_limit` of the sonars says."""
        array, echoes = self.sensors.equipment.array, self.sensors.echoes
        return self.reflectors.surfaces(self.obstacles, array, echoes=echoes, depth=self.site[2])

    @property
    def start_pose(self) -> NDArray[np.float64]:
        """Pose η (4,) at the start: x, y, z [m], and heading ψ [rad] along the first path segment."""
        first_leg = self.path.waypoints[1] - self.start
        return np.array([*self.start, self.depth, np.arctan2(first_leg[1], first_leg[0])])

    @property
    def turns(self) -> NDArray[np.float64]:
        """By how much the direction changes at each inner waypoint of the path (n - 2,) [rad], at least 0."""
        ahead = np.diff(self.path.waypoints, axis=0)
        turns = np.diff(np.arctan2(ahead[:, 1], ahead[:, 0]))
        return np.abs((turns + np.pi) % (2 * np.pi) - np.pi)

    def follower(self) -> Follower:
        """Return a path follower at the start of the path."""
        return Follower(self.path, visit=self.visit)

    @property
    def visit(self) -> float | None:
        """Distance [m] to a corner within which the corner counts as visited; None if all corners may be skipped."""
        visits = self.corners == "visit" if self.path.kinds is None else bool(np.any(self.path.kinds == VISIT))
        return self.arrival_radius if visits else None

    @property
    def visited(self) -> NDArray[np.float64]:
        """Corners of the path that must be visited (k, 2) [m]."""
        kinds = self.path.table(visits=self.corners == "visit")[:, 4]
        corners: NDArray[np.float64] = self.path.waypoints[1:-1][kinds[1:-1] == VISIT]
        return corners

    @property
    def depth_range(self) -> tuple[float, float]:
        """Lowest and highest z [m] of the path."""
        rises = np.zeros(1) if self.path.rises is None else self.path.rises
        return self.depth + float(rises.min()), self.depth + float(rises.max())

    @property
    def end_depth(self) -> float:
        """z of the path's end [m]."""
        return self.depth if self.path.rises is None else self.depth + float(self.path.rises[-1])

    @property
    def fastest(self) -> float:
        """Largest speed of the target point along the path [m/s]."""
        if self.path.speeds is None:
            return self.cruise
        speeds = self.path.speeds[1:]
        return float(np.max(np.where(speeds > 0, speeds, self.cruise)))

    @property
    def duration(self) -> float:
        """Time [s] in which the target point goes along the whole path without waiting."""
        return self.path.duration(self.cruise)

    @property
    def seeded(self) -> bool:
        """Whether a run with true positions depends on the random seed."""
        return self.disturbance.seeded or any(o.drift_m > 0 for o in self.obstacles)

    @property
    def start(self) -> NDArray[np.float64]:
        """Start of the path (2,) [m]."""
        start: NDArray[np.float64] = self.path.waypoints[0]
        return start

    @property
    def target(self) -> NDArray[np.float64]:
        """End of the path (2,) [m]."""
        target: NDArray[np.float64] = self.path.waypoints[-1]
        return target


_ABOUT = {name: name for name in ("name", "title", "provenance", "vehicle")}
_NUMBERS = {
    "depth_m": "depth",
    "cruise_m_per_s": "cruise",
    "cap_m_per_s": "cap",
    "arrival_m": "arrival_radius",
    "time_limit_s": "time_limit",
    "launch_m": "launch",
    "depths_m": "depths",
    "corners": "corners",
}
_TABLES = {name: name for name in ("obstacles", "disturbance", "uncertainty", "paper")}
"""Attribute of `Scenario` of each key of its file; `_SITE`: keys of `[site]` in the order of `Scenario.site`."""

_SITE = ("length_m", "width_m", "depth_m")


def scenario_table(scenario: Scenario) -> dict[str, Any]:
    """Return the content of a TOML file that describes the scenario, as nested mappings.

    `scenario_from_table` restores the scenario from these mappings, except for the name of its source.
    """
    tables = scenario.reflectors.tables()
    numbers = {key: getattr(scenario, name) for key, name in _NUMBERS.items()}
    return {
        "kind": "scenario",
        **{key: getattr(scenario, name) for key, name in _ABOUT.items()},
        **_route_table(scenario),
        **{key: value for key, value in numbers.items() if value is not None},
        "site": dict(zip(_SITE, scenario.site, strict=True)) | tables.pop("site"),
        **tables,
        "obstacles": [o.model_dump(exclude_none=True) for o in scenario.obstacles],
        "disturbance": scenario.disturbance.model_dump(),
        **sensor_tables(scenario.sensors),
        "uncertainty": scenario.uncertainty.model_dump(),
        "paper": scenario.paper.model_dump(exclude_unset=True),
    }


def _route_table(scenario: Scenario) -> dict[str, Any]:
    """Return the entries that describe the path: those of the scenario's file if they give this path, or all points."""
    path, route = scenario.path, scenario.route
    if route is not None:
        try:
            same = route.path(depth=scenario.depth, cruise=scenario.cruise, cap=scenario.cap, corners=scenario.corners)
        except InputError:
            same = None
        columns = ("waypoints", "rises", "speeds", "kinds")  # each an array or None
        if same is not None and all(np.array_equal(getattr(same, name), getattr(path, name)) for name in columns):
            return route.model_dump(exclude_none=True, exclude_defaults=True, mode="json")
    if any(column is not None for column in (path.rises, path.speeds, path.kinds)):
        problem = "has speeds, depths or kinds of corners that the scenario's route does not give"
        raise InputError(problem, key="path_m", remedy="describe them by legs in a scenario file")
    return {"path_m": path.waypoints.tolist()}


def load_scenario(name_or_path: str) -> Scenario:
    """Load a built-in scenario by name or a scenario file by path; InputError if no vehicle could carry it out.

    Example:
        >>> from surctl.marine.simulation import load_scenario
        >>> scenario = load_scenario("pool-static")
        >>> scenario.title, scenario.cruise, scenario.site, len(scenario.obstacles)
        ('Four drifting cylinders in the pool', 0.15, (3.0, 2.0, 1.0), 4)
    """
    path = pick(str(name_or_path), LIBRARY, what="scenario")
    return scenario_from_table(read_toml(path), source=str(path))


def scenario_from_table(table: dict[str, Any], *, source: str) -> Scenario:
    """Return a scenario from the content of its TOML file; `source` names the file in error messages."""
    model = validate(table, _ScenarioFile, file=source)
    route, path = _route(model, source)
    with mistakes_in(source):
        sensors = sensors_from_tables(model.sonar, model.base_station, model.own_state, depth=model.site.depth_m)
        sensors = replace(sensors, source=source)
    values: dict[str, Any] = {name: getattr(model, key) for key, name in (_ABOUT | _NUMBERS | _TABLES).items()}
    values["time_limit"] = values["time_limit"] or _time_limit(path, model)
    values["site"] = tuple(getattr(model.site, key) for key in _SITE)
    values |= {"source": source, "sensors": sensors, "route": route, "reflectors": _reflectors(model)}
    scenario = Scenario(path=path, **values)
    _check(scenario)
    return scenario


def _route(model: _ScenarioFile, source: str) -> tuple[Route, Path]:
    route = Route(**{name: getattr(model, name) for name in Route.model_fields})
    try:
        path = route.path(
            depth=model.depth_m, cruise=model.cruise_m_per_s, cap=model.cap_m_per_s, corners=model.corners
        )
    except InputError as error:
        raise error.inside(source, "path_m" if error.key == "path" else error.key) from None
    return route, path


def _reflectors(model: _ScenarioFile) -> Reflectors:
    site, walls = model.site, model.site.walls
    each = (walls,) * 4 if not isinstance(walls, WallTable) else (walls.x0, walls.x1, walls.y0, walls.y1)
    return Reflectors(each, site.surface, site.floor, model.reflectors)


def _time_limit(path: Path, model: _ScenarioFile) -> float:
    # chosen: twice the time that the target point takes, 10 s for each visit, and a minute
    visits = np.sum(path.table(visits=model.corners == "visit")[1:-1, 4] == VISIT)
    return float(ceil(2 * path.duration(model.cruise_m_per_s) + 10 * visits + 60))


def _check(scenario: Scenario) -> None:
    source = scenario.source
    if not -scenario.site[2] < scenario.depth < 0:
        remedy = _DEPTHS.format(-scenario.site[2])
        raise InputError("is not in the water", file=source, key="depth_m", value=scenario.depth, remedy=remedy)
    if scenario.depths is not None and not (
        -scenario.site[2] <= scenario.depths[0] < scenario.depth < scenario.depths[1] <= 0
    ):
        problem = f"must be a depth below and a depth above the path's depth of {scenario.depth:g}, both in the water"
        remedy = f"z points up: write [lowest, highest] between {-scenario.site[2]:g} and 0"
        raise InputError(problem, file=source, key="depths_m", value=list(scenario.depths), remedy=remedy)
    if scenario.cruise > scenario.cap:
        problem = f"is above cap_m_per_s = {scenario.cap:g}"
        remedy = "lower it or raise the cap"
        raise InputError(problem, file=source, key="cruise_m_per_s", value=scenario.cruise, remedy=remedy)
    _check_depths(scenario)
    with mistakes_in(source):
        _ = scenario.surfaces
        scenario.sensors.check_floor(scenario.deepest)
    check_spacing(scenario, cap=scenario.cap)
    inside = [("path_m", point) for point in scenario.path.waypoints.tolist()]
    inside += [(f"obstacles.{o.name}.centre_m", list(o.centre_m)) for o in scenario.obstacles]
    for key, (x, y) in inside:
        if not (0 <= x <= scenario.site[0] and 0 <= y <= scenario.site[1]):
            raise InputError(
                "lies outside the site", file=source, key=key, value=[x, y], remedy="correct the point or the site"
            )
    with mistakes_in(source):
        names = [o.name for o in scenario.obstacles]
        check_once(names, "is the name of two obstacles", key="obstacles.name", remedy="rename one")
    _apart([o for o in scenario.obstacles if o.still], scenario)


def _check_depths(scenario: Scenario) -> None:
    if scenario.depths is not None and scenario.path.rises is not None and np.any(scenario.path.rises):
        problem = "cannot be combined with a path that changes its depth"
        remedy = "remove it, or remove depth_m from the legs"
        raise InputError(problem, file=scenario.source, key="depths_m", value=list(scenario.depths), remedy=remedy)
    for k, leg in enumerate(scenario.route.leg if scenario.route else ()):
        _in_water(scenario, f"leg.{k}.depth_m", leg.depth_m)
    if scenario.route and scenario.route.survey:
        _in_water(scenario, "survey.depth_m", scenario.route.survey.depth_m)


def _in_water(scenario: Scenario, key: str, depth: float | None) -> None:
    if depth is not None and not -scenario.site[2] < depth < 0:
        raise InputError(
            "is not in the water", file=scenario.source, key=key, value=depth, remedy=_DEPTHS.format(-scenario.site[2])
        )


def check_spacing(scenario: Scenario, *, cap: float) -> None:
    """Raise InputError for points of a long path that are nearer than a robot at speed `cap` moves in a control period.

    The law's window moves on by at most one waypoint in a control period.
    """
    lengths, least = scenario.path.lengths, cap * PERIOD
    if len(lengths) < MAX_WAYPOINTS or lengths.min() >= least:
        return
    near = int(np.argmin(lengths))
    raise InputError(
        f"is {lengths[near]:.3g} m from the next point of the path, but at the cap of {cap:g} m/s the robot "
        f"moves {least:.3g} m in a control period",
        file=scenario.source or None,
        key="path_m",
        value=[round(float(c), 4) for c in scenario.path.waypoints[near]],
        remedy="leave out points, raise arc_error_m, or lower the cap",
    )


def _apart(still: Sequence[Obstacle], scenario: Scenario) -> None:
    # at zero drift; `findings` checks the drift
    target = scenario.target.tolist()
    for k, obstacle in enumerate(still):
        here = obstacle.heights.crosses(scenario.depth, 0.0)
        if here and obstacle.distance((target[0], target[1])) <= 0:
            problem = f"the target lies inside obstacle {obstacle.name!r}"
            remedy = "move the target or the obstacle"
            raise InputError(problem, file=scenario.source, key="path_m", value=target, remedy=remedy)
        for other in still[k + 1 :]:
            if obstacle.heights.shares(other.heights) and (gap := obstacle.apart(other)) < 0:
                raise InputError(
                    f"overlaps obstacle {obstacle.name!r} by {-gap:.3f} m",
                    file=scenario.source,
                    key=f"obstacles.{other.name}.centre_m",
                    value=list(other.centre_m),
                    remedy="move one of them or make it smaller",
                )


def escaped(name: str) -> str:
    r"""Return a name with control and format characters escaped as in JSON, so that a text with it is one line."""
    return "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in name)
