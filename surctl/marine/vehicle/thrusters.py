"""Thrusters and fins of a vehicle: place, limits, command curve and swivel; the forces that they attain together.

A thruster pushes along a fixed direction, from `-reverse` to `forward`. A swivelling thruster (a vectored water jet)
pushes in a plane: its force lies in a sector of a disc, which is replaced by an inscribed polygon, so that every limit
is linear and no force exceeds the jet's limit. All thrusters of a vehicle share the vehicle's `thrust_lag`: a
first-order lag with one time constant on every thruster equals the same lag of the total force and moment, because the
total is a linear function of the thrusters' forces.

A rudder or another fin pushes along a fixed direction too, with the force `lift` u² δ, in which u is the forward speed
through the water and δ the deflection. So its limits grow with u²; `forward` and `reverse` hold at 1 m/s. At rest and
astern it gives nothing. The force is normal to the blade in its middle position; the drag of the deflected blade and
the propeller's stream are left out. What the fin does as a fixed part of the hull belongs to the drag of the vehicle
(`Yuv`, `Nur`, …).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import combinations
from math import atan2, ceil, comb, cos, degrees, hypot, isclose, pi, sin
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, check_known

Array = NDArray[np.float64]

ORDERS: Mapping[str, tuple[int, ...]] = {
    "surge": (0,),
    "sway": (1,),
    "heave": (2,),
    "yaw": (3,),
    "horizontal": (0, 1),
    "force": (0, 1, 2),
    "effort": (),
}
"""Levels of `[allocation] order`, with the entries of (F_u, F_v, F_w, F_r) that they contain."""

DEFAULT_ORDER = ("yaw", "force", "effort")
"""The order of allocation that a vehicle file without `[allocation]` has."""

_SIDES = 8
"""Number of sides of the polygon that replaces a full disc of forces; it loses at most 7.6 % of the force."""

_FULL = 2 * pi
_SAME = 1e-9


@dataclass(frozen=True)
class Swivel:
    """The joint of a swivelling thruster.

    Attributes:
        axis: unit vector of the joint's axis in {B}, at right angles to the thruster's direction.
        range: least and largest angle of the joint [rad], counter-clockwise about the axis, 0 along `direction`.
        rate: largest rate of the joint [rad/s], or None. The simulation does not model it.
    """

    axis: tuple[float, float, float]
    range: tuple[float, float]
    rate: float | None = None


@dataclass(frozen=True)
class Fin:
    """The blade of a rudder or another fin.

    Attributes:
        lift: force per squared speed and deflection [N s²/m²]; the deflection is in rad.
        limit: largest deflection to both sides [rad]: the stop of the servo, or the stall angle.
    """

    lift: float
    limit: float


@dataclass(frozen=True)
class Thruster:
    """A thruster, a rudder or another fin.

    Attributes:
        name: name in messages and ports.
        at: place in the body frame {B} [m]: x forward, y to the left, z up.
        direction: unit vector of the force on the vehicle at a positive command, in {B}.
        forward, reverse: largest force along and against `direction` [N]; a water jet has reverse = 0. Those of a fin
            hold at a forward speed of 1 m/s.
        curve: (command, force [N]) points of the piecewise linear characteristic, from command −1 to 1. The command of
            a fin is its deflection as a share of the largest one.
        swivel: the joint of a vectored jet, or None.
        provenance: where the numbers come from.
        fin: the blade of a rudder or another fin, or None.
    """

    name: str
    at: tuple[float, float, float]
    direction: tuple[float, float, float]
    forward: float
    reverse: float
    curve: tuple[tuple[float, float], ...]
    swivel: Swivel | None = None
    provenance: str = ""
    fin: Fin | None = None

    @cached_property
    def directions(self) -> Array:
        """Unit vectors (3, k) of the force components in {B}: k = 1, or 2 for a swivelling thruster."""
        first = np.array(self.direction)
        if self.swivel is None:
            return first[:, None]
        return np.column_stack([first, np.cross(self.swivel.axis, first)])

    @cached_property
    def columns(self) -> Array:
        """Force and moments (6, k) per newton of each component: F_u, F_v, F_w, then roll, pitch and yaw moments."""
        at = np.array(self.at)
        return np.vstack([self.directions, np.cross(at, self.directions, axisb=0).T])

    @cached_property
    def corners(self) -> Array:
        """Corners (c, k) of the set of possible force components [N], counter-clockwise for a swivelling thruster."""
        if self.swivel is None:
            return np.array([[-self.reverse], [self.forward]])
        low, high = self.swivel.range
        full = isclose(high - low, _FULL, abs_tol=_SAME)
        count = max(1, ceil((high - low) / _FULL * _SIDES - _SAME))
        angles = low + (high - low) * np.arange(count + (not full)) / count
        arc = self.forward * np.array([[cos(a), sin(a)] for a in angles])
        return arc if full else np.vstack([[0.0, 0.0], arc])

    @cached_property
    def sides(self) -> tuple[Array, Array]:
        """Normals (s, k) and bounds (s,) [N]: the force components f satisfy normals · f ≤ bounds.

        For a thruster without swivel, the two sides are f ≤ forward and −f ≤ reverse.
        """
        if self.swivel is None:
            return np.array([[1.0], [-1.0]]), np.array([self.forward, self.reverse])
        edges = np.roll(self.corners, -1, axis=0) - self.corners
        outward = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1)[:, None]
        bounds = (outward * self.corners).sum(axis=1)
        bounds[np.abs(bounds) < _SAME * self.forward] = 0.0
        repeated = [k for k in range(1, len(outward)) if np.abs(outward[:k] - outward[k]).max(axis=1).min() < _SAME]
        return np.delete(outward, repeated, axis=0), np.delete(bounds, repeated)

    def force(self, command: float) -> float:
        """Return the force [N] at a command in [−1, 1], from the curve."""
        commands, forces = np.array(self.curve).T
        return float(np.interp(command, commands, forces))

    def command(self, force: float) -> float:
        """Return the command of smallest magnitude at which the curve gives the force [N]; 0 for no force."""
        limited = min(max(force, -self.reverse), self.forward)
        if limited == 0.0:
            return 0.0
        side = [point for point in self.curve if point[1] * limited >= 0.0 and point[0] * limited >= 0.0]
        side = sorted(side, key=lambda point: (abs(point[1]), abs(point[0])))
        while len(side) > 1 and side[1][1] == 0.0:  # the edge of the dead band
            del side[0]
        inner, outer = np.array(side).T
        if limited < 0:
            return -float(np.interp(-limited, -outer, -inner))
        return float(np.interp(limited, outer, inner))


@dataclass(frozen=True)
class Actuators:
    """The thrusters of a vehicle and the order in which their allocation meets force and yaw moment.

    Attributes:
        thrusters: the thrusters.
        order: the levels, highest priority first; the last one is `effort`, the smallest sum of squared forces.
    """

    thrusters: tuple[Thruster, ...]
    order: tuple[str, ...] = DEFAULT_ORDER

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the thrusters."""
        return tuple(thruster.name for thruster in self.thrusters)

    @property
    def levels(self) -> tuple[tuple[str, tuple[int, ...]], ...]:
        """Name of each level without `effort`, and its entries of (F_u, F_v, F_w, F_r)."""
        return tuple((name, ORDERS[name]) for name in self.order if ORDERS[name])

    @cached_property
    def matrix(self) -> Array:
        """Matrix B (4, N): (F_u, F_v, F_w, F_r) = B f for the force components f (N,) of all thrusters."""
        return np.hstack([thruster.columns[[0, 1, 2, 5]] for thruster in self.thrusters])

    @cached_property
    def tilting(self) -> Array:
        """Matrix (2, N): roll and pitch moments [N m] per newton of each force component; they are not controlled."""
        return np.hstack([thruster.columns[[3, 4]] for thruster in self.thrusters])

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Entries of each thruster in the vector of force components."""
        ends = np.cumsum([thruster.directions.shape[1] for thruster in self.thrusters]).tolist()
        return tuple(slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True))

    @property
    def swivels(self) -> tuple[int, ...]:
        """Indices of the swivelling thrusters."""
        return tuple(k for k, thruster in enumerate(self.thrusters) if thruster.swivel is not None)

    @property
    def fins(self) -> tuple[int, ...]:
        """Indices of the rudders and other fins."""
        return tuple(k for k, thruster in enumerate(self.thrusters) if thruster.fin is not None)

    @property
    def finned(self) -> NDArray[np.bool_]:
        """Whether a fin pushes on each axis (4,)."""
        columns = [self.matrix[:, self.slices[k]] for k in self.fins]
        return np.any(np.abs(np.hstack(columns)) > _SAME, axis=1) if columns else np.zeros(4, dtype=bool)

    def shares(self, speed: float) -> Array:
        """Return (n,): each thruster's limits at a forward speed [m/s] over `forward` and `reverse`, 1 unless a fin."""
        grown = max(speed, 0.0) ** 2
        return np.array([1.0 if thruster.fin is None else grown for thruster in self.thrusters])

    @property
    def largest(self) -> float:
        """Largest force of any thruster [N]."""
        return max(max(thruster.forward, thruster.reverse) for thruster in self.thrusters)

    @property
    def most(self) -> Array:
        """Bounds (4,) of |F_u|, |F_v|, |F_w| [N] and |F_r| [N m], with every thruster at its limit."""
        limits = [np.abs(thruster.corners).max(axis=0) for thruster in self.thrusters]
        return np.asarray(np.abs(self.matrix) @ np.concatenate(limits))

    @property
    def lever(self) -> float:
        """Largest yaw moment per newton [m] of any thruster, or 1 if no thruster turns the vehicle."""
        most = float(np.abs(self.matrix[3]).max())
        return most if most > _SAME else 1.0

    def to_dict(self) -> dict[str, Any]:
        """Return the thrusters and the order as plain data for JSON."""
        return asdict(self)

    def text(self) -> str:
        """Return all numbers and names as one text, without provenance; equal thrusters have equal texts."""
        data = self.to_dict()
        for one in data["thrusters"]:
            del one["provenance"]
            if one["fin"] is None:  # as before there were fins, so that the digest of a vehicle stays
                del one["fin"]
        return json.dumps(data, sort_keys=True)

    def index(self, name: str) -> int:
        """Return the index of a thruster; for an unknown name, raise InputError with a similar name."""
        check_known(name, self.names, "no such thruster", key="thruster")
        return self.names.index(name)

    def moments(self, components: Array) -> tuple[float, float]:
        """Return the roll and pitch moments [N m] of force components (N,)."""
        roll, pitch = self.tilting @ components
        return float(roll), float(pitch)

    def magnitudes(self, components: Array) -> Array:
        """Return the force (n,) [N] of each thruster: the component along its direction, or the length for a swivel."""
        parts = [components[where] for where in self.slices]
        return np.array([part[0] if part.size == 1 else hypot(*part) for part in parts])

    def angles(self, components: Array) -> Array:
        """Return the joint angle (k,) [rad] of each swivelling thruster; 0 for a force of 0."""
        parts = [components[self.slices[k]] for k in self.swivels]
        return np.array([atan2(part[1], part[0]) for part in parts])

    def components(self, forces: Array, angles: Array) -> Array:
        """Return the force components (N,) [N] of thrusters with these forces (n,) and joint angles (k,) [rad]."""
        turned = dict(zip(self.swivels, angles.tolist(), strict=True))
        parts = [
            [force * cos(turned[k]), force * sin(turned[k])] if k in turned else [force]
            for k, force in enumerate(forces.tolist())
        ]
        return np.array([component for part in parts for component in part])

    def lines(self) -> list[str]:
        """Return one line of text for each thruster."""
        return [_line(thruster) for thruster in self.thrusters]


