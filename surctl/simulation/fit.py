"""What a scenario cannot do with a vehicle, found before it is flown."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import atan, degrees, inf, pi, tan
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from surctl.control import Gains, load_gains
from surctl.control.ports import YAW_SHARE
from surctl.errors import InputError
from surctl.sensing import SonarArray
from surctl.sensing.local_map import MIDDLE, LocalMap
from surctl.simulation.scenario import Scenario
from surctl.simulation.world import build_world
from surctl.vehicle import Vehicle

__all__ = ["Finding", "findings"]

_ROOM = 0.02  # [m] two standard deviations of the base station's position: less room than that cannot be kept


@dataclass(frozen=True)
class Finding:
    """One thing that cannot work (`error`) or that a reader should know (`warning`)."""

    level: Literal["error", "warning"]
    key: str
    text: str

    def to_dict(self) -> dict[str, str]:
        """Plain data for JSON."""
        return asdict(self)


def findings(scenario: Scenario, vehicle: Vehicle, *, gains: Gains | None = None) -> list[Finding]:
    """Everything found, errors first.

    Args:
        scenario: the mission.
        vehicle: that flies it.
        gains: of the law that looks around and brakes; default: the built-in ones.

    Raises:
        InputError: the hull starts inside an obstacle.
    """
    build_world(scenario, vehicle, seed=0)
    found = [*_wall_fit(scenario, vehicle), *_obstacle_speeds(scenario), *_targets(scenario, vehicle)]
    found += [*_surface(scenario, vehicle), *_current(scenario)]
    found += _sonars(scenario, vehicle, gains or load_gains("default"))
    return sorted(found, key=lambda f: f.level != "error")


def _wall_fit(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    found = []
    for name, point in (("start", scenario.start), ("target", scenario.target)):
        room = _wall_room(scenario, point) - vehicle["radius"]
        if room < _ROOM:
            where = f"{-room:.3f} m inside a wall" if room < 0 else f"only {room:.3f} m off a wall"
            text = f"the {vehicle['radius']:g} m hull of {vehicle.name} is {where} at the {name}"
            found.append(Finding("error", "path_m", text))
    return found


def _targets(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    found = []
    for obstacle in scenario.obstacles:
        if obstacle.shape == "moving":
            continue
        half = np.array(obstacle.size_m or (0.0, 0.0)) / 2
        beyond = np.maximum(np.abs(scenario.target - np.array(obstacle.centre_m)) - half, 0)
        room = float(np.linalg.norm(beyond)) - (obstacle.radius_m or 0.0) - vehicle["radius"]
        if room <= 0:
            text = (
                f"the target lies {-room:.3f} m too close to obstacle {obstacle.name!r} for the hull of {vehicle.name}"
            )
            found.append(Finding("error", f"obstacles.{obstacle.name}", text))
    return found


def _wall_room(scenario: Scenario, point: NDArray[np.float64]) -> float:
    return min(wall.nearest(point)[0] for wall in scenario.walls)


def _obstacle_speeds(scenario: Scenario) -> list[Finding]:
    return [
        Finding(
            "warning",
            f"obstacles.{o.name}.speed_m_per_s",
            f"obstacle {o.name!r} at {o.speed_m_per_s:g} m/s is faster than the cap of {scenario.cap:g} m/s: "
            "it cannot be outrun, only sidestepped",
        )
        for o in scenario.obstacles
        if o.speed_m_per_s is not None and o.speed_m_per_s > scenario.cap
    ]


def _surface(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    out = vehicle["radius"] + scenario.depth
    if out <= 0:
        return []
    text = f"the hull stands {out:.2f} m out of the water at this depth; the model has no buoyancy (E16)"
    return [Finding("warning", "depth_m", text)]


def _current(scenario: Scenario) -> list[Finding]:
    current = float(np.hypot(*scenario.disturbance.current_m_per_s))
    if current < scenario.cap:
        return []
    text = f"the current of {current:g} m/s is not below the speed cap of {scenario.cap:g} m/s"
    return [Finding("error", "disturbance.current_m_per_s", text)]


def _sonars(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    """What the law that goes only where it has looked cannot do with these sonars."""
    try:
        array = scenario.sensors.on(vehicle["radius"]).array
    except InputError as error:
        return [Finding("error", error.key or "sonar", f"on {vehicle.name}: {error.problem}")]
    split = [i for i, cones in enumerate(array.cones) if len(cones) > 1]
    if split:
        text = f"on {vehicle.name} the hull cuts the beam of sensor {split[0]} in two; the map knows one cone a sensor"
        return [Finding("error", "sonar.mounts_m", text)]
    turning = min(gains["spin"], vehicle.steady_yaw(YAW_SHARE))
    return [*_unseen(array, turning), *_short(scenario, array, vehicle, gains)]


def _unseen(array: SonarArray, turning: float) -> list[Finding]:
    """Directions that no beam shows again before the map has forgotten them, at a yaw rate [rad/s].

    A beam clears its middle alone (`MIDDLE` of its width), and a cleared place is forgotten after `LocalMap.memory`.
    """
    memory, between = LocalMap(dt=0.05).memory, turning * array.cycle
    least = min(2 * atan(MIDDLE * tan(half)) for cones in array.cones for _, half in cones)
    if between > least:
        text = (
            f"between two firings of a sensor the robot turns {degrees(between):.2g}°, and the middle of its beam, "
            f"which clears the map, is {degrees(least):.2g}° wide: a turn leaves places ahead unseen"
        )
        return [Finding("error", "sonar.beam_deg", text)]
    gap = _widest_gap(array)
    wait = gap / turning if turning > 0 else (inf if gap > 0 else 0.0)
    if wait <= memory:
        return []
    text = (
        f"the widest gap between two beams is {degrees(gap):.0f}°, which the robot's turn of {turning:.2g} rad/s "
        f"takes {wait:.1f} s to show; the map forgets after {memory:.1f} s, so that places ahead stay unknown"
    )
    return [Finding("error", "sonar.azimuths_deg", text)]


def _widest_gap(array: SonarArray) -> float:
    """Largest angle [rad] between neighbouring cones, seen from afar; 0 when they leave none."""
    cones = sorted(
        ((azimuth + offset) % (2 * pi), half)
        for azimuth, parts in zip(array.azimuths, array.cones, strict=True)
        for offset, half in parts
    )
    end, widest = cones[0][0] + cones[0][1], 0.0
    for middle, half in [*cones[1:], (cones[0][0] + 2 * pi, cones[0][1])]:
        widest, end = max(widest, middle - half - end), max(end, middle + half)
    return widest


def _short(scenario: Scenario, array: SonarArray, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    """A range within which the law cannot stop from the cruise speed: v²/(2a) + v t, as it brakes."""
    deceleration = gains["brake"] * float(np.min(vehicle.thrust_limit[:2]) / np.max(vehicle.mass[:2]))
    braking = scenario.cruise**2 / (2 * deceleration) + scenario.cruise * gains["reaction"]
    if array.maximum >= braking:
        return []
    text = (
        f"the sonars reach {array.maximum:g} m, and {vehicle.name} takes {braking:.2f} m to stop from the cruise speed "
        f"of {scenario.cruise:g} m/s: with sonars it will not go that fast"
    )
    return [Finding("error", "sonar.maximum_m", text)]
