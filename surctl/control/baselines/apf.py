"""Artificial potential field (Khatib, "Real-time obstacle avoidance for manipulators and mobile robots", IJRR 1986).

The velocity-limited form of his section on moving to a goal: F = m k_v (v_d − ẋ) + Σ F_FIRAS, where v_d goes to the
attracting point. The velocity loop is that first term, so the command is v_d + Σ F_FIRAS / (m k_v); it damps, and its
speed is limited. The attracting point is the path's look-ahead point: the line of sight of (9) leads to it. A field
knows no velocity of an obstacle, and has its local minima. Near a contact the speed along its normal is damped further.
"""

from __future__ import annotations

import casadi as ca

from surctl.control.baselines.situation import Situation, decided, limited, over_ground
from surctl.control.decision import Decision
from surctl.guidance import Contact
from surctl.ir import fold, tabulated

__all__ = ["DAMPING", "NEAREST", "RANGE", "STRENGTH", "apf_law"]

RANGE = 0.5
"""ρ_0 [m], clearance below which a contact repels (tuned from 0.2 to 2)."""

STRENGTH = 0.01
"""η / (m k_v) [m⁴/s] (tuned from 0.0001 to 1)."""

NEAREST = 0.1
"""[m] below which a clearance repels no more strongly (tuned from 0.02 to 0.2): the field has a pole at 0."""

DAMPING = 1.0
"""Share of the speed along a contact's normal, within ρ_0, that is taken off the command (tuned from 0 to 4)."""


def apf_law(s: Situation) -> Decision:
    """Attraction of the wish, and η (1/ρ − 1/ρ_0) / ρ² away from each contact within ρ_0."""
    now = over_ground(s)

    def repelled(repulsion: ca.SX, row: ca.SX) -> ca.SX:
        contact = Contact.of(row)
        near = ca.fmin(ca.fmax(contact.clearance, NEAREST), RANGE)
        repulsion = repulsion - STRENGTH * (1 / near - 1 / RANGE) / (near * near) * contact.normal
        speed = ca.dot(now, contact.normal)
        return repulsion - ca.if_else(contact.clearance < RANGE, DAMPING * speed, 0) * contact.normal

    total = fold("repulsion", repelled, ca.SX.zeros(2), tabulated((contact.row for contact in s.perceived.all), 6))
    return decided(s, limited(s.desired.velocity + total, s.p["cap"]), degraded=ca.SX(0))
