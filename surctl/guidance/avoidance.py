"""Avoidance law (17)–(20) in three forms, and its extension to many contacts with the braking distance.

φ is the bearing from the robot to the obstacle, counter-clockwise (E1); λ2 = +1 passes with the obstacle on
the right, −1 on the left (E10).
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
    """ψ_dm [rad], the commanded course, counter-clockwise.

    Args:
        form: `printed`: (20) as it stands, with the clockwise angle of (17) and (22) put into (2);
            `consistent`: (20) with every angle counter-clockwise (E1) and λ2 by E10;
            `corrected`: ψ_dm = φ + λ2 arccos(sat[(v_o·n + κ(l − R_OB − d_s))/u]), so that
            l̇ = −κ(l − R_OB − d_s): the clearance is a barrier, the obstacle's velocity is in it.
        phi: bearing robot → obstacle [rad], counter-clockwise.
        clearance: l_dm = l − R_OB [m].
        radius: R_OB, anti-collision radius [m].
        side: λ2, +1 or −1; `printed` takes its own from the sign of the angle.
        delta: δ of (20) [m].
        k3: convergence coefficient of (20).
        speed: u_dm > 0 [m/s].
        closing: v_o·n, the obstacle's velocity along n (robot → obstacle) [m/s]; only `corrected` uses it.
        kappa: κ [1/s].
        standoff: d_s ≥ 0 [m].

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
    """λ2 as printed below (20): +1 for an angle in [0°, 180°], −1 in [−180°, 0°]; the angle is clockwise (E1)."""
    return ca.if_else(ca.sin(-phi) >= 0, 1, -1)


def encounter_side(relative_velocity: ca.SX, normal: ca.SX, *, deadband: float = 0.02) -> ca.SX:
    """λ2 by E10: +1 when the velocity relative to the obstacle points left of the bearing, −1 when right.

    Args:
        relative_velocity: robot minus obstacle (2, 1) in {E} [m/s].
        normal: unit vector robot → obstacle (2, 1) in {E}.
        deadband: cross component [m/s] below which the encounter is head-on, and the side +1.

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
    """l̇ [m/s] for a robot that flies `speed` on `course`: v_o·n − u cos(ψ_dm − φ), cf. (23)."""
    return closing - speed * ca.cos(course - phi)


def allowed_closing_speed(distance: ca.SX, *, deceleration: ca.SX, reaction: ca.SX) -> ca.SX:
    """Largest closing speed [m/s] from which the robot still stops within `distance` [m].

    The inverse of s ↦ s²/(2a) + s t: −a t + √((a t)² + 2 a d) for d ≥ 0, continued with its slope 1/t below 0, so
    that an intrusion asks for a retreat.

    Args:
        distance: clearance less the stand-off [m], any sign.
        deceleration: a > 0 [m/s²], what the thrust gives at the heaviest.
        reaction: t > 0 [s], thrust lag, control period and velocity loop together.

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
