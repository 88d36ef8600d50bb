"""The acceleration of the vehicle model in CasADi symbols, and helper functions of the own-state filter."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

import casadi as ca

__all__ = ["believed_acceleration", "from_upper", "wrapped"]

_LEAST_MASS = 1e-6  # [kg]


def believed_acceleration(
    psi: ca.SX, velocity: ca.SX, rate: ca.SX, thrust: ca.SX, model: Mapping[str, ca.SX], dt: float
) -> tuple[ca.SX, ca.SX]:
    """Return the mean acceleration (3,) in {E} [m/s²] and yaw acceleration [rad/s²] over a step.

    The accelerations are those of the vehicle model, equation (3) of the paper.

    The integration step is linearly implicit: it uses the drag at the middle of the step, so it is stable for any drag.
    For accelerations in {E}, the Coriolis force vanishes except for the part that the difference m22 − m11 of the
    masses in sway and surge causes: (m22 − m11)(v r, u r, 0, −u v) in {B}.
    """
    c, s = ca.cos(psi), ca.sin(psi)
    nu = ca.vertcat(c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0], velocity[2], rate)
    linear, quadratic = model["linear_drag"], model["quadratic_drag"]
    mass = ca.fmax(model["mass"], _LEAST_MASS)
    uneven = (mass[1] - mass[0]) * ca.vertcat(nu[1] * rate, nu[0] * rate, 0, -nu[0] * nu[1])
    load = thrust + uneven - linear * nu - quadratic * nu * ca.fabs(nu)
    a = load / (mass + 0.5 * dt * (linear + 2 * quadratic * ca.fabs(nu)))
    return ca.vertcat(c * a[0] - s * a[1], s * a[0] + c * a[1], a[2]), a[3]


def from_upper(upper: ca.SX) -> ca.SX:
    """Return a covariance (3, 3) from the 6 numbers of its upper triangle."""
    a, b, c, d, e, f = (upper[k] for k in range(6))
    return ca.vertcat(ca.horzcat(a, b, c), ca.horzcat(b, d, e), ca.horzcat(c, e, f))


def wrapped(angle: ca.SX) -> ca.SX:
    """Return the angle [rad] wrapped to (−π, π]."""
    turn = 2.0 * pi
    once = angle + turn * ca.floor((pi - angle) / turn)
    return once - turn * (once > pi) + turn * (once <= -pi)
