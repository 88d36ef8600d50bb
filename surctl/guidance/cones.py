"""Collision cones: which velocities lead into something that moves, within a time (Fiorini and Shiller 1998).

A range barrier on what moves asks for retreat before it; here only the velocities that would hit it are closed, so
that a sidestep stays open.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from surctl.guidance.contacts import Contact

__all__ = ["Cone", "collision_cone", "inside"]

_NEVER = -10.0  # [m/s]


class Cone(NamedTuple):
    """Velocities v (2, 1) [m/s] in {E} with left·v, right·v and ahead·v all above their bounds lead into it.

    Attributes:
        left, right: (2, 1) unit normals of the cone's two sides, inwards.
        ahead: (2, 1) unit vector robot → contact.
        left_bound, right_bound: [m/s].
        ahead_bound: [m/s], above which it is met within the horizon.
        closing: velocity of the contact along `ahead` [m/s], negative when it comes nearer.
        room: clearance that is left before the stand-off [m], not negative.
        distance: between the centres [m].
        offset: between the centres when it is passed [m].
        crossing: velocity of the contact across `ahead`, to the left [m/s].
        there: 1 where there is something to meet.
        point: (2, 1) [m] in {E}, where it is.
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
        """The cone in a row of a table of cones."""
        left, right, ahead, point = (row[k : k + 2] for k in (0, 2, 4, 15))
        bounds, met = (row[6], row[7], row[8]), (row[9], row[10], row[11], row[12], row[13], row[14])
        return Cone(left, right, ahead, *bounds, *met, point)


def collision_cone(
    contact: Contact, *, apart: ca.SX, standoff: ca.SX, horizon: ca.SX, there: ca.SX, point: ca.SX
) -> Cone:
    """The cone of a contact.

    Args:
        contact: what moves.
        apart: clearance at which it may be passed [m].
        standoff: clearance at which it counts as met [m].
        horizon: time ahead that counts [s].
        there: 1 where it counts at all.
        point: (2, 1) [m] in {E}, where it is.

    Example:
        >>> import casadi as ca
        >>> from surctl.guidance import collision_cone, disc_contact
        >>> here, hull, centre, motion = ca.DM([0, 0]), ca.DM(0.2), ca.DM([2, 0]), ca.DM([-0.1, 0])
        >>> contact = disc_contact(here, hull, centre, ca.DM(0.3), motion, ca.DM(1))  # comes on at 0.1 m/s
        >>> known = dict(apart=0.05, standoff=0.0, horizon=10.0, there=1)
        >>> known = {name: ca.DM(value) for name, value in known.items()}
        >>> cone = collision_cone(contact, point=centre, **known)
        >>> float(cone.closing), round(float(cone.room), 2), float(cone.distance)
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
    """How deep in the cone a velocity (2, 1) lies [m/s]; negative outside.

    Example:
        >>> import casadi as ca
        >>> from surctl.guidance import collision_cone, disc_contact, inside
        >>> here, hull, centre, motion = ca.DM([0, 0]), ca.DM(0.2), ca.DM([2, 0]), ca.DM([-0.1, 0])
        >>> contact = disc_contact(here, hull, centre, ca.DM(0.3), motion, ca.DM(1))  # comes on at 0.1 m/s
        >>> known = dict(apart=0.05, standoff=0.0, horizon=10.0, there=1)
        >>> known = {name: ca.DM(value) for name, value in known.items()}
        >>> cone = collision_cone(contact, point=centre, **known)
        >>> [round(float(inside(ca.DM(v), cone)), 3) for v in ([0.15, 0.0], [0.1, 0.15])]  # into it, past it
        [0.069, -0.089]
    """
    depth = ca.fmin(ca.dot(cone.left, velocity) - cone.left_bound, ca.dot(cone.right, velocity) - cone.right_bound)
    depth = ca.fmin(depth, ca.dot(cone.ahead, velocity) - cone.ahead_bound)
    return ca.if_else(cone.there, depth, _NEVER)
