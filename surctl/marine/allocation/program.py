"""The allocation as one program for runs, batches and exported C: level by level, then thruster commands.

If the smallest forces for the desired force and yaw moment are within all limits, they are the solution. Otherwise, and
after a thruster has failed, each level is solved in turn by the least-distance solver of `priority.solver`.

The levels of `[allocation] order` need no search over thruster forces: each level is the point of the attainable set
nearest to the desired force, where the values of all higher levels are fixed. The attainable set of the levels so far
is a projection of the vehicle's attainable set, known as half-spaces. The last level, `effort`, is the point nearest to
0 in the null space of the allocation matrix. So every level is a least-distance problem with at most a few unknowns.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Block, Call, Loop, Program, Real, Routine, Step, lower, without_libm
from surctl.marine.vehicle import Actuators, Thruster, attainable
from surctl.priority.solver.dual_step import Space
from surctl.priority.solver.elimination import FLOAT32, FLOAT64, Precision
from surctl.priority.solver.kernel import lanes_of, search

Array = NDArray[np.float64]

_ZERO = 1e-9  # part of a unit normal below which a half-space does not restrict a level
_RANK = 1e-7


@dataclass(frozen=True, eq=False)
class ForceRows:
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

    def part(self, columns: tuple[int, ...]) -> ForceRows:
        """Return the rows that restrict some of the unknowns, which no row connects to the other unknowns."""
        used = np.abs(self.normals[:, columns]).max(axis=1) > _ZERO
        return ForceRows(
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
    rows: ForceRows


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

    def _level(self, known: tuple[int, ...], axes: tuple[int, ...]) -> ForceRows:
        forces = attainable(self.actuators, known + axes)
        own = forces.normals[:, len(known) :]
        length = np.linalg.norm(own, axis=1)
        used = length > _ZERO
        parts = [part[used] / length[used, None] for part in (own, forces.above, forces.below, forces.normals)]
        normals, above, below, whole = parts
        return ForceRows(normals, above, below, whole[:, : len(known)], np.zeros(len(normals), dtype=bool))

    @cached_property
    def limits(self) -> ForceRows:
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
        return ForceRows(
            np.array(normals), np.array(above), np.array(below), np.zeros((len(normals), 0)), np.array(absent)
        )

    @cached_property
    def effort(self) -> tuple[tuple[tuple[int, ...], ForceRows], ...]:
        """The level `effort` in parts that do not affect each other: (coordinates in the null space, limits on them).

        The known numbers of the rows are the forces (4,) of the higher levels.
        """
        rows = self._effort
        return tuple((group, rows.part(group)) for group in _groups(np.abs(rows.normals) > _ZERO))

    @cached_property
    def _effort(self) -> ForceRows:
        limits = self.limits
        inner = limits.normals @ self.null
        length = np.linalg.norm(inner, axis=1)
        used = length > _ZERO
        inner, above, below, outer = (
            part[used] / length[used, None]
            for part in (inner, limits.above, limits.below, limits.normals @ self.inverse)
        )
        return ForceRows(inner, above, below, outer, limits.absent[used])


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


_SLABS = 6  # strips up to which a nearest point in the plane is computed directly, without a search
_PARALLEL = 1e-9


def allocation_block(actuators: Actuators, real: Real = "float64") -> Block:
    """Return the block that allocates (F_u, F_v, F_w, F_r) to the thrusters, with the tolerances of a number type.

    Inputs: wrench (4,) [N, N m]; working (n,), the share of its limits that each thruster has: 1 if it works, 0 if it
    has failed, and for a working fin the square of the forward speed in m/s (`Actuators.shares`). Outputs: achieved
    (4,), the force and yaw moment that the thrusters produce; components (N,) [N], the force components of all
    thrusters; commands (n,) in [−1, 1]; angles (k,) [rad] of the swivelling thrusters, absent without any.
    """
    return without_libm(_Builder(Design(actuators), FLOAT64 if real == "float64" else FLOAT32).build(), real)


class _Builder:
    def __init__(self, design: Design, precision: Precision) -> None:
        self.design, self.precision = design, precision
        self.thrusters = design.actuators.thrusters
        self.count, self.size = len(self.thrusters), design.matrix.shape[1]

    def build(self) -> Routine:
        slow, finish = self._slow(), self._finish()
        outputs = ("achieved", "components", "commands", *(("angles",) if self.design.actuators.swivels else ()))
        steps: tuple[Step, ...] = (
            Call(self._fast(), ("wrench", "working"), ("w", "t_first", "done_first")),
            Loop(
                slow, 1, carried=("t_first", "done_first"), results=("t", "done"), fixed=("w", "working"), until=1
            ),
            Call(finish, ("t", "working"), outputs),
        )  # fmt: skip
        inputs = (("wrench", 4), ("working", self.count))
        return Routine("allocate", inputs, steps, outputs)

    def _fast(self) -> Program:
        """Scale the wrench and compute the smallest forces; the last output is 1 if they solve all levels."""
        d = self.design
        wrench, working = ca.SX.sym("wrench", 4), ca.SX.sym("working", self.count)
        w = wrench * (1 / d.scale)
        t = _times(d.inverse, w)
        good = ca.SX(1)
        for k in range(self.count):
            if k not in d.actuators.fins:
                good = ca.logic_and(good, ca.eq(working[k], 1))
        value = _times(d.limits.normals, t)
        above, below = (self._least(bounds, working) for bounds in (d.limits.above, d.limits.below))
        for k in range(len(d.limits.normals)):
            good = ca.logic_and(good, value[k] <= above[k])
            if not d.limits.absent[k]:
                good = ca.logic_and(good, -below[k] <= value[k])
        if not d.full:
            missed = w - _times(d.matrix, t)
            for k in range(4):
                good = ca.logic_and(good, ca.fabs(missed[k]) <= self.precision.priced)
        return _program("allocate_fast", {"wrench": wrench, "working": working}, {"w": w, "t": t, "done": good})

    def _least(self, bounds: Array, working: ca.SX) -> list[ca.SX | float]:
        # bounds of single thrusters; only those of fins change
        owners = np.argmax(bounds, axis=1).tolist()
        sums = bounds.sum(axis=1).tolist()
        fins = self.design.actuators.fins
        return [most * working[k] if k in fins else most for k, most in zip(owners, sums, strict=True)]

    def _slow(self) -> Routine:
        steps, at = list[Step](), "w"
        for k, level in enumerate(self.design.levels):
            steps += self._level(level, at, f"w{k}")
            at = f"w{k}"
        steps += self._effort(at)
        end = _program("allocate_done", {"done": ca.SX.sym("done")}, {"done": ca.SX.ones(1)})
        steps.append(Call(end, ("done",), ("done_next",)))
        inputs = (("t", self.size), ("done", 1), ("w", 4), ("working", self.count))
        return Routine("allocate_levels", inputs, tuple(steps), ("t_next", "done_next"))

    def _level(self, level: LevelRows, before: str, after: str) -> list[Step]:
        """Return the steps that replace the level's entries of w by the nearest attainable values."""
        w, working = ca.SX.sym("w", 4), ca.SX.sym("working", self.count)
        known = ca.vertcat(*(w[k] for k in level.known))
        inputs = {"w": w, "working": working}
        lower_, upper = self._bounds(level.rows, working, known)
        name = f"allocate_{after}"
        if len(level.axes) == 1:
            value = _interval(level.rows.normals[:, 0], lower_, upper, w[level.axes[0]], self.precision)
            return [Call(_program(name, inputs, {"w": _with(w, level.axes, value)}), (before, "working"), (after,))]
        desired = ca.vertcat(*(w[k] for k in level.axes))
        higher, point = ca.SX.sym("w", 4), ca.SX.sym("point", len(level.axes))
        put = _program(f"{name}_put", {"w": higher, "point": point}, {"w": _with(higher, level.axes, point)})
        return [
            *self._nearest(name, inputs, (before, "working"), level.rows, lower_, upper, desired, f"{after}_point"),
            Call(put, (before, f"{after}_point"), (after,)),
        ]

    def _effort(self, at: str) -> list[Step]:
        d, steps, parts = self.design, list[Step](), dict[str, tuple[int, ...]]()
        w, working = ca.SX.sym("w", 4), ca.SX.sym("working", self.count)
        inputs = {"w": w, "working": working}
        for k, (group, rows) in enumerate(d.effort):
            lower_, upper = self._bounds(rows, working, w)
            name = f"z{k}"
            parts[name] = group
            if len(group) == 1:
                z = _interval(rows.normals[:, 0], lower_, upper, ca.SX(0), self.precision)
                steps.append(Call(_program(f"allocate_effort{k}", inputs, {"z": z}), (at, "working"), (name,)))
                continue
            zero = ca.SX.zeros(len(group))
            steps += self._nearest(f"allocate_effort{k}", inputs, (at, "working"), rows, lower_, upper, zero, name)
        coordinates = {name: ca.SX.sym(name, len(group)) for name, group in parts.items()}
        t = _times(d.inverse, w)
        for name, group in parts.items():
            t += _times(d.null[:, group], coordinates[name])
        end = _program("allocate_forces", {"w": w, **coordinates}, {"t": t})
        return [*steps, Call(end, (at, *parts), ("t_next",))]

    def _nearest(
        self,
        name: str,
        inputs: dict[str, ca.SX],
        arguments: tuple[str, ...],
        rows: ForceRows,
        lower_: ca.SX,
        upper: ca.SX,
        start: ca.SX,
        result: str,
    ) -> list[Step]:
        m, d = rows.normals.shape
        if d == 2 and m <= _SLABS:
            point = _polygon(rows.normals, lower_, upper, start, self.precision)
            return [Call(_program(name, inputs, {"point": point}), arguments, (result,))]
        lanes = self.precision.lanes
        padded = -(-m // lanes) * lanes
        never = self.precision.never
        entries = [[*map(ca.SX, rows.normals[k].tolist()), lower_[k], upper[k]] for k in range(m)]
        entries += [[*[ca.SX(0)] * d, ca.SX(-never), ca.SX(never)]] * (padded - m)
        wide = lanes_of(padded, self.precision)
        flat = [
            entries[block + k][entry] for block in range(0, padded, wide) for entry in range(d + 2) for k in range(wide)
        ]
        table = ca.vertcat(*flat)
        outputs: dict[str, ca.SX] = {"rows": table, "start": start, "skip": ca.SX(0)}
        arrays = tuple(f"{result}_{key}" for key in outputs)
        space = Space(d, self.precision)
        rest = tuple(f"{result}_{key}" for key in ("numbers", "multipliers", "status", "count"))
        prepare = Call(_program(name, inputs, outputs), arguments, arrays)
        return [prepare, Call(search(space, padded), arrays, (result, *rest))]

    def _bounds(self, rows: ForceRows, working: ca.SX, known: ca.SX) -> tuple[ca.SX, ca.SX]:
        shift = _times(rows.fixed, known) if rows.fixed.shape[1] else ca.SX.zeros(len(rows.normals))
        upper, lower_ = _times(rows.above, working) - shift, -_times(rows.below, working) - shift
        absent = [ca.SX(-self.precision.never) if rows.absent[k] else lower_[k] for k in range(len(rows.normals))]
        return ca.vertcat(*absent), upper

    def _finish(self) -> Program:
        t, working = ca.SX.sym("t", self.size), ca.SX.sym("working", self.count)
        unit, components, commands, angles = self.design.actuators.largest, list[ca.SX](), list[ca.SX](), list[ca.SX]()
        for k, (thruster, where) in enumerate(zip(self.thrusters, self.design.actuators.slices, strict=True)):
            force = unit * t[where]
            if thruster.swivel is None:
                most, least = working[k] * thruster.forward, -working[k] * thruster.reverse
                limited = self._without_noise(ca.fmin(ca.fmax(force, least), most))
                components.append(limited)
                commands.append(_command(thruster, limited) if thruster.fin is None else _deflection(limited, most))
                continue
            length = ca.sqrt(ca.sumsqr(force))
            most = working[k] * thruster.forward
            force = ca.if_else(ca.eq(self._without_noise(length), 0), 0, force)
            share = ca.if_else(length > most, most / ca.if_else(length > most, length, 1), 1)
            components.append(share * force)
            commands.append(_command(thruster, self._without_noise(ca.fmin(length, most))))
            angles.append(ca.atan2(force[1], force[0]))
        every = ca.vertcat(*components)
        outputs = {
            "achieved": _times(self.design.actuators.matrix, every),
            "components": every,
            "commands": ca.vertcat(*commands),
            **({"angles": ca.vertcat(*angles)} if angles else {}),
        }
        return _program("allocate_end", {"t": t, "working": working}, outputs)

    def _without_noise(self, force: ca.SX) -> ca.SX:
        # a force that is 0 but for rounding must not switch a thruster to the edge of its dead band
        return ca.if_else(ca.fabs(force) <= self.precision.priced * self.design.actuators.largest, 0, force)


def _command(thruster: Thruster, force: ca.SX) -> ca.SX:
    """Return the command for a force, on the segments of the curve; the dead band maps only 0 to command 0."""
    command = ca.SX(0)
    forward = [point for point in thruster.curve if point[0] >= 0 and point[1] >= 0]
    while len(forward) > 1 and forward[1][1] == 0:
        del forward[0]
    backward = [(-c, -f) for c, f in reversed(thruster.curve) if c <= 0 and f <= 0]
    while len(backward) > 1 and backward[1][1] == 0:
        del backward[0]
    for side, sign in ((forward, 1.0), (backward, -1.0)):
        if len(side) < 2 or side[-1][1] <= 0:
            continue
        size = sign * force
        value = ca.SX(side[-1][0])
        for (c0, f0), (c1, f1) in reversed(list(itertools.pairwise(side))):
            value = ca.if_else(size < f1, c0 + (size - f0) * ((c1 - c0) / (f1 - f0)), value)
        command = ca.if_else(size > 0, sign * value, command)
    return command


def _deflection(force: ca.SX, most: ca.SX) -> ca.SX:
    # without flow, no deflection gives the force
    flow = most > 0
    return ca.if_else(flow, force / ca.if_else(flow, most, 1), 0)


def _interval(normal: Array, lower_: ca.SX, upper: ca.SX, desired: ca.SX, precision: Precision) -> ca.SX:
    """Return the number nearest to `desired` between all bounds; each normal is 1 or −1."""
    ends = [(lower_[k], upper[k]) if normal[k] > 0 else (-upper[k], -lower_[k]) for k in range(len(normal))]
    low, high = ends[0]
    for below, above in ends[1:]:
        low, high = ca.fmax(low, below), ca.fmin(high, above)
    # bounds that cross by rounding leave one number
    return ca.if_else(low > high, 0.5 * (low + high), ca.fmin(ca.fmax(desired, low), high))


def _polygon(normals: Array, lower_: ca.SX, upper: ca.SX, start: ca.SX, precision: Precision) -> ca.SX:
    """Return the point (2,) of a polygon nearest to `start`; the polygon is the intersection of strips.

    If `start` is outside, the nearest point lies on the violated side of a strip: it is the nearest of the points that
    `start` is projected to on each violated side, limited to the part of the side inside all other strips.
    """
    best, least = start, ca.SX(precision.never)
    outside = ca.SX(0)
    for i, normal in enumerate(normals):
        value = _along(normal, start)
        above, below = value > upper[i], value < lower_[i]
        violated = ca.logic_or(above, below)
        outside = ca.logic_or(outside, violated)
        foot = start - (value - ca.if_else(above, upper[i], lower_[i])) * ca.DM(normal)
        side = np.array([-normal[1], normal[0]])
        low, high, there = ca.SX(-precision.never), ca.SX(precision.never), violated
        for j, other in enumerate(normals):
            if j == i:
                continue
            rate, at = float(other @ side), _along(other, foot)
            if abs(rate) < _PARALLEL:
                slack = ca.fmin(upper[j] - at, at - lower_[j])
                there = ca.logic_and(there, slack >= -precision.priced)
                continue
            ends = (lower_[j] - at) * (1 / rate), (upper[j] - at) * (1 / rate)
            first, last = ends if rate > 0 else ends[::-1]
            low, high = ca.fmax(low, first), ca.fmin(high, last)
        there = ca.logic_and(there, low <= high + precision.priced)
        place = ca.fmax(ca.fmin(ca.SX(0), high), low)
        point = foot + place * ca.DM(side)
        distance = ca.sumsqr(point - start)
        nearer = ca.logic_and(there, distance < least)
        best, least = ca.if_else(nearer, point, best), ca.if_else(nearer, distance, least)
    return ca.if_else(outside, best, start)


def _along(normal: Array, point: ca.SX) -> ca.SX:
    terms = [float(a) * point[k] for k, a in enumerate(normal.tolist()) if a != 0.0]
    return sum(terms[1:], start=terms[0])


def _with(w: ca.SX, axes: Sequence[int], values: ca.SX) -> ca.SX:
    entries = [w[k] for k in range(4)]
    for axis, value in zip(axes, ca.vertsplit(values), strict=True):
        entries[axis] = value
    return ca.vertcat(*entries)


def _times(matrix: Array, vector: ca.SX) -> ca.SX:
    # a product without the terms whose factor is 0
    rows = []
    for row in np.asarray(matrix):
        terms = [float(a) * vector[j] for j, a in enumerate(row.tolist()) if a != 0.0]
        rows.append(sum(terms[1:], start=terms[0]) if terms else ca.SX(0))
    return ca.vertcat(*rows)


def _program(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> Program:
    dense = [ca.densify(ca.SX(value)) for value in outputs.values()]
    return lower(ca.Function(name, list(inputs.values()), dense, list(inputs), [f"{key}_out" for key in outputs]))
