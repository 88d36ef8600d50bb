"""Dead ends and layers in plain Python: the same numbers as `control.trap` and `control.layers`, written apart from
them, case by case as a reader would tell it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import cos, hypot, sin, sqrt

from surctl.control.dead_end import ARRIVED, HOLD, MOVES, NEAR, NEW
from surctl.control.layers import AT, FAST, RISES, SLACK

__all__ = ["Aim", "DeadEnd", "Mission", "Mover", "Place", "aim", "dead_end_step"]


@dataclass(frozen=True, kw_only=True)
class Mission:
    """Numbers of the law: gains, model and mission, as `PARAMETERS` names them.

    Attributes:
        acceleration: brake · largest heave thrust / heave mass [m/s²].
        end: (2,) the path's end in {E} [m].
    """

    patience: float
    cruise: float
    margin: float
    k2: float
    reaction: float
    hull: float
    depth: float
    acceleration: float
    end: tuple[float, float]

    @property
    def pitch(self) -> float:
        """From one layer to the next [m]."""
        return 2 * self.hull + self.margin


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where the robot is in one step.

    Attributes:
        eta, nu: (4,) pose in {E} and velocity in {B}.
        reached: arc length of its projection on the path [m].
        halted: whether the law stands for want of knowledge.
        column: free water above and below the hull [m]; None: the path's depth alone.
    """

    eta: tuple[float, float, float, float]
    nu: tuple[float, float, float, float]
    reached: float
    stopped: bool = False
    column: tuple[float, float] | None = None

    @property
    def fast(self) -> bool:
        """Whether it moves too fast horizontally to change its depth."""
        c, s = cos(self.eta[3]), sin(self.eta[3])
        x, y = c * self.nu[0] - s * self.nu[1], s * self.nu[0] + c * self.nu[1]
        return x * x + y * y > FAST**2

    def free(self, rise: float, margin: float) -> bool:
        """Whether the water is free as far as a rise [m], negative downwards."""
        assert self.column is not None
        return abs(rise) <= (self.column[0] if rise > 0 else self.column[1]) - margin + SLACK


@dataclass(frozen=True)
class Mover:
    """A known obstacle: clearance to the hull [m], and speed [m/s]."""

    clearance: float
    speed: float


@dataclass(frozen=True)
class DeadEnd:
    """`TRAP_PORTS` and `LAYER_PORTS`."""

    furthest: float = -100.0
    searched: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    stalled: float = 0.0
    trapped: bool = False
    layer: float = 0.0
    changing: float = 0.0
    beyond: float = 0.0


@dataclass(frozen=True)
class Aim:
    """What is asked for while it stands or changes its depth.

    Attributes:
        velocity: (2,) towards the place it keeps [m/s] in {E}, or None: the wish is left alone.
        layer: z of the layer [m].
        depth: z for the depth task [m].
    """

    velocity: tuple[float, float] | None
    layer: float
    depth: float


def aim(dead_end: DeadEnd, place: Place, mission: Mission) -> Aim:
    """`trap.standing` and `layers.aimed_depth`."""
    velocity = None
    if dead_end.trapped or dead_end.changing > 0.5:
        dx, dy = dead_end.searched[0] - place.eta[0], dead_end.searched[2] - place.eta[1]
        gain = min(HOLD, mission.cruise / max(hypot(dx, dy), 1e-3))
        velocity = (gain * dx, gain * dy)
    goal, z = _goal(dead_end, mission), place.eta[2]
    if place.column is None or dead_end.changing < 0.5:
        return Aim(velocity, goal, goal)
    if place.fast:
        return Aim(velocity, goal, z)
    up, down = (_stops(free - mission.margin, mission) / max(mission.k2, 1e-6) for free in place.column)
    return Aim(velocity, goal, z + min(max(goal - z, -down), up))


