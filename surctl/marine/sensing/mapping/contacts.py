"""Obstacle points without a map, one for each sensor: echoes that no known wall or obstacle explains.

The functions build CasADi expressions for the exported law. The heading is an input as (cos ψ, sin ψ), and azimuths and
beam angle are floats, so the expressions need dot and cross products but no angles. The class `ContactMemory` stores
one echo per sensor; it is not a map. All positions are planar at the robot's depth, in the world frame {E}, in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, pi
from typing import NamedTuple

import casadi as ca

from surctl.errors import InputError
from surctl.ir import Port, fold
from surctl.marine.sensing.sonar.array import SonarArray
from surctl.marine.sensing.sonar.solids import disc_range, turned, wall_range


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

    The function uses the closed form of `Solid.nearest_in_cone`: the nearest point of a wall or
    disc in the cone is the foot point (the nearest point of the whole shape) if the cone contains it, otherwise a point
    on an edge ray of the cone.

    Args:
        position: (2,) robot's centre in {E} [m].
        heading: (2,) cos ψ, sin ψ.
        walls: (4,) xmin, xmax, ymin, ymax of the tank in {E} [m].
        discs: (K, 3) known obstacles: x, y, radius [m]; K may be 0.
        valid: (K,) 1 for a disc that is present, else 0.
        azimuth: azimuth of the sensor in {B} [rad].
        hull_radius: distance from the robot's centre to the apex of the cone [m]; a symbol in a law for any vehicle.
        half_angle: half the opening angle of the cone [rad], 0 < half_angle < π/2.
        maximum: longest range that the sensor measures [m].
        incidence: largest angle between a wall's normal and the direction to the sensor at which the wall answers
            [rad]; None: a wall answers at every angle. Obstacles answer at every angle.

    Raises:
        InputError: if half_angle is out of range.
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
    margin: float = 0.1,
    tolerance: float = 0.1,
) -> Contacts:
    """Return one point per sensor, on the beam's axis at `range_hat`; the point is valid if the echo is unexplained.

    A range is an echo if range_hat < maximum − margin. The known walls and obstacles explain the echo if
    range_hat ≥ expected − tolerance.

    Args:
        array: the sonar array.
        range_hat: (n,) filtered ranges [m].
        position: (2,) robot's centre in {E} [m].
        heading: (2,) cos ψ, sin ψ.
        hull_radius: distance from the robot's centre to the apexes [m].
        expected: (n,) expected ranges from `expected_range` [m].
        margin: a range above `maximum` − `margin` counts as no echo [m].
        tolerance: a range above `expected` − `tolerance` is explained by the known walls and obstacles [m].
    """
    points = []
    for i, azimuth in enumerate(array.azimuths):
        points.append((position + (hull_radius + range_hat[i]) * turned(heading, azimuth)).T)
    is_echo = range_hat < array.maximum - margin
    explained = range_hat >= expected - tolerance
    return Contacts(ca.vertcat(*points), ca.logic_and(is_echo, ca.logic_not(explained)))


@dataclass(frozen=True, kw_only=True)
class ContactMemory:
    """A memory of the last unexplained echo of each sensor; the echo is dropped after the time `hold`.

    The position of a stored echo in {E} is fixed.

    Later readings without an echo do not remove a stored echo, because the beam may have turned away from the obstacle.

    Attributes:
        sensors: number of sensors n.
        dt: period of the updates [s].
        hold: longest age of a stored echo [s] (design choice).
    """

    dt: float
    sensors: int = 4
    hold: float = 0.5

    def __post_init__(self) -> None:
        """Check the values; raise an InputError that names an invalid value."""
        for name in ("dt", "hold"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise InputError("must be greater than 0", key=f"contacts.{name}", value=value, remedy="give s")
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

        Args:
            state: value of each entry of `ports(prefix)`, by name.
            contacts: obstacle points at this control step; only the points of fresh sensors are used.
            fresh: (n,) 1 for a sensor that fired since the last update, else 0.
            prefix: prefix of the names of the state's entries.
        """
        echo, age = state[f"{prefix}echo"], state[f"{prefix}age"]
        new = ca.logic_and(fresh > 0.5, contacts.valid)
        points = [ca.if_else(new[i], contacts.points[i, :], echo[i, :]) for i in range(self.sensors)]
        older = ca.fmin(age + self.dt, self.hold + self.dt)
        ages = ca.if_else(new, 0.0, older)
        after = {f"{prefix}echo": ca.vertcat(*points), f"{prefix}age": ages}
        # tolerance of half a step, because sums of dt are not exact
        return after, Contacts(after[f"{prefix}echo"], ages <= self.hold + 0.5 * self.dt)
