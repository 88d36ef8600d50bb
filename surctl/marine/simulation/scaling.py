"""Missions scaled to a vehicle: lengths by the hull radius, speeds by the cruise speed, times by their ratio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from surctl.marine.control import Gains
from surctl.marine.control.steering import turning_radius
from surctl.marine.guidance import Path
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.simulation.scenario import Disturbance, PaperFigure, Scenario
from surctl.marine.vehicle import Vehicle, load_vehicle

_LONGER = 1.5  # factor on the scaled time limit: a vehicle that is slow to turn for its size loses time at obstacles
_CAP = 1.1  # speed cap as a share of the cruise speed
_TURN = 0.44 / 0.27  # turning radius over hull radius of the vehicle of tank-static
_HULLS = 20.0  # length of the straight mission in hull lengths


def mission_size(vehicle: Vehicle, gains: Gains, *, cruise: float) -> float:
    """Return the length [m] by which missions are scaled: the hull radius, or more for a craft that cannot sway.

    The craft of `tank-static` can turn on a circle of 1.6 hull radii, at its cruise speed and its spin. A craft without
    sway force needs as many of its own lengths, so its turning radius over 1.6, by the gain `sideslip`, counts if it is
    larger than the hull.
    """
    if vehicle["Fv_max"] > 0:
        return vehicle["radius"]
    return max(vehicle["radius"], turning_radius(vehicle, gains.values, cruise) / _TURN)


def scaled_scenario(scenario: Scenario, vehicle: Vehicle, *, cruise: float, size: float) -> Scenario:
    """Return a scenario scaled to a vehicle and its cruise speed [m/s].

    Lengths are multiplied by the ratio of `size` (see `mission_size`) to the hull radius of the scenario's vehicle,
    speeds by the ratio of the cruise speeds, and times by the ratio of the two; sonars, currents and forces stay as
    they are.
    """
    length = size / load_vehicle(scenario.vehicle)["radius"]
    speed = cruise / scenario.cruise
    time = length / speed
    disturbance = scenario.disturbance
    periods = {name: getattr(disturbance, name) * time for name in ("wave_period_s", "drift_period_s")}
    depths = scenario.depths
    return replace(
        scenario,
        name=f"{scenario.name}-{vehicle.name}",
        source="",
        vehicle=vehicle.name,
        path=Path(length * scenario.path.waypoints),
        depth=length * scenario.depth,
        cruise=cruise,
        cap=speed * scenario.cap,
        arrival_radius=length * scenario.arrival_radius,
        time_limit=_LONGER * time * scenario.time_limit,
        site=(length * scenario.site[0], length * scenario.site[1], length * scenario.site[2]),
        obstacles=tuple(_obstacle(one, length, speed) for one in scenario.obstacles),
        disturbance=disturbance.model_copy(update=periods),
        launch=length * scenario.launch,
        depths=None if depths is None else (length * depths[0], length * depths[1]),
    )


def _mission(name: str, vehicle: Vehicle, corners: ArrayLike, *, cruise: float, size: float) -> Scenario:
    """Return a mission in open water; `corners` are (n, 2) waypoints in hull lengths (twice the size)."""
    points = 2 * size * np.asarray(corners, dtype=float)
    points += 8 * size - points.min(axis=0)
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    side = points.max(axis=0) + 8 * size
    return Scenario(
        name=f"{name}-{vehicle.name}",
        title=name,
        provenance="scaled to the vehicle",
        vehicle=vehicle.name,
        path=Path(points),
        depth=-4 * size,
        cruise=cruise,
        cap=_CAP * cruise,
        arrival_radius=0.5 * size,
        time_limit=3 * length / cruise + 60,
        site=(float(side[0]), float(side[1]), 8 * size),
        obstacles=(),
        disturbance=Disturbance(),
        paper=PaperFigure(),
    )


def straight_mission(vehicle: Vehicle, *, cruise: float, size: float) -> Scenario:
    """Return a straight mission of 20 hull lengths (twice the `mission_size`) in open water."""
    return _mission("straight", vehicle, [(0, 0), (_HULLS, 0)], cruise=cruise, size=size)


def two_leg_mission(vehicle: Vehicle, *, cruise: float, size: float) -> Scenario:
    """Return a mission of two legs of 10 hull lengths each, with a corner of 90 degrees, in open water."""
    half = _HULLS / 2
    return _mission("two-legs", vehicle, [(0, 0), (half, 0), (half, half)], cruise=cruise, size=size)


def disturbed(scenario: Scenario, vehicle: Vehicle, *, share: float) -> Scenario:
    """Return a scenario with waves, slow drift and thrust errors by the seed, each a share of the surge thrust."""
    force = share * vehicle["Fu_max"]
    return replace(
        scenario,
        disturbance=scenario.disturbance.model_copy(
            update={"thrust_error": 2 * share, "wave_force_n": force, "drift_force_n": force}
        ),
    )


def _obstacle(one: Obstacle, length: float, speed: float) -> Obstacle:
    point = {name: getattr(one, name) for name in ("centre_m", "size_m", "to_m")}
    size = {name: getattr(one, name) for name in ("radius_m", "drift_m", "bottom_m", "top_m")}
    update: dict[str, object] = {
        name: tuple(length * x for x in pair) for name, pair in point.items() if pair is not None
    }
    update |= {name: length * value for name, value in size.items() if value is not None}
    update |= {"drift_period_s": one.drift_period_s * length / speed}
    update |= {} if one.speed_m_per_s is None else {"speed_m_per_s": speed * one.speed_m_per_s}
    return one.model_copy(update=update)
