"""A case as flat numbers, in the layout that `hand/loop.c` and the numba loop read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.marine.simulation import METRICS, Obstacle, Scenario
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle, plant_parameters

__all__ = ["COUNTED", "LUCK", "MOST_OBSTACLES", "OWN_METRICS", "Array", "luck_of", "scene_of", "with_corners"]

Array: TypeAlias = NDArray[np.float64]

MOST_OBSTACLES = 16
LUCK = 3 + 3 * MOST_OBSTACLES  # numbers per run: wave direction and phase, drift direction and phase of every obstacle
_ACTIVITY = (
    "crab_angle_deg", "max_crab_angle_deg", "heading_error_deg", "variation_surge_n_per_s", "variation_sway_n_per_s",
    "variation_heave_n_per_s", "variation_yaw_n_m_per_s", "sign_changes_per_s", "axis_sign_changes_per_s",
    "axis_saturated_share", "energy_n15_s", "wasted_impulse_n_s", "wasted_share",
)  # fmt: skip
COUNTED = [k for k, name in enumerate(METRICS) if name not in _ACTIVITY]
"""Columns of the metrics that the hand-written loops return: all but those of attitude and thrust activity."""

_OWN = [k for k in COUNTED if list(METRICS)[k] != "missed_corner_m"]  # a path of one leg has no corner
OWN_METRICS = len(_OWN)
_WAYPOINTS = 8
_DT = 0.05


def with_corners(own: Array) -> Array:
    """Return metrics (runs, len(METRICS)) from those that the hand-written loops count, (runs, OWN_METRICS)."""
    metrics = np.zeros((len(own), len(METRICS)))
    metrics[:, _OWN] = own
    return metrics


def scene_of(scenario: Scenario, vehicle: Vehicle, *, sonar: bool, projected: bool) -> Array:
    """Return all numbers except gains and random numbers: the members of `Scene` in hand/loop.c, in order."""
    if len(scenario.obstacles) > MOST_OBSTACLES:
        raise ValueError(f"{len(scenario.obstacles)} obstacles; the hand-written loop takes {MOST_OBSTACLES}")
    d = scenario.disturbance
    if any((d.drift_force_n, d.thrust_error, d.thrust_bias)):
        raise ValueError("the hand-written loop knows neither a slow drift nor errors of the thrust")
    if len(scenario.path.waypoints) != 2:
        raise ValueError("the hand-written loop knows paths of one leg")
    length, width, _ = scenario.site
    points = np.zeros((_WAYPOINTS, 2))
    count = len(scenario.path.waypoints)
    points[:count] = scenario.path.waypoints
    plant = plant_parameters(vehicle)
    hull = vehicle["radius"]
    obstacles = np.zeros((MOST_OBSTACLES, 11))
    for row, obstacle in zip(obstacles, scenario.obstacles, strict=False):
        row[:] = _obstacle(obstacle, hull)
    ticks = float(np.ceil(scenario.time_limit / _DT))
    return np.concatenate(
        [
            [_DT, sonar, projected, ticks, *scenario.start, *scenario.target, scenario.depth],
            [scenario.cruise, scenario.cap, scenario.arrival_radius, length, width, count],
            points.reshape(-1),
            plant,
            [hull],
            plant[:16],
            [hull, *d.current_m_per_s, d.wave_force_n, d.wave_period_s],
            [len(scenario.obstacles)],
            obstacles.reshape(-1),
        ]
    )


def luck_of(scenario: Scenario, vehicle: Vehicle, seeds: Sequence[int] | NDArray[np.int_]) -> Array:
    """Return the random numbers before the start, (seeds, LUCK), as the toolkit draws them from the seeds."""
    table = np.zeros((len(seeds), LUCK))
    for row, seed in zip(table, seeds, strict=True):
        world = build_world(scenario, vehicle, seed=int(seed))
        row[:3] = *world.wave_direction, world.wave_phase
        drift = np.column_stack([world.drift_direction, world.drift_phase]).reshape(-1)
        row[3 : 3 + drift.size] = drift
    return table


def _obstacle(o: Obstacle, hull: float) -> list[float]:
    shape = ("box", "cylinder", "moving").index(o.shape)
    radius = o.radius_m or (hull if o.shape == "moving" else 0.0)
    half = [0.5 * edge for edge in o.size_m] if o.size_m is not None else [radius, 0.0]
    to = o.to_m or o.centre_m
    speed = o.speed_m_per_s or 0.0
    return [shape, *o.centre_m, *half, o.drift_m, 2 * np.pi / o.drift_period_s, *to, speed, float(o.removed)]
