"""Law `apf`: an artificial potential field pushes the velocity away from obstacles (Khatib, IJRR 1986).

Source: "Real-time obstacle avoidance for manipulators and mobile robots", in the velocity-limited form F = m k_v (v_d −
ẋ) + Σ F_FIRAS, where v_d points to the attracting point. m is the mass, ẋ the velocity, and F_FIRAS the repulsive force
of one obstacle. The velocity loop provides the first term, so the command is v_d + Σ F_FIRAS / (m k_v), with limited
speed. The attracting point is the look-ahead point on the path, at which the line-of-sight guidance (9) of the paper
aims. The field ignores the velocity of obstacles and has local minima. Near an obstacle, the speed towards the obstacle
is damped further.
"""

from __future__ import annotations

import casadi as ca
from textbook import decided, limited, over_ground

from surctl.ir import fold, tabulated
from surctl.marine.control import Decision, LawSource, Situation
from surctl.marine.guidance import Contact

RANGE = 0.5
"""Clearance ρ_0 [m] below which an obstacle repels the robot (tuned between 0.2 and 2)."""

STRENGTH = 0.01
"""Strength η / (m k_v) of the repulsion [m⁴/s] (tuned between 0.0001 and 1)."""

NEAREST = 0.1
"""Clearance [m] below which the repulsion no longer grows (tuned between 0.02 and 0.2); the field is infinite at 0."""

DAMPING = 1.0
"""Multiple of the speed towards an obstacle within ρ_0 that is subtracted from the command (tuned between 0 and 4)."""


def decide(s: Situation) -> Decision:
    """Return the desired velocity plus η (1/ρ − 1/ρ_0) / ρ² away from each obstacle point at a distance ρ < ρ_0."""
    now = over_ground(s)

    def repelled(repulsion: ca.SX, row: ca.SX) -> ca.SX:
        contact = Contact.of(row)
        near = ca.fmin(ca.fmax(contact.clearance, NEAREST), RANGE)
        repulsion = repulsion - STRENGTH * (1 / near - 1 / RANGE) / (near * near) * contact.normal
        speed = ca.dot(now, contact.normal)
        return repulsion - ca.if_else(contact.clearance < RANGE, DAMPING * speed, 0) * contact.normal

    total = fold("repulsion", repelled, ca.SX.zeros(2), tabulated((contact.row for contact in s.perceived.all), 6))
    return decided(s, limited(s.desired.velocity + total, s.p["cap"]), degraded=ca.SX(0))


def law() -> LawSource:
    """Return the law."""
    return LawSource("apf", decide, latches=False)