def dead_end_step(dead_end: DeadEnd, place: Place, movers: Iterable[Mover], mission: Mission, *, dt: float) -> DeadEnd:
    """One control period later.

    Args:
        trap: now.
        place: of this step.
        movers: known obstacles that may move.
        mission: numbers of the law.
        dt: control period [s].
    """
    after, ended = _searching(dead_end, place, movers, mission, dt)
    after = replace(after, changing=max(dead_end.changing, 0.0))
    if place.column is None or dead_end.trapped:
        return after
    # a dead end at one depth is none yet
    dead, after = after.trapped, replace(after, trapped=False)
    here = (place.eta[0], place.eta[0], place.eta[1], place.eta[1])
    if dead_end.changing > 0.5:
        return _changing(
            dead_end, replace(after, searched=here if place.fast else dead_end.searched), place, mission, dead
        )
    home = mission.depth - place.eta[2]
    if abs(dead_end.layer) > 0.5 and (place.reached > dead_end.beyond or ended) and place.free(home, mission.margin):
        return replace(after, changing=2.0, searched=here, stalled=0.0)
    if not dead:
        return after
    return replace(
        after,
        layer=dead_end.layer + (-1 if dead_end.layer < 0 else 1),
        changing=1.0,
        searched=here,
        stalled=0.0,
        beyond=dead_end.beyond if abs(dead_end.layer) > 0.5 else after.furthest + mission.pitch,
    )


def _searching(
    dead_end: DeadEnd, place: Place, movers: Iterable[Mover], mission: Mission, dt: float
) -> tuple[DeadEnd, bool]:
    """Without layers, and whether it is at the path's end."""
    x, y = place.eta[:2]
    west, east, south, north = dead_end.searched
    further = place.reached > dead_end.furthest + NEW
    outside = max(west - x, x - east, south - y, y - north) > NEW
    ended = (x - mission.end[0]) ** 2 + (y - mission.end[1]) ** 2 < ARRIVED**2
    waits = place.stopped or ended or any(m.speed > MOVES and m.clearance < NEAR for m in movers)
    stalled = dead_end.stalled if waits else dead_end.stalled + dt
    stalled = 0.0 if further or outside else stalled
    furthest = place.reached if further else dead_end.furthest
    if dead_end.trapped:
        return replace(dead_end, furthest=furthest, stalled=stalled), ended
    if mission.patience > 0 and stalled >= mission.patience:
        return replace(dead_end, furthest=furthest, stalled=stalled, trapped=True, searched=(x, x, y, y)), ended
    box = (
        x if west - x > NEW else west,
        x if x - east > NEW else east,
        y if south - y > NEW else south,
        y if y - north > NEW else north,
    )
    return replace(dead_end, furthest=furthest, stalled=stalled, searched=(x, x, y, y) if further else box), ended


def _changing(before: DeadEnd, after: DeadEnd, place: Place, mission: Mission, dead: bool) -> DeadEnd:
    """On the way to another depth, whose place is already kept in `after`."""
    returns = before.changing > 1.5
    rise = _goal(before, mission) - place.eta[2]
    if abs(rise) <= AT:
        return replace(after, changing=-1.0, stalled=0.0, layer=0.0 if returns else before.layer)
    if place.free(rise, mission.margin) and not dead:
        return replace(after, stalled=0.0) if abs(place.nu[2]) > RISES else after
    if returns:  # something came under it: back to the layer
        return replace(after, changing=1.0, stalled=0.0)
    if before.layer < 0:
        abandoned_layer = (place.eta[2] - mission.depth) / mission.pitch
        return replace(after, changing=0.0, trapped=True, layer=abandoned_layer)
    return replace(after, changing=1.0, stalled=0.0, layer=-1.0)


def _goal(dead_end: DeadEnd, mission: Mission) -> float:
    return mission.depth + (0.0 if dead_end.changing > 1.5 else dead_end.layer) * mission.pitch


def _stops(distance: float, mission: Mission) -> float:
    """Speed [m/s] from which it stops within a distance [m]; see `guidance.allowed_closing_speed`."""
    at = mission.acceleration * mission.reaction
    return sqrt(at * at + 2 * mission.acceleration * max(distance, 0.0)) - at
