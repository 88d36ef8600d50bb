"""The parameter vector of a law from a mission, gains and a vehicle, and ranges of what changes along the path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.marine.control import Gains
from surctl.marine.control.ports import law_parameters
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.vehicle import Vehicle

VISITED = 0.5
"""Share of the visit distance within which the law counts a corner as visited by its measured position (*chosen*).

The rest of the distance covers the error of that position.
"""


def law_numbers(scenario: Scenario, gains: Gains, model: Vehicle) -> NDArray[np.float64]:
    """Return the law's parameter vector, packed as in `PARAMETERS`, from a scenario, gains and the law's vehicle model.

    If the path is fed (`Path.fed`), waypoints, depth, cruise speed and visits are those of its first window.

    Example:
        >>> from surctl.marine.control import PARAMETERS, load_gains
        >>> from surctl.marine.simulation import law_numbers, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> p = law_numbers(load_scenario("pool-behind"), load_gains("default"), load_vehicle("sur400"))
        >>> [p[PARAMETERS.slice(name)].tolist() for name in ("cruise", "depth", "walls")]
        [[0.15], [-0.15], [0.0, 3.0, 0.0, 2.0]]
    """
    length, width, _ = scenario.site
    return law_parameters(
        gains,
        model,
        path=scenario.path,
        depth=scenario.depth,
        cruise=scenario.cruise,
        cap=scenario.cap,
        walls=(0.0, length, 0.0, width),
        launch=scenario.launch,
        visit=0.0 if scenario.visit is None else VISITED * scenario.visit,
    )


def fed_ranges(scenario: Scenario) -> dict[str, tuple[float, float]]:
    """Return the range of each parameter that changes along the path; empty if the parameters stay as they are."""
    path = scenario.path
    if not path.fed:
        return {}
    speeds = path.table()[1:, 3]
    cruise = [scenario.cruise, *speeds[speeds > 0].tolist()]
    return {
        "waypoints": (float(path.waypoints.min()), float(path.waypoints.max())),
        "depth": scenario.depth_range,
        "cruise": (min(cruise), max(cruise)),
        "visit": (0.0, 0.0 if scenario.visit is None else VISITED * scenario.visit),
    }
