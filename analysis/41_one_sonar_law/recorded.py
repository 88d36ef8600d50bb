"""Firings of recorded runs with their truth, and how far a map's clearance is from the true clearance.

`record` simulates the present law by sonar and returns its firings: estimated and true beam, reading, and the surfaces.
`Judge` compares a map, as points with a radius, with the still obstacles. In each of 32 directions the hull moves until
the map stops it. The error is positive, and dangerous, if the hull would have entered an obstacle on this way: then it
is the greatest depth. Else the error is negative: the distance that is still free where the map stops the hull.
Walls of the site and moving obstacles are known to the law; they do not count as obstacles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.marine.control import load_gains
from surctl.marine.sensing import LocalMap, SonarArray, map_view
from surctl.marine.simulation import load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.marine.world import Disc, Shape, site_walls

DIRECTIONS, REACH, STRIDE = 32, 1.0, 0.01  # number, m, m: directions of the hull, its longest way, and its steps
EACH = 10  # control steps between two comparisons
RECENT = 10.0  # s: a surface that answered within this time must not be lost
NEAR = 0.5  # m: distance from the hull within which it must not be lost
GRAIN = 0.03  # m between two points of a true surface
AGREES = 0.04  # m by which a reading and the surface that answered may differ
BESIDE = 0.1  # m around a point that answered, within which the surface counts as measured
EXPLAINED = 0.06  # m before a known surface from which an echo counts as its own
LAG = 0.1  # s, age of the position in the law's state

Array = NDArray[np.float64]

_ANGLES = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
RAYS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
"""Directions in which the hull moves, unit vectors (directions, 2) in {E}."""


class Firing(NamedTuple):
    """One firing: its time [s], the estimated apex (2,) [m] and axis [rad], the mean reading [m], and what it shows.

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
    """A run: firings by control step, estimated and true position (n, 2) [m], and the still obstacles by step."""

    array: SonarArray
    hull: float
    extent: Array
    firings: list[list[Firing]]
    here: Array
    true: Array
    shapes: list[list[Shape]]
    points: list[Array]
    marks: list[Array]
    around: float
    outcome: str
    bodies: NDArray[np.int_] = field(default_factory=lambda: np.zeros(0, dtype=int))


def surface_points(shape: Shape) -> Array:
    """Return points (n, 2) [m] on the surface of a disc or an upright box, at most `GRAIN` apart."""
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


def record(name: str, echoes: str, seed: int, *, limit: float | None = None) -> Recorded:
    """Simulate the law of the library by sonar and return the firings of the run."""
    scenario = load_scenario(name)
    scenario = replace(scenario, sensors=scenario.sensors.hearing(echoes), time_limit=limit or scenario.time_limit)
    vehicle = load_vehicle(scenario.vehicle)
    run = simulate(scenario, vehicle, gains=load_gains("default"), sensing="sonar", seed=seed)
    law, rows = run.law, run.record
    hull, extent = vehicle["radius"], np.array(scenario.site[:2])
    array = scenario.sensors.array_on(hull)
    after = rows.law_state[1:]

    def state(entry: str) -> Array:
        return np.asarray(after[:, law.state.slice(entry)])

    velocity, turn = state("own_velocity")[:, :2], state("own_turn")
    here = state("own_position")[:, :2] + LAG * velocity
    samples = rows.law_input[:, law.inputs.slice("samples")].reshape(len(rows.time), array.size, -1)
    fresh = rows.law_input[:, law.inputs.slice("fresh")] > 0.5
    readings = np.mean(np.sort(samples, axis=2)[:, :, 1:-1], axis=2)
    walls = site_walls(float(extent[1]), float(extent[0]))
    level = [np.inf] if echoes in ("ideal", "webots") else [-scenario.depth, scenario.depth + scenario.site[2]]
    steepest = np.sin(array.steepest(1))
    local_map = LocalMap(dt=law.dt, slots=2, sectors=16)
    out = Recorded(array, hull, extent, [], here, rows.eta[:-1, :2], [], [], [], 0.8 * hull / 4, run.metrics.stopped_because)
    for k in range(len(after)):
        still = [body.shape for body in rows.obstacles[k] if not body.moving]
        movers = [body.shape for body in rows.obstacles[k] if body.moving]
        points = [surface_points(shape) for shape in still]
        out.bodies = np.repeat(np.arange(len(points)), [len(p) for p in points])
        surface = np.concatenate(points) if points else np.zeros((0, 2))
        firings = []
        for ago in (1, 0):
            sensor = array.sensor_at(2 * k - ago)
            if not fresh[k, sensor] or 2 * k < ago:
                continue
            late = ago * array.firing_period
            heading = turn[k, 0] - late * turn[k, 1]
            x, y, axis = array.apex(sensor, position=here[k] - late * velocity[k], heading=heading)
            reading = float(readings[k, sensor])
            expected = min(
                (s.nearest_in_cone((x, y), axis, half_angle=array.half_angle) for s in (*walls, *movers)), default=np.inf
            )
            silent = reading > array.maximum - 0.1
            blind = reading < array.lowest + 1.5 * array.resolution
            known = not silent and reading > min([expected, *(gap / steepest for gap in level)]) - EXPLAINED
            true = array.apex(sensor, position=rows.eta[k, :2] - late * rows.nu[k, 0], heading=rows.eta[k, 3])
            heard = _answered(surface, true, reading, array) if not silent and not blind else np.zeros(0, dtype=int)
            corrected = (reading - array.bias) / array.scale
            firings.append(
                Firing(rows.time[k] - late, np.array([x, y]), axis, corrected, silent, blind, known, heard)
            )
        out.firings.append(firings)
        out.shapes.append(still)
        out.points.append(surface)
        if k % EACH == 0:
            cells, corner = (after[k, law.state.slice(f"map_{part}")] for part in ("cells", "corner"))
            values, xs, ys = map_view(local_map, cells, corner, edge=hull / 4)
            row, column = np.nonzero(values > 0)
            out.marks.append(np.stack([xs[column], ys[row]], axis=1))
    return out


