"""From ranges to contacts: what the known world explains, and where the rest of the echoes stand.

CasADi expressions for the exported law. The heading enters as (cos ψ, sin ψ), azimuths and beam as floats, so
that no angle is ever recovered: dot and cross products only. This version keeps one echo a sensor and no cell
memory.
Planar at the robot's depth, world frame {E}, metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, pi
from typing import NamedTuple

import casadi as ca

from surctl.errors import InputError
from surctl.ir import Port, fold
from surctl.sensing.sonar.array import SonarArray
from surctl.sensing.sonar.cones import disc_range, turned, wall_range

__all__ = ["ContactMemory", "Contacts", "expected_range", "sonar_contacts"]


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
) -> ca.SX:
    """Range that the known things alone would give in one sensor's cone [m]; 2·maximum when none or further.

    The same closed form as `surctl.world.Shape.nearest_in_cone`: foot point if inside the cone, else the edge
    rays.

    Args:
        position: (2,) robot's centre in {E} [m].
        heading: (2,) cos ψ, sin ψ.
        walls: (4,) xmin, xmax, ymin, ymax of the tank in {E} [m].
        discs: (K, 3) known obstacles: x, y, radius [m]; K may be 0.
        valid: (K,) 1 for a disc that is there, else 0.
        azimuth: of the sensor in {B} [rad].
        hull_radius: from the centre to the apex [m]; a symbol in the law, which any vehicle may fly.
        half_angle: of the cone [rad], 0 < half_angle < π/2.
        maximum: longest range of the sensor [m].

    Raises:
        InputError: half_angle out of range.

    Example:
        >>> import casadi as ca
        >>> from math import radians
        >>> from surctl.sensing import expected_range
        >>> tank, none = ca.SX([0.0, 3.0, 0.0, 2.0]), {"discs": ca.SX(0, 3), "valid": ca.SX(0, 1)}
        >>> sonar = {"azimuth": 0.0, "hull_radius": 0.2, "half_angle": radians(15), "maximum": 4.5}
        >>> ca.evalf(expected_range(ca.SX([1.0, 1.0]), ca.SX([1.0, 0.0]), walls=tank, **none, **sonar))
        DM(1.8)
    """
    if not 0.0 < half_angle < pi / 2:
        raise InputError("must lie between 0 and pi/2", key="half_angle", value=half_angle, remedy="give radians")
    axis = turned(heading, azimuth)
    apex = position + hull_radius * axis
    nothing = 2.0 * maximum
    closest: ca.SX = ca.SX(nothing)
    for normal, distance in (
        ((1.0, 0.0), walls[1] - apex[0]),
        ((-1.0, 0.0), apex[0] - walls[0]),
        ((0.0, 1.0), walls[3] - apex[1]),
        ((0.0, -1.0), apex[1] - walls[2]),
    ):
        closest = ca.fmin(closest, wall_range(axis, normal, distance=distance, half_angle=half_angle, nothing=nothing))

    def nearer(range_: ca.SX, disc: ca.SX) -> ca.SX:
        hit = disc_range(axis, disc[:2] - apex, radius=disc[2], half_angle=half_angle, nothing=nothing)
        return ca.fmin(range_, ca.if_else(disc[3] > 0.5, hit, nothing))

    nearest: ca.SX = fold("disc_range", nearer, closest, ca.horzcat(discs, valid))
    return nearest


class Contacts(NamedTuple):
    """Echoes of one tick; SX expressions."""

    points: ca.SX
    """(n, 2) contact points in {E} [m]."""
    valid: ca.SX
    """(n,) 1 for an echo of something unknown, else 0."""


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
    """Contact of each sensor: the point at `range_hat` on its axis, valid when an echo and not explained.

    An echo is range_hat < maximum − margin; it is explained by the known world when range_hat ≥ expected −
    tolerance.

    Args:
        array: the sensors.
        range_hat: (n,) filtered ranges [m].
        position: (2,) robot's centre in {E} [m].
        heading: (2,) cos ψ, sin ψ.
        hull_radius: from the centre to the apexes [m].
        expected: (n,) of `expected_range` [m].
        margin: [m].
        tolerance: [m].

    Example:
        >>> import casadi as ca
        >>> from surctl.sensing import SonarArray, sonar_contacts
        >>> ranges, walls = ca.SX([1.0, 0.8, 4.5, 0.8]), ca.SX([1.8, 0.8, 0.8, 0.8])  # heard, and expected of the tank
        >>> place = {"position": ca.SX([1.0, 1.0]), "heading": ca.SX([1.0, 0.0]), "hull_radius": 0.2}
        >>> contacts = sonar_contacts(SonarArray(), ranges, expected=walls, **place)
        >>> ca.evalf(contacts.valid), ca.evalf(contacts.points[0, :])
        (DM([1, 0, 0, 0]), DM([[2.2, 1]]))
    """
    points = []
    for i, azimuth in enumerate(array.azimuths):
        points.append((position + (hull_radius + range_hat[i]) * turned(heading, azimuth)).T)
    is_echo = range_hat < array.maximum - margin
    explained = range_hat >= expected - tolerance
    return Contacts(ca.vertcat(*points), ca.logic_and(is_echo, ca.logic_not(explained)))


@dataclass(frozen=True, kw_only=True)
class ContactMemory:
    """The last unexplained echo of each sensor, fixed in {E}, dropped after `hold`.

    An echo outlives readings without one: a beam that turns away from an obstacle does not remove it.

    Attributes:
        sensors: their number n.
        dt: period of the updates [s].
        hold: longest age of an echo [s] (*chosen*).
    """

    dt: float
    sensors: int = 4
    hold: float = 0.5

    def __post_init__(self) -> None:
        """Check the values; InputError names the wrong one."""
        for name in ("dt", "hold"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise InputError("must be greater than 0", key=f"contacts.{name}", value=value, remedy="give s")
        if self.sensors < 1:
            raise InputError("must be at least 1", key="contacts.sensors", value=self.sensors)

    def ports(self, prefix: str = "") -> tuple[Port, ...]:
        """The state; it starts with every echo too old to count."""
        return (
            Port(f"{prefix}echo", (self.sensors, 2), "m", "last unexplained echo of each sensor, x, y in {E}"),
            Port(
                f"{prefix}age",
                (self.sensors,),
                "s",
                "age of that echo, held at hold + dt",
                self.hold + self.dt,
            ),
        )

    def update(
        self, state: Mapping[str, ca.SX], contacts: Contacts, *, fresh: ca.SX, prefix: str = ""
    ) -> tuple[dict[str, ca.SX], Contacts]:
        """Next state, and the echoes that stand: new ones at age 0, and older ones up to `hold`.

        Args:
            state: by port name, shapes of `ports(prefix)`.
            contacts: of this tick; only those of fresh sensors are taken.
            fresh: (n,) 1 for a sensor that fired since the last update, else 0.
            prefix: of the names of the state.
        """
        echo, age = state[f"{prefix}echo"], state[f"{prefix}age"]
        new = ca.logic_and(fresh > 0.5, contacts.valid)
        points = [ca.if_else(new[i], contacts.points[i, :], echo[i, :]) for i in range(self.sensors)]
        older = ca.fmin(age + self.dt, self.hold + self.dt)
        ages = ca.if_else(new, 0.0, older)
        after = {f"{prefix}echo": ca.vertcat(*points), f"{prefix}age": ages}
        # half a step of slack: sums of dt are not exact
        return after, Contacts(after[f"{prefix}echo"], ages <= self.hold + 0.5 * self.dt)