def _line(thruster: Thruster) -> str:
    at, along = (", ".join(f"{entry:.3g}" for entry in vector) for vector in (thruster.at, thruster.direction))
    joint = ""
    if thruster.swivel is not None:
        low, high = map(degrees, thruster.swivel.range)
        joint = f", swivels {low:.0f} to {high:.0f} deg"
    if thruster.fin is not None:
        fin = thruster.fin
        force = f"{fin.lift:.4g} N s^2/m^2 times u^2 and deflection, up to {degrees(fin.limit):.3g} deg"
        return f"{thruster.name}: fin at ({at}) m, push ({along}), {force}"
    return f"{thruster.name}: at ({at}) m, push ({along}), {thruster.forward:g} N, reverse {thruster.reverse:g}{joint}"


# The attainable set: every (F_u, F_v, F_w, F_r) that the thrusters of a vehicle can produce.
#
# The set is a sum of segments and polygons (a zonotope, if no thruster swivels), described by half-spaces. A facet is
# spanned by edges of the summands, so its normal is orthogonal to three independent edges; the bound is the sum of the
# largest values that the thrusters reach along this normal. The same normals describe the set after any thruster fails.


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
    return np.asarray(points[np.argsort([atan2(y, x) for x, y in middle], kind="stable")])


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
    edges = [p[1:] - p[:1] if len(p) == 2 else np.roll(p, -1, axis=0) - p for p in corners]
    normals = _normals(_distinct(np.vstack(edges)), len(axes))
    values = [points @ normals.T for points in corners]  # (corners, m)
    above = np.column_stack([value.max(axis=0) for value in values])
    below = np.column_stack([(-value).max(axis=0) for value in values])
    return Attainable(axes, normals, above, below, unit, lever)


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
        problem = f"push in {len(edges)} different directions, too many for the attainable set"
        remedy = "describe fewer or equal thrusters, or fixed directions in place of swivels"
        raise InputError(problem, key="thruster", remedy=remedy)
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
