"""The obstacles of a scenario as CasADi expressions, and their parameter values for many runs at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.marine.sensing import Solid, SolidBox, SolidDisc
from surctl.marine.simulation.column import BAND, FOOTPRINT, LONGEST
from surctl.marine.simulation.obstacle import Obstacle

__all__ = ["ABSENT", "NO_END", "Body", "BodyKind", "body_at", "body_columns", "body_size", "kind_of"]

Columns: TypeAlias = NDArray[np.float64]
BodyKind = Literal["box", "disc", "drifting box", "drifting disc", "mover"]

ABSENT = 1e30  # [m] clearance of an absent obstacle
NO_END = 1e6  # [m] height of an end beyond the floor or the surface


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
        """Return the signed distance [m] from a point to the obstacle's surface.

        If the obstacle is absent, the distance is the constant `ABSENT`.

        A point (2, 1) gives the planar distance; a point (3, 1) gives the distance in 3D if the obstacle has `heights`.
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


def kind_of(obstacle: Obstacle, *, drifting: bool) -> BodyKind:
    """Return the kind (shape and motion) of the obstacle; the kind cannot change after the loop is compiled."""
    if obstacle.shape == "moving":
        return "mover"
    if obstacle.shape == "box":
        return "drifting box" if drifting else "box"
    return "drifting disc" if drifting else "disc"


def body_size(kind: BodyKind) -> int:
    """Return the number of parameters that describe an obstacle of this kind."""
    return {"box": 4, "disc": 3, "drifting box": 8, "drifting disc": 7, "mover": 8}[kind]


def body_at(kind: BodyKind, numbers: ca.SX, time: ca.SX) -> Body:
    """Return the obstacle at a time [s], computed from the parameter values that `body_columns` returns."""
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


def body_columns(
    obstacle: Obstacle,
    kind: BodyKind,
    *,
    number: Callable[[str], Columns],
    values: Mapping[str, Columns],
    hull: Columns,
    direction: Columns,
    phase: Columns,
) -> list[Columns]:
    """Return the obstacle parameters that `body_at` needs for n runs: one array (n,) per parameter, or a scalar.

    Args:
        obstacle: the obstacle of the scenario.
        kind: kind of the obstacle, from `kind_of`.
        number: function that returns the values of an obstacle parameter; its argument is the last part of the
            parameter's name.
        values: values of the changed parameters, by full name of the parameter; the names show whether the radius was
            changed.
        hull: (n,) hull radius [m]; a moving obstacle without a stated radius takes this radius.
        direction: (n, 2) unit vector along the obstacle's drift (a sinusoidal motion).
        phase: (n,) phase of the drift [rad].
    """
    x, y = number("x"), number("y")
    if kind == "mover":
        own = obstacle.radius_m is not None or f"obstacle.{obstacle.name}.radius" in values
        displacement = np.stack(np.broadcast_arrays(number("to_x") - x, number("to_y") - y))
        distance = np.hypot(*displacement)
        unit = displacement / np.where(distance > 0, distance, 1.0)
        stays = np.asarray(float(not obstacle.removed))
        return [x, y, number("radius") if own else hull, unit[0], unit[1], distance, number("speed"), stays]
    size = [number("size_x"), number("size_y")] if kind.endswith("box") else [number("radius")]
    if not kind.startswith("drifting"):
        return [x, y, *size]
    rate, amplitude = 2 * np.pi / number("drift_period"), number("drift")
    return [x, y, *size, amplitude * direction[:, 0], amplitude * direction[:, 1], rate, phase]
