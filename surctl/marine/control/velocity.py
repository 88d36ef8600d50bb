"""Velocity controller with drag feedforward at the desired velocity, proportional action and thrust limits.

The controller cancels neither Coriolis forces nor the true drag. A body that turns while it translates needs no force
to hold its inertial velocity. To cancel the Coriolis force m u r, the thrusters would have to provide 9–14 N, but only
5 N are available. The true drag adds damping. Because the gains in surge and sway are equal, properties of the closed
loop can be proved. The feedback uses the velocity over ground, so a constant current causes only a small steady error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import casadi as ca

__all__ = ["velocity_control"]


def velocity_control(
    nu_reference: ca.SX,
    nu: ca.SX,
    integral: ca.SX,
    model: Mapping[str, ca.SX],
    *,
    k_v: ca.SX,
    k_r: ca.SX,
    k_i: ca.SX,
    dt: float,
    calm: Callable[[ca.SX], ca.SX] | None = None,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the limited thrust, the next integral ξ, and whether a limit is reached.

    Before the limits, the thrust is D(ν_d)ν_d + M (K (ν_d − ν) + ξ) with the drag D, the mass matrix M and the gains K.

    Args:
        nu_reference: ν_d (4, 1) [m/s, rad/s] in {B}.
        nu: measured velocity over ground (4, 1) in {B}.
        integral: ξ (4, 1) [m/s², rad/s²].
        model: `mass`, `linear_drag`, `quadratic_drag` and `thrust_limit` of the controller's model, each (4, 1).
        k_v: bandwidth in surge, sway and heave [1/s], one number or (3, 1).
        k_r: bandwidth in yaw [1/s].
        k_i: integral gain [1/s²]; the integral of an axis does not change while the thrust of this axis is saturated
            (conditional anti-windup).
        dt: control period [s].
        calm: function that keeps measurement noise out of the thrust before its limits (`control.calm`), or None.

    Returns:
        The thrust (4, 1) [N, N m] within the limits, the next integral (4, 1), and 1 if the thrust of an axis is
        saturated, otherwise 0. Each axis is limited separately, because a common scaling of the horizontal force would
        allow a large sideways command to remove most of the braking force.
    """
    error = nu_reference - nu
    gain = ca.vertcat(ca.SX.ones(3) * k_v, k_r)
    drag = model["linear_drag"] * nu_reference + model["quadratic_drag"] * nu_reference * ca.fabs(nu_reference)
    free = drag + model["mass"] * (gain * error + integral)
    if calm is not None:
        free = calm(free)
    limit = model["thrust_limit"]
    thrust = ca.fmin(ca.fmax(free, -limit), limit)
    clipped = ca.fabs(free - thrust) > 1e-9
    held = ca.if_else(clipped, integral, integral + dt * k_i * error)
    return thrust, held, ca.fmax(ca.fmax(clipped[0], clipped[1]), ca.fmax(clipped[2], clipped[3]))
