"""Laws of study 41 that add a cost-to-go to the fan, one for each static scenario; positions are exact.

The cost-to-go is computed once, from the obstacles of the scenario at their centres, on 24 x 24 cells over the site:
the length of the way to the last waypoint, weighted with the distance from the path. In each cell the direction of
descent replaces the desired course; the fan keeps the distance to the obstacles.
"""

from __future__ import annotations

import heapq
from dataclasses import replace
from math import hypot

import casadi as ca
import numpy as np
from laws import fan_decision, length
from numpy.typing import NDArray

from surctl.ir import fold
from surctl.marine.control import Decision, LawSource, Situation, load_gains
from surctl.marine.simulation import Obstacle, Scenario, load_scenario
from surctl.marine.vehicle import load_vehicle

CELLS = 24
FROM_PATH = 1.0  # 1/m, share by which a way at a distance from the path counts as longer
AHEAD = 3  # cells along the way of descent to which the direction of a cell leads
NEAR_GOAL = 0.4  # m, distance at which path following takes over

Array = NDArray[np.float64]


def gap(obstacle: Obstacle, point: Array) -> float:
    """Return the distance [m] from a point to the surface of an obstacle, less than or equal to 0 inside."""
    offset = np.abs(point - np.array(obstacle.centre_m))
    if obstacle.radius_m is not None:
        return float(np.hypot(*offset)) - obstacle.radius_m
    assert obstacle.size_m is not None
    return float(np.hypot(*np.maximum(offset - np.array(obstacle.size_m[:2]) / 2, 0)))


def descent(scenario: Scenario) -> tuple[Array, Array]:
    """Return the cell size (2,) [m] and, for each cell, a row x, y of its centre [m] and the direction of descent."""
    keep = load_vehicle(scenario.vehicle)["radius"] + load_gains("default")["margin"]
    extent = np.array(scenario.site[:2])
    size, way = extent / CELLS, scenario.path.waypoints
    centres = (np.stack(np.meshgrid(*[np.arange(CELLS)] * 2, indexing="ij"), axis=-1) + 0.5) * size
    blocked, weight = np.zeros((CELLS, CELLS), dtype=bool), np.ones((CELLS, CELLS))
    for cell in np.ndindex(CELLS, CELLS):
        point = centres[cell]
        walls = min(*point, *(extent - point))
        blocked[cell] = min([walls, *(gap(o, point) for o in scenario.obstacles)]) < keep
        along = np.diff(way, axis=0)
        share = np.clip(np.sum((point - way[:-1]) * along, axis=1) / np.sum(along**2, axis=1), 0, 1)
        weight[cell] += FROM_PATH * np.min(np.hypot(*(point - way[:-1] - share[:, None] * along).T))
    weight += 100.0 * blocked  # a start or a drifting obstacle may block the own cell: the way out must be known
    cost, successor = to_go(centres, weight, tuple(np.clip((way[-1] / size).astype(int), 0, CELLS - 1)))
    rows = []
    for cell in np.ndindex(CELLS, CELLS):
        target = cell
        for _ in range(AHEAD):
            target = successor.get(target, target)
        towards = centres[target] - centres[cell]
        rows.append([*centres[cell], *(towards / max(hypot(*towards), 1e-9))])
    assert np.isfinite(cost).all()
    return size, np.array(rows)


def to_go(centres: Array, weight: Array, goal: tuple[int, ...]) -> tuple[Array, dict[tuple[int, ...], tuple[int, ...]]]:
    """Return the cost-to-go of each cell to the cell `goal`, and the next cell on its way (Dijkstra, 8 neighbours)."""
    cost: Array = np.full(weight.shape, np.inf)
    successor: dict[tuple[int, ...], tuple[int, ...]] = {}
    cost[goal], queue = 0.0, [(0.0, goal)]
    while queue:
        so_far, cell = heapq.heappop(queue)
        if so_far > cost[cell]:
            continue
        for step in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            other = (cell[0] + step[0], cell[1] + step[1])
            if not all(0 <= k < CELLS for k in other):
                continue
            more = so_far + hypot(*(centres[other] - centres[cell])) * (weight[other] + weight[cell]) / 2
            if more < cost[other]:
                cost[other], successor[other] = more, cell
                heapq.heappush(queue, (more, other))
    return cost, successor


def _law(name: str) -> LawSource:
    scenario = load_scenario(name)
    size, rows = descent(scenario)
    goal = ca.DM(scenario.path.waypoints[-1])

    def decide(s: Situation) -> Decision:
        def blended(total: ca.SX, row: ca.SX) -> ca.SX:
            near = ca.fmax(0, 1 - ca.fabs(row[:2] - s.eta[:2]) / size)
            return total + near[0] * near[1] * row[2:]

        course = fold("descent", blended, ca.SX.zeros(2), ca.SX(rows))
        far = ca.logic_and(length(goal - s.eta[:2]) > NEAR_GOAL, length(course) > 1e-3)
        wanted = s.p["cruise"] * course / ca.fmax(length(course), 1e-3)
        velocity = ca.if_else(far, wanted, s.desired.velocity)
        return fan_decision(s._replace(desired=replace(s.desired, velocity=velocity)))

    return LawSource("fan_to_go", decide, sensing=("truth",))


def pool_static() -> LawSource:
    """Return the fan with the cost-to-go of `pool-static`."""
    return _law("pool-static")


def tank_static() -> LawSource:
    """Return the fan with the cost-to-go of `tank-static`."""
    return _law("tank-static")


def tank_slalom() -> LawSource:
    """Return the fan with the cost-to-go of `tank-slalom`."""
    return _law("tank-slalom")
