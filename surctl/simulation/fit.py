"""What a scenario cannot do with a vehicle, found before it is flown."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

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


def findings(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Everything found, errors first.

    Raises:
        InputError: the hull starts inside an obstacle.
    """
    build_world(scenario, vehicle, seed=0)
    found = [*_wall_fit(scenario, vehicle), *_obstacle_speeds(scenario), *_targets(scenario, vehicle)]
    found += [*_surface(scenario, vehicle), *_current(scenario)]
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
