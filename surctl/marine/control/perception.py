"""Perception of a law with sonars: which echoes (not walls or floor) become obstacle points; faces that are silent.

Perception estimates four things: the robot's own state, from delayed position fixes; moving obstacles, from delayed
messages; the range of every sonar, with an error bound; and the map of `sensing.mapping`. The nearest marks (occupied
cells) of the map become obstacle points, in addition to the obstacles from the base station. An echo that a wall or a
known obstacle explains is not marked in the map. The radius of every obstacle point includes the uncertainty of its
position.

A smooth face answers only near its normal, so a robot that moves along a face hears only the part beside it. The map
has no marks of the part ahead, and no range at all within the sonars' blind range. The nearest point of the face is the
foot of the perpendicular from the sensor. Two echoes with the ranges r1, r2 from the apexes A1, A2 therefore determine
the face's unit normal n by n·(A2 − A1) = r1 − r2 (range-only mapping; see Leonard and Durrant-Whyte 1992, "Directed
sonar sensing for mobile robot navigation"). A third echo between the two must fit the plane: the echoes of an edge and
of a thin cylinder do not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, cos, pi, sin
from typing import NamedTuple

import casadi as ca

from surctl.errors import InputError
from surctl.ir import (
    Block,
    Call,
    Layout,
    Port,
    Program,
    Recording,
    Routine,
    each,
    fold,
    lower_named,
    tabulated,
    without_libm,
)
from surctl.ir.c99 import rearranged
from surctl.marine.control.beams import (
    SILENT,
    Expected,
    StepState,
    beams,
    corrected,
    expected,
    floor_range,
    honest,
    least_of,
    slotted,
)
from surctl.marine.control.ports import LAUNCHED, PARAMETERS, SECTORS, after_gap
from surctl.marine.sensing import Equipment, LocalMap, OwnStateFilter, RangeTracker
from surctl.marine.sensing.localisation.movers import MoverTracker
from surctl.marine.sensing.mapping.firing import READING, RING
from surctl.marine.vehicle import planar_rotation

_NEVER = 1e5  # [s] age of a face that was never measured
_NEAR = 0.6  # [m] longest range of an echo from which a face is determined
_APART = 0.25  # [m] least distance between two echoes
_TOGETHER = 0.8  # [m] distance beyond which two echoes count as those of different objects
_FLAT = 0.025  # [m] largest error of the middle echo
_SAME = 0.03  # [m] largest difference of an echo from the face that it confirms
_GONE = 0.15  # [m] distance beyond the face from which a reading shows that the face has ended
_TURNS = 0.2  # share by which an estimate turns a face that is already known
_ALIKE = 0.9  # least cosine of the angle between an estimate and the known face, for them to be the same
_INSIDE = 0.05  # [rad] the foot of the perpendicular must lie this far inside the beam
_LASTS = 10.0  # [s] time without a confirmation after which the face is dropped
_CLOSE = 3.0  # [s] time since an echo from within the blind range after which the map alone counts
_GOES_ON = 0.2  # [m] distance by which the face goes on beyond the last place at which it was confirmed
_NO_FACE = 1e6  # [m²] no face; as in the map

FACE_PORTS = (
    Port(
        "face_echoes",
        (2, 3),
        "m",
        "two earlier echoes, the later one first: x, y of the apex in {E}, range; range 0: none",
    ),
    Port(
        "face_plane", (5,), "1, m", "normal x, y in {E}, distance from the origin of {E}, x, y of the last confirmation"
    ),
    Port("face_age", (2,), "s", "time since the face was confirmed, and since it was within the blind range", _NEVER),
)
"""State of the face beside the robot."""


class Firing(NamedTuple):
    """One firing: apex and axis (2, 1) of the beam in {E}, and what was measured.

    Attributes:
        within: cosine of the largest angle between the axis and the foot of a face that the beam measures.
        arrived: 1 if the firing is new and credible.
        reading: range [m].
        longest: range [m] up to which the last firings agree that nothing answered.
        echo: 1 if no wall, no floor and no known obstacle explains the echo.
        blind: 1 if the echo came from within the blind range.
    """

    apex: ca.SX
    axis: ca.SX
    within: ca.SX | float
    arrived: ca.SX
    reading: ca.SX
    longest: ca.SX
    echo: ca.SX
    blind: ca.SX

    @classmethod
    def of(cls, row: ca.SX) -> Firing:
        """Return the firing whose numbers are a column, in the order of the attributes."""
        return cls(row[:2], row[2:4], *ca.vertsplit(row[4:]))


def within_beam(half: float) -> float:
    """Return `Firing.within` for half the opening angle [rad] of the beam."""
    return cos(half - _INSIDE)


def face_after(
    x: Mapping[str, ca.SX],
    firings: ca.SX,
    position: ca.SX,
    *,
    dt: float,
    blind: float,
    hull: ca.SX,
    deep: ca.SX,
) -> tuple[dict[str, ca.SX], ca.SX]:
    """Return the face beside the robot, by name as in `FACE_PORTS`, after the firings of one control period.

    The second result is the foot of the perpendicular (3, 1): offset x, y from the robot [m], and squared distance.

    Args:
        firings: table with a row for each `Firing`.
        position: the robot's place (2, 1) in {E} [m].
        blind: longest range that a sensor cannot measure [m].
        hull: radius of the hull [m].
        deep: distance [m] by which the foot lies behind the face, as the centre of a marked cell does.
    """
    late, early = x["face_echoes"][0, :].T, x["face_echoes"][1, :].T
    plane, age, close = x["face_plane"], x["face_age"][0] + dt, x["face_age"][1] + dt

    def nearer(nearest: ca.SX, best: ca.SX, row: ca.SX) -> list[ca.SX]:
        one = Firing.of(row)
        measured = ca.logic_and(ca.logic_and(one.arrived, one.echo), ca.logic_not(one.blind))
        take = ca.logic_and(measured, one.reading < nearest)
        candidate = ca.vertcat(one.apex, one.reading, one.axis, one.within)
        return [ca.if_else(take, one.reading, nearest), ca.if_else(take, candidate, best)]

    _, best = fold("nearest_echo", nearer, [ca.SX(_NEAR), ca.SX([0, 0, 0, 1, 0, 1])], firings)
    now, axis, within = best[:3], best[3:5], best[5]
    there = now[2] > 0
    # a plane through the present echo and the earlier one
    base = now[:2] - early[:2]
    apart = ca.sqrt(ca.sumsqr(base))
    along = base / ca.fmax(apart, 1e-6)
    cosine = (early[2] - now[2]) / ca.fmax(apart, 1e-6)
    sine = ca.sqrt(ca.fmax(1 - cosine * cosine, 0))
    side = ca.vertcat(-along[1], along[0])
    side = ca.if_else(ca.dot(side, axis) < 0, -side, side)
    normal = cosine * along + sine * side
    distance = ca.dot(normal, now[:2]) + now[2]
    same = ca.logic_and(age < _LASTS, ca.dot(normal, plane[:2]) > _ALIKE)
    same = ca.logic_and(same, ca.fabs(plane[2] - ca.dot(plane[:2], now[:2]) - now[2]) < _SAME)
    middle = ca.fabs(distance - ca.dot(normal, late[:2]) - late[2])
    fits = ca.logic_and(ca.logic_and(there, early[2] > 0), ca.logic_and(apart > _APART, apart < _TOGETHER))
    fits = ca.logic_and(fits, ca.logic_and(ca.fabs(cosine) < 1, ca.dot(normal, axis) > within))
    step = ca.sqrt(ca.sumsqr(now[:2] - late[:2]))
    fits = ca.logic_and(fits, ca.logic_and(step > 0.1, middle < _FLAT))
    turned = plane[:2] + _TURNS * (normal - plane[:2])
    normal = ca.if_else(same, turned / ca.fmax(ca.sqrt(ca.sumsqr(turned)), 0.5), normal)
    plane = ca.if_else(fits, ca.vertcat(normal, ca.dot(normal, now[:2]) + now[2], now[:2]), plane)
    age = ca.if_else(fits, 0, age)

    def confirmed(age: ca.SX, close: ca.SX, place: ca.SX, row: ca.SX) -> list[ca.SX]:
        one = Firing.of(row)
        ahead = plane[2] - ca.dot(plane[:2], one.apex)
        faces = ca.logic_and(one.arrived, ca.dot(plane[:2], one.axis) > one.within)
        agrees = ca.if_else(one.blind, ahead < blind + _SAME, ca.fabs(one.reading - ahead) < _SAME)
        agrees = ca.logic_and(ca.logic_and(faces, age < _LASTS), agrees)
        gone = ca.logic_and(faces, one.longest > ca.fmax(ahead, blind) + _GONE)
        close = ca.if_else(ca.logic_and(agrees, one.blind), 0, close)
        age = ca.if_else(agrees, 0, ca.if_else(gone, _NEVER, age))
        return [age, close, ca.if_else(agrees, one.apex, place)]

    age, close, place = fold("face_firing", confirmed, [age, close, plane[3:]], firings)
    plane = ca.vertcat(plane[:3], place)
    # the later of the two echoes moves on
    lost = ca.logic_or(late[2] <= 0, step > _TOGETHER)
    moves = ca.logic_and(there, ca.logic_or(lost, step >= _APART))
    echoes = ca.vertcat(
        ca.if_else(moves, now, late).T, ca.if_else(moves, ca.if_else(lost, ca.DM.zeros(3), late), early).T
    )
    away = plane[2] - ca.dot(plane[:2], position)
    further = ca.fabs(ca.dot(ca.vertcat(-plane[1], plane[0]), position - plane[3:]))
    holds = ca.logic_and(
        ca.logic_and(ca.logic_and(age < _LASTS, close < _CLOSE), further < _GOES_ON),
        ca.logic_and(away > 0, away < hull + blind),
    )
    away += deep
    foot = ca.if_else(holds, ca.vertcat(away * plane[:2], away * away), ca.DM([0, 0, _NO_FACE]))
    return {"face_echoes": echoes, "face_plane": plane, "face_age": ca.fmin(ca.vertcat(age, close), _NEVER)}, foot


def with_face(marks: ca.SX, foot: ca.SX) -> ca.SX:
    """Return the nearest marks of the map (sectors, 3), with the face's foot (3, 1) in its sector if it is nearer."""
    sectors = marks.shape[0]
    middles = [2 * pi * k / sectors for k in range(sectors)]

    def nearer(mark: ca.SX, middle: ca.SX) -> tuple[ca.SX]:
        inside = ca.dot(foot[:2], middle) > cos(pi / sectors) * ca.sqrt(foot[2])
        return (ca.if_else(ca.logic_and(foot[2] < mark[2], inside), foot, mark),)

    (table,) = each("with_face", nearer, marks, ca.SX([[cos(a), sin(a)] for a in middles]))
    return table


