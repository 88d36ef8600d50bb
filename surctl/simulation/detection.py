"""What the sonars of a scenario detect for certain: how far, and whether its surfaces answer as the claims assume."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

from surctl.control.beams import floor_range
from surctl.sensing import INCIDENCE_LIMITS, Reflector

if TYPE_CHECKING:
    from surctl.simulation.scenario import Scenario

__all__ = ["detection_range", "unanswered"]

_NAMED = 4  # obstacles that a text names; others are counted
_ANGLE = 1e-9  # [rad] rounding of an angle in degrees


def detection_range(scenario: Scenario) -> float:
    """Return the range [m] up to which a law with sonars takes an echo for an obstacle, at the deepest place.

    That is the longest range of the sonars, or the range from which the law takes echoes for those of the floor.

    Example:
        >>> from surctl.simulation import load_scenario
        >>> from surctl.simulation.detection import detection_range
        >>> detection_range(load_scenario("tank-static"))
        4.5
    """
    equipment = scenario.sensors.equipment
    floor = floor_range(equipment, scenario.deepest)
    return equipment.array.maximum if floor is None else max(min(equipment.array.maximum, floor), 0.0)


def unanswered(scenario: Scenario) -> str:
    """Return which obstacles answer otherwise than the law's surface model says, as text; empty if none does.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.simulation import load_scenario
        >>> from surctl.simulation.detection import unanswered
        >>> pool = load_scenario("pool-static")
        >>> unanswered(replace(pool, sensors=pool.sensors.hearing("webots")))
        'Obstacle1, Obstacle2, Obstacle3 and Obstacle4 are silent beyond 22.5 deg of the normal'
    """
    equipment, surfaces = scenario.sensors.equipment, scenario.surfaces
    within = INCIDENCE_LIMITS[equipment.surface_model]
    usual = Reflector(equipment.array.incidence_limit)
    kinds = (usual,) * len(scenario.obstacles) if surfaces is None else surfaces.obstacles
    groups: dict[str, list[str]] = {}
    for obstacle, reflector in zip(scenario.obstacles, kinds, strict=True):
        limit, weak = reflector.incidence_limit, reflector.cylinder_range if obstacle.shape != "box" else None
        if 0.0 in (limit, weak):
            how = "silent"
        elif weak is not None:
            how = "detected with a probability"
        elif limit is not None and (within is None or limit < within - _ANGLE):
            how = f"silent beyond {degrees(limit):.3g} deg of the normal"
        else:
            continue
        groups.setdefault(how, []).append(" ".join(obstacle.name.split()))
    parts = [f"{_listed(names)} {'is' if len(names) == 1 else 'are'} {how}" for how, names in groups.items()]
    return "; ".join(parts)


def _listed(names: list[str]) -> str:
    *first, last = names if len(names) <= _NAMED else [*names[:_NAMED], f"{len(names) - _NAMED} more"]
    return f"{', '.join(first)} and {last}" if first else last
