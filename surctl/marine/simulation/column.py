"""The water around a hull: the obstacles that the hull's sonars can detect, and the free water above and below it.

Both simulations of the closed loop, `simulate` and the compiled loop, make two simplifications. First, the beam of a
sonar is a horizontal fan, whose thickness at every range is that of the hull plus the constant `BAND` above and below.
The sonar detects exactly the obstacles that cross this fan. (A real beam is thinner near the hull and thicker far away,
where it would detect a sill that the hull passes over.) Second, an echo sounder measures, without noise, the vertical
distance to the nearest obstacle over or under a disc that is wider than the hull by the constant `FOOTPRINT`. The
limits of the mission's `depths` count as obstacles for the echo sounder.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import numpy as np
from numpy.typing import NDArray

from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.world import Body

__all__ = ["BAND", "FOOTPRINT", "LONGEST", "beside", "column"]

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


def column(
    scenario: Scenario, bodies: Sequence[Body], place: NDArray[np.float64] | Sequence[float], hull: float
) -> tuple[float, float]:
    """Return the free water [m] above and below a hull, within the mission's `depths`; 0 without `depths`.

    Args:
        scenario: the mission.
        bodies: obstacles of the scenario at the present instant.
        place: (3,) position of the hull's centre in the earth frame {E} [m].
        hull: radius of the hull [m].
    """
    if scenario.depths is None:
        return 0.0, 0.0
    x, y, z = (float(value) for value in place)
    above = below = LONGEST
    for body in bodies:
        if body.heights.whole or body.shape.foot(x, y)[0] >= hull + FOOTPRINT:
            continue
        above = min(above, body.heights.bottom - z - hull if body.heights.bottom > z else inf)
        below = min(below, z - hull - body.heights.top if body.heights.top < z else inf)
    lowest, highest = scenario.depths
    return max(0.0, min(above, highest - hull - z)), max(0.0, min(below, z - hull - lowest))
