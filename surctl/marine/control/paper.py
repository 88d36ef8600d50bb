"""Laws `paper` and `closed_form`: obstacle tasks of the four sensors by urgency, then velocity, depth, heading.

The variable of sensor i's task is its distance to the obstacle, σ_i = l_dm,i. While the robot avoids an obstacle, the
velocity task uses the avoidance velocity (20) of the paper, otherwise the cruise velocity (sections III-B to III-D).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.marine.control.decision import (
    DECISION_PORTS,
    Decision,
    Perception,
    Situation,
    TaskLevel,
    lower_levels,
    weakest_acceleration,
)
from surctl.marine.control.ports import DEFAULT_ARRAY
from surctl.marine.control.reference import DesiredMotion
from surctl.marine.guidance import FAR, Contact
from surctl.marine.guidance.avoidance import avoidance_course, encounter_side
from surctl.marine.guidance.contacts import nearest_in_quadrants
from surctl.marine.vehicle import planar_rotation
from surctl.tasks import velocity_task

# The law `closed_form`, the simplest law that avoids an obstacle: the paper's tasks for one known obstacle.
#
# The law combines the guidance (8)–(12) of the paper, one sensor sub-task, the corrected avoidance course (20), the
# depth task and the heading task by the null-space projection (16). The position of the obstacle is an input, and the
# path must avoid the walls. The law evaluates equation (20) without angles: its velocity is u (r n + λ2 √(1 − r²) n⊥)
# with r = sat((v_o·n + κ l) / u). Here u is the speed, n the unit vector to the obstacle, n⊥ its normal, l the
# clearance beyond the margin, v_o the obstacle's velocity, κ a gain, and λ2 = ±1 the passing side. Every denominator
# has a positive lower bound and every component of a direction stays within [−1, 1], so interval arithmetic can prove
# that the C code has no run-time errors.


DAMPING = 1e-3
"""Damping λ of the null-space projection; it changes a task velocity by the relative error λ²."""

CLOSED_FORM_PORTS = tuple(port for port in DECISION_PORTS if port.name == "side")

_SENSE_RANGE = 1.0  # [m] range below which the sensor sub-task may act
_OVERTAKE = 0.02  # [m/s] difference of the avoidance speed and the obstacle's speed
_NEAR = 1e-3  # [m] smallest distance to the obstacle's centre at which its direction is defined


def known_obstacle(u: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> Perception:
    """Return a `Perception` that contains only the obstacle in input `contacts` (1, 6), and no walls.

    The components of the direction to the obstacle are clamped to [-1, 1], because rounding errors could exceed 1.
    """
    slots = u["contacts"].shape[0] if "contacts" in u else 0
    if slots != 1:
        raise InputError("law closed_form takes one obstacle", key="contacts", value=slots, remedy="give 1 slot")
    row = u["contacts"].T
    offset = row[:2] - u["eta"][:2]
    distance = ca.sqrt(ca.sumsqr(offset))
    n = ca.fmin(ca.fmax(offset / ca.fmax(distance, _NEAR), -1), 1)
    combined_radius = row[2] + p["hull"]
    clearance = ca.if_else(row[5] > 0.5, distance - combined_radius, FAR)
    return Perception(
        [Contact(n, clearance, row[3:5], combined_radius)], [], [], ca.SX.ones(4) * DEFAULT_ARRAY.maximum, {}
    )


def closed_form_law(s: Situation) -> Decision:
    """Return the decision of the law `closed_form`; its tasks are combined by a damped null-space projection."""
    desired, p = s.desired, s.p
    (contact,) = s.perceived.known
    n, left = contact.normal, ca.vertcat(-contact.normal[1], contact.normal[0])
    bound = p["kappa"] * (contact.clearance - p["margin"]) + contact.closing
    near = contact.clearance < p["margin"] + _SENSE_RANGE
    avoiding = ca.logic_and(near, ca.dot(desired.velocity, n) > bound)
    side = ca.if_else(s.x["side"] == 0, encounter_side(desired.velocity - contact.velocity, n), s.x["side"])
    speed = ca.fmin(p["cap"], ca.fmax(p["cruise"], ca.sqrt(ca.sumsqr(contact.velocity)) + _OVERTAKE))
    ratio = ca.fmin(ca.fmax(bound / ca.fmax(speed, _OVERTAKE), -1), 1)
    course = speed * (ratio * n + side * ca.sqrt(ca.fmax(1 - ratio * ratio, 0)) * left)
    chosen = ca.if_else(avoiding, course, desired.velocity)
    to_body = planar_rotation(s.eta[3]).T
    row = ca.if_else(avoiding, -(to_body @ n), 0)
    # in {B} the Jacobian is constant, and so is its projection
    ahead = TaskLevel("velocity", ca.horzcat(ca.SX.eye(2), ca.SX.zeros(2, 2)), to_body @ chosen, "m/s")
    levels = [
        TaskLevel("sensor", ca.horzcat(row.T, 0, 0), ca.if_else(avoiding, -bound, 0), "m/s"),
        ahead,
        *lower_levels(s.eta, desired, p),
    ]
    return Decision(levels, [], chosen, avoiding, ca.SX(0), {"side": ca.if_else(avoiding, side, 0)})


def paper_law(s: Situation) -> Decision:
    """Return the decision of the paper's law: the sensor tasks by urgency, then velocity, depth and heading."""
    desired, eta, p = s.desired, s.eta, s.p
    heading = ca.vertcat(ca.cos(eta[3]), ca.sin(eta[3]))
    left = ca.vertcat(-heading[1], heading[0])
    sensed = nearest_in_quadrants(s.perceived.all, [heading, left, -heading, -left])
    closing = [p["kappa"] * (c.clearance - p["margin"]) for c in sensed]  # speeds [m/s] that σ̇ = −κ σ requires
    threat = [
        ca.logic_and(c.clearance - p["margin"] < _SENSE_RANGE, ca.dot(desired.velocity, c.normal) > v)
        for c, v in zip(sensed, closing, strict=True)
    ]
    avoiding = threat[0]
    for other in threat[1:]:
        avoiding = ca.logic_or(avoiding, other)
    velocity, side = _avoidance_velocity(s, _most_urgent(sensed, threat, desired), avoiding)
    levels = _by_urgency(sensed, closing, velocity, eta, p)
    return Decision(
        [*levels, TaskLevel.of(velocity_task(eta, velocity)), *lower_levels(eta, desired, p)],
        [],
        velocity,
        avoiding,
        ca.SX(0),
        {"side": side, "blocker": s.x["blocker"], "last_velocity": velocity},
    )


