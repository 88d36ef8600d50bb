"""Contacts around the robot: circles, points, walls; collision cones, and the side on which to pass a moving one.

The method follows Fiorini and Shiller (1998). A barrier on the distance would make the robot retreat from an
approaching contact. A collision cone forbids only the velocities that lead to a collision, so the robot can also
sidestep.

In a head-on encounter, the course left of the contact and the course right of it are equally near to the desired
course. Without these costs, the noise of the first measurement of the contact would choose the side, and the robot
would keep to this side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from surctl.ir import each

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

    def or_else(self, other: Contact, take: ca.SX) -> Contact:
        """Return the other contact if `take` holds, else this one."""
        return Contact(*(ca.if_else(take, b, a) for a, b in zip(self.row, other.row, strict=True)))


def disc_contact(position: ca.SX, hull: ca.SX, centre: ca.SX, radius: ca.SX, velocity: ca.SX, valid: ca.SX) -> Contact:
    """Return the direction, clearance and velocity of a disc with a given radius [m] and velocity (2, 1) [m/s].

    The radius is 0 for a point.
    """
    offset = centre - position
    distance = ca.sqrt(ca.sumsqr(offset))
    apart = distance > 1e-6
    normal = ca.if_else(apart, offset / ca.fmax(distance, 1e-6), ca.SX([1, 0]))
    clearance = ca.if_else(valid > 0.5, distance - radius - hull, FAR)
    return Contact(normal, clearance, velocity, hull + radius)


def disc_contacts(position: ca.SX, hull: ca.SX, discs: ca.SX) -> list[Contact]:
    """Return the result of `disc_contact` for each disc (x, y, radius, vx, vy, valid) in an array (n, 6)."""

    def contact(disc: ca.SX) -> tuple[ca.SX, ...]:
        return (ca.vertcat(*disc_contact(position, hull, disc[:2], disc[2], disc[3:5], disc[5]).row),)

    if discs.shape[0] == 0:
        return []
    (table,) = each("disc_contact", contact, discs)
    return [Contact.of(table[k, :].T) for k in range(table.shape[0])]


def point_contact(position: ca.SX, hull: ca.SX, point: ca.SX, valid: ca.SX) -> Contact:
    """Return the direction and clearance of a point at rest, for example of the point that caused an echo."""
    return disc_contact(position, hull, point, ca.SX(0), ca.SX.zeros(2), valid)


def wall_contacts(position: ca.SX, hull: ca.SX, walls: ca.SX) -> list[Contact]:
    """Return the direction and clearance of the four walls x_min, x_max, y_min, y_max [m] of a rectangular site."""
    x, y = position[0], position[1]
    sides = [
        (ca.SX([-1, 0]), x - walls[0]),
        (ca.SX([1, 0]), walls[1] - x),
        (ca.SX([0, -1]), y - walls[2]),
        (ca.SX([0, 1]), walls[3] - y),
    ]
    return [Contact(n, distance - hull, ca.SX.zeros(2), hull) for n, distance in sides]


def nearest_in_quadrants(contacts: Sequence[Contact], axes: Sequence[ca.SX]) -> list[Contact]:
    """Return, for each sensor axis (2, 1), the nearest contact within ±45° of this axis."""
    chosen = []
    for axis in axes:
        best = Contact(axis, ca.SX(FAR), ca.SX.zeros(2), ca.SX(0.5))
        for contact in contacts:
            inside = ca.dot(contact.normal, axis) >= 0.7071
            best = best.or_else(contact, ca.logic_and(inside, contact.clearance < best.clearance))
        chosen.append(best)
    return chosen


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
        return Cone(*ca.vertsplit(row, [0, 2, 4, *range(6, 16), 17]))


def collision_cone(
    contact: Contact, *, apart: ca.SX, standoff: ca.SX, horizon: ca.SX, there: ca.SX, point: ca.SX
) -> Cone:
    """Return the collision cone of a contact.

    Args:
        apart: least clearance with which the robot may pass the contact [m].
        standoff: clearance at or below which the robot and the contact count as having collided [m].
        horizon: prediction time; only collisions within this time count [s].
        there: 1 if the contact must be avoided; with 0, the cone is empty.
        point: (2, 1) [m] in {E}, position of the contact.
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
        >>> from surctl.marine.guidance import inside
        >>> from surctl.marine.guidance.contacts import collision_cone, disc_contact
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