CELLS_A_HULL = 4.0
"""Number of map cells per hull radius (*chosen*); the cell size is 6.75 cm in the tank and 5 cm in the pool."""

LAST_THRUST = Port("last_thrust", (4,), "N, N m", "thrust command of the step before", gap="anew")
"""The first entry of the state; the decision writes it, and the filter of the robot's own state reads it."""

PERCEPTION = "perception"
"""Name of the block of a `PerceptionStage`."""

_READING = 0.03  # [m] largest error of one plausible firing: four standard deviations
_DIAGONAL = 0.71  # [cells] half a cell's diagonal
_AROUND_A_MARK = 0.8  # [cells] radius of the contact for a mark: half a diagonal plus an allowance for drift
_EXPLAINS = 0.5  # [cells] distance beyond a reading within which a mark explains the reading
_MARGIN_SD = 0.02 / 3  # [m] standard deviation of the robot's position that the law's margin already covers
_DEAF = 0.3  # [s] time without a plausible firing, after which a sonar is not trusted
_PLACED_SD = 0.2  # [m] standard deviation above which the position counts as unknown
_SILENT_MARGIN = 0.05  # [m] added to the radius of every mark while a sonar is silent, since obstacles drift
# [s] longest silence of a sonar; also of a sonar that was never plausible
_FAR = 1e5  # [m²] larger than any squared distance in the map
_JUDGED = ("late", "distrust", "repeated", "recent")  # states of a sonar by which its firing is judged


