"""What is fixed in a compiled loop: kinds of obstacles and their clearance, thrust errors, feeding of long missions.

The parameters of a run contain the mission's table. Each control step copies from it the rows around the target point
and the rows around the robot, so the time of a step does not depend on the number of waypoints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Call, Gather, Layout, Port, Program, Step, lower_named
from surctl.marine.control import ARC_LENGTHS, CONTACT_SLOTS, Barrier, Law, Movers
from surctl.marine.guidance import AHEAD, ROW, SKIPS, AvoidanceForm, Guidance
from surctl.marine.guidance.following import follow_on, window_next, window_values
from surctl.marine.sensing import Equipment, Surfaces
from surctl.marine.sensing.sonar.solids import Solid, SolidBox, SolidDisc
from surctl.marine.simulation.metrics import ABSENT
from surctl.marine.simulation.run import Sensing
from surctl.marine.simulation.world import BAND, FOOTPRINT, LONGEST
from surctl.marine.vehicle import Actuators, PlantForm
from surctl.priority import Mode

_WINDOW = ("start", *(f"row{k}" for k in range(AHEAD + 1)), "end")
AROUND = tuple(f"around{k}" for k in range(SKIPS + 4))
"""Names of the rows around the robot, from the waypoint before its segment on; the end of a control step reads them."""
ROWS = (*_WINDOW, *AROUND)
"""Names of the rows of the mission's table that a control period reads."""
FIRST = Port("first", (1,), "1", "number of the first waypoint in a row in the law's window", 1.0)
"""The state that a run needs for the law's window."""


class Mission:
    """The steps of a compiled loop that feed the law, and the expressions for the robot's progress.

    `capacity` is the number of waypoints in the parameters; `rises` says whether the path changes
    its depth.
    """

    def __init__(self, law: Law, capacity: int, *, rises: bool) -> None:
        self.law, self.capacity, self.rises = law, capacity, rises

    def parameters(self, before: Layout) -> tuple[Port, ...]:
        """Return the entries that the mission adds to the parameters of a run, after the entries `before`."""
        return (
            Port("alignment", (-before.size % ROW,), "1", "not used: the table begins at a whole number of rows"),
            Port("mission", (self.capacity, ROW), "m, m/s, 1", "one waypoint per row, see Path.table"),
        )

    def steps(self, state: Layout, parameters: Layout) -> tuple[Step, ...]:
        """Return the steps that read state `s` and parameters `w` and write `x`, `p`, `first_next` and the rows."""
        places, feed = self.programs(state, parameters)
        return (
            Call(places, ("s", "w"), tuple(f"at_{name}" for name in ROWS)),
            *(Gather("w", f"at_{name}", ROW, name) for name in ROWS),
            Call(feed, ("s", "w", *_WINDOW), ("x", "p", "first_next")),
        )

    def programs(self, state: Layout, parameters: Layout) -> tuple[Program, Program]:
        """Return the programs `places`, to the numbers of the `rows`, and `feed`, to `x`, `p` and `first_next`."""
        return self._places(state, parameters), self._feed(state, parameters)

    def _places(self, state: Layout, parameters: Layout) -> Program:
        # numbers of the pieces of w
        s, old = state.symbols("s")
        w, known = parameters.symbols("w")
        base = parameters.slice("mission").start // ROW
        numbers = [ca.SX(0), *(old["first"] + k for k in range(AHEAD + 1)), known["legs"]]
        numbers += [old["leg"] - 1 + k for k in range(len(AROUND))]
        places = {
            f"at_{name}": base + ca.fmin(ca.fmax(number, 0), known["legs"])
            for name, number in zip(ROWS, numbers, strict=True)
        }
        return lower_named("places", {"s": s, "w": w}, places)

    def _feed(self, state: Layout, parameters: Layout) -> Program:
        law = self.law
        s, old = state.symbols("s")
        w, known = parameters.symbols("w")
        rows = {name: ca.SX.sym(name, ROW) for name in _WINDOW}
        alone = {} if "law" in old else {"law_state": ca.SX.sym("law_state", law.state.size)}
        x = law.state.split(alone["law_state"] if alone else old["law"])
        table = ca.vertcat(*(rows[f"row{k}"].T for k in range(AHEAD + 1)))
        last = ca.fmax(1, known["legs"] - AHEAD)
        first, shift = window_next(old["first"], x["progress"], table, rows["start"][:2], last)
        moved = first > old["first"]
        ahead = ca.if_else(moved, table[1:, :], table[:-1, :])
        window = ca.vertcat(rows["start"].T, ahead, rows["end"].T)
        x |= {name: x[name] + shift for name in ARC_LENGTHS if name in law.state}
        depth, cruise, visit = window_values(
            window, x["progress"], depth=known["depth"], cruise=known["cruise"], visit=known["visit"]
        )
        fed = {"waypoints": window[:, :2], "depth": depth, "cruise": cruise, "visit": visit}
        p = law.gains.join({port.name: fed.get(port.name, known[port.name]) for port in law.gains})
        outputs = {"x": law.state.join(x), "p": p, "first_next": first}
        return lower_named("feed", {"s": s, "w": w, **rows, **alone}, outputs)

    def progress(
        self, old: Mapping[str, ca.SX], w: Mapping[str, ca.SX], rows: Mapping[str, ca.SX]
    ) -> tuple[dict[str, ca.SX], ca.SX, ca.SX, ca.SX]:
        """Return the robot's progress as expressions, from state and parameters of a run and the rows around the robot.

        The results are the next state of `follow_on`, waypoints around the robot (k, 2) [m], the number of its segment
        among them, and z [m] of the path.
        """
        table = ca.vertcat(*(rows[name].T for name in AROUND))
        following, moved = follow_on(old, table[1 : SKIPS + 3, :], w["legs"], old["plant"][:2], visit=w["visited"])
        a, b = table[1, :], table[2, :]
        for k in range(1, SKIPS + 1):
            a, b = ca.if_else(moved == k, table[k + 1, :], a), ca.if_else(moved == k, table[k + 2, :], b)
        length = ca.sqrt(ca.sumsqr(b[:2] - a[:2]))
        rise = a[2] + (b[2] - a[2]) * (following["along"] / ca.fmax(length, 1e-12))
        return following, table[:, :2], 1 + moved, w["depth"] + rise


