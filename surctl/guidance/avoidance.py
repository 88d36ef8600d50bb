"""Avoidance law (17)–(20) in three forms, and the closing speed that the braking distance allows.

φ is the bearing from the robot to the obstacle, positive counter-clockwise (E1). With λ2 = +1 the robot passes with the
obstacle on its right; with λ2 = −1 it passes with the obstacle on its left (E10).
"""

from __future__ import annotations

from typing import Literal, get_args

import casadi as ca
import numpy as np

from surctl.errors import InputError, nearest

__all__ = [
    "FORMS",
    "AvoidanceForm",
    "allowed_closing_speed",
    "avoidance_course",
    "clearance_rate",
    "encounter_side",
    "printed_side",
]

AvoidanceForm = Literal["printed", "consistent", "corrected"]
FORMS: tuple[AvoidanceForm, ...] = get_args(AvoidanceForm)


def avoidance_course(
    form: AvoidanceForm,
    phi: ca.SX,
    clearance: ca.SX,
    *,
    radius: ca.SX,
    side: ca.SX,
    delta: ca.SX,
    k3: ca.SX,
    speed: ca.SX,
    closing: ca.SX,
    kappa: ca.SX,
    standoff: ca.SX,
) -> ca.SX:
    """Return the commanded course ψ_dm [rad], positive counter-clockwise.

    Args:
        form: `printed`: (20) as printed, with the clockwise angle of (17) and (22) inserted into (2);
            `consistent`: (20) with every angle counter-clockwise (E1) and with λ2 by E10;
            `corrected`: ψ_dm = φ + λ2 arccos(sat[(v_o·n + κ(l − R_OB − d_s))/u]), so that l̇ = −κ(l − R_OB − d_s): the
            clearance is a barrier function whose rate includes the obstacle's velocity.
        phi: bearing from robot to obstacle [rad], positive counter-clockwise.
        clearance: l_dm = l − R_OB [m].
        radius: anti-collision radius R_OB [m].
        side: λ2, +1 or −1; the form `printed` ignores this argument and uses the sign of the angle.
        delta: offset δ of (20) [m].
        k3: convergence coefficient of (20).
        speed: avoidance speed u_dm > 0 [m/s].
        closing: v_o·n, the obstacle's velocity along n (from robot to obstacle) [m/s]; only the form `corrected` uses
            it.
        kappa: gain κ [1/s].
        standoff: stand-off distance d_s ≥ 0 [m].

    Example:
        >>> import casadi as ca
        >>> from surctl.guidance import avoidance_course
        >>> def course(clearance):
        ...     known = dict(radius=0.3, side=1, delta=0, k3=1, speed=0.15, closing=0, kappa=0.3, standoff=0.05)
        ...     known = {name: ca.SX(value) for name, value in known.items()}
        ...     return round(float(avoidance_course("corrected", ca.SX(0), ca.SX(clearance), **known)), 2)
        >>> course(1.0), course(0.1), course(0.0)  # rad, obstacle dead ahead
        (0.0, 1.47, 1.67)
    """
    if form == "corrected":
        ratio = (closing + kappa * (clearance - standoff)) / speed
        return phi + side * ca.acos(ca.fmin(ca.fmax(ratio, -1), 1))
    turn = np.pi / 2 - ca.atan2(clearance + delta, k3 * radius)
    if form == "consistent":
        return phi + side * turn
    if form == "printed":
        return -phi + printed_side(phi) * turn
    raise InputError("unknown avoidance form", key="avoidance", value=form, remedy=nearest(str(form), FORMS))


def printed_side(phi: ca.SX) -> ca.SX:
    """Return λ2 as printed below (20): +1 for a clockwise angle (E1) in [0°, 180°], −1 for an angle in [−180°, 0°]."""
    return ca.if_else(ca.sin(-phi) >= 0, 1, -1)


def encounter_side(relative_velocity: ca.SX, normal: ca.SX, *, deadband: float = 0.02) -> ca.SX:
    """Return λ2 by E10: +1 if the velocity relative to the obstacle points left of the bearing, −1 if it points right.

    Args:
        relative_velocity: velocity of the robot minus that of the obstacle (2, 1) in {E} [m/s].
        normal: unit vector from robot to obstacle (2, 1) in {E}.
        deadband: crosswise velocity [m/s] below which the encounter counts as head-on and the side is +1.

    Example:
        >>> import casadi as ca
        >>> from surctl.guidance import encounter_side
        >>> ahead = ca.SX([1, 0])
        >>> float(encounter_side(ca.SX([0.1, 0.05]), ahead)), float(encounter_side(ca.SX([0.1, -0.05]), ahead))
        (1.0, -1.0)
    """
    cross = normal[0] * relative_velocity[1] - normal[1] * relative_velocity[0]
    return ca.if_else(cross <= -deadband, -1, 1)


def clearance_rate(course: ca.SX, phi: ca.SX, *, speed: ca.SX, closing: ca.SX) -> ca.SX:
    """Return the rate l̇ = v_o·n − u cos(ψ_dm − φ) [m/s] of the clearance at a speed u on a course ψ_dm, cf. (23)."""
    return closing - speed * ca.cos(course - phi)


def allowed_closing_speed(distance: ca.SX, *, deceleration: ca.SX, reaction: ca.SX) -> ca.SX:
    """Return the largest closing speed [m/s] from which the robot still stops within `distance` d [m].

    The result is the inverse of the braking distance s²/(2a) + s t of a speed s: −a t + √((a t)² + 2 a d) for d ≥ 0.
    For d < 0 the result continues with the slope 1/t, so a robot inside the stand-off distance must retreat.

    Args:
        distance: d, clearance minus stand-off distance [m], of any sign.
        deceleration: a > 0 [m/s²], with the thrust available for braking and the largest mass.
        reaction: t > 0 [s], sum of thrust lag, control period and delay of the velocity loop.

    Example:
        >>> import casadi as ca
        >>> from surctl.guidance import allowed_closing_speed
        >>> speed = allowed_closing_speed(ca.SX(0.5), deceleration=ca.SX(0.05), reaction=ca.SX(0.8))
        >>> round(float(speed), 3)  # m/s, half a metre off
        0.187
    """
    at = deceleration * reaction
    inside = ca.sqrt(at * at + 2 * deceleration * ca.fmax(distance, 0)) - at
    return ca.if_else(distance >= 0, inside, distance / reaction)
