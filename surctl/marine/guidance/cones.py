"""Collision cones: the velocities that lead to a collision with a moving contact (object) within a given time.

The method follows Fiorini and Shiller (1998). A barrier on the distance would make the robot retreat from an
approaching contact. A collision cone forbids only the velocities that lead to a collision, so the robot can also
sidestep.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from surctl.marine.guidance.contacts import Contact

__all__ = ["Cone", "collision_cone", "inside"]

_NEVER = -10.0  # [m/s] depth of every velocity if there is no contact: far outside the cone


class Cone(NamedTuple):
    """A collision cone: velocities v (2, 1) [m/s] in {E} at which the robot collides with a moving contact.

    A velocity v lies in the cone if left·v, right·v and ahead·v exceed `left_bound`, `right_bound` and `ahead_bound`.

    Attributes:
        left, right: (2, 1) unit normals of the two sides of the cone, which point into the cone.
        ahead: (2, 1) unit vector from robot to contact.
        left_bound, right_bound: bounds on left·v and right·v [m/s].
        ahead_bound: value of ahead·v [m/s] above which the robot meets the contact within the prediction time.
        closing: component of the contact's velocity along `ahead` [m/s], negative if the contact approaches.
        clearance: clearance minus the stand-off distance [m], not negative.
        distance: distance between the centres of robot and contact [m].
        offset: distance between the centres of robot and contact when the robot passes the contact [m].
        crossing: component of the contact's velocity perpendicular to `ahead` [m/s], positive to the left.
        there: 1 if a contact exists; 0 if the cone is empty.
        point: (2, 1) [m] in {E}, position of the contact.
    """

    left: ca.SX
    right: ca.SX
    ahead: ca.SX
    left_bound: ca.SX
    right_bound: ca.SX
    ahead_bound: ca.SX
    closing: ca.SX
    clearance: ca.SX
    distance: ca.SX
    offset: ca.SX
    crossing: ca.SX
    there: ca.SX
    point: ca.SX

    @staticmethod
    def of(row: ca.SX) -> Cone:
        """Return the collision cone whose numbers form one row of an array of cones."""
        left, right, ahead, point = (row[k : k + 2] for k in (0, 2, 4, 15))
        bounds, met = (row[6], row[7], row[8]), (row[9], row[10], row[11], row[12], row[13], row[14])
        return Cone(left, right, ahead, *bounds, *met, point)


def collision_cone(
    contact: Contact, *, apart: ca.SX, standoff: ca.SX, horizon: ca.SX, there: ca.SX, point: ca.SX
) -> Cone:
    """Return the collision cone of a contact.

    Args:
        contact: the moving contact.
        apart: least clearance with which the robot may pass the contact [m].
        standoff: clearance at or below which the robot and the contact count as having collided [m].
        horizon: prediction time; only collisions within this time count [s].
        there: 1 if the contact must be avoided; with 0, the cone is empty.
        point: (2, 1) [m] in {E}, position of the contact.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import collision_cone, disc_contact
        >>> here, hull, centre, motion = ca.DM([0, 0]), ca.DM(0.2), ca.DM([2, 0]), ca.DM([-0.1, 0])
        >>> contact = disc_contact(here, hull, centre, ca.DM(0.3), motion, ca.DM(1))  # approaches at 0.1 m/s
        >>> known = dict(apart=0.05, standoff=0.0, horizon=10.0, there=1)
        >>> known = {name: ca.DM(value) for name, value in known.items()}
        >>> cone = collision_cone(contact, point=centre, **known)
        >>> float(cone.closing), round(float(cone.clearance), 2), float(cone.distance)
        (-0.1, 1.5, 2.0)
    """
    n, across = contact.normal, ca.vertcat(-contact.normal[1], contact.normal[0])
    distance = contact.clearance + contact.combined_radius
    sine = ca.fmin((contact.combined_radius + apart) / ca.fmax(distance, 1e-6), 1)
    cosine = ca.sqrt(1 - sine * sine)
    left, right = sine * n - cosine * across, sine * n + cosine * across
    motion = contact.velocity
    return Cone(
        left,
        right,
        n,
        ca.dot(left, motion),
        ca.dot(right, motion),
        ca.dot(n, motion) + ca.fmax(contact.clearance - standoff, 0) / horizon,
        ca.dot(n, motion),
        ca.fmax(contact.clearance - standoff, 0),
        distance,
        contact.combined_radius + apart,
        ca.dot(across, motion),
        there,
        point,
    )


def inside(velocity: ca.SX, cone: Cone) -> ca.SX:
    """Return how deep [m/s] inside the cone a velocity (2, 1) lies; the result is negative outside the cone.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.guidance import collision_cone, disc_contact, inside
        >>> here, hull, centre, motion = ca.DM([0, 0]), ca.DM(0.2), ca.DM([2, 0]), ca.DM([-0.1, 0])
        >>> contact = disc_contact(here, hull, centre, ca.DM(0.3), motion, ca.DM(1))  # approaches at 0.1 m/s
        >>> known = dict(apart=0.05, standoff=0.0, horizon=10.0, there=1)
        >>> known = {name: ca.DM(value) for name, value in known.items()}
        >>> cone = collision_cone(contact, point=centre, **known)
        >>> [round(float(inside(ca.DM(v), cone)), 3) for v in ([0.15, 0.0], [0.1, 0.15])]  # collides, passes
        [0.069, -0.089]
    """
    depth = ca.fmin(ca.dot(cone.left, velocity) - cone.left_bound, ca.dot(cone.right, velocity) - cone.right_bound)
    depth = ca.fmin(depth, ca.dot(cone.ahead, velocity) - cone.ahead_bound)
    return ca.if_else(cone.there, depth, _NEVER)
