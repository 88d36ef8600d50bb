"""The constants of the allocation of a vehicle's thrusters, in units of the largest thruster force.

The levels of `[allocation] order` need no search over thruster forces: each level is the point of the attainable set
nearest to the desired force, where the values of all higher levels are fixed. The attainable set of the levels so far
is a projection of the vehicle's attainable set, known as half-spaces. The last level, `effort`, is the point nearest to
0 in the null space of the allocation matrix. So every level is a least-distance problem with at most a few unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle import Actuators, attainable

__all__ = ["Design", "LevelRows", "Rows"]

Array = NDArray[np.float64]

_ZERO = 1e-9  # part of a unit normal below which a half-space does not restrict a level
_RANK = 1e-7


@dataclass(frozen=True, eq=False)
class Rows:
    """Constraint rows of one least-distance problem: lower ≤ normals · y ≤ upper.

    lower = −`below` · working − `fixed` · known, upper = `above` · working − `fixed` · known. An absent bound is inf.

    Attributes:
        normals: (m, d) unit normals.
        above, below: (m, n) share of each thruster in the bounds, 0 for a failed thruster.
        fixed: (m, q) part of the rows that acts on the known numbers.
        absent: (m,) whether the lower bound is absent.
    """

    normals: Array
    above: Array
    below: Array
    fixed: Array
    absent: NDArray[np.bool_]

    def part(self, columns: tuple[int, ...]) -> Rows:
        """Return the rows that restrict some of the unknowns, which no row connects to the other unknowns."""
        used = np.abs(self.normals[:, columns]).max(axis=1) > _ZERO
        return Rows(
            self.normals[np.ix_(used, columns)], self.above[used], self.below[used], self.fixed[used], self.absent[used]
        )


@dataclass(frozen=True, eq=False)
class LevelRows:
    """A level of the allocation, or a part of one that the thrusters serve independently of its other axes.

    Attributes:
        name: name of the level. axes: its entries of (F_u, F_v, F_w, F_r).
        known: entries of the higher levels. rows: rows on the level's entries, for the known ones.
    """

    name: str
    axes: tuple[int, ...]
    known: tuple[int, ...]
    rows: Rows


@dataclass(frozen=True)
class Design:
    """The allocation of a vehicle's thrusters, in units of the largest thruster force and of its yaw moment.

    With force components t (N,) of all thrusters, (F_u, F_v, F_w, F_r) = `matrix` t in these units.
    """

    actuators: Actuators

    @cached_property
    def scale(self) -> Array:
        """Units (4,) of F_u, F_v, F_w [N] and F_r [N m]."""
        unit = self.actuators.largest
        return np.array([unit, unit, unit, unit * self.actuators.lever])

    @cached_property
    def matrix(self) -> Array:
        """Allocation matrix (4, N)."""
        return self.actuators.matrix * (self.actuators.largest / self.scale)[:, None]

    @cached_property
    def inverse(self) -> Array:
        """Pseudo-inverse (N, 4) of the allocation matrix: the smallest forces for a force in the matrix's range."""
        return _clean(np.asarray(np.linalg.pinv(self.matrix, rcond=_RANK), dtype=np.float64))

    @cached_property
    def null(self) -> Array:
        """Orthonormal basis (N, d) of the force components that produce neither force nor yaw moment."""
        columns = []
        for group in _groups(np.abs(self.matrix) > _ZERO):
            _, values, rows = np.linalg.svd(self.matrix[:, group])
            inner = np.zeros((self.matrix.shape[1], len(group) - int((values > _RANK).sum())))
            inner[list(group)] = rows[len(group) - inner.shape[1] :].T
            columns.append(inner)
        return _clean(np.hstack(columns))

    @property
    def full(self) -> bool:
        """Whether the thrusters can push in every direction of (F_u, F_v, F_w, F_r)."""
        return bool(self.matrix.shape[1] - self.null.shape[1] == len(self.matrix))

    @cached_property
    def levels(self) -> tuple[LevelRows, ...]:
        """The levels above `effort`, highest priority first."""
        levels: list[LevelRows] = []
        known: tuple[int, ...] = ()
        for name, axes in self.actuators.levels:
            rows = self._level(known, axes)
            groups = _groups(np.abs(rows.normals) > _ZERO)
            levels += [LevelRows(name, tuple(axes[k] for k in group), known, rows.part(group)) for group in groups]
            known += axes
        return tuple(levels)

    def _level(self, known: tuple[int, ...], axes: tuple[int, ...]) -> Rows:
        forces = attainable(self.actuators, known + axes)
        own = forces.normals[:, len(known) :]
        length = np.linalg.norm(own, axis=1)
        used = length > _ZERO
        parts = [part[used] / length[used, None] for part in (own, forces.above, forces.below, forces.normals)]
        normals, above, below, whole = parts
        return Rows(normals, above, below, whole[:, : len(known)], np.zeros(len(normals), dtype=bool))

    @cached_property
    def limits(self) -> Rows:
        """Rows of the thrusters' limits on all force components (N,): segments, or the sides of polygons."""
        actuators, unit = self.actuators, self.actuators.largest
        count, size = len(actuators.thrusters), self.matrix.shape[1]
        normals, above, below, absent = [], [], [], []
        for k, (thruster, where) in enumerate(zip(actuators.thrusters, actuators.slices, strict=True)):
            outward, bounds = thruster.sides
            one = np.eye(count)[k] / unit
            if thruster.swivel is None:
                outward = outward[:1]
            for row, bound in zip(outward, bounds, strict=False):
                wide = np.zeros(size)
                wide[where] = row
                normals.append(wide)
                above.append(one * bound)
                below.append(one * thruster.reverse)
                absent.append(thruster.swivel is not None)
        return Rows(np.array(normals), np.array(above), np.array(below), np.zeros((len(normals), 0)), np.array(absent))

    @cached_property
    def effort(self) -> tuple[tuple[tuple[int, ...], Rows], ...]:
        """The level `effort` in parts that do not affect each other: (coordinates in the null space, limits on them).

        The known numbers of the rows are the forces (4,) of the higher levels.
        """
        rows = self._effort
        return tuple((group, rows.part(group)) for group in _groups(np.abs(rows.normals) > _ZERO))

    @cached_property
    def _effort(self) -> Rows:
        limits = self.limits
        inner = limits.normals @ self.null
        length = np.linalg.norm(inner, axis=1)
        used = length > _ZERO
        inner, above, below, outer = (
            part[used] / length[used, None]
            for part in (inner, limits.above, limits.below, limits.normals @ self.inverse)
        )
        return Rows(inner, above, below, outer, limits.absent[used])


def _groups(connected: NDArray[np.bool_]) -> list[tuple[int, ...]]:
    """Return the groups of columns (of a boolean matrix) that no row with entries in two groups connects."""
    groups: list[set[int]] = []
    for column in range(connected.shape[1]):
        rows = connected[:, column]
        joined = [g for g in groups if (connected[:, list(g)].any(axis=1) & rows).any()]
        groups = [g for g in groups if g not in joined] + [{column}.union(*joined)]
    return [tuple(sorted(group)) for group in sorted(groups, key=min)]


def _clean(matrix: Array) -> Array:
    # entries that are 0 but for rounding would cost instructions
    return np.where(np.abs(matrix) < 1e-14 * np.abs(matrix).max(initial=1.0), 0.0, matrix)
