"""One update of the local map in NumPy, with the same results as `LocalMap.routine`."""

from __future__ import annotations

from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.marine.sensing.mapping.firing import (
    _INSIDE,
    _INSIDE_MORE,
    _OF_A_MARK,
    _OF_THE_UNKNOWN,
    BENT,
    BESIDE,
    BLIND,
    DIRECTIONS,
    MOVED,
    NEAR,
    PROTECTED,
    READING,
    RING,
    WIDEST,
)
from surctl.marine.sensing.mapping.local_map import LocalMap
from surctl.marine.sensing.mapping.programs import _AT_A_WALL, _FAR, _SLACK

__all__ = ["map_step"]

Vector: TypeAlias = NDArray[np.float64]
T = TypeVar("T", bound=np.generic)

_SIZE = sum(size for _, size, _ in READING)


def map_step(
    local_map: LocalMap, cells: ArrayLike, corner: ArrayLike, place: ArrayLike, walls: ArrayLike, readings: ArrayLike
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return `cells`, `corner`, `marked` and `unknown` after one update period, as `LocalMap.routine` does.

    Args:
        local_map: the map.
        cells: (N²,) values of the cells, block by block as in `LocalMap.ports`.
        corner: (2,) lowest cell of the window along x and y of {E}.
        place: (4,) the robot's position x, y in {E} [m], hull radius [m], edge length of a cell [m].
        walls: (4,) x_min, x_max, y_min, y_max of the site in {E} [m].
        readings: (slots · 10,) firings, each with the 10 numbers of `READING`.

    Raises:
        InputError: if an array does not have the stated size.
    """
    n, edge = local_map.side, float(_sized("place", place, 4)[3])
    old = _sized("corner", corner, 2)
    here, hull = _sized("place", place, 4)[:2], float(_sized("place", place, 4)[2])
    firings = [
        _reading(part) for part in np.split(_sized("readings", readings, local_map.slots * _SIZE), local_map.slots)
    ]
    ends = _sized("walls", walls, 4).reshape(2, 2).T
    window = _window(n, here / edge, ends / edge)
    was, now = (_world(n, low) for low in (old, window))
    x, y = ((now[axis] + 0.5) * edge for axis in (0, 1))
    stays = np.outer(was[1] == now[1], was[0] == now[0])
    value = np.where(stays, _torus(local_map, _sized("cells", cells, n * n)), 0.0)
    value = _faded(value, local_map.dt / local_map.free_time, local_map.dt / local_map.mark_time)
    beams = [_Beam(firing, x, y) for firing in firings]

    known = -local_map.known
    explained = [bool(np.any(beam.on_arc(edge) & (value >= known) & (beam.square <= beam.cutoff**2))) for beam in beams]
    for beam, already in zip(beams, explained, strict=True):
        now = _level(value)
        lasting = (now > PROTECTED) & (_stored(value) > DIRECTIONS)
        moved = (beam.far > 0) & (beam.square > max(beam.near - MOVED * edge, 0.0) ** 2)
        strict = (beam.square < NEAR * NEAR * (edge * edge)) & ~moved
        stays = lasting & ~_includes(value, beam.direction, np.where(strict, 0.0, BESIDE))
        marked = beam.on_arc(edge) & ((value >= known) | (not already))
        remark = _sector_with(value, beam.direction, goes_on=now > BLIND)
        mark = remark if beam.clear >= 0 else np.where(now > BLIND, value, BLIND)
        value = np.where(beam.in_front(edge, now) & ~stays, -1.0, np.where(marked, mark, value))
    dx, dy = np.broadcast_arrays(x - here[0], (y - here[1])[:, None])
    square = dx * dx + dy * dy
    value = np.where(square < hull * hull, -1.0, value)
    across, along = (
        (low + _AT_A_WALL * edge < centres) & (centres < high - _AT_A_WALL * edge)
        for centres, low, high in zip((x, y), *ends, strict=True)
    )
    blank = (value >= known) & (value <= 0) & (square > (hull + RING * edge) ** 2) & np.outer(along, across)
    many = _blocks(local_map, value >= known).sum(axis=1, keepdims=True) >= local_map.held
    blank &= _torus(local_map, np.repeat(many, local_map.block**2, axis=1))
    marks, blanks = (_nearest(local_map, which, dx, dy, square) for which in (value > 0, blank))
    return _blocks(local_map, value).reshape(-1), window, marks, blanks


def _level(value: Vector) -> Vector:
    # strength of a mark or of a cleared cell, see `firing.level`
    return np.asarray(value - 2 * _stored(value))


def _stored(value: Vector) -> Vector:
    return np.asarray(np.floor(np.maximum(value, 0.0) / 2))


def _faded(value: Vector, free: float, mark: float) -> Vector:
    marks = np.where(_level(value) <= mark, 0.0, value - mark)
    return np.where(value > 0, marks, np.minimum(value + free, 0.0))


def _bearing(x: Vector, y: Vector) -> Vector:
    share = np.abs(y) / np.maximum(np.abs(x) + np.abs(y), 1e-9)
    share = share + BENT * share * (1 - share) * (2 * share - 1)
    upper = np.where(x >= 0, share, 2 - share)
    return np.asarray(np.where(y >= 0, upper, 4 - upper) * (DIRECTIONS / 4))


def _includes(value: Vector, direction: Vector, beside: Vector) -> NDArray[np.bool_]:
    """Return whether the sector of each cell includes a direction, or is close to it; see `firing.includes`."""
    stored = _stored(value)
    further = np.floor(np.maximum(stored - 1, 0) / DIRECTIONS)
    off = np.mod(direction - (stored - 1 - DIRECTIONS * further), DIRECTIONS)
    return np.asarray((stored < 1) | (off <= further + 1 + beside) | (off >= DIRECTIONS - beside))


def _sector_with(value: Vector, direction: Vector, *, goes_on: NDArray[np.bool_]) -> Vector:
    """Return the number of a mark in each cell with a direction in its sector; see `firing.sector_with`."""
    stored = _stored(value)
    further = np.floor(np.maximum(stored - 1, 0) / DIRECTIONS)
    first, now = stored - 1 - DIRECTIONS * further, np.minimum(np.floor(direction), DIRECTIONS - 1)
    after = np.mod(now - first, DIRECTIONS)
    before = DIRECTIONS - after + further
    grown = (after <= further) | ((after <= WIDEST) & (after <= before))
    keep = (stored >= 1) & goes_on & (grown | (before <= WIDEST))
    count = np.where(keep, np.where(grown, np.maximum(after, further), before), 0)
    return np.asarray(3 + 2 * (np.where(keep & grown, first, now) + DIRECTIONS * count))


class _Beam:
    # all cells, (N, N), relative to one firing
    def __init__(self, firing: dict[str, Vector], x: Vector, y: Vector) -> None:
        away_x, away_y = x - firing["apex"][0], (y - firing["apex"][1])[:, None]
        ex, ey = firing["axis"]
        self.cosine, self.sine = firing["half"]
        self.clear, self.near, self.far, self.cutoff = (firing[k].item() for k in ("clear", "near", "far", "cutoff"))
        self.along = away_x * ex + away_y * ey
        self.across = np.abs(away_x * ey - away_y * ex)
        self.square = away_x**2 + away_y**2
        self.direction = _bearing(*np.broadcast_arrays(away_x, away_y))

    @property
    def depth(self) -> Vector:
        # distance [m] from the nearer edge of the cone
        return np.asarray(self.along * self.sine - self.across * self.cosine)

    def on_arc(self, edge: float) -> NDArray[np.bool_]:
        # cells that may have caused the echo
        band = (self.square >= self.near**2) & (self.square <= self.far**2) & (self.far >= 0)
        return np.asarray(band & (self.depth > -0.5 * edge))

    def in_front(self, edge: float, value: Vector) -> NDArray[np.bool_]:
        # free cells: nearer than the echo, and as deep in the cone as their value requires
        share = np.where(value > 0, _OF_A_MARK, _OF_THE_UNKNOWN)
        deep = np.minimum(_INSIDE * edge + _INSIDE_MORE, share * self.along * self.sine)
        return np.asarray((self.depth > deep) & (self.square < self.clear**2) & ((self.clear > 0) | (value <= BLIND)))


def _window(n: int, here: Vector, ends: Vector) -> Vector:
    # lowest cell (2,) of the window; `ends`: lower and upper walls (2, 2), in cells
    lowest, end = np.floor(ends[0] + _SLACK), np.ceil(ends[1] - _SLACK)
    return np.asarray(np.maximum(np.minimum(np.floor(here) - n // 2, end - n), lowest))


def _world(n: int, corner: Vector) -> Vector:
    # indices (2, N), along x and y, of the world cells stored at the N indices of the torus
    rank = np.arange(n)
    return np.array([low + np.mod(rank - low, n) for low in corner])


def _torus(local_map: LocalMap, cells: NDArray[T]) -> NDArray[T]:
    # (N, N) indexed by y, then x
    many, size = local_map.blocks, local_map.block
    return cells.reshape(many, many, size, size).swapaxes(1, 2).reshape(local_map.side, local_map.side)


def _blocks(local_map: LocalMap, torus: NDArray[T]) -> NDArray[T]:
    # (blocks², block²)
    many, size = local_map.blocks, local_map.block
    return torus.reshape(many, size, many, size).swapaxes(1, 2).reshape(many * many, size * size)


def _nearest(local_map: LocalMap, which: NDArray[np.bool_], dx: Vector, dy: Vector, square: Vector) -> Vector:
    """Return the nearest cell in each direction, (sectors · 3,); `which` selects the cells that count."""
    held = _blocks(local_map, np.where(which & (square < _FAR), square, _FAR))
    at = (np.arange(len(held)), np.argmin(held, axis=1))
    x, y, far = _blocks(local_map, dx)[at], _blocks(local_map, dy)[at], held[at]
    sector = np.mod(np.floor(np.arctan2(y, x) * local_map.sectors / (2 * np.pi) + 0.5), local_map.sectors)
    rows = np.tile([0.0, 0.0, _FAR], (local_map.sectors, 1))
    for k in range(local_map.sectors):
        here = np.flatnonzero((sector == k) & (far < _FAR))
        if len(here):
            best = here[np.argmin(far[here])]
            rows[k] = x[best], y[best], far[best]
    return rows.reshape(-1)


def _reading(part: Vector) -> dict[str, Vector]:
    ends = np.cumsum([size for _, size, _ in READING])[:-1]
    return {name: values for (name, _, _), values in zip(READING, np.split(part, ends), strict=True)}


def _sized(name: str, values: ArrayLike, size: int) -> Vector:
    array = np.asarray(values, dtype=float)
    if array.shape != (size,):
        raise InputError(f"has shape {array.shape}", key=name, remedy=f"give ({size},)")
    return array
