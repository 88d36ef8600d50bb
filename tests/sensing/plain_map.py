"""The local map on whole arrays, in the order of operations of its routine: the same bits, in double and in float."""

from __future__ import annotations

import math

import numpy as np

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
from surctl.marine.sensing.mapping.programs import _AT_A_WALL, _FAR, _SLACK

SIZE = sum(size for _, size, _ in READING)


def plain_map(chart, cells, corner, place, walls, slots, *, real=np.float64):
    """(cells, corner, marked, unknown) after one period."""
    with np.errstate(all="ignore"):
        return _Plain(chart, real).step(*(np.asarray(x, dtype=real) for x in (cells, corner, place, walls, slots)))


class _Plain:
    def __init__(self, chart, real):
        self.chart, self.real, self.n = chart, real, chart.side

    def step(self, cells, corner, place, walls, slots):
        chart, real, n = self.chart, self.real, self.n
        hull, edge = place[2:]
        lowest = np.floor(walls[[0, 2]] / edge + real(_SLACK))
        end = -np.floor(real(_SLACK) - walls[[1, 3]] / edge)
        middle = np.floor(place[:2] / edge) - real(n // 2)
        window = _larger(_smaller(middle, end - real(n)), lowest)
        now, was = self._world(window), self._world(corner)
        centre = (now + real(0.5)) * edge
        (x, y), stays = centre - place[:2, None], (was == now).astype(real)
        beside = real(_AT_A_WALL) * edge
        counts = (centre > walls[[0, 2], None] + beside) & (centre < walls[[1, 3], None] - beside)
        old = self._torus(cells) * np.outer(stays[1], stays[0])
        fades = real(chart.dt / chart.mark_time)
        marks = np.where(self._level(old) <= fades, real(0), old - fades)
        value = np.where(old > 0, marks, _smaller(old + real(chart.dt / chart.free_time), real(0)))
        firings = [self._firing(part, centre, edge) for part in np.split(slots, chart.slots)]
        known = real(-chart.known)
        found = [np.any(f["arc"] & (value >= known) & (f["square"] <= f["cutoff"])) for f in firings]
        for f, already in zip(firings, found, strict=True):
            share = np.where(value > 0, real(_OF_A_MARK), real(_OF_THE_UNKNOWN))
            deep = _smaller(real(_INSIDE) * edge + real(_INSIDE_MORE), share * f["beam"])
            strength = self._level(value)
            free = (f["inside"] > deep) & (f["square"] < f["clear"] ** 2)
            free &= (f["clear"] > 0) | (strength <= real(BLIND))
            lasts, remark = self._by_direction(f, value, edge)
            free &= ~lasts
            mark = remark if f["clear"] >= 0 else np.where(strength > real(BLIND), value, real(BLIND))
            value = np.where(free, real(-1), np.where(f["arc"] & ((value >= known) | (not already)), mark, value))
        square = (x * x) + (y * y)[:, None]
        value = np.where(square < hull * hull, real(-1), value)
        ring = hull + real(RING) * edge
        blank = (value >= known) & (value <= 0) & (square > ring * ring) & np.outer(counts[1], counts[0])
        many = self._blocks(value >= known).sum(axis=1) >= chart.held
        marked = self._nearest(self._blocks(value > 0), x, y, square)
        unknown = self._nearest(self._blocks(blank) & many[:, None], x, y, square)
        return self._blocks(value).reshape(-1), window, marked, unknown

    def _world(self, corner):
        at, n = np.arange(self.n, dtype=self.real), self.real(self.n)
        return np.array([at + n * np.floor((low + (n - 1) - at) / n) for low in corner])

    def _firing(self, part, centre, edge):
        ends = np.cumsum([size for _, size, _ in READING])[:-1]
        named = {name: values for (name, _, _), values in zip(READING, np.split(part, ends), strict=True)}
        (ex, ey), (cosine, sine) = named["axis"], named["half"]
        x, y = centre - named["apex"][:, None]
        clear, near, far, reach = (named[name][0] for name in ("clear", "near", "far", "cutoff"))
        along, beside = x * ex + (y * ey)[:, None], x * ey + (-y * ex)[:, None]
        across = np.abs(beside)
        square, beam = x * x + (y * y)[:, None], along * sine
        inside = beam - across * cosine
        arc = (square >= near * near) & (square <= far * abs(far)) & (inside > self.real(-0.5) * edge)
        away = self._bearing(along * ex + beside * ey, along * ey - beside * ex)
        moved = _larger(near - self.real(MOVED) * edge, self.real(0)) if far > 0 else self.real(1e3)
        named = {"beam": beam, "inside": inside, "square": square, "arc": arc, "clear": clear, "cutoff": reach * reach}
        return {**named, "away": away, "moved": square > moved * moved}

    def _level(self, value):
        return value - self.real(2) * np.floor(_larger(value, self.real(0)) / self.real(2))

    def _bearing(self, x, y):
        real = self.real
        share = np.abs(y) / _larger(np.abs(x) + np.abs(y), real(1e-9))
        share = share + real(BENT) * share * (real(1) - share) * (real(2) * share - real(1))
        upper = np.where(x >= 0, share, real(2) - share)
        return np.where(y >= 0, upper, real(4) - upper) * real(DIRECTIONS / 4)

    def _by_direction(self, f, value, edge):
        """Which cells are marks that silence does not clear, and each cell's value after an echo."""
        real, whole, strength = self.real, self.real(DIRECTIONS), self._level(value)
        stored = np.floor(_larger(value, real(0)) / real(2))
        further = np.floor(_larger(stored - real(1), real(0)) / whole)
        first = stored - real(1) - whole * further
        strict = (f["square"] < real(NEAR * NEAR) * (edge * edge)) & ~f["moved"]
        beside = np.where(strict, real(0), real(BESIDE))
        off = (f["away"] - first) - whole * np.floor((f["away"] - first) / whole)
        inside = (stored < 1) | (off <= further + real(1) + beside) | (off >= whole - beside)
        lasts = (strength > real(PROTECTED)) & (stored > DIRECTIONS) & ~inside
        now = _smaller(np.floor(f["away"]), real(DIRECTIONS - 1))
        after = (now - first) - whole * np.floor((now - first) / whole)
        before = whole - after + further
        grown = (after <= further) | ((after <= WIDEST) & (after <= before))
        keep = (stored >= 1) & (strength > real(BLIND)) & (grown | (before <= WIDEST))
        count = np.where(keep, np.where(grown, _larger(after, further), before), real(0))
        at = np.where(keep & grown, first, now)
        return lasts, real(3) + real(2) * (at + whole * count)

    def _nearest(self, which, x, y, square):
        """(sectors · 3,) of each block's first nearest cell; a block by a nearer one alone is replaced."""
        real, sectors, n = self.real, self.chart.sectors, self.n
        dx, dy, away = (self._blocks(np.broadcast_to(a, (n, n))) for a in (x, y[:, None], square))
        away = np.where(which & (away < real(_FAR)), away, real(np.inf))
        first = np.argmin(away, axis=1)[:, None]
        dx, dy, near = (np.take_along_axis(a, first, axis=1)[:, 0] for a in (dx, dy, away))
        limits = [2 * math.pi * (k - 0.5) / sectors for k in range(sectors // 2)]
        sides = np.array([dy * real(math.cos(a)) - dx * real(math.sin(a)) >= 0 for a in limits])
        sides = np.concatenate([sides, ~sides])
        rows = np.tile(np.array([0.0, 0.0, _FAR], dtype=real), (sectors, 1))
        for k, inside in enumerate(sides & ~np.roll(sides, -1, axis=0)):
            best = np.argmin(np.where(inside, near, np.inf))  # the first of the nearest
            if inside[best] and near[best] < real(_FAR):
                rows[k] = dx[best], dy[best], near[best]
        return rows.reshape(-1)

    def _torus(self, cells):
        many, size = self.chart.blocks, self.chart.block
        return cells.reshape(many, many, size, size).swapaxes(1, 2).reshape(self.n, self.n)

    def _blocks(self, torus):
        many, size = self.chart.blocks, self.chart.block
        return torus.reshape(many, size, many, size).swapaxes(1, 2).reshape(many * many, size * size)


def _smaller(a, b):
    return np.where(b < a, b, a)


def _larger(a, b):
    return np.where(a < b, b, a)
