"""The law `closed_form`, the simplest law that avoids an obstacle: the paper's tasks for one known obstacle.

The law combines the guidance (8)–(12) of the paper, one sensor sub-task, the corrected avoidance course (20), the depth
task and the heading task by the null-space projection (16). The position of the obstacle is an input, and the path must
avoid the walls. The law evaluates equation (20) without angles: its velocity is u (r n + λ2 √(1 − r²) n⊥) with r =
sat((v_o·n + κ l) / u). Here u is the speed, n the unit vector to the obstacle, n⊥ its normal, l the clearance beyond
the margin, v_o the obstacle's velocity, κ a gain, and λ2 = ±1 the passing side. Every denominator has a positive lower
bound and every component of a direction stays within [−1, 1], so interval arithmetic can prove that the C code has no
run-time errors.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from surctl.errors import InputError
from surctl.marine.control.decision import DECISION_PORTS, Decision, TaskLevel, lower_levels
from surctl.marine.control.echoes import Perception
from surctl.marine.control.ports import DEFAULT_ARRAY
from surctl.marine.control.reference import DesiredMotion
from surctl.marine.guidance import FAR, Contact, encounter_side
from surctl.marine.vehicle import planar_rotation

__all__ = ["CLOSED_FORM_PORTS", "DAMPING", "closed_form_law", "known_obstacle"]

DAMPING = 1e-3
"""Damping λ of the null-space projection; it changes a task velocity by the relative error λ²."""

CLOSED_FORM_PORTS = tuple(port for port in DECISION_PORTS if port.name == "side")

_SENSE_RANGE = 1.0  # [m] range below which the sensor sub-task may act
_OVERTAKE = 0.02  # [m/s] difference of the avoidance speed and the obstacle's speed
_NEAR = 1e-3  # [m] smallest distance to the obstacle's centre at which its direction is defined


def known_obstacle(u: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> Perception:
    """Return a `Perception` that contains only the obstacle in input `contacts` (1, 6), and no walls.

    The components of the direction to the obstacle are clamped to [-1, 1], because rounding errors could exceed 1.

    Raises:
        InputError: the input does not hold exactly one obstacle.
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


def closed_form_law(
    desired: DesiredMotion, perceived: Perception, x: Mapping[str, ca.SX], eta: ca.SX, p: Mapping[str, ca.SX]
) -> Decision:
    """Return the decision of the law `closed_form`; its tasks are combined by a damped null-space projection.

    Args:
        desired: the motion along the path without obstacles.
        perceived: the result of `known_obstacle`.
        x: state, with the entry `side` (passing side).
        eta: (4, 1) pose.
        p: parameters; the function uses the gains `margin`, `kappa` and the mission's `cruise`, `cap`.
    """
    (contact,) = perceived.known
    n, left = contact.normal, ca.vertcat(-contact.normal[1], contact.normal[0])
    bound = p["kappa"] * (contact.clearance - p["margin"]) + contact.closing
    near = contact.clearance < p["margin"] + _SENSE_RANGE
    avoiding = ca.logic_and(near, ca.dot(desired.velocity, n) > bound)
    side = ca.if_else(x["side"] == 0, encounter_side(desired.velocity - contact.velocity, n), x["side"])
    speed = ca.fmin(p["cap"], ca.fmax(p["cruise"], ca.sqrt(ca.sumsqr(contact.velocity)) + _OVERTAKE))
    ratio = ca.fmin(ca.fmax(bound / ca.fmax(speed, _OVERTAKE), -1), 1)
    course = speed * (ratio * n + side * ca.sqrt(ca.fmax(1 - ratio * ratio, 0)) * left)
    chosen = ca.if_else(avoiding, course, desired.velocity)
    to_body = planar_rotation(eta[3]).T
    row = ca.if_else(avoiding, -(to_body @ n), 0)
    # in {B} the Jacobian is constant, and so is its projection
    ahead = TaskLevel("velocity", ca.horzcat(ca.SX.eye(2), ca.SX.zeros(2, 2)), to_body @ chosen, "m/s")
    levels = [
        TaskLevel("sensor", ca.horzcat(row.T, 0, 0), ca.if_else(avoiding, -bound, 0), "m/s"),
        ahead,
        *lower_levels(eta, desired, p),
    ]
    return Decision(levels, [], chosen, avoiding, ca.SX(0), {"side": ca.if_else(avoiding, side, 0)})
