"""The attainable set: every (F_u, F_v, F_w, F_r) that the thrusters of a vehicle can produce.

The set is a sum of segments and polygons (a zonotope, if no thruster swivels), described by half-spaces. A facet is
spanned by edges of the summands, so its normal is orthogonal to three independent edges; the bound is the sum of the
largest values that the thrusters reach along this normal. The same normals describe the set after any thruster fails.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.marine.vehicle.thrusters import Actuators

__all__ = ["Attainable", "attainable"]

Array = NDArray[np.float64]

_PARALLEL = 1e-7  # sine of the angle below which two edges count as parallel
_FLAT = 1e-9  # relative determinant below which edges count as dependent
_MOST = 60_000  # combinations of edges


@dataclass(frozen=True, eq=False)
class Attainable:
    """Half-spaces of the attainable set, or of its projection on some of the axes (F_u, F_v, F_w, F_r).

    Attributes:
        axes: entries of (F_u, F_v, F_w, F_r) that the set contains.
        normals: (m, q) unit normals, for forces in units of `unit` and moments in units of `unit` times `lever`.
        above, below: (m, n) largest value of ± normal · wrench that each thruster contributes, in the same units.
        unit: unit of force [N]. lever: unit of length [m].
    """

    axes: tuple[int, ...]
    normals: Array
    above: Array
    below: Array
    unit: float
    lever: float

    @property
    def scale(self) -> Array:
        """Units (q,) of the axes [N, N m]."""
        return self.unit * np.where(np.array(self.axes) == 3, self.lever, 1.0)

    def bounds(self, working: ArrayLike | None = None) -> tuple[Array, Array]:
        """Return lower and upper bounds (m,) of normals · wrench, with the thrusters for which `working` (n,) is 1."""
        on = np.ones(self.above.shape[1]) if working is None else np.asarray(working, dtype=float)
        return -self.below @ on, self.above @ on

    def contains(self, wrench: ArrayLike, *, working: ArrayLike | None = None, tolerance: float = 1e-9) -> bool:
        """Return whether the thrusters can produce (F_u, F_v, F_w, F_r) (4,) [N, N m]."""
        point = np.asarray(wrench, dtype=float)[list(self.axes)] / self.scale
        low, high = self.bounds(working)
        value = self.normals @ point
        return bool(np.all(value >= low - tolerance) and np.all(value <= high + tolerance))

    def extent(self, direction: ArrayLike, *, working: ArrayLike | None = None) -> float:
        """Return the largest s for which s times the direction (4,) is attainable.

        The direction is in N and N m; the result is 0 if no positive multiple is attainable.
        """
        rate = self.normals @ (np.asarray(direction, dtype=float)[list(self.axes)] / self.scale)
        low, high = self.bounds(working)
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.where(rate > _FLAT, high / rate, np.where(rate < -_FLAT, low / rate, np.inf))
        return max(0.0, float(ends.min()))

    def intervals(self, *, working: ArrayLike | None = None) -> Array:
        """Return (q, 2): least and largest force or moment on each axis alone, with 0 on all other axes [N, N m]."""
        ends = [[-self.extent(-axis, working=working), self.extent(axis, working=working)] for axis in np.eye(4)]
        return np.array(ends)[list(self.axes)]

    def box_share(self, limits: ArrayLike, *, working: ArrayLike | None = None) -> float:
        """Return the largest s for which the box |F_u| ≤ s·limits[0], … lies in the set; limits (4,) in N and N m.

        The thrusters can produce every combination of axis forces in the box at once. This linear programme has a
        closed form: s is the smallest ratio of a half-space's bound to the largest value of the box along its normal.
        """
        most = np.abs(self.normals) @ (np.asarray(limits, dtype=float)[list(self.axes)] / self.scale)
        low, high = self.bounds(working)
        slack = np.minimum(high, -low)
        used = most > _FLAT
        share = float((slack[used] / most[used]).min()) if used.any() else float("inf")
        return share if share > _FLAT else 0.0

    def planar(self, *, yaw: float = 0.0, working: ArrayLike | None = None) -> Array:
        """Return the corners (k, 2) of all (F_u, F_v) [N] with F_w = 0 and a given F_r [N m], counter-clockwise.

        The result has no corners if the thrusters cannot produce this yaw moment without a heave force.
        """
        low, high = self.bounds(working)
        turn = self.normals[:, 3] * (yaw / self.scale[3])
        return _polygon(self.normals[:, :2], low - turn, high - turn) * self.unit

    def outline(self, *, working: ArrayLike | None = None) -> Array:
        """Return the corners (k, 2) [N, N m] of a set with two axes, counter-clockwise."""
        return _polygon(self.normals, *self.bounds(working)) * self.scale


def _polygon(normals: Array, low: Array, high: Array) -> Array:
    """Return the corners (k, 2) of low ≤ normals · y ≤ high, counter-clockwise; none if the set is empty."""
    rows = np.vstack([normals, -normals])
    ends = np.concatenate([high, -low])
    flat = np.linalg.norm(rows, axis=1) < _FLAT
    if np.any(ends[flat] < -_FLAT):
        return np.zeros((0, 2))
    rows, ends = rows[~flat], ends[~flat]
    first, second = (k.ravel() for k in np.triu_indices(len(rows), 1))
    area = rows[first, 0] * rows[second, 1] - rows[first, 1] * rows[second, 0]
    crossing = np.abs(area) > _FLAT
    first, second, area = first[crossing], second[crossing], area[crossing]
    x = (ends[first] * rows[second, 1] - ends[second] * rows[first, 1]) / area
    y = (rows[first, 0] * ends[second] - rows[second, 0] * ends[first]) / area
    points = np.column_stack([x, y])
    points = points[np.all(points @ rows.T <= ends + _FLAT, axis=1)]
    points = np.unique(points.round(9), axis=0)
    if len(points) == 0:
        return points
    middle = points - points.mean(axis=0)
    return np.asarray(points[np.argsort(np.arctan2(middle[:, 1], middle[:, 0]))])


def attainable(actuators: Actuators, axes: tuple[int, ...] = (0, 1, 2, 3)) -> Attainable:
    """Return the attainable set of the thrusters, projected on some axes of (F_u, F_v, F_w, F_r).

    Example:
        >>> from surctl.marine.vehicle import attainable, load_vehicle
        >>> forces = attainable(load_vehicle("bluerov2-heavy").actuators)
        >>> forces.intervals().round(1).tolist()[2], forces.contains([100.0, 0.0, 0.0, 0.0])
        ([-138.0, 177.2], True)
    """
    unit, lever = actuators.largest, actuators.lever
    matrix = actuators.matrix / np.array([1.0, 1.0, 1.0, lever])[:, None]
    summands = [matrix[np.ix_(axes, range(s.start, s.stop))] for s in actuators.slices]
    corners = [thruster.corners / unit @ part.T for thruster, part in zip(actuators.thrusters, summands, strict=True)]
    edges = np.vstack([_edges(points) for points in corners])
    normals = _normals(_distinct(edges), len(axes))
    values = [points @ normals.T for points in corners]  # (corners, m)
    above = np.column_stack([value.max(axis=0) for value in values])
    below = np.column_stack([(-value).max(axis=0) for value in values])
    return Attainable(axes, normals, above, below, unit, lever)


def _edges(points: Array) -> Array:
    return points[1:] - points[:1] if len(points) == 2 else np.roll(points, -1, axis=0) - points


def _distinct(edges: Array) -> Array:
    """Return the directions of the edges as unit vectors, without parallel ones."""
    lengths = np.linalg.norm(edges, axis=1)
    units = edges[lengths > _FLAT] / lengths[lengths > _FLAT, None]
    chosen: list[Array] = []
    for unit in units:
        if all(np.linalg.norm(unit - (unit @ other) * other) > _PARALLEL for other in chosen):
            chosen.append(unit)
    return np.array(chosen).reshape(-1, edges.shape[1])


def _normals(edges: Array, q: int) -> Array:
    """Return unit normals (m, q) of all hyperplanes that q − 1 independent edges span, one of each opposite pair.

    Directions without any edge are added as edges of length 0, so that the set is bounded in them too.
    """
    if q == 1:
        return np.ones((1, 1))
    _, values, rows = np.linalg.svd(edges if len(edges) else np.zeros((1, q)))
    rank = int((values > _PARALLEL).sum())
    edges = np.vstack([edges, rows[rank:]])
    if comb(len(edges), q - 1) > _MOST:
        raise InputError(
            f"push in {len(edges)} different directions, too many for the attainable set",
            key="thruster",
            remedy="describe fewer or equal thrusters, or fixed directions in place of swivels",
        )
    groups = np.array(list(combinations(range(len(edges)), q - 1)))
    _, values, rows = np.linalg.svd(edges[groups])
    normals = rows[values[:, -1] > _FLAT**0.5 * 1e-2, -1, :]
    normals[np.abs(normals) < 1e-12] = 0.0
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    first = np.take_along_axis(normals, np.argmax(np.abs(normals) > 1e-9, axis=1)[:, None], axis=1)
    normals *= np.sign(first)
    different: list[Array] = []
    for normal in normals[np.lexsort(normals.T[::-1].round(9))]:
        if not different or np.abs(np.array(different) - normal).max(axis=1).min() > 1e-9:
            different.append(normal)
    return np.array(different)