@dataclass(frozen=True, eq=False)
class PerceptionStage:
    """The part of a law that runs before the decision.

    Attributes:
        state: layout of the perception state, with `LAST_THRUST` first.
        outputs: layout of the inputs of the decision.
        block: instruction list or routine that maps (state, inputs, parameters) to (next state without `LAST_THRUST`,
            outputs). If other depths are allowed, it has a fourth input, which is 1 in a step in which the map is
            cleared.
    """

    state: Layout
    inputs: Layout
    outputs: Layout
    block: Block


def build_perception(
    equipment: Equipment,
    inputs: Layout,
    outputs: Layout,
    *,
    dt: float,
    model_noise: float = OwnStateFilter.model_noise,
    acceleration_noise: float = OwnStateFilter.acceleration_noise,
) -> PerceptionStage:
    """Assemble the perception of a law for the sensors that it assumes."""
    return _Builder(equipment, inputs, outputs, dt, model_noise, acceleration_noise).build()


@dataclass(frozen=True)
class _Builder:
    equipment: Equipment
    inputs: Layout
    outputs: Layout
    dt: float
    model_noise: float
    acceleration_noise: float

    def build(self) -> PerceptionStage:
        array = self.equipment.array
        if any(len(cones) > 1 for cones in array.cones):
            problem = "the hull splits a beam in two, but the map takes one cone per sonar"
            raise InputError(problem, key="array.mounts", remedy="move that sonar")
        split, measure, report = self._split(), self._measure(), self._report()
        # a law that changes its depth clears the map, because echoes from the old depth no longer apply
        anew, corner = (("anew",), "corner") if "column" in self.outputs else ((), "map_corner")
        steps = (
            Call(split, ("x",), tuple(name for name, _ in split.outputs)),
            Call(measure, ("small", "u", "p"), ("small_next", "place", "walls", "readings", "perceived")),
            *(Call(self._anew(), ("map_corner", name), (corner,)) for name in anew),
            Call(
                self._map.routine(),
                ("map_cells", corner, "place", "walls", "readings"),
                ("map_cells_next", "map_corner_next", "marked", "unknown"),
            ),
            Call(report, ("p", "perceived", "marked", "unknown"), ("decision_inputs",)),
            Call(self._join(), ("small_next", "map_cells_next", "map_corner_next"), ("x_next",)),
        )
        sizes = (("x", self.state.size), ("u", self.inputs.size), ("p", PARAMETERS.size), *((n, 1) for n in anew))
        block = without_libm(Routine(PERCEPTION, sizes, steps, ("x_next", "decision_inputs")))
        return PerceptionStage(self.state, self.inputs, self.outputs, block)

    @cached_property
    def _map(self) -> LocalMap:
        array = self.equipment.array
        slots = min(array.size, ceil(self.dt / array.firing_period - 1e-9))
        return LocalMap(dt=self.dt, slots=slots, sectors=SECTORS)

    @cached_property
    def _ranges(self) -> RangeTracker:
        array = replace(self.equipment.array, bias=0.0)  # `corrected` has already removed the bias
        return RangeTracker(array=array, dt=self.dt)

    @cached_property
    def _own(self) -> OwnStateFilter | None:
        own = self.equipment.own
        if own is None:
            return None
        return OwnStateFilter(
            dt=self.dt,
            latency=own.fixes.latency,
            position_sd=max(own.position_sd, 1e-4),
            yaw_sd=max(own.yaw_sd, 1e-4),
            rate_sd=max(own.rate_sd, 1e-4),
            model_noise=self.model_noise,
            acceleration_noise=self.acceleration_noise,
        )

    @cached_property
    def _movers(self) -> MoverTracker | None:
        station = self.equipment.station
        slots = self.inputs.port("contacts").shape[0] if "contacts" in self.inputs else 0
        if not slots:
            return None
        return MoverTracker(
            dt=self.dt,
            slots=slots,
            latency=station.messages.latency,
            position_sd=station.position_sd,
            velocity_sd=station.velocity_sd,
        )

    @cached_property
    def _small(self) -> Layout:
        # without the last thrust and the map
        own = self._own.ports("own_") if self._own else ()
        movers = self._movers.ports("mover_") if self._movers else ()
        n = self.equipment.array.size
        silent = Port("silent", (n,), "s", "time since the last plausible firing of each sonar", _NEVER)
        launched = Port("launched", (1,), "1", "1 after the free water around the start is marked in the map")
        last = tuple(after_gap(port) for port in (*own, *movers, *self._ranges.ports("sonar_"), silent, *FACE_PORTS))
        return Layout((*last, launched))

    @cached_property
    def state(self) -> Layout:
        return Layout((LAST_THRUST, *self._small.ports, *self._map.ports("map_")))

    @cached_property
    def _perceived(self) -> Layout:
        # values that are known before the map is evaluated
        sonars = self.outputs.port("sonars")
        slots = self._movers.slots if self._movers else 0
        known = (Port("movers", (slots, 6), "m, m/s, 1", "moving obstacles at the present time"),) if slots else ()
        pose = tuple(self.outputs.port(name) for name in ("eta", "nu"))
        column = (self.outputs.port("column"),) if "column" in self.outputs else ()
        face = Port("face", (3,), "m, m^2", "nearest point of the face beside the robot")
        uncertainty = Port("uncertainty", (1,), "m", "position uncertainty that the margin does not cover")
        flags = tuple(self.outputs.port(name) for name in ("placed", "echoed"))
        return Layout((*pose, uncertainty, *flags, *known, sonars, *column, face))

    def _split(self) -> Program:
        # three parts: small states, map cells, map corner
        size = self.state.size
        parts = {f"map_{name}": self.state.slice(f"map_{name}") for name in ("cells", "corner")}
        pieces = {"small": slice(0, LAST_THRUST.size + self._small.size), **parts}
        return rearranged("split", {"x": size}, {k: [("x", part.start, part.stop)] for k, part in pieces.items()})

    def _anew(self) -> Program:
        # to clear the map, its corner is moved far away
        corner, anew = ca.SX.sym("corner", 2), ca.SX.sym("anew")
        nowhere = self.state.port("map_corner").default
        return lower_named("anew", {"corner": corner, "anew": anew}, {"at": ca.if_else(anew > 0.5, nowhere, corner)})

    def _join(self) -> Program:
        parts = {"small": self._small.size}
        parts |= {name: self.state.port(name).size for name in ("map_cells", "map_corner")}
        return rearranged("join", parts, {"x_next": [(name, 0, size) for name, size in parts.items()]})

    def _measure(self) -> Block:
        recording = Recording()
        with recording:
            inputs, outputs = self._measured()
        return recording.block("measure", inputs, outputs)

    def _measured(self) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
        # inputs and outputs of the block `measure`
        array, local_map = self.equipment.array, self._map
        small = ca.SX.sym("small", LAST_THRUST.size + self._small.size)
        x = self._small.split(small[LAST_THRUST.size :])
        u, inputs = self.inputs.symbols("u")
        p, known = PARAMETERS.symbols("p")
        around, after = self._around(x, small[: LAST_THRUST.size], inputs, known)
        edge = known["hull"] / CELLS_A_HULL
        axes, apexes, halves = beams(array, around, known["hull"])
        velocity = planar_rotation(around.eta[3]) @ around.nu[:2]
        ranges = expected(array, around, apexes, known)
        ranges = ranges.where(around.placed, 2 * array.maximum)  # without a position, no echo counts as too long
        shortest = array.lowest / array.scale + array.resolution  # no range is expected below the shortest reading
        ranging = self._ranges.update(
            x,
            corrected(array, inputs["samples"]),
            fresh=inputs["fresh"],
            closing=ca.vertcat(*(ca.dot(velocity, axis) for axis in axes)),
            expected=ca.fmax(ranges.walls, shortest),
            longest=ca.fmax(ranges.sure, shortest),
            turn=around.nu[3],
            prefix="sonar_",
        )
        floor = floor_range(self.equipment, around.eta[2])
        # near the start an object within the blind range was never measured: its marks stay where they are
        starting = ca.sumsqr(around.eta[:2] - known["waypoints"][0, :].T) <= LAUNCHED**2

        def fired(states: ca.SX, samples: ca.SX, known_ranges: ca.SX, beam: ca.SX) -> list[ca.SX]:
            fresh, silent, reading, late, distrust, repeated = ca.vertsplit(states[:6])
            recent, apex, axis, half = states[6:], beam[:2], beam[2:4], beam[4:6]
            trusted = honest(
                array, inputs["samples"], samples, reading, ca.logic_and(late < 0.5, distrust < 0.5),
                repeated < max(self._ranges.repeats, 1),
            )  # fmt: skip
            arrived = ca.logic_and(fresh > 0.5, trusted)
            silent = ca.if_else(arrived, 0.0, ca.fmin(silent + self.dt, _NEVER))
            strange = Expected(*ca.vertsplit(known_ranges)).unexplained(reading)
            if floor is not None:
                strange = ca.logic_and(strange, reading < floor)
            echo = ca.logic_and(reading < array.maximum - SILENT, strange)
            blind = reading <= shortest
            usable = ca.logic_and(arrived, around.placed)
            clear = ca.fmax(least_of(recent) - _READING - _DIAGONAL * edge, 0)
            cleared = ca.if_else(starting, 0, clear)
            firing = {
                "apex": apex,
                "axis": axis,
                "half": half,
                "clear": ca.if_else(blind, -ca.fmax(cleared, 1e-3), clear),
                "near": ca.fmax(reading - _READING - 0.5 * edge, 0),
                "far": ca.if_else(echo, reading + _READING + 0.5 * edge, -1),
                "cutoff": reading + _EXPLAINS * edge + 0.01,
            }
            listed = ca.vertcat(usable, *(firing[name] for name, _, _ in READING))
            return [
                silent,
                ca.vertcat(*Firing(apex, axis, beam[6], usable, reading, least_of(recent), echo, blind)),
                listed,
            ]

        own = (inputs["fresh"], x["silent"], ranging.reading, *(ranging.state[f"sonar_{n}"] for n in _JUDGED))
        silent, firings, readings = each(
            "firing", fired, ca.horzcat(*own), inputs["samples"], ca.horzcat(*ranges),
            tabulated(
                (apex, axis, cos(half), sin(half), within_beam(half))
                for apex, axis, half in zip(apexes, axes, halves, strict=True)
            ),
        )  # fmt: skip
        healthy = silent <= _DEAF
        sonars = [
            ca.horzcat(ranging.range[i], ranging.bound[i], healthy[i], ranging.age[i], axes[i].T)
            for i in range(array.size)
        ]
        perceived = {
            "eta": around.eta,
            "nu": around.nu,
            "uncertainty": around.uncertainty,
            "placed": around.placed,
            "echoed": least_of(silent) < _NEVER,
            "sonars": ca.vertcat(*sonars),
        }
        if self._movers:
            perceived["movers"] = around.movers
        if "column" in self.outputs:
            perceived["column"] = inputs["column"]
        face, perceived["face"] = face_after(
            x, firings, around.eta[:2], dt=self.dt, blind=shortest, hull=known["hull"], deep=edge / 2
        )
        after |= face
        free = known["hull"] + ca.if_else(x["launched"], 0, known["launch"])
        outputs = {
            "small_next": self._small.join(
                {
                    **after,
                    **ranging.state,
                    "silent": silent,
                    "launched": ca.logic_or(x["launched"], around.placed),
                }
            ),
            # if the robot does not know its position, the cells under its hull do not count as free
            "place": ca.vertcat(around.eta[:2], ca.if_else(around.placed, free, 0), edge),
            "walls": known["walls"],
            "readings": slotted(readings, local_map.slots),
            "perceived": self._perceived.join(perceived),
        }
        return {"small": small, "u": u, "p": p}, outputs

    def _around(
        self, x: Mapping[str, ca.SX], tau: ca.SX, u: Mapping[str, ca.SX], p: Mapping[str, ca.SX]
    ) -> tuple[StepState, dict[str, ca.SX]]:
        movers = ca.SX(0, 6)
        after: dict[str, ca.SX] = {}
        if self._movers:
            tracked = self._movers.update(x, message=u["contacts"], message_fresh=u["contacts_fresh"], prefix="mover_")
            after |= tracked.state
            rows = tracked.rows
            movers = ca.horzcat(rows[:, :2], rows[:, 2] + tracked.bound, rows[:, 3:])
        if self._own is None:
            return StepState(u["eta"], u["nu"], ca.SX(0), ca.SX(1), movers), after
        own = self._own.update(
            x,
            fix=u["fix"],
            fix_fresh=u["fix_fresh"],
            yaw=u["yaw"],
            yaw_rate=u["yaw_rate"],
            tau=tau,
            model=p,
            prefix="own_",
        )
        placed = own.position_sd < _PLACED_SD
        uncertainty = 3 * ca.fmax(ca.fmin(own.position_sd, _PLACED_SD) - _MARGIN_SD, 0)
        return StepState(own.eta, own.nu, uncertainty, placed, movers), {**after, **own.state}

    def _report(self) -> Block:
        local_map = self._map
        p, known = PARAMETERS.symbols("p")
        flat, perceived = self._perceived.symbols("perceived")
        marked, unknown = ca.SX.sym("marked", 3 * local_map.sectors), ca.SX.sym("unknown", 3 * local_map.sectors)
        position, edge = perceived["eta"][:2], known["hull"] / CELLS_A_HULL
        every = ca.sum1(perceived["sonars"][:, 2]) > self.equipment.array.size - 0.5
        around = _AROUND_A_MARK * edge + perceived["uncertainty"] + ca.if_else(every, 0, _SILENT_MARGIN)

        def mover(row: ca.SX) -> list[ca.SX]:
            return [ca.if_else(row[5] > 0.5, row + ca.vertcat(0, 0, perceived["uncertainty"], 0, 0, 0), 0)]

        def sector(mark: ca.SX, blank: ca.SX) -> list[ca.SX]:
            contact = ca.vertcat(position + mark[:2], around, 0, 0, 1)
            there = blank[2] < _FAR
            distance = ca.sqrt(ca.if_else(there, blank[2], 1))
            unknown_row = ca.vertcat(
                blank[:2] / distance, distance - known["hull"] - RING * edge - perceived["uncertainty"]
            )
            return [ca.if_else(mark[2] < _FAR, contact, 0), ca.if_else(there, unknown_row, ca.DM([0, 0, 100]))]

        with Recording() as recording:
            nearest, blanks = (ca.reshape(flat, 3, local_map.sectors).T for flat in (marked, unknown))
            marks, blank = each("sector_ahead", sector, with_face(nearest, perceived["face"]), blanks)
            contacts = [*(each("mover_ahead", mover, perceived["movers"]) if self._movers else []), marks]
        values = {
            "eta": perceived["eta"],
            "nu": perceived["nu"],
            "contacts": ca.vertcat(*contacts),
            "unknown": blank,
            "sonars": perceived["sonars"],
            "placed": perceived["placed"],
            "echoed": perceived["echoed"],
        }
        if "column" in perceived:
            values["column"] = perceived["column"]
        inputs = {"p": p, "perceived": flat, "marked": marked, "unknown": unknown}
        return recording.block("report", inputs, {"decision_inputs": self.outputs.join(values)})
