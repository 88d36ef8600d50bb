"""A robot that turns and wanders among discs, boxes and walls, its exact ranges, and what the map makes of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from surctl.marine.sensing import SonarArray
from surctl.marine.world import Box, Disc, Wall
from tests.oracles.echoes import true_range
from tests.oracles.local_map import map_step
from tests.oracles.rays import hit, nearest_in_cone

HULL = 0.27
EDGE = HULL / 4
OPEN = (-1e7, 1e7, -1e7, 1e7)  # no wall anywhere
EMPTY = (0.0,) * 8 + (-1.0, 0.0)
SPEED, SPIN = 0.15, 0.27
READING_ERROR, DIAGONAL, EXPLAINS = 0.03, 0.71, 0.5  # m, cells, cells: what the law allows for


class Moment(NamedTuple):
    """After one period: robot (2,), world, map, the nearest (sectors, 3), and surface points heard in this period."""

    time: float
    position: np.ndarray
    shapes: list
    cells: np.ndarray
    corner: np.ndarray
    marked: np.ndarray
    unknown: np.ndarray
    heard: list


def firing(apex, axis, distance, *, half, edge=EDGE, array=SonarArray()):  # noqa: B008, frozen
    """What a range [m] says to the map."""
    blind, reading = distance <= array.minimum, min(max(distance, array.minimum), array.maximum)
    echo = reading < array.maximum - 0.1
    clear = max(reading - READING_ERROR - DIAGONAL * edge, 0.0)
    return (
        *apex,
        math.cos(axis),
        math.sin(axis),
        math.cos(half),
        math.sin(half),
        -max(clear, 1e-3) if blind else clear,
        0.0 if blind else max(reading - READING_ERROR - 0.5 * edge, 0.0),
        reading + READING_ERROR + 0.5 * edge if echo else -1.0,
        reading + EXPLAINS * edge + 0.01,
    )


def world(rng):
    """A room with discs and boxes in it, and a place for the robot."""
    while True:
        length, width = rng.uniform(3, 7), rng.uniform(3, 6)
        shapes = [Wall((0, 0), (1, 0)), Wall((length, 0), (-1, 0)), Wall((0, 0), (0, 1)), Wall((0, width), (0, -1))]
        for _ in range(rng.integers(2, 6)):
            at = (rng.uniform(0.3, length - 0.3), rng.uniform(0.3, width - 0.3))
            size, turn = (rng.uniform(0.3, 1.6), 0.3), rng.uniform(0, 3)
            shapes.append(Disc(at, rng.uniform(0.04, 0.35)) if rng.random() < 0.5 else Box(at, size, turn))
        for _ in range(100):
            place = rng.uniform((0.4, 0.4), (length - 0.4, width - 0.4))
            if clearance(shapes, place) > 0.15:
                return shapes, place


def clearance(shapes, place):
    """From the hull to the nearest surface [m]."""
    return min(shape.nearest(place)[0] for shape in shapes) - HULL


def echoes(shapes, apex, axis, half, distance):
    """Points on surfaces from which the echo came: feet, or where an edge ray hits."""
    found = []
    for shape in shapes:
        if nearest_in_cone(shape, apex, axis, half_angle=half) > distance + 1e-6:
            continue
        away, x, y = shape.foot(*apex)
        if abs(away - distance) < 1e-6:
            found.append((x, y))
        for ray in (axis - half, axis + half):
            ex, ey = math.cos(ray), math.sin(ray)
            if abs(hit(shape, *apex, ex=ex, ey=ey)[0] - distance) < 1e-6:
                found.append((apex[0] + distance * ex, apex[1] + distance * ey))
    return found


def journey(seed, beam, *, chart, seconds=30.0, speed=SPEED, shapes=None, place=None) -> Iterator[Moment]:
    """Fly with four sonars of a full beam angle [°]; a random world unless one is given."""
    rng = np.random.default_rng(seed)
    if shapes is None:
        shapes, place = world(rng)
    array = SonarArray(beam_angle=math.radians(beam))
    heading, course = rng.uniform(-3, 3, 2)
    cells, corner = np.zeros(chart.side**2), np.full(2, 1e6)
    place = np.array(place, dtype=float)
    for tick in range(round(seconds / chart.dt)):
        place, course = _moved(rng, shapes, place, course, speed * chart.dt)
        heading += SPIN * chart.dt
        told, points = [], []
        for k in (array.sensor_at(2 * tick), array.sensor_at(2 * tick + 1)):
            x, y, axis = array.apex(k, position=place, heading=heading)
            away = true_range(array, k, position=place, heading=heading, shapes=shapes)
            told += firing((x, y), axis, away, half=array.half_angle)
            if array.minimum < away < array.maximum - 0.1:
                points += echoes(shapes, (x, y), axis, array.half_angle, away)
        cells, corner, marked, unknown = map_step(chart, cells, corner, [*place, HULL, EDGE], OPEN, told)
        yield Moment(
            tick * chart.dt,
            place,
            shapes,
            cells,
            corner,
            marked.reshape(-1, 3),
            unknown.reshape(-1, 3),
            points,
        )


def _moved(rng, shapes, place, course, way):
    for _ in range(20):
        ahead = place + way * np.array([math.cos(course), math.sin(course)])
        if clearance(shapes, ahead) > 0.05:
            return ahead, course
        course = rng.uniform(-3, 3)
    return place, course


def directions(chart, x, y):
    """The direction in which an offset lies, 0 … sectors − 1."""
    return np.mod(np.floor(np.arctan2(y, x) * chart.sectors / (2 * np.pi) + 0.5), chart.sectors).astype(int)