def _urgency(contact: Contact, speed: ca.SX) -> ca.SX:
    # time to contact [s], very large if the robot does not approach the contact
    rate = ca.fmax(speed - contact.closing, 1e-3)
    return ca.fmax(contact.clearance, 0) / rate


def _most_urgent(sensed: Sequence[Contact], threat: Sequence[ca.SX], desired: DesiredMotion) -> Contact:
    best, least = sensed[0], ca.SX(1e6)
    for contact, active in zip(sensed, threat, strict=True):
        time = ca.if_else(active, _urgency(contact, ca.dot(desired.velocity, contact.normal)), 1e6)
        best = best.or_else(contact, time < least)
        least = ca.fmin(time, least)
    return best


def _avoidance_velocity(s: Situation, contact: Contact, avoiding: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the avoidance velocity (20) within the limits (19) of the paper, and the next passing side λ2.

    λ2 does not change during an encounter with an obstacle.
    """
    desired, p = s.desired, s.p
    met = encounter_side(desired.velocity - contact.velocity, contact.normal)
    side = ca.if_else(ca.fabs(s.x["side"]) > 0.5, s.x["side"], met)
    speed = ca.fmin(p["cap"], ca.fmax(p["cruise"], ca.sqrt(ca.sumsqr(contact.velocity)) + _OVERTAKE))
    course = avoidance_course(
        s.form,
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
    velocity = _window(speed, course, s.x["last_velocity"], contact.combined_radius + p["margin"], p, dt=s.dt)
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
