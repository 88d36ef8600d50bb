"""The water around a hull: the obstacles that the hull's sonars can detect, and the free water above and below it.

The closed loop makes two simplifications. First, the beam of a
sonar is a horizontal fan, whose thickness at every range is that of the hull plus the constant `BAND` above and below.
The sonar detects exactly the obstacles that cross this fan. (A real beam is thinner near the hull and thicker far away,
where it would detect a sill that the hull passes over.) Second, an echo sounder measures, without noise, the vertical
distance to the nearest obstacle over or under a disc that is wider than the hull by the constant `FOOTPRINT`. The
limits of the mission's `depths` count as obstacles for the echo sounder.
"""

from __future__ import annotations

from collections.abc import Sequence

from surctl.marine.simulation.world import Body

__all__ = ["BAND", "FOOTPRINT", "LONGEST", "beside"]

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
