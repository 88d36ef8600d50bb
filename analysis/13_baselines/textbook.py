"""What the textbook laws share: their tasks of lower priority, and the time to contact.

The textbook laws use the same desired velocity, obstacle points and velocity loop as the law `guarded`. With sonars,
the robot turns about its vertical axis as under `guarded`, and the obstacle points are the occupied cells of the sonar
map. However, the textbook laws do not slow down before unknown space.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from surctl.ir import fold, tabulated
from surctl.marine.control import Decision, Situation, TaskLevel
from surctl.marine.control.decision import lower_levels
from surctl.marine.guidance import Contact
from surctl.marine.vehicle import planar_rotation
from surctl.tasks import HalfPlane, velocity_task

NEVER = 1e3
"""Time [s] to an obstacle that the robot never meets."""

_CHANGED = 1e-3  # [m/s] difference above which a velocity counts as different from the desired velocity


def decided(s: Situation, velocity: ca.SX, *, degraded: ca.SX, rows: Sequence[HalfPlane] = ()) -> Decision:
    """Return the decision for `velocity` (2, 1) [m/s] in {E}, with the lower-priority tasks of the guarded law.

    The tasks of lower priority are the depth, then the heading of the path; a law with sonars has a constant yaw rate
    instead of the heading.
    """
    return Decision(
        [TaskLevel.of(velocity_task(s.eta, velocity)), *lower_levels(s.eta, s.desired, s.p, s.scan)],
        rows,
        velocity,
        length(velocity - s.desired.velocity) > _CHANGED,
        degraded,
    )


def length(vector: ca.SX) -> ca.SX:
    """Return the Euclidean norm of a vector."""
    return ca.sqrt(ca.sumsqr(vector))


def limited(vector: ca.SX, most: ca.SX) -> ca.SX:
    """Return the vector, shortened to the length `most` if it is longer."""
    return vector * ca.fmin(1, most / ca.fmax(length(vector), 1e-9))


def over_ground(s: Situation) -> ca.SX:
    """Return the measured horizontal velocity over ground (2, 1) [m/s] in {E}."""
    return planar_rotation(s.eta[3]) @ s.nu[:2]


def time_to_contact(velocity: ca.SX, contact: Contact, *, margin: ca.SX, flat: bool = False) -> ca.SX:
    """Return the time [s] until a robot at constant `velocity` (2, 1) [m/s] is within `margin` of a moving obstacle.

    The obstacle `contact` continues at its present velocity. It is a disc of radius `combined_radius` + margin around
    its centre, or a straight wall if `flat`. The returned time is 0 if the robot is already within the margin and
    approaches, and `NEVER` if robot and obstacle do not meet.
    """
    gap = contact.clearance - margin
    relative = velocity - contact.velocity
    towards = ca.dot(relative, contact.normal)
    nearing = towards > 1e-9
    if flat:
        return ca.if_else(nearing, ca.fmin(ca.fmax(gap, 0) / ca.fmax(towards, 1e-9), NEVER), NEVER)
    # first root t of |w|² t² − 2 d (w·n) t + gap (d + R) = 0, with the distance d of the centre and R = d − gap
    d = contact.clearance + contact.combined_radius
    square, half, rest = ca.sumsqr(relative), d * towards, gap * (2 * d - gap)
    disc = half * half - square * rest
    # numerically stable form of (half − √disc) / square
    first = ca.fmax(rest, 0) / ca.fmax(half + ca.sqrt(ca.fmax(disc, 0)), 1e-9)
    first = ca.if_else(gap > 0, first, 0)
    return ca.if_else(ca.logic_and(nearing, disc > 0), ca.fmin(first, NEVER), NEVER)


def first_contact(s: Situation, velocity: ca.SX, *, extra: float) -> ca.SX:
    """Return the time [s] until a robot at `velocity` (2, 1) [m/s] in {E} meets the first obstacle or wall, or `NEVER`.

    `extra` is the distance [m] beyond the margin at which the robot counts as having met an obstacle.
    """
    margin, first = s.p["margin"] + extra, ca.SX(NEVER)
    for flat, contacts in ((False, [*s.perceived.known, *s.perceived.echoes]), (True, s.perceived.walls)):

        def sooner(first: ca.SX, row: ca.SX, flat: bool = flat) -> ca.SX:
            return ca.fmin(first, time_to_contact(velocity, Contact.of(row), margin=margin, flat=flat))

        table = tabulated((contact.row for contact in contacts), 6)
        first = fold("wall_time" if flat else "contact_time", sooner, first, table)
    return first
