"""Contacts: objects near the robot, described by direction, clearance and velocity, whatever sensor detects them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from surctl.ir import each

__all__ = ["FAR", "Contact", "disc_contact", "disc_contacts", "nearest_in_quadrants", "point_contact", "wall_contacts"]

FAR = 100.0  # clearance [m] of an empty contact slot


@dataclass(frozen=True)
class Contact:
    """One object near the robot, as CasADi expressions.

    Attributes:
        normal: (2, 1) unit vector from robot to contact, in {E}.
        clearance: distance from the hull to the object's surface [m]; `FAR` if there is no object.
        velocity: (2, 1) velocity of the object in {E} [m/s].
        combined_radius: distance between the centres of robot and contact minus the clearance [m], that is, the sum of
            their radii (R_OB without its margin).
    """

    normal: ca.SX
    clearance: ca.SX
    velocity: ca.SX
    combined_radius: ca.SX

    @property
    def closing(self) -> ca.SX:
        """Component of the contact's velocity along `normal` [m/s]; negative if the contact approaches."""
        return ca.dot(self.velocity, self.normal)

    @staticmethod
    def of(row: ca.SX) -> Contact:
        """Return the contact whose numbers form one row of an array of contacts; see `row`."""
        return Contact(row[:2], row[2], row[3:5], row[5])

    @property
    def row(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """The attributes of the contact, as one row of an array of contacts."""
        return self.normal, self.clearance, self.velocity, self.combined_radius


def disc_contact(position: ca.SX, hull: ca.SX, centre: ca.SX, radius: ca.SX, velocity: ca.SX, valid: ca.SX) -> Contact:
    """Return the direction, clearance and velocity of a disc with a given radius [m] and velocity (2, 1) [m/s].

    The radius is 0 for a point.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import disc_contact
        >>> here, centre, still = ca.DM([0, 0]), ca.DM([2, 0]), ca.DM([0, 0])
        >>> contact = disc_contact(here, ca.DM(0.2), centre, ca.DM(0.5), still, ca.DM(1))
        >>> float(contact.clearance)  # m, from hull to rim
        1.3
    """
    offset = centre - position
    distance = ca.sqrt(ca.sumsqr(offset))
    apart = distance > 1e-6
    normal = ca.if_else(apart, offset / ca.fmax(distance, 1e-6), ca.SX([1, 0]))
    clearance = ca.if_else(valid > 0.5, distance - radius - hull, FAR)
    return Contact(normal, clearance, velocity, hull + radius)


def disc_contacts(position: ca.SX, hull: ca.SX, discs: ca.SX) -> list[Contact]:
    """Return the result of `disc_contact` for each disc (x, y, radius, vx, vy, valid) in an array (n, 6).

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import disc_contacts
        >>> discs = ca.SX([[2, 0, 0.5, 0, 0, 1], [0, 3, 0.5, 0, 0, 1]])
        >>> [float(contact.clearance) for contact in disc_contacts(ca.SX([0, 0]), ca.SX(0.2), discs)]
        [1.3, 2.3]
    """

    def contact(disc: ca.SX) -> tuple[ca.SX, ...]:
        return (ca.vertcat(*disc_contact(position, hull, disc[:2], disc[2], disc[3:5], disc[5]).row),)

    if discs.shape[0] == 0:
        return []
    (table,) = each("disc_contact", contact, discs)
    return [Contact.of(table[k, :].T) for k in range(table.shape[0])]


def point_contact(position: ca.SX, hull: ca.SX, point: ca.SX, valid: ca.SX) -> Contact:
    """Return the direction and clearance of a point at rest, for example of the point that caused an echo.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import point_contact
        >>> contact = point_contact(ca.DM([0, 0]), ca.DM(0.2), ca.DM([0, 1]), ca.DM(1))
        >>> round(float(contact.clearance), 3), ca.DM(contact.normal).full().ravel().tolist()
        (0.8, [0.0, 1.0])
    """
    return disc_contact(position, hull, point, ca.SX(0), ca.SX.zeros(2), valid)


def wall_contacts(position: ca.SX, hull: ca.SX, walls: ca.SX) -> list[Contact]:
    """Return the direction and clearance of the four walls x_min, x_max, y_min, y_max [m] of a rectangular site.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import wall_contacts
        >>> tank = ca.DM([0, 8, 0, 3])  # x_min, x_max, y_min, y_max
        >>> [round(float(c.clearance), 2) for c in wall_contacts(ca.DM([1.0, 1.5]), ca.DM(0.27), tank)]
        [0.73, 6.73, 1.23, 1.23]
    """
    x, y = position[0], position[1]
    sides = [
        (ca.SX([-1, 0]), x - walls[0]),
        (ca.SX([1, 0]), walls[1] - x),
        (ca.SX([0, -1]), y - walls[2]),
        (ca.SX([0, 1]), walls[3] - y),
    ]
    return [Contact(n, distance - hull, ca.SX.zeros(2), hull) for n, distance in sides]


def nearest_in_quadrants(contacts: Sequence[Contact], axes: Sequence[ca.SX]) -> list[Contact]:
    """Return, for each sensor axis (2, 1), the nearest contact within ±45° of this axis.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import nearest_in_quadrants, point_contact
        >>> hull, yes = ca.DM(0.2), ca.DM(1)
        >>> contacts = [point_contact(ca.DM([0, 0]), hull, ca.DM(p), yes) for p in ([2, 0.1], [1, 0], [0, 3])]
        >>> [float(c.clearance) for c in nearest_in_quadrants(contacts, [ca.DM([1, 0]), ca.DM([0, 1])])]
        [0.8, 2.8]
    """
    chosen = []
    for axis in axes:
        best = Contact(axis, ca.SX(FAR), ca.SX.zeros(2), ca.SX(0.5))
        for contact in contacts:
            inside = ca.dot(contact.normal, axis) >= 0.7071
            take = ca.logic_and(inside, contact.clearance < best.clearance)
            best = Contact(
                ca.if_else(take, contact.normal, best.normal),
                ca.if_else(take, contact.clearance, best.clearance),
                ca.if_else(take, contact.velocity, best.velocity),
                ca.if_else(take, contact.combined_radius, best.combined_radius),
            )
        chosen.append(best)
    return chosen
