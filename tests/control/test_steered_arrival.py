"""Craft without sway force arrive at a goal that lies beside them, inside their turning circle, or in a current."""

from __future__ import annotations

import numpy as np
import pytest

from surctl.marine.control import load_gains
from surctl.marine.control.steered import STEERED_GAINS
from surctl.marine.control.steering import turning_radius
from surctl.marine.simulation import Case, simulate_batch
from surctl.marine.vehicle import load_vehicle
from tests.craft import CRUISE, mission

GAINS = load_gains("default", own=STEERED_GAINS)


@pytest.mark.parametrize(
    ("name", "current", "turned", "seconds"),
    [
        ("otter", 0.4, 0.0, 60.0),  # stood still in the current, and turned beside the goal
        ("lauv", 0.38, 84.0, 450.0),  # drifted away with the current: no water passed the rudder
    ],
)
def test_a_goal_beside_the_craft_is_reached(name: str, current: float, turned: float, seconds: float) -> None:
    craft, gains = load_vehicle(name), GAINS if name == "otter" else GAINS.with_values({"k_psi": 1.3, "k_r": 4.0})
    r = turning_radius(craft, gains.values, CRUISE[name])
    end = 0.9 * r * np.array([np.cos(np.radians(turned)), np.sin(np.radians(turned))])
    path = [[20 * r, 20 * r], [25 * r, 20 * r], (np.array([25 * r, 20 * r]) + end).tolist()]
    water = {"current_m_per_s": [0.0, current]}
    scenario = mission(
        path, name, size=(60 * r, 60 * r), time=seconds, arrival_m=0.1 if name == "otter" else 0.3, disturbance=water
    )
    batch = simulate_batch(Case(scenario, craft, gains))
    assert batch.column("reached")[0] == 1
