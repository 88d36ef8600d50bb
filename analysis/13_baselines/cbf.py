"""Law `cbf`: line-of-sight guidance, corrected by control barrier functions (Ames et al., IEEE TAC 2017).

Source: "Control barrier function based quadratic programs for safety critical systems", here on the kinematics. Each
obstacle i has the barrier h_i = clearance − margin, and the law requires ḣ_i ≥ −α h_i. For a unit vector n_i from the
robot to the obstacle and the obstacle's velocity v_i, this is the constraint n_i·v ≤ α h_i + n_i·v_i on the robot's
velocity v. The law computes the velocity that is nearest to the desired velocity and satisfies every constraint and the
speed limit. The computation is exact and adds one constraint after another: if the optimum so far violates the added
constraint, the new optimum lies on the line n_i·v = α h_i + n_i·v_i (Seidel 1991; de Berg et al., *Computational
Geometry*, 4.4). The barriers do not account for the braking distance: they bound the commanded velocity, which the
robot with its limited thrust follows only after some time.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin  # NumPy's differ in the last bit between processors, and the law's digest with them

import casadi as ca
from textbook import decided, limited

from surctl.ir import fold, tabulated
from surctl.marine.control import Decision, LawSource, Situation
from surctl.marine.vehicle import planar_rotation
from surctl.tasks import HalfPlane

ALPHA = 0.2
"""Barrier gain α [1/s] (tuned between 0.03 and 1)."""

EXTRA = 0.02
"""Distance [m] that is added to the margin, because the velocity lags behind the command (tuned between 0 and 0.15)."""

_FAN = 24
"""Number of courses that the law tries at full speed, besides zero velocity, if the constraints are infeasible."""

_ROUNDING = 1e-9  # [m/s] tolerance of a constraint for rounding errors


def decide(s: Situation) -> Decision:
    """Return the decision: of all velocities that satisfy every barrier, the one nearest to the desired velocity.

    In the priority modes with inequalities, the barriers are also inequality constraints of the priority problem.
    """
    rows = [
        (c.normal, ALPHA * (c.clearance - s.p["margin"] - EXTRA) + ca.dot(c.velocity, c.normal))
        for c in s.perceived.all
    ]
    velocity, feasible = nearest_velocity(s.desired.velocity, rows, cap=s.p["cap"])
    to_body = planar_rotation(s.eta[3]).T
    planes = [
        HalfPlane(f"contact_{k}", ca.horzcat((to_body @ normal).T, 0, 0), bound, kind="barrier")
        for k, (normal, bound) in enumerate(rows)
    ]
    return decided(s, velocity, degraded=ca.logic_not(feasible), rows=planes)


def nearest_velocity(desired: ca.SX, rows: Sequence[tuple[ca.SX, ca.SX]], *, cap: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return v that minimises |v − desired| subject to n·v ≤ bound for every constraint in `rows`, and |v| ≤ cap.

    `rows` are pairs of a unit vector n (2, 1) and a bound [m/s]. If a feasible v exists, the result is v (2, 1) and 1.
    Otherwise it is the velocity of a fixed set of directions whose largest violation is smallest, and 0.
    """
    v, feasible = limited(desired, cap), ca.SX(1)
    for i, (normal, bound) in enumerate(rows):
        missed = ca.dot(normal, v) > bound + _ROUNDING
        along = ca.vertcat(-normal[1], normal[0])
        square = cap * cap - bound * bound
        half_chord = ca.sqrt(ca.fmax(square, 0))
        low, high, open_ = -half_chord, half_chord, square >= 0
        for other, limit in rows[:i]:
            slope, slack = ca.dot(other, along), limit - bound * ca.dot(other, normal)
            parallel = ca.fabs(slope) < 1e-9
            at = slack / ca.if_else(parallel, 1.0, slope)
            high = ca.if_else(ca.logic_and(slope > 0, ca.logic_not(parallel)), ca.fmin(high, at), high)
            low = ca.if_else(ca.logic_and(slope < 0, ca.logic_not(parallel)), ca.fmax(low, at), low)
            open_ = ca.logic_and(open_, ca.logic_or(ca.logic_not(parallel), slack >= -_ROUNDING))
        open_ = ca.logic_and(open_, low <= high + _ROUNDING)
        on_line = bound * normal + ca.fmin(ca.fmax(ca.dot(desired, along), low), high) * along
        v = ca.if_else(missed, on_line, v)
        feasible = ca.logic_and(feasible, ca.logic_or(ca.logic_not(missed), open_))
    return ca.if_else(feasible, v, _least_bad(desired, rows, cap)), feasible


def _least_bad(desired: ca.SX, rows: Sequence[tuple[ca.SX, ca.SX]], cap: ca.SX) -> ca.SX:
    angles = [2 * pi * k / _FAN for k in range(_FAN)]
    table = tabulated(rows, 3)

    def judged(best: ca.SX, least: ca.SX, candidate: ca.SX) -> list[ca.SX]:
        def missed(worst: ca.SX, row: ca.SX) -> ca.SX:
            return ca.fmax(worst, ca.dot(row[:2], candidate) - row[2])

        worst = fold("missed", missed, ca.SX(-1e6), table)
        return [ca.if_else(worst < least - 1e-9, candidate, best), ca.fmin(worst, least)]

    fan = [ca.SX.zeros(2), *(cap * ca.SX([cos(a), sin(a)]) for a in angles)]
    best: ca.SX = fold("fan", judged, [desired, ca.SX(1e6)], tabulated([candidate] for candidate in fan))[0]
    return best


def law() -> LawSource:
    """Return the law."""
    return LawSource("cbf", decide, latches=False)
