"""Firings of recorded runs with their truth, and how far a map's clearance is from the true clearance.

`record` simulates the present law by sonar and returns its firings: estimated beam, reading, and what answered. `Judge`
compares a map with the still obstacles. In each of 32 directions the hull moves until the map stops it, at most 1 m.
The error is positive, and dangerous, if the hull enters an obstacle on this way: it is the greatest depth. Else the
error is negative: its size is the clearance that the hull still has where the map stops it. The law knows the walls of
the site and the moving obstacles, so a way also ends at a wall, and only still obstacles can be entered.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.marine.control import load_gains
from surctl.marine.sensing import REFLECTORS, LocalMap, SonarArray
from surctl.marine.sensing.sonar.returns import level_range
from surctl.marine.simulation import ECHOES, Scenario, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.marine.world import Disc, Shape, site_walls
from tests.oracles.rays import nearest_in_cone

__all__ = ["EACH", "ECHOES", "RAYS", "Firing", "Judge", "Recorded", "cells", "present", "record", "stops_at"]

DIRECTIONS, REACH, STRIDE = 32, 1.0, 0.01  # number, m, m: directions of the hull, its longest way, and its steps
EACH = 10  # control steps between two comparisons
RECENT = 10.0  # s: a surface that answered within this time counts as measured
NEAR = 0.5  # m: distance from the hull within which it must not be lost
GRAIN = 0.03  # m between two points of a true surface
AGREES = 0.04  # m by which a reading and the surface that answered may differ
BESIDE = 0.06  # m around a point that answered, within which the surface counts as measured
EXPLAINED = 0.06  # m before a known surface from which an echo counts as its own
LAG = 0.1  # s, age of the position in the law's state
AROUND = 0.8  # cells, radius that the law gives a mark
CELLS = 4  # cells of the law's map per hull radius
OVER = 0.03  # m, errors above it are counted

Array = NDArray[np.float64]

_ANGLES = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
RAYS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
"""Directions in which the hull moves, unit vectors (directions, 2) in {E}."""


class Firing(NamedTuple):
    """One firing: its time [s], the apex (2,) [m] and axis [rad] of the beam, the mean reading [m], and what it shows.

    `silent` is a reading without an echo, `blind` one from within the blind range, `known` one that a wall, a moving
    obstacle, the water surface or the floor explains. `surface` holds the indices of the true points that answered.
    """

    time: float
    apex: Array
    axis: float
    reading: float
    silent: bool
    blind: bool
    known: bool
    surface: NDArray[np.int_]


@dataclass
class Recorded:
    """A run of n control steps: firings, true positions (n, 2) [m], and the still obstacles.

    `points` are points of their surfaces (m, 2) [m], which belong to `bodies` (m,); `marks` are the marked cells (., 2)
    [m] of the law's map at every `EACH` steps.
    """

    array: SonarArray
    hull: float
    extent: Array
    dt: float
    true: Array
    firings: list[list[Firing]]
    shapes: list[list[Shape]]
    points: list[Array]
    bodies: NDArray[np.int_]
    marks: list[Array]


class Pose(NamedTuple):
    """Position (2,) [m] and heading [rad] of the robot in {E}, with its velocity (2,) [m/s] and yaw rate [rad/s]."""

    position: Array
    heading: float
    velocity: Array
    turning: float


class Ears:
    """What the sonars of an array hear, two firings a step.

    `walls` are the surfaces that the law knows, and `level` is the range of the echo of water surface or floor [m].
    """

    def __init__(self, array: SonarArray, walls: list[Shape], level: float) -> None:
        self.array, self.walls, self.level = array, walls, level

    def late(self, k: int) -> list[tuple[int, float]]:
        """Return the sonars that fired before control step `k`, and how long before it [s]."""
        return [(self.array.sensor_at(2 * k - n), n * self.array.firing_period) for n in (1, 0) if 2 * k >= n]

    def heard(
        self, k: int, pose: Pose, readings: Array, fresh: NDArray[np.bool_], movers: list[Shape]
    ) -> list[tuple[int, Firing]]:
        """Return the sonars and firings of control step `k`, without the true points that answered.

        Args:
            k: the control step.
            pose: the pose from which the firings are seen.
            readings: (sensors,) mean readings [m].
            fresh: (sensors,) whether a firing has arrived.
            movers: the known moving obstacles.
        """
        array, found = self.array, []
        for sensor, late in self.late(k):
            if not fresh[sensor]:
                continue
            apex = array.apex(
                sensor, position=pose.position - late * pose.velocity, heading=pose.heading - late * pose.turning
            )
            reading = float(readings[sensor])
            known = [nearest_in_cone(s, apex[:2], apex[2], half_angle=array.half_angle) for s in (*self.walls, *movers)]
            silent, blind = reading > array.maximum - 0.1, reading < array.lowest + 1.5 * array.resolution
            explained = not silent and reading > min([*known, self.level]) - EXPLAINED
            corrected = (reading - array.bias) / array.scale
            nothing = np.zeros(0, dtype=int)
            at = np.array(apex[:2])
            found.append(
                (
                    sensor,
                    Firing(
                        array.firing_period * 2 * k - late, at, apex[2], corrected, silent, blind, explained, nothing
                    ),
                )
            )
        return found


def surface_points(shape: Shape) -> Array:
    """Return points (n, 2) [m] on the surface of a disc or of an upright box, at most `GRAIN` apart."""
    if isinstance(shape, Disc):
        angles = np.arange(0, 2 * np.pi, GRAIN / shape.radius)
        return np.array(shape.center) + shape.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    half, sides = np.array(shape.size) / 2, []
    for k in (0, 1):
        along = np.linspace(-half[k], half[k], int(np.ceil(2 * half[k] / GRAIN)) + 1)
        for end in (-half[1 - k], half[1 - k]):
            side = np.full((len(along), 2), end)
            side[:, k] = along
            sides.append(side)
    return np.array(shape.center) + np.concatenate(sides)


def distances(shapes: list[Shape], where: Array) -> Array:
    """Return the signed distance [m] of points (..., 2) to the nearest disc or upright box."""
    least = np.full(where.shape[:-1], np.inf)
    for shape in shapes:
        offset = where - np.array(shape.center)
        if isinstance(shape, Disc):
            away = np.hypot(offset[..., 0], offset[..., 1]) - shape.radius
        else:
            beyond = np.abs(offset) - np.array(shape.size) / 2
            away = np.hypot(*np.moveaxis(np.maximum(beyond, 0), -1, 0)) + np.minimum(beyond.max(axis=-1), 0)
        least = np.minimum(least, away)
    return least


def record(
    name: str, echoes: str, seed: int, *, exact: bool = False, still: bool = False, limit: float | None = None
) -> Recorded:
    """Simulate the law of the library by sonar and return the firings of the run.

    Args:
        name: scenario of the library.
        echoes: name of the echo model.
        seed: seed of the run.
        exact: whether the firings have the true pose instead of the law's estimate.
        still: whether the obstacles do not drift.
        limit: time limit [s]; None: that of the scenario.
    """
    scenario = load_scenario(name)
    scenario = replace(scenario, sensors=scenario.sensors.hearing(echoes), time_limit=limit or scenario.time_limit)
    if still:
        parts = [obstacle.model_copy(update={"drift_m": 0.0}) for obstacle in scenario.obstacles]
        scenario = replace(scenario, obstacles=tuple(parts))
    vehicle = load_vehicle(scenario.vehicle)
    run = simulate(scenario, vehicle, gains=load_gains("default"), sensing="sonar", seed=seed)
    law, rows = run.law, run.record
    hull, after = vehicle["radius"], rows.law_state[1:]
    array = scenario.sensors.array_on(hull)
    rates = np.gradient(rows.eta, law.dt, axis=0)[:-1]
    speed, turning, pose = rates[:, :2], rates[:, 3], rows.eta[:-1, [0, 1, 3]]
    if not exact:
        part = {one: after[:, law.state.slice(f"own_{one}")] for one in ("position", "velocity", "turn")}
        speed, turning = part["velocity"][:, :2], part["turn"][:, 1]
        pose = np.column_stack([part["position"][:, :2] + LAG * speed, part["turn"][:, 0]])
    samples = rows.law_input[:, law.inputs.slice("samples")].reshape(len(rows.time), array.size, -1)
    fresh = rows.law_input[:, law.inputs.slice("fresh")] > 0.5
    readings = np.mean(np.sort(samples, axis=2)[:, :, 1:-1], axis=2)
    extent = np.array(scenario.site[:2])
    walls, level = site_walls(float(extent[1]), float(extent[0])), level_echo(scenario, array, echoes)
    shapes = [[body.shape for body in bodies if not body.moving] for bodies in rows.obstacles]
    points = [[surface_points(shape) for shape in each] for each in shapes]
    bodies = np.repeat(np.arange(len(shapes[0])), [len(each) for each in points[0]])
    surfaces = [np.concatenate(each) for each in points]
    out = Recorded(array, hull, extent, law.dt, rows.eta[:-1, :2], [], shapes, surfaces, bodies, [])
    local_map, ears = LocalMap(dt=law.dt), Ears(array, [*walls], level)
    for k in range(len(after)):
        movers = [body.shape for body in rows.obstacles[k] if body.moving]
        late = dict(ears.late(k))
        firings = []
        for sensor, firing in ears.heard(
            k, Pose(pose[k, :2], pose[k, 2], speed[k], turning[k]), readings[k], fresh[k], movers
        ):
            if not firing.silent and not firing.blind:
                ago = late[sensor]
                true = array.apex(
                    sensor, position=rows.eta[k, :2] - ago * rates[k, :2], heading=rows.eta[k, 3] - ago * rates[k, 3]
                )
                reading = float(readings[k, sensor])
                firing = firing._replace(surface=_answered(surfaces[k], true, reading, array))
            firings.append(firing)
        out.firings.append(firings)
        if k % EACH == 0:
            grid, corner = (after[k, law.state.slice(f"map_{one}")] for one in ("cells", "corner"))
            values, xs, ys = local_map.view(grid, corner, edge=hull / CELLS)
            row, column = np.nonzero(values > 0)
            out.marks.append(np.stack([xs[column], ys[row]], axis=1))
    return out


def level_echo(scenario: Scenario, array: SonarArray, echoes: str) -> float:
    """Return the range [m] of the nearest echo of the water surface and of the floor; inf if both are silent."""
    reflector, depth = REFLECTORS[ECHOES[echoes].level], -scenario.depth
    gaps = {1: depth, -1: scenario.site[2] - depth}
    ranges = [level_range(array, reflector, side=side, gap=gap) for side, gap in gaps.items()]
    return min((one for one in ranges if one is not None), default=np.inf)


def _answered(surface: Array, beam: tuple[float, float, float], reading: float, array: SonarArray) -> NDArray[np.int_]:
    # points of the true surface near the one that answered
    away = surface - np.array(beam[:2])
    far, axis = np.hypot(*away.T), np.array([np.cos(beam[2]), np.sin(beam[2])])
    fits = (away @ axis >= far * np.cos(array.half_angle + 0.03)) & (np.abs(far - reading) < AGREES)
    if not fits.any():
        return np.zeros(0, dtype=int)
    best = np.flatnonzero(fits)[np.argmin(far[fits])]
    return np.flatnonzero(np.hypot(*(surface - surface[best]).T) < BESIDE)


def stops_at(here: Array, points: Array, reach: Array) -> Array:
    """Return the ways (..., directions) [m] of the centre from `here` until it is `reach` (...) [m] from a point.

    `points` is (..., 2) [m]. The result is infinite where the centre passes a point.
    """
    away = points - here
    along, across = away @ RAYS.T, away @ np.stack([-RAYS[:, 1], RAYS[:, 0]])
    room = reach[..., None] ** 2 - across**2
    way = along - np.sqrt(np.maximum(room, 0))
    return np.asarray(np.where((room > 0) & (along > 0), np.maximum(way, 0), np.inf))


def present(run: Recorded) -> Judge:
    """Return the errors of the present law's map: its marked cells, with the radius that the law gives them."""
    judge, around = Judge(run), AROUND * run.hull / CELLS

    def covers(place: Array) -> bool:
        return bool(np.hypot(*(marks - place).T).min(initial=np.inf) < 0.1 + around)

    for k, firings in enumerate(run.firings):
        judge.hear(firings)
        if k % EACH == 0:
            marks = run.marks[k // EACH]
            stops = stops_at(run.true[k], marks, np.full(len(marks), run.hull + around))
            judge.compare(k, stops.min(axis=0, initial=np.inf), covers)
    return judge


class Judge:
    """Errors [m] of a map over a run, in the directions with an obstacle; surfaces not measured lately count apart."""

    def __init__(self, run: Recorded) -> None:
        self.run = run
        self.last = np.full(len(run.bodies), -np.inf)
        self.errors: list[float] = []
        self.unmeasured = self.lost = self.near = 0

    def hear(self, firings: list[Firing]) -> None:
        """Note which true surfaces answered."""
        for firing in firings:
            self.last[firing.surface] = firing.time

    def compare(self, k: int, stops: Array, covers: Callable[[Array], bool]) -> None:
        """Compare a map at control step `k`.

        Args:
            k: the control step.
            stops: (directions,) ways [m] of the hull in the directions `RAYS` until it touches the map.
            covers: function that returns whether the map has a surface at a place (2,) [m].
        """
        run, here = self.run, self.run.true[k]
        room = np.where(RAYS > 0, run.extent - here, here) - run.hull
        walls = (np.maximum(room, 0) / np.maximum(np.abs(RAYS), 1e-9)).min(axis=1)
        way = np.arange(0, REACH + STRIDE, STRIDE)
        places = here + way[None, :, None] * RAYS[:, None, :]
        clearance = distances(run.shapes[k], places) - run.hull
        for d in range(DIRECTIONS):
            on_way = np.where(way <= min(stops[d], walls[d], REACH), clearance[d], np.inf)
            deepest = int(np.argmin(on_way))
            if on_way[deepest] < 0:
                nearest = np.argmin(np.hypot(*(run.points[k] - places[d, deepest]).T))
                if run.dt * k - self.last[nearest] <= RECENT:
                    self.errors.append(-float(on_way[deepest]))
                else:
                    self.unmeasured += 1
            elif stops[d] <= min(walls[d], REACH):
                there = here + stops[d] * RAYS[d]
                left = min(float(distances(run.shapes[k], there)), *there, *(run.extent - there)) - run.hull
                self.errors.append(-max(left, 0.0))
        away = np.hypot(*(run.points[k] - here).T) - run.hull
        for body in np.unique(run.bodies):
            measured = (run.bodies == body) & (run.dt * k - self.last <= RECENT) & (away < NEAR)
            if measured.any():
                self.near += 1
                self.lost += not covers(run.points[k][measured][np.argmin(away[measured])])


def cells(judges: list[Judge]) -> str:
    """Return cells of a Markdown row: directions, median, 99 %, extremes, share above `OVER`, lost, not measured."""
    errors = np.concatenate([np.array(judge.errors) for judge in judges])
    count = {name: sum(getattr(judge, name) for judge in judges) for name in ("lost", "near", "unmeasured")}
    rest = f"{count['lost']} of {count['near']} | {count['unmeasured']}"
    if not len(errors):
        return f"0 | - | - | - | - | - | {rest}"
    cm = 100 * errors
    return (
        f"{len(cm)} | {np.median(cm):+.1f} | {np.quantile(np.abs(cm), 0.99):.1f} | {cm.min():+.1f} | {cm.max():+.1f} "
        f"| {100 * np.mean(errors > OVER):.1f} | {rest}"
    )
