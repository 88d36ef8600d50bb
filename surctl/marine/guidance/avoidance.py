"""The paper's avoidance law, equations (17)–(20), in three forms, and the side on which it passes an obstacle.

φ is the bearing from the robot to the obstacle, positive counter-clockwise (erratum E1). The sign λ2 selects the side:
with λ2 = +1 the robot passes with the obstacle on its right, with λ2 = −1 on its left (erratum E10).
"""

from __future__ import annotations

from typing import Literal, get_args

import casadi as ca
import numpy as np

from surctl.errors import InputError, nearest

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
        form: `printed`: equation (20) of the paper as printed, with the clockwise angle of (17) and (22) inserted into
            (2); `consistent`: equation (20) with every angle counter-clockwise (erratum E1) and with λ2 by erratum E10;
            `corrected`: ψ_dm = φ + λ2 arccos(sat[(v_o·n + κ(l − R_OB − d_s))/u]), where sat limits its argument to [−1,
            1], so that the distance l to the obstacle changes at the rate l̇ = −κ(l − R_OB − d_s), whatever the
            obstacle's velocity.
        phi: bearing from robot to obstacle [rad], positive counter-clockwise.
        clearance: l_dm = l − R_OB [m], where l is the distance between robot and obstacle.
        radius: anti-collision radius R_OB [m].
        side: λ2, +1 (obstacle on the robot's right) or −1 (on its left); the form `printed` uses `printed_side`
            instead.
        delta: offset δ of equation (20) [m].
        k3: convergence coefficient k3 of equation (20).
        speed: speed u > 0 of the robot while it avoids the obstacle [m/s].
        closing: v_o·n, component of the obstacle's velocity along the unit vector n from robot to obstacle [m/s]; only
            the form `corrected` uses `closing`, `kappa` and `standoff`.
        kappa: gain κ [1/s].
        standoff: stand-off distance d_s ≥ 0 [m].
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
    """Return the sign λ2 of the passing side as printed below equation (20) of the paper.

    λ2 is +1 if the clockwise angle −φ to the obstacle is in [0°, 180°], otherwise −1.
    """
    return ca.if_else(ca.sin(-phi) >= 0, 1, -1)


def encounter_side(relative_velocity: ca.SX, normal: ca.SX, *, deadband: float = 0.02) -> ca.SX:
    """Return the sign λ2 of the side on which the robot passes an obstacle, by erratum E10.

    λ2 is +1 (obstacle on the robot's right) if `relative_velocity`, of the robot minus that of the obstacle (2, 1) in
    {E} [m/s], points left of the obstacle (`normal` (2, 1)), or if its crosswise part is below `deadband` [m/s]; else
    −1.
    """
    cross = normal[0] * relative_velocity[1] - normal[1] * relative_velocity[0]
    return ca.if_else(cross <= -deadband, -1, 1)


def clearance_rate(course: ca.SX, phi: ca.SX, *, speed: ca.SX, closing: ca.SX) -> ca.SX:
    """Return the rate [m/s] at which the clearance changes, cf. equation (23) of the paper.

    The rate is l̇ = v_o·n − u cos(ψ_dm − φ) for the robot's speed u and course ψ_dm, the bearing φ of the obstacle, and
    the component v_o·n (`closing`) of the obstacle's velocity along the direction from robot to obstacle.
    """
    return closing - speed * ca.cos(course - phi)
