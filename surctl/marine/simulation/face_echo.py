"""Whether a face of a box returns an echo to a sonar on a hull, for some place and heading at which the hull fits."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import atan2, hypot, inf, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from surctl.marine.sensing import SonarArray
from surctl.marine.simulation.column import BAND
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.simulation.scenario import Scenario

__all__ = ["has_echo"]

Array = NDArray[np.float64]
Point = tuple[float, float]

_OVERLAP = 1e-5  # [m] by which a hull that fits may overlap an obstacle, for hulls that touch it
_COARSE = (9, 9, 13, 7)  # places on the face, angles of incidence, ranges, and directions in the beam
_BEST = 48  # places from which the search goes on
_ROUNDS = 12  # times that it halves its steps


def has_echo(box: Obstacle, normal: Point, *, scenario: Scenario, array: SonarArray, limit: float) -> bool:
    """Return whether the hull fits at a place at which a sonar receives an echo of a face.

    The function searches over the point of the face, the angle of incidence, the range, and the direction of the ray in
    the beam; these determine the place and the heading of the hull. A grid of all four comes first. From the places of
    the grid with the least overlap the search goes on with ever smaller steps, so that it finds narrow places, too.

    Args:
        box: a still box of the scenario.
        normal: outward normal of the face, along x or y.
        scenario: the mission; other still obstacles may hide the face, and none may overlap the hull. They are taken at
            their places at the start.
        array: the sonars on the hull, with its radius.
        limit: largest angle of incidence [rad] at which the face answers, below π/2; 0: it is silent.
    """
    if limit <= 0:
        return False
    low, high = scenario.depth_range
    depths = (low,) if low == high else (low, 0.5 * (low + high), high)
    extent = array.hull_radius + BAND
    return any(
        _Face(box, normal, scenario=scenario, array=array, limit=limit, part=part, z=z).has_place()
        for z in depths
        if box.heights.crosses(z, extent)
        for part in _parts(array)
    )


def _parts(array: SonarArray) -> list[tuple[float, float, float]]:
    # distance of the apex from the centre [m], and ends of the beam from the direction of the apex [rad], of each kind
    parts = {}
    for i, cones in enumerate(array.cones):
        x, y = (array.hull_radius, 0.0) if array.mounts is None else array.mounts[i]
        turned = 0.0 if array.mounts is None else array.azimuths[i] - atan2(y, x)
        for offset, half in cones:
            middle = turned + offset - 2 * pi * round((turned + offset) / (2 * pi))
            part = (hypot(x, y), middle - half, middle + half)
            parts[tuple(round(value, 9) for value in part)] = part
    return list(parts.values())


class _Face:
    # the search at one depth, for one kind of sensor; points of it are rows of four numbers from 0 to 1

    def __init__(
        self,
        box: Obstacle,
        normal: Point,
        *,
        scenario: Scenario,
        array: SonarArray,
        limit: float,
        part: tuple[float, float, float],
        z: float,
    ) -> None:
        assert box.size_m is not None
        self._hull, self._maximum, self._limit, self._part = array.hull_radius, array.maximum, limit, part
        self._site, self._normal = scenario.site[:2], normal
        (nx, ny), (length, width) = normal, box.size_m
        # the face lies a little outside the box
        self._middle = (box.centre_m[0] + nx * (0.5 * length + 1e-6), box.centre_m[1] + ny * (0.5 * width + 1e-6))
        self._along = (abs(ny) * length, abs(nx) * width)
        farthest = self._maximum + part[0] + self._hull
        near = [o for o in scenario.obstacles if o.still and o.heights.crosses(z, self._hull + BAND)]
        self._near = [o for o in near if o.apart(box) <= farthest and self._ahead(o) > -part[0] - self._hull]
        # at most how far the hull's centre moves [m] while a number goes from 0 to 1
        moved = (max(self._along), 2 * limit * (self._maximum + part[0]), 2 * self._maximum)
        self._travel = np.array([*moved, part[0] * (part[2] - part[1])])
        gaps = [max(o.heights.gap(z), 0.0) for o in self._near]
        # horizontal distance that the hull, a sphere, keeps from an obstacle above or below its centre
        self._needed = [sqrt(max(self._hull**2 - gap**2, 0.0)) for gap in gaps]

    def has_place(self) -> bool:
        """Return whether the search finds a place."""
        ahead = _grid(_COARSE[0], 1, 2 * _COARSE[2], 1)
        if np.min(self._overlap(ahead)) <= _OVERLAP:
            return True
        points = _grid(*_COARSE)
        overlap = self._overlap(points)
        steps = 0.5 / (np.array(_COARSE) - 1.0)
        offsets = np.array(list(product((-1.0, 0.0, 1.0), repeat=4)))
        for _ in range(_ROUNDS):
            if np.min(overlap) <= _OVERLAP:
                return True
            # what is left of the search cannot move a hull out of the obstacle
            if np.min(overlap) > 2 * float(steps @ self._travel):
                return False
            best = points[np.argsort(overlap, kind="stable")[:_BEST]]
            points = np.clip((best[:, None] + offsets * steps).reshape(-1, 4), 0.0, 1.0)
            overlap, steps = self._overlap(points), 0.5 * steps
        return bool(np.min(overlap) <= _OVERLAP)

    def _ahead(self, obstacle: Obstacle) -> float:
        # [m] from the plane of the face to the end of the obstacle, positive on the side of the water
        (nx, ny), own = self._normal, obstacle.size_m or (2 * obstacle.rounding,) * 2
        middle = sum(n * (obstacle.centre_m[k] - self._middle[k]) for k, n in enumerate((nx, ny)))
        return middle + 0.5 * (abs(nx) * own[0] + abs(ny) * own[1])

    def _overlap(self, points: Array) -> Array:
        # [m] by which the hull at each place overlaps obstacles or walls
        along, turn, share, aside = points.T
        (nx, ny), (radius, first, last) = self._normal, self._part
        x, y = (self._middle[k] + (along - 0.5) * self._along[k] for k in (0, 1))
        angle = (2 * turn - 1) * self._limit
        c, s = np.cos(angle), np.sin(angle)
        ux, uy = c * nx - s * ny, s * nx + c * ny
        distance = share**2 * self._free(x, y, ux, uy)
        radial = np.arctan2(-uy, -ux) - (first + aside * (last - first))
        x, y = x + distance * ux - radius * np.cos(radial), y + distance * uy - radius * np.sin(radial)
        length, width = self._site
        worst = self._hull - np.minimum.reduce([x, length - x, y, width - y])
        for obstacle, needed in zip(self._near, self._needed, strict=True):
            worst = np.maximum(worst, needed - _distance(obstacle, x, y))
        return np.asarray(worst)

    def _free(self, x: Array, y: Array, ux: Array, uy: Array) -> Array:
        # [m] from each point of the face along its ray to the first obstacle or wall, at most the range of the sonar
        length, width = self._site
        free = np.full(len(x), self._maximum)
        with np.errstate(divide="ignore", invalid="ignore"):
            for place, direction, end in ((x, ux, length), (y, uy, width)):
                wall = np.where(direction > 0, (end - place) / direction, -place / direction)
                free = np.minimum(free, np.where(direction == 0, inf, np.maximum(wall, 0.0)))
            for obstacle in self._near:
                free = np.minimum(free, _hit(obstacle, x, y, ux, uy))
        return free


def _grid(*counts: int) -> Array:
    axes = [np.linspace(0.0, 1.0, n) if n > 1 else np.array([0.5]) for n in counts]
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def _distance(obstacle: Obstacle, x: Array, y: Array) -> Array:
    # `Obstacle.distance` for many points
    own: Sequence[float] = obstacle.size_m or (0.0, 0.0)
    dx, dy = np.abs(x - obstacle.centre_m[0]) - 0.5 * own[0], np.abs(y - obstacle.centre_m[1]) - 0.5 * own[1]
    outside = np.hypot(np.maximum(dx, 0.0), np.maximum(dy, 0.0))
    larger = np.maximum(dx, dy)
    return np.asarray(np.where(larger > 0, outside, larger) - obstacle.rounding)


def _hit(obstacle: Obstacle, x: Array, y: Array, ux: Array, uy: Array) -> Array:
    # [m] along each ray to the obstacle; inf if the ray misses it
    dx, dy = obstacle.centre_m[0] - x, obstacle.centre_m[1] - y
    if obstacle.size_m is None:
        along, across = dx * ux + dy * uy, dx * uy - dy * ux
        square = obstacle.rounding**2 - across**2
        hit = (square >= 0) & (along > 0)
        return np.where(hit, np.maximum(along - np.sqrt(np.maximum(square, 0.0)), 0.0), inf)
    near, far = np.full(len(x), -inf), np.full(len(x), inf)
    for offset, direction, size in ((dx, ux, obstacle.size_m[0]), (dy, uy, obstacle.size_m[1])):
        one, other = (offset - 0.5 * size) / direction, (offset + 0.5 * size) / direction
        beside = np.abs(offset) > 0.5 * size
        one = np.where(direction == 0, np.where(beside, inf, -inf), one)
        other = np.where(direction == 0, np.where(beside, -inf, inf), other)
        near, far = np.maximum(near, np.minimum(one, other)), np.minimum(far, np.maximum(one, other))
    return np.where((near <= far) & (far >= 0), np.maximum(near, 0.0), inf)
