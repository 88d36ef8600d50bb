"""Roll and pitch: the motion in six degrees of freedom of a vehicle with weight, buoyancy and their centres.

The velocity of the plant stays that of the heading frame (x ahead and y to the left, both horizontal, z up), because
laws, sensors and metrics are about that frame; roll φ, pitch θ and the angular velocities p, q of the hull follow as
four more states. The forces are computed in the frame of the hull: Kirchhoff's equations with the momenta M ν (Fossen
2021, equation 6.44), drag, and the restoring forces (section 4.1). The rotation from the hull to the heading frame is
R_y(θ) R_x(φ). With y to the left, a positive pitch lowers the bow. Roll and pitch must stay below 90°.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import casadi as ca

from surctl.ir import Layout, Port

__all__ = ["TILT_STATE", "hull_load", "tilted_rate", "to_heading"]

TILT_STATE = Layout((Port("tilt", (4,), "rad, rad/s", "roll, pitch, and angular velocities p, q of the hull"),))
"""Further states of a vehicle that rolls and pitches."""

_LINEAR, _ANGULAR = [0, 1, 2], [4, 5, 3]  # places of (u, v, w) and (p, q, r) in a velocity (u, v, w, r, p, q)


def to_heading(roll: ca.SX, pitch: ca.SX) -> ca.SX:
    """Return the matrix R_y(θ) R_x(φ), 3×3, that rotates vectors from the frame of the hull to the heading frame."""
    c, s = ca.cos(roll), ca.sin(roll)
    about_x = ca.vertcat(ca.horzcat(1, 0, 0), ca.horzcat(0, c, -s), ca.horzcat(0, s, c))
    c, s = ca.cos(pitch), ca.sin(pitch)
    about_y = ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))
    return about_y @ about_x


def hull_load(
    nu: ca.SX, momentum: ca.SX, thrust: ca.SX, outer: ca.SX, rotation: ca.SX, terms: Mapping[str, ca.SX]
) -> ca.SX:
    """Return the load M ν̇ (6,) [N, N m] on the hull without its drag, in the order of ν = (u, v, w, r, p, q).

    All vectors but `outer` are in the frame of the hull.

    Args:
        nu: velocity through the water (6,).
        momentum: M ν (6,).
        thrust: surge, sway and heave force and yaw moment (4,).
        outer: force (3,) and moment about the vertical (1,) on the hull, in the heading frame.
        rotation: result of `to_heading`.
        terms: the optional terms by name.
    """
    linear, angular = momentum[_LINEAR], momentum[_ANGULAR]
    velocity, turning = nu[_LINEAR], nu[_ANGULAR]
    up = rotation[2, :].T  # the vertical
    weight, buoyancy = terms["weight"], terms["buoyancy"]
    force = thrust[:3] + rotation.T @ outer[:3] + (buoyancy - weight) * up - ca.cross(turning, linear)
    moment = ca.cross(buoyancy * _point(terms, "b") - weight * _point(terms, "g"), up) + outer[3] * up
    moment += ca.cross(_point(terms, "t"), thrust[:3]) - ca.cross(turning, angular) - ca.cross(velocity, linear)
    return ca.vertcat(force, moment[2] + thrust[3], moment[:2])


def _point(terms: Mapping[str, ca.SX], letter: str) -> ca.SX:
    return ca.vertcat(*(terms.get(f"{axis}{letter}", ca.SX(0)) for axis in "xyz"))


def tilted_rate(
    nu: ca.SX, tilt: ca.SX, current: ca.SX, acceleration: Callable[[ca.SX, ca.SX], ca.SX]
) -> tuple[ca.SX, ca.SX]:
    """Return ν̇ (4,) of the heading frame and the rate (4,) of `TILT_STATE`.

    Args:
        nu: velocity over ground (u, v, w, r) in the heading frame.
        tilt: roll, pitch, p, q.
        current: current (3,) in the heading frame; it is constant in the world and irrotational.
        acceleration: function of the velocity through the water (6,) in the frame of the hull, and of the result of
            `to_heading`; it returns the rate (6,) of that velocity.
    """
    roll, pitch, p, q = (tilt[k] for k in range(4))
    rotation, yaw = to_heading(roll, pitch), nu[3]
    r = (yaw * ca.cos(pitch) - q * ca.sin(roll)) / ca.cos(roll)
    turning = ca.vertcat(p, q, r)
    roll_rate, pitch_rate = p + yaw * ca.sin(pitch), q * ca.cos(roll) - r * ca.sin(roll)
    velocity = rotation.T @ (nu[:3] - current)
    rates = acceleration(ca.vertcat(velocity, r, p, q), rotation)
    # the rate in the world, seen from the heading frame, which turns at the yaw rate about the vertical
    linear = rotation @ (rates[:3] + ca.cross(turning, velocity)) - yaw * ca.vertcat(-nu[1], nu[0], 0)
    spin = rates[5] * ca.sin(roll) + q * ca.cos(roll) * roll_rate
    spin += rates[3] * ca.cos(roll) - r * ca.sin(roll) * roll_rate
    angular = spin / ca.cos(pitch) + yaw * ca.sin(pitch) / ca.cos(pitch) * pitch_rate
    return ca.vertcat(linear, angular), ca.vertcat(roll_rate, pitch_rate, rates[4:])
