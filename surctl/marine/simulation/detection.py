"""What the sonars of a scenario detect for certain: how far, and whether its surfaces answer as the claims assume."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

from surctl.marine.control.beams import floor_range
from surctl.marine.sensing import INCIDENCE_LIMITS, Reflector, SonarArray
from surctl.marine.simulation.finding import escaped

if TYPE_CHECKING:
    from surctl.marine.simulation.scenario import Scenario

__all__ = ["detection_range", "obstacle_reflectors", "unanswered"]

_NAMED = 4  # obstacles that a text names; others are counted
_ANGLE = 1e-9  # [rad] rounding of an angle in degrees


def detection_range(scenario: Scenario) -> float:
    """Return the range [m] up to which a law with sonars takes an echo for an obstacle, at the deepest place.

    That is the longest range of the sonars, or the range from which the law takes echoes for those of the floor.

    Example:
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.simulation.detection import detection_range
        >>> detection_range(load_scenario("tank-static"))
        4.5
    """
    equipment = scenario.sensors.equipment
    floor = floor_range(equipment, scenario.deepest)
    return equipment.array.maximum if floor is None else max(min(equipment.array.maximum, floor), 0.0)


def obstacle_reflectors(scenario: Scenario, array: SonarArray) -> tuple[Reflector, ...]:
    """Return the reflector of each obstacle; without an echo model, as the `incidence_limit` of `array` says."""
    surfaces = scenario.surfaces
    return (Reflector(array.incidence_limit),) * len(scenario.obstacles) if surfaces is None else surfaces.obstacles


def unanswered(scenario: Scenario) -> str:
    """Return which obstacles answer otherwise than the law's surface model says, as text; empty if none does.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.simulation.detection import unanswered
        >>> pool = load_scenario("pool-static")
        >>> unanswered(replace(pool, sensors=pool.sensors.hearing("webots")))
        'Obstacle1, Obstacle2, Obstacle3 and Obstacle4 are silent beyond 22.5 deg of the normal'
    """
    equipment = scenario.sensors.equipment
    within = INCIDENCE_LIMITS[equipment.surface_model]
    groups: dict[str, list[str]] = {}
    for obstacle, reflector in zip(scenario.obstacles, obstacle_reflectors(scenario, equipment.array), strict=True):
        limit, curved = reflector.incidence_limit, obstacle.size_m is None
        if reflector.silent(curved=curved):
            how = "silent"
        elif limit == 0 or (curved and reflector.cylinder_range is not None):
            how = "detected with a probability"
        elif limit is not None and (within is None or limit < within - _ANGLE):
            how = f"silent beyond {degrees(limit):.3g} deg of the normal"
        else:
            continue
        groups.setdefault(how, []).append(escaped(obstacle.name))
    parts = [f"{_listed(names)} {'is' if len(names) == 1 else 'are'} {how}" for how, names in groups.items()]
    return "; ".join(parts)


def _listed(names: list[str]) -> str:
    *first, last = names if len(names) <= _NAMED else [*names[:_NAMED], f"{len(names) - _NAMED} more"]
    return f"{', '.join(first)} and {last}" if first else last
