"""What a hull meets above, below and beside it: which obstacles its sonars hear, and the free water over and under it.

Two simplifications, the same in both loops. A sonar's beam is a fan as thick as the hull and `BAND` more above and
below, at every range: it hears what crosses that, and nothing else. (A real beam is thinner at the hull and thicker
far off: there it would hear a sill that the hull passes over.) An echo sounder hears, without noise, the nearest that
stands over or under a disc `FOOTPRINT` wider than the hull, the surface and the floor among it.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import numpy as np
from numpy.typing import NDArray

from surctl.simulation.scenario import Scenario
from surctl.simulation.world import Body

__all__ = ["BAND", "FOOTPRINT", "LONGEST", "beside", "column"]

BAND = 0.05
"""[m] by which a sonar's fan is thicker than the hull, above and below (*chosen*)."""

FOOTPRINT = 0.03
"""[m] by which an echo sounder's footprint is wider than the hull, at every range (*chosen*: less than the stand-off
from a wall, along which the robot may go up and down; what is nearer beside it, its sonars hear)."""

LONGEST = 10.0
"""[m] from the hull that an echo sounder hears (*chosen*)."""


def beside(bodies: Sequence[Body], z: float, hull: float) -> list[Body]:
    """Those of the obstacles that a hull of this radius [m] at z meets when it goes on horizontally."""
    return [body for body in bodies if body.heights.crosses(z, hull + BAND)]


def column(
    scenario: Scenario, bodies: Sequence[Body], place: NDArray[np.float64] | Sequence[float], hull: float
) -> tuple[float, float]:
    """Free water above and below a hull [m], no further than the mission's `depths` allow; 0 without them.

    Args:
        scenario: the mission.
        bodies: obstacles at this instant.
        place: (3,) of the hull's centre in {E} [m].
        hull: its radius [m].
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