Columns: TypeAlias = NDArray[np.float64]
BodyKind = Literal["box", "disc", "drifting box", "drifting disc", "mover"]


@dataclass(frozen=True)
class Body:
    """An obstacle at one instant, as CasADi expressions.

    Attributes:
        centre: (2, 1) centre of the obstacle in the earth frame {E} [m].
        size: (2, 1) edge lengths of a box, or (1, 1) radius of a disc [m].
        velocity: (2, 1) velocity of the obstacle in {E} [m/s].
        present: 1 if the obstacle is in the water, 0 after its removal.
        moving: whether the base station (an external sensor for moving obstacles) tracks the obstacle.
        heights: (2, 1) z of the obstacle's bottom and top [m]; None if it fills the whole water column.
    """

    centre: ca.SX
    size: ca.SX
    velocity: ca.SX
    present: ca.SX
    moving: bool
    heights: ca.SX | None = None

    @property
    def boxed(self) -> bool:
        """Whether the obstacle is a box."""
        return bool(self.size.numel() == 2)

    def clearance(self, position: ca.SX) -> ca.SX:
        """Return the signed distance [m] from a point to the obstacle's surface; `ABSENT` if the obstacle is absent.

        A point (2, 1) gives the planar distance; a point (3, 1) that in 3D if the obstacle has `heights`.
        """
        distance = self._planar(position[:2])
        if self.heights is not None and position.numel() == 3:
            along = self._gap(position[2])
            apart = ca.sqrt(ca.fmax(distance, 0) ** 2 + ca.fmax(along, 0) ** 2)
            distance = ca.if_else(apart > 0, apart, ca.fmax(distance, along))
        return ca.if_else(self.present, distance, ABSENT)

    def beside(self, z: ca.SX, hull: ca.SX) -> Body:
        """Return a copy of the obstacle, present only if a hull of radius `hull` [m] at height z [m] can touch it."""
        if self.heights is None:
            return self
        return replace(self, present=ca.logic_and(self.present, self._gap(z) < hull + BAND))

    def over_and_under(self, place: ca.SX, hull: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the free water [m] above and below a hull at `place` up to the obstacle.

        Both values are limited to the constant `LONGEST`.
        """
        if self.heights is None:
            return ca.SX(LONGEST), ca.SX(LONGEST)
        bottom, top, z = self.heights[0], self.heights[1], place[2]
        near = ca.logic_and(self.present, self._planar(place[:2]) < hull + FOOTPRINT)
        above = ca.if_else(ca.logic_and(near, bottom > z), bottom - z - hull, LONGEST)
        below = ca.if_else(ca.logic_and(near, top < z), z - hull - top, LONGEST)
        return above, below

    def _gap(self, z: ca.SX) -> ca.SX:
        assert self.heights is not None
        return ca.fmax(self.heights[0] - z, z - self.heights[1])

    def _planar(self, position: ca.SX) -> ca.SX:
        offset = position - self.centre
        if self.boxed:
            beyond = ca.fabs(offset) - 0.5 * self.size
            outside = ca.sqrt(ca.sumsqr(ca.fmax(beyond, 0)))
            distance = ca.if_else(outside > 0, outside, ca.fmax(beyond[0], beyond[1]))
        else:
            distance = ca.sqrt(ca.sumsqr(offset)) - self.size
        return distance

    def contact(self, position: ca.SX) -> ca.SX:
        """Return the obstacle as input of the law: a row (1, 6) with x, y, radius, vx, vy, and 1 if it is present.

        For a box, the row holds the box's point nearest to `position`, with radius 0.
        """
        if self.boxed:
            half = 0.5 * self.size
            point = self.centre + ca.fmin(ca.fmax(position - self.centre, -half), half)
            radius = ca.SX(0)
        else:
            point, radius = self.centre, self.size
        row = ca.vertcat(point, radius, self.velocity, 1)
        return ca.if_else(self.present, row, ca.SX.zeros(6)).T

    @property
    def solid(self) -> Solid:
        """The surface of the obstacle, which reflects the sonar pulses."""
        if self.boxed:
            return SolidBox(self.centre, self.size, present=self.present)
        return SolidDisc(self.centre, self.size, present=self.present)


BODY_SIZES: Mapping[BodyKind, int] = {"box": 4, "disc": 3, "drifting box": 8, "drifting disc": 7, "mover": 8}
"""Number of parameters that describe an obstacle of each kind."""


def body_at(kind: BodyKind, numbers: ca.SX, time: ca.SX) -> Body:
    """Return the obstacle at a time [s], computed from its parameter values."""
    start = numbers[:2]
    if kind == "mover":
        direction, distance, speed, stays = numbers[3:5], numbers[5], numbers[6], numbers[7]
        there = speed * time >= distance
        velocity = ca.if_else(there, 0, speed) * direction
        where = start + ca.fmin(speed * time, distance) * direction
        return Body(where, numbers[2], velocity, ca.logic_or(ca.logic_not(there), stays), moving=True)
    shape = 2 if kind.endswith("box") else 1
    size, drift = numbers[2 : 2 + shape], numbers[2 + shape :]
    if not kind.startswith("drifting"):
        return Body(start, size, ca.SX.zeros(2), ca.SX(1), moving=False)
    angle = drift[2] * time + drift[3]
    return Body(start + ca.sin(angle) * drift[:2], size, drift[2] * ca.cos(angle) * drift[:2], ca.SX(1), moving=False)


@dataclass(frozen=True)
class Structure:
    """The part of a simulation setup that is fixed in the compiled loop; every other number is a parameter of each run.

    Attributes:
        equipment: the sensors; the hull radius matters only if the mounting points of the sonars are stated.
        faults: number of scheduled sonar faults that a run can hold.
        delays: whether one of the scheduled faults is a delay.
        optional: whether a run may leave obstacles out.
        heights: whether some obstacle ends above the floor or below the surface.
        depths: whether the mission allows other depths than the depth of the path.
        avoidance, mode, guidance, barrier, movers: the options of `build_law`.
        actuators: the thrusters to which the law allocates its thrust; None: each axis has its own limit.
        points: number of waypoints that a run can hold if the path is fed to the law (`Path.fed`); 0: it is not fed.
        surfaces: how each surface answers a sonar; None: all alike, as the `incidence_limit` of the sonars says.
    """

    law: str
    avoidance: AvoidanceForm
    mode: Mode
    sensing: Sensing
    bodies: tuple[BodyKind, ...]
    equipment: Equipment = field(default_factory=Equipment)
    faults: int = 0
    chances: bool = False
    delays: bool = False
    optional: bool = False
    guidance: Guidance = "los"
    barrier: Barrier = "simple"
    movers: Movers = "predict"
    heights: bool = False
    depths: bool = False
    form: PlantForm = field(default_factory=PlantForm)
    actuators: Actuators | None = None
    points: int = 0
    rises: bool = False
    surfaces: Surfaces | None = None

    @property
    def may_fail(self) -> bool:
        """Whether a sonar can fail in a run."""
        return self.faults > 0 or self.chances

    @property
    def draws_echoes(self) -> bool:
        """Whether some echoes are detected with a probability."""
        return self.surfaces is not None and self.surfaces.weak

    @property
    def moving(self) -> bool:
        """Whether the obstacle points that the law receives may move."""
        return self.sensing == "sonar" or any(kind not in ("box", "disc") for kind in self.bodies)

    @property
    def moved(self) -> int:
        """Number of moving obstacles."""
        return self.bodies.count("mover")

    @property
    def slots(self) -> int:
        """Number of moving obstacles that a message of the base station contains."""
        return min(CONTACT_SLOTS, self.moved)

    def bodies_at(self, w: Mapping[str, ca.SX], time: ca.SX) -> list[Body]:
        """Return the obstacles at a time [s], from the parameters of a run by name."""
        bodies = [body_at(kind, w[f"body{k}"], time) for k, kind in enumerate(self.bodies)]
        if self.heights:
            bodies = [replace(b, heights=w["heights"][k, :].T) for k, b in enumerate(bodies)]
        if not self.optional:
            return bodies
        return [replace(b, present=ca.logic_and(b.present, w["there"][k] > 0.5)) for k, b in enumerate(bodies)]

    @property
    def contacts(self) -> int:
        """Number of obstacle points that the law receives."""
        return min(CONTACT_SLOTS, self.moved if self.sensing == "sonar" else len(self.bodies))
