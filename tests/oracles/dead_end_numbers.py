"""Reference implementation of the detection of dead ends and of the change of depth, in plain Python.

This module computes the same numbers as `control.dead_end` and `control.layers`, but with independent code that handles
each case separately.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import cos, hypot, sin, sqrt

from surctl.marine.control.dead_end import ARRIVED, AT, FAST, HOLD, MOVING_SPEED, NEAR, NEW, RISES, SLACK

__all__ = ["Aim", "DeadEnd", "Mission", "Mover", "Place", "aim", "dead_end_step"]


@dataclass(frozen=True, kw_only=True)
class Mission:
    """Gains, vehicle model and mission parameters of the law, with the names that they have in `PARAMETERS`.

    Attributes:
        acceleration: largest heave acceleration for braking: brake · largest heave thrust / heave mass [m/s²].
        end: (2,) end of the path in {E} [m].
        search_limit: see `sensing.Equipment.search_limit`.
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
    search_limit: float | None = None

    @property
    def pitch(self) -> float:
        """Return the depth difference between adjacent layers (depths that the robot may use) [m]."""
        return 2 * self.hull + self.margin


@dataclass(frozen=True, kw_only=True)
class Place:
    """Position and surroundings of the robot in one control step.

    Attributes:
        eta, nu: (4,) pose in {E}, and (4,) velocity in {B}.
        reached: arc length of the robot's projection on the path [m].
        stopped: whether the law stops because it does not know what is ahead.
        column: free water above and below the hull [m]; None: only the path's depth is allowed.
    """

    eta: tuple[float, float, float, float]
    nu: tuple[float, float, float, float]
    reached: float
    stopped: bool = False
    column: tuple[float, float] | None = None

    @property
    def fast(self) -> bool:
        """Return whether the robot moves too fast horizontally to change its depth."""
        c, s = cos(self.eta[3]), sin(self.eta[3])
        x, y = c * self.nu[0] - s * self.nu[1], s * self.nu[0] + c * self.nu[1]
        return x * x + y * y > FAST**2

    def free(self, rise: float, margin: float) -> bool:
        """Return whether there is free water for a rise by `rise` [m]; a negative rise is a descent."""
        assert self.column is not None
        return abs(rise) <= (self.column[0] if rise > 0 else self.column[1]) - margin + SLACK


@dataclass(frozen=True)
class Mover:
    """A known obstacle with its clearance to the hull [m] and its speed [m/s]."""

    clearance: float
    speed: float


@dataclass(frozen=True)
class DeadEnd:
    """The values of the law's state entries `DEAD_END_PORTS`, `SEARCH_PORT` and `LAYER_PORTS`."""

    furthest: float = -100.0
    searched: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    stalled: float = 0.0
    trapped: bool = False
    layer: float = 0.0
    changing: float = 0.0
    beyond: float = 0.0
    searching: float = 0.0

    def anew(self) -> DeadEnd:
        """Return the state with both counts of time at zero."""
        return replace(self, stalled=0.0, searching=0.0)


@dataclass(frozen=True)
class Aim:
    """The commands while the robot holds its position or changes its depth.

    Attributes:
        velocity: (2,) velocity towards the position to hold [m/s] in {E}; None: the desired velocity does not change.
        layer: z of the present layer; during a change of depth, of the next layer [m].
        depth: reference z of the depth task [m].
    """

    velocity: tuple[float, float] | None
    layer: float
    depth: float


