"""Obstacle points without a map, one for each sensor: echoes that no known wall or obstacle explains.

The functions build CasADi expressions for the exported law. The heading is an input as (cos ψ, sin ψ), and azimuths and
beam angle are floats, so the expressions need dot and cross products but no angles. The class `ContactMemory` stores
one echo per sensor; it is not a map. All positions are planar at the robot's depth, in the world frame {E}, in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import NamedTuple

import casadi as ca

from surctl.errors import InputError, check_number
from surctl.ir import Port, fold
from surctl.marine.sensing.sonar.array import SonarArray
from surctl.marine.sensing.sonar.solids import disc_range, turned, wall_range

_TOLERANCE = 0.1  # [m]


def expected_range(
    position: ca.SX,
    heading: ca.SX,
    *,
    walls: ca.SX,
    discs: ca.SX,
    valid: ca.SX,
    azimuth: float,
    hull_radius: ca.SX | float,
    half_angle: float,
    maximum: float,
    incidence: float | None = None,
) -> ca.SX:
    """Return the range [m] that one sensor would measure if only known walls and obstacles existed; at most 2·maximum.

    As in `Solid.nearest_in_cone`, the nearest point of a wall or disc is its foot point if the cone contains it,
    otherwise a point on an edge ray of the cone.

    Args:
        position, heading: (2,) robot's centre in {E} [m]; (2,) cos ψ, sin ψ.
        walls: (4,) xmin, xmax, ymin, ymax of the tank in {E} [m].
        discs, valid: (K, 3) known obstacles, x, y, radius [m], and (K,) 1 for one that is present, else 0.
        azimuth: azimuth of the sensor in {B} [rad].
        hull_radius: distance from the robot's centre to the apex of the cone [m]; a symbol in a law for any vehicle.
        half_angle: half the opening angle of the cone [rad], 0 < half_angle < π/2.
        incidence: largest angle between a wall's normal and the direction to the sensor at which the wall answers
            [rad]; None: any. Obstacles answer at every angle.
    """
    if not 0.0 < half_angle < pi / 2:
        raise InputError("must lie between 0 and pi/2", key="half_angle", value=half_angle, remedy="give radians")
    axis = turned(heading, azimuth)
    apex = position + hull_radius * axis
    nothing = 2.0 * maximum
    closest: ca.SX = ca.SX(nothing)
    away = (walls[1] - apex[0], walls[3] - apex[1], apex[0] - walls[0], apex[1] - walls[2])
    for k in (0, 2, 1, 3):
        hit = wall_range(
            axis,
            ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[k],
            distance=away[k],
            half_angle=half_angle,
            nothing=nothing,
            incidence=incidence,
            sides=(away[(k + 1) % 4], away[k - 1]),
        )
        closest = ca.fmin(closest, hit)

    def nearer(range_: ca.SX, disc: ca.SX) -> ca.SX:
        hit = disc_range(axis, disc[:2] - apex, radius=disc[2], half_angle=half_angle, nothing=nothing)
        return ca.fmin(range_, ca.if_else(disc[3] > 0.5, hit, nothing))

    nearest: ca.SX = fold("disc_range", nearer, closest, ca.horzcat(discs, valid))
    return nearest


class Contacts(NamedTuple):
    """The obstacle points (contacts) at one control step, as CasADi SX expressions."""

    points: ca.SX
    """(n, 2) obstacle points in {E} [m], one per sensor."""
    valid: ca.SX
    """(n,) 1 if the point is an echo of an unknown object, else 0."""


def sonar_contacts(
    array: SonarArray,
    range_hat: ca.SX,
    *,
    position: ca.SX,
    heading: ca.SX,
    hull_radius: ca.SX | float,
    expected: ca.SX,
) -> Contacts:
    """Return one point per sensor, on the beam's axis at `range_hat`; the point is valid if the echo is unexplained.

    A range is an echo if it is 0.1 m below the maximum or more. The known walls and obstacles explain it if it is at
    least `expected` − 0.1 m. Ranges are (n,) [m]; `position` and `heading` are as for `expected_range`.
    """
    points = []
    for i, azimuth in enumerate(array.azimuths):
        points.append((position + (hull_radius + range_hat[i]) * turned(heading, azimuth)).T)
    is_echo = range_hat < array.maximum - _TOLERANCE
    explained = range_hat >= expected - _TOLERANCE
    return Contacts(ca.vertcat(*points), ca.logic_and(is_echo, ca.logic_not(explained)))


@dataclass(frozen=True, kw_only=True)
class ContactMemory:
    """A memory of the last unexplained echo of each sensor, fixed in {E}, for the time `hold` [s] (design choice).

    Later readings without an echo do not remove it, because the beam may have turned away from the obstacle.
    """

    dt: float
    sensors: int = 4
    hold: float = 0.5

    def __post_init__(self) -> None:
        for name in ("dt", "hold"):
            check_number(f"contacts.{name}", getattr(self, name), unit="s")
        if self.sensors < 1:
            raise InputError("must be at least 1", key="contacts.sensors", value=self.sensors)

    def ports(self, prefix: str = "") -> tuple[Port, ...]:
        """Return the entries (name, shape, initial value) of the state; initially, no stored echo is valid."""
        return (
            Port(f"{prefix}echo", (self.sensors, 2), "m", "last unexplained echo of each sensor, x, y in {E}"),
            Port(f"{prefix}age", (self.sensors,), "s", "age of that echo, limited to hold + dt", self.hold + self.dt),
        )

    def update(
        self, state: Mapping[str, ca.SX], contacts: Contacts, *, fresh: ca.SX, prefix: str = ""
    ) -> tuple[dict[str, ca.SX], Contacts]:
        """Return the next state and the valid echoes: new echoes at age 0, and older echoes up to age `hold`.

        Only the points of sensors with `fresh` (n,) 1, which fired since the last update, are used.
        """
        echo, age = state[f"{prefix}echo"], state[f"{prefix}age"]
        new = ca.logic_and(fresh > 0.5, contacts.valid)
        points = [ca.if_else(new[i], contacts.points[i, :], echo[i, :]) for i in range(self.sensors)]
        older = ca.fmin(age + self.dt, self.hold + self.dt)
        ages = ca.if_else(new, 0.0, older)
        after = {f"{prefix}echo": ca.vertcat(*points), f"{prefix}age": ages}
        # tolerance of half a step, because sums of dt are not exact
        return after, Contacts(after[f"{prefix}echo"], ages <= self.hold + 0.5 * self.dt)