def _answered(surface: Array, beam: tuple[float, float, float], reading: float, array: SonarArray) -> NDArray[np.int_]:
    # points of the true surface near the one that answered
    if not len(surface):
        return np.zeros(0, dtype=int)
    away = surface - np.array(beam[:2])
    far, axis = np.hypot(*away.T), np.array([np.cos(beam[2]), np.sin(beam[2])])
    inside = away @ axis >= far * np.cos(array.half_angle + 0.03)
    fits = inside & (np.abs(far - reading) < AGREES)
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
    """Return the errors of the present law's map: the marked cells, with the radius that the law gives them."""
    judge = Judge(run)
    for k, firings in enumerate(run.firings):
        judge.hear(firings)
        if k % EACH == 0:
            marks = run.marks[k // EACH]
            stops = stops_at(run.true[k], marks, np.full(len(marks), run.hull + run.around)).min(axis=0, initial=np.inf)
            judge.compare(k, stops, lambda place, at=marks: np.hypot(*(at - place).T).min(initial=np.inf) < 0.1 + run.around)
    return judge


class Judge:
    """Errors of a map over a run, in directions with an obstacle; surfaces never measured count apart."""

    def __init__(self, run: Recorded) -> None:
        self.run = run
        self.last = np.full(len(run.points[0]), -np.inf)
        self.errors: list[float] = []
        self.unheard: list[float] = []
        self.lost = self.near = 0
        self.longest = 0
        self.row: dict[int, int] = {}

    def hear(self, firings: list[Firing]) -> None:
        """Note which true surfaces answered."""
        for firing in firings:
            self.last[firing.surface] = firing.time

    def compare(self, k: int, stops: Array, covers: Callable[[Array], bool]) -> None:
        """Compare a map at control step `k`: its `stops` and whether it `covers` a place (2,) [m] of a true surface.

        `stops` (directions,) [m] are the ways of the hull in the directions `RAYS` until it touches the map.
        """
        run, here = self.run, self.run.true[k]
        time = k * 0.05
        walls = self._walls(here)
        ends = np.minimum(np.minimum(stops, walls), REACH)
        way = np.arange(0, REACH + STRIDE, STRIDE)
        places = here + way[None, :, None] * RAYS[:, None, :]
        free = distances(run.shapes[k], places) - run.hull
        for d in range(DIRECTIONS):
            on_way = way <= ends[d]
            depth = -free[d, on_way].min(initial=np.inf)
            if depth > 0:
                at = places[d, np.argmin(np.where(on_way, free[d], np.inf))]
                nearest = np.argmin(np.hypot(*(run.points[k] - at).T))
                recent = time - self.last[nearest] <= RECENT
                (self.errors if recent else self.unheard).append(float(depth))
            elif stops[d] <= min(walls[d], REACH):
                there = here + stops[d] * RAYS[d]
                room = min(float(distances(run.shapes[k], there)), *there, *(run.extent - there)) - run.hull
                self.errors.append(-max(room, 0.0))
        self._lost(k, time, covers)

    def _walls(self, here: Array) -> Array:
        # way [m] until the hull touches a wall of the site
        room = np.where(RAYS > 0, self.run.extent - here, here) - self.run.hull
        return np.asarray((np.maximum(room, 0) / np.maximum(np.abs(RAYS), 1e-9)).min(axis=1))

    def _lost(self, k: int, time: float, covers: Callable[[Array], bool]) -> None:
        # obstacles near the hull that answered lately and have no point of the map beside their nearest measured place
        run = self.run
        away = np.hypot(*(run.points[k] - run.true[k]).T) - run.hull
        for body in range(run.bodies.max(initial=-1) + 1):
            seen = (run.bodies == body) & (time - self.last <= RECENT) & (away < NEAR)
            if not seen.any():
                continue
            place = run.points[k][seen][np.argmin(away[seen])]
            lost = not covers(place)
            self.near += 1
            self.row[body] = self.row.get(body, 0) + 1 if lost else 0
            self.lost += lost
            self.longest = max(self.longest, self.row[body])


def told(judges: list[Judge]) -> str:
    """Return the cells of a Markdown row for the runs: directions, median, 99 %, worst of both signs, lost, unheard."""
    errors = np.concatenate([np.array(judge.errors) for judge in judges])
    unheard = sum(len(judge.unheard) for judge in judges)
    if not len(errors):
        return f"0 | - | - | - | - | - | - | {unheard}"
    size = np.abs(errors)
    lost, near = sum(j.lost for j in judges), sum(j.near for j in judges)
    return (
        f"{len(errors)} | {100 * np.median(errors):+.1f} | {100 * np.quantile(size, 0.99):.1f} | {100 * errors.min():+.1f} "
        f"| {100 * errors.max():+.1f} | {100 * np.mean(errors > 0.03):.2f} | {lost} of {near} | {unheard}"
    )