MISSED, MISSED_RATE = 10.0, 100.0
"""Cost of a course that violates a bound, and additional cost per m/s of violation."""

_HEAD_ON = 0.03  # [m/s] crosswise speed below which an encounter is head-on: three standard deviations of a message
_RIGHT = 0.15  # cost of passing a head-on contact on its right; noise changes the costs of the courses by only 0.05
# share of the path to the place of passing, and sufficient clearance from walls there [m]
_AMPLE_CLEARANCE = ((0.5, 0.3), (1.0, 0.05))
_CRAMPED = 5.0  # cost per metre of missing clearance
_SWAP = 2.0  # cost of changing sides, per share of the speed that must be reversed
_AHEAD = 12.0  # [s] time until the meeting, below which this cost counts
_REACHED = 0.5  # share of the time until the meeting in which the crosswise velocity must be reversed
_STANDS = 1e-3  # [m/s] lower bound of the closing speed
_SLOW = 0.05  # [m/s] least assumed speed of a contact towards the robot


def side_costs(cone: Cone, desired: ca.SX, walls: Sequence[Contact]) -> tuple[ca.SX, ca.SX]:
    """Return the additional costs of passing a moving contact on its left and on its right in a head-on encounter.

    In any other encounter both costs are 0. The robot keeps a head-on contact on its right (erratum E10), unless the
    path left of the contact is too close to a wall: near a wall the sonars detect little and the robot is slow.
    `desired` is the desired velocity (2, 1) [m/s] in {E}.
    """
    n, across = cone.ahead, _left_of(cone.ahead)
    speed = ca.sqrt(ca.sumsqr(desired))
    travel = cone.distance * speed / ca.fmax(speed - cone.closing, speed + _SLOW)
    left, right = (_cramped(travel * n + sign * cone.offset * across, walls) for sign in (1, -1))
    head_on = ca.fabs(ca.dot(across, desired) - cone.crossing) < _HEAD_ON
    return ca.if_else(head_on, left, 0), ca.if_else(head_on, right + _RIGHT, 0)


def swap_costs(cone: Cone, now: ca.SX, speed: ca.SX, acceleration: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the costs of passing a moving contact on its left and on its right that a reversal of motion causes.

    A cost grows with the crosswise velocity relative to the contact that the robot would have to reverse. So the robot
    completes a manoeuvre that it has begun, and from rest it passes behind a crossing contact. What the thrust cannot
    reverse in half the time until the encounter counts as a violation of a bound. In a head-on encounter both costs are
    0, so that noise does not choose the side.

    Args:
        now: velocity over ground (2, 1) [m/s] in {E}.
        speed, acceleration: commanded speed [m/s] and available acceleration [m/s²].
    """
    across = ca.dot(_left_of(cone.ahead), now) - cone.crossing
    nearing = ca.fmax(ca.dot(cone.ahead, now) - cone.closing, _STANDS)
    turn, time = ca.fabs(across), cone.clearance / nearing
    late = turn - _REACHED * acceleration * time
    cost = _SWAP * turn / speed + ca.if_else(late > 0, MISSED + MISSED_RATE * late, 0)
    counts = ca.logic_and(turn > _HEAD_ON, ca.logic_and(cone.there, time < _AHEAD))
    cost = ca.if_else(counts, cost, 0)
    return ca.if_else(across < 0, cost, 0), ca.if_else(across > 0, cost, 0)


def passes_left(velocity: ca.SX, cone: Cone) -> ca.SX:
    """Return whether a velocity (2, 1) outside the cone passes left of the contact (contact on the robot's right)."""
    return ca.dot(_left_of(cone.ahead), velocity) >= cone.crossing


def _left_of(n: ca.SX) -> ca.SX:
    return ca.vertcat(-n[1], n[0])


def _cramped(path: ca.SX, walls: Sequence[Contact]) -> ca.SX:
    """Return the cost of a straight path (2, 1) [m] from the robot's position, positive if too close to a wall."""
    cost = ca.SX(0)
    for share, ample in _AMPLE_CLEARANCE:
        clearance = ca.SX(FAR)
        for wall in walls:
            clearance = ca.fmin(clearance, wall.clearance - share * ca.dot(path, wall.normal))
        cost += _CRAMPED * ca.fmax(ample - clearance, 0)
    return cost