def aim(dead_end: DeadEnd, place: Place, mission: Mission) -> Aim:
    """Return the commands that `dead_end.standing` and `layers.aimed_depth` compute."""
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
    """Return the state after one control period.

    Args:
        dead_end: present state.
        place: position and surroundings of the robot in this step.
        movers: known obstacles that may move.
        mission: gains, model and mission numbers of the law.
        dt: control period [s].
    """
    after, ended = _searching(dead_end, place, movers, mission, dt)
    after = replace(after, changing=max(dead_end.changing, 0.0))
    if place.column is None or dead_end.trapped:
        return after
    # a dead end at one depth is not final: other depths are tried first
    dead, after = after.trapped, replace(after, trapped=False)
    here = (place.eta[0], place.eta[0], place.eta[1], place.eta[1])
    if dead_end.changing > 0.5:
        return _changing(
            dead_end, replace(after, searched=here if place.fast else dead_end.searched), place, mission, dead
        )
    home = mission.depth - place.eta[2]
    if abs(dead_end.layer) > 0.5 and (place.reached > dead_end.beyond or ended) and place.free(home, mission.margin):
        return replace(after.anew(), changing=2.0, searched=here)
    if not dead:
        return after
    return replace(
        after.anew(),
        layer=dead_end.layer + (-1 if dead_end.layer < 0 else 1),
        changing=1.0,
        searched=here,
        beyond=dead_end.beyond if abs(dead_end.layer) > 0.5 else after.furthest + mission.pitch,
    )


def _searching(
    dead_end: DeadEnd, place: Place, movers: Iterable[Mover], mission: Mission, dt: float
) -> tuple[DeadEnd, bool]:
    # the next state without layers, and whether the robot is at the end of the path
    x, y = place.eta[:2]
    west, east, south, north = dead_end.searched
    further = place.reached > dead_end.furthest + NEW
    outside = max(west - x, x - east, south - y, y - north) > NEW
    ended = (x - mission.end[0]) ** 2 + (y - mission.end[1]) ** 2 < ARRIVED**2
    near = any(m.speed > MOVING_SPEED and m.clearance < NEAR for m in movers)
    stalled = dead_end.stalled if place.stopped or ended or near else dead_end.stalled + dt
    stalled = 0.0 if further or outside else stalled
    searching = dead_end.searching
    if mission.search_limit is not None:
        searching = 0.0 if further else searching if ended or near else searching + dt
    furthest = place.reached if further else dead_end.furthest
    after = replace(dead_end, furthest=furthest, stalled=stalled, searching=searching)
    if dead_end.trapped:
        return after, ended
    lost = mission.search_limit is not None and searching >= mission.search_limit
    if lost or (mission.patience > 0 and stalled >= mission.patience):
        return replace(after, trapped=True, searched=(x, x, y, y)), ended
    box = (
        x if west - x > NEW else west,
        x if x - east > NEW else east,
        y if south - y > NEW else south,
        y if y - north > NEW else north,
    )
    return replace(after, searched=(x, x, y, y) if further else box), ended


def _changing(before: DeadEnd, after: DeadEnd, place: Place, mission: Mission, dead: bool) -> DeadEnd:
    # `after` already contains the position to hold
    returns = before.changing > 1.5
    rise = _goal(before, mission) - place.eta[2]
    if abs(rise) <= AT:
        return replace(after.anew(), changing=-1.0, layer=0.0 if returns else before.layer)
    if place.free(rise, mission.margin) and not dead:
        return after.anew() if abs(place.nu[2]) > RISES else after
    if returns:  # the water back to the path's depth is no longer free: go back to the layer
        return replace(after.anew(), changing=1.0)
    if before.layer < 0:
        abandoned_layer = (place.eta[2] - mission.depth) / mission.pitch
        return replace(after, changing=0.0, trapped=True, layer=abandoned_layer)
    return replace(after.anew(), changing=1.0, layer=-1.0)


def _goal(dead_end: DeadEnd, mission: Mission) -> float:
    return mission.depth + (0.0 if dead_end.changing > 1.5 else dead_end.layer) * mission.pitch


def _stops(distance: float, mission: Mission) -> float:
    # speed [m/s]; see `tasks.allowed_closing_speed`
    at = mission.acceleration * mission.reaction
    return sqrt(at * at + 2 * mission.acceleration * max(distance, 0.0)) - at
