"""The paper's law: obstacle tasks of the four sensors (most urgent first), then velocity, depth and heading.

The variable of sensor i's task is its distance to the obstacle, σ_i = l_dm,i. While the robot avoids an obstacle, the
velocity task uses the avoidance velocity (20) of the paper, otherwise the cruise velocity (sections III-B to III-D).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from surctl.marine.control.decision import Decision, TaskLevel, lower_levels, weakest_acceleration
from surctl.marine.control.echoes import Perception
from surctl.marine.control.reference import DesiredMotion
from surctl.marine.guidance import AvoidanceForm, Contact, avoidance_course, encounter_side, nearest_in_quadrants
from surctl.marine.vehicle import planar_rotation
from surctl.tasks import velocity_task

__all__ = ["paper_law"]

_SENSE_RANGE = 1.0  # [m] range below which a sensor sub-task may act
_OVERTAKE = 0.02  # [m/s] difference of the avoidance speed and the obstacle's speed


def paper_law(
    form: AvoidanceForm,
    desired: DesiredMotion,
    perceived: Perception,
    x: Mapping[str, ca.SX],
    eta: ca.SX,
    p: Mapping[str, ca.SX],
    *,
    dt: float,
) -> Decision:
    """Return the decision of the paper's law: the sensor tasks by urgency, then velocity, depth and heading."""
    heading = ca.vertcat(ca.cos(eta[3]), ca.sin(eta[3]))
    left = ca.vertcat(-heading[1], heading[0])
    sensed = nearest_in_quadrants(perceived.all, [heading, left, -heading, -left])
    closing = [_sub_task_speed(c, p) for c in sensed]
    threat = [
        ca.logic_and(c.clearance - p["margin"] < _SENSE_RANGE, ca.dot(desired.velocity, c.normal) > v)
        for c, v in zip(sensed, closing, strict=True)
    ]
    avoiding = threat[0]
    for other in threat[1:]:
        avoiding = ca.logic_or(avoiding, other)
    velocity, side = _avoidance_velocity(form, desired, _most_urgent(sensed, threat, desired), avoiding, x, p, dt=dt)
    levels = _by_urgency(sensed, closing, velocity, eta, p)
    return Decision(
        [*levels, TaskLevel.of(velocity_task(eta, velocity)), *lower_levels(eta, desired, p)],
        [],
        velocity,
        avoiding,
        ca.SX(0),
        {"side": side, "blocker": x["blocker"], "last_velocity": velocity},
    )


def _sub_task_speed(contact: Contact, p: Mapping[str, ca.SX]) -> ca.SX:
    # the speed towards the contact [m/s] that σ̇ = −κ σ requires
    return p["kappa"] * (contact.clearance - p["margin"])


def _urgency(contact: Contact, speed: ca.SX) -> ca.SX:
    # time to contact [s], very large if the robot does not approach the contact
    rate = ca.fmax(speed - contact.closing, 1e-3)
    return ca.fmax(contact.clearance, 0) / rate


def _most_urgent(sensed: Sequence[Contact], threat: Sequence[ca.SX], desired: DesiredMotion) -> Contact:
    best, least = sensed[0], ca.SX(1e6)
    for contact, active in zip(sensed, threat, strict=True):
        time = ca.if_else(active, _urgency(contact, ca.dot(desired.velocity, contact.normal)), 1e6)
        take = time < least
        best = Contact(*(ca.if_else(take, a, b) for a, b in zip(_fields(contact), _fields(best), strict=True)))
        least = ca.fmin(time, least)
    return best


def _fields(contact: Contact) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    return contact.normal, contact.clearance, contact.velocity, contact.combined_radius


def _avoidance_velocity(
    form: AvoidanceForm,
    desired: DesiredMotion,
    contact: Contact,
    avoiding: ca.SX,
    x: Mapping[str, ca.SX],
    p: Mapping[str, ca.SX],
    *,
    dt: float,
) -> tuple[ca.SX, ca.SX]:
    """Return the avoidance velocity (20) within the limits (19) of the paper, and the next passing side λ2.

    λ2 does not change during an encounter with an obstacle.
    """
    met = encounter_side(desired.velocity - contact.velocity, contact.normal)
    side = ca.if_else(ca.fabs(x["side"]) > 0.5, x["side"], met)
    speed = ca.fmin(p["cap"], ca.fmax(p["cruise"], ca.sqrt(ca.sumsqr(contact.velocity)) + _OVERTAKE))
    course = avoidance_course(
        form,
        ca.atan2(contact.normal[1], contact.normal[0]),
        contact.clearance - p["margin"],
        radius=contact.combined_radius + p["margin"],
        side=side,
        delta=p["delta"],
        k3=p["k3"],
        speed=speed,
        closing=contact.closing,
        kappa=p["kappa"],
        standoff=ca.SX(0),
    )
    velocity = _window(speed, course, x["last_velocity"], contact.combined_radius + p["margin"], p, dt=dt)
    return ca.if_else(avoiding, velocity, desired.velocity), ca.if_else(avoiding, side, 0)


def _window(speed: ca.SX, course: ca.SX, last: ca.SX, radius: ca.SX, p: Mapping[str, ca.SX], *, dt: float) -> ca.SX:
    # (19): speed within a·t, course within √(a/R_OB)·t (E17) of the last command
    acceleration = weakest_acceleration(p)
    previous = ca.sqrt(ca.sumsqr(last))
    step = acceleration * dt
    allowed = ca.fmin(ca.fmax(speed, previous - step), previous + step)
    turn = course - ca.atan2(last[1], last[0])
    turn = turn - 2 * np.pi * ca.floor((turn + np.pi) / (2 * np.pi))
    widest = ca.sqrt(acceleration / radius) * dt
    # a robot that hardly moves has no defined course
    turn = ca.if_else(previous > 0.02, ca.fmin(ca.fmax(turn, -widest), widest), turn)
    course = ca.atan2(last[1], last[0]) + turn
    return allowed * ca.vertcat(ca.cos(course), ca.sin(course))


def _by_urgency(
    sensed: Sequence[Contact], closing: Sequence[ca.SX], lower: ca.SX, eta: ca.SX, p: Mapping[str, ca.SX]
) -> list[TaskLevel]:
    """Return the sensor tasks sorted by time to contact; equal times are sorted front, left, rear, right.

    The Jacobian and reference of an inactive task are zero.
    """
    to_body = planar_rotation(eta[3]).T
    entries = []
    for contact, bound in zip(sensed, closing, strict=True):
        near = contact.clearance - p["margin"] < _SENSE_RANGE
        active = ca.logic_and(near, ca.dot(lower, contact.normal) > bound)
        row = ca.horzcat(-(to_body @ contact.normal).T, 0, 0)
        time = ca.if_else(active, _urgency(contact, ca.dot(lower, contact.normal)), 1e6)
        entries.append([time, ca.if_else(active, row, ca.SX.zeros(1, 4)), ca.if_else(active, -bound, 0)])
    for i, j in ((0, 1), (2, 3), (0, 2), (1, 3), (1, 2)):  # sorting network for four
        swap = entries[j][0] < entries[i][0]
        first = [ca.if_else(swap, b, a) for a, b in zip(entries[i], entries[j], strict=True)]
        second = [ca.if_else(swap, a, b) for a, b in zip(entries[i], entries[j], strict=True)]
        entries[i], entries[j] = first, second
    return [TaskLevel(f"sensor_{k + 1}", row, reference, "m/s") for k, (_, row, reference) in enumerate(entries)]
