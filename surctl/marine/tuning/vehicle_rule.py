"""Explicit formulae from a vehicle and a cruise speed to every gain of the built-in laws.

Notation: T thrust lag, h control period, τ = T + 1.5 h the delay of the inner loops, U cruise speed, a the horizontal
acceleration at full thrust, R hull radius.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle import Vehicle, steady_speed

__all__ = ["DEPENDENT", "inner_start", "munk_rate", "rule", "top_speed"]

Array = NDArray[np.float64]

DEPENDENT = ("k_v", "k_r", "k_psi", "k1", "k2", "lookahead", "wait", "margin", "reaction", "brake", "kappa", "spin")
"""The gains that `rule` computes from the vehicle; the first three can be changed by a search."""

_PHASE = 0.55  # k τ of a velocity loop k / (s (1 + T s)) e^(−1.5 h s): phase margin near 60 deg, disk margin near 0.75
_FASTEST = 5.0  # [1/s] a faster loop only amplifies the noise of the measured velocity
_FULL_THRUST = 0.15  # share of U: velocity error at which a velocity loop may reach full thrust
_OUTER = 5.0  # ratio of inner and outer bandwidths: the outer loop costs the inner loop about 11 deg of phase
_HEADING = 2.5  # the same for yaw and heading
_ABOVE_MUNK = 2.0  # ratio of k_r k_psi and the square of the Munk rate
_BRAKE = 0.7  # share of the thrust for braking; the rest is for Coriolis forces and errors of the model
_HULLS = 4.0  # look-ahead in hull radii
_GAP, _LEAST_GAP = 0.2, 0.05  # stand-off in hull radii, and the least [m]: errors of position and ranges
_PATIENCE, _LENGTHS = 60.0, 40.0  # [s], and hull radii of cruise without progress


def munk_rate(vehicle: Vehicle, cruise: float) -> float:
    """Return p = U √((m22 − m11)/m44) [1/s], at which the Munk moment turns an uncontrolled hull; 0 if m22 ≤ m11.

    A hull that moves along the path with heading error ψ has the sway velocity v = −U ψ, and the moment
    (m11 − m22) u v = (m22 − m11) U² ψ increases ψ.
    """
    return cruise * float(np.sqrt(max(vehicle["m22"] - vehicle["m11"], 0.0) / vehicle["m44"]))


def top_speed(vehicle: Vehicle) -> float:
    """Return the speed [m/s] at full surge thrust, at most 10 m/s."""
    return min(steady_speed(vehicle["Fu_max"], vehicle["Xu"], vehicle["Xuu"]), 10.0)


def held_speed(vehicle: Vehicle) -> float:
    """Return the largest speed [m/s] that a law holds, whose thrust ahead is limited to that astern; at most 10 m/s."""
    return min(steady_speed(float(vehicle.thrust_limit[0]), vehicle["Xu"], vehicle["Xuu"]), 10.0)


def inner_start(vehicle: Vehicle, *, cruise: float, dt: float) -> Array:
    """Return k_v, k_r and k_psi (3,) [1/s] of the formulae.

    - k_v = 0.55/τ leaves a phase margin of about 60° after lag, computation and sampling; and a velocity error of 15 %
      of U must not yet command full thrust.
    - k_r = 0.55/τ likewise; k_psi = k_r/2.5, but a heading error of 1 rad must not need more than the full yaw moment,
      k_psi ≤ √(Fr_max/m44).
    - Munk moment: yaw and heading together have the stiffness k_r k_psi, which must exceed p² (`munk_rate`) twice: both
      are raised in proportion until it does.
    """
    lag = vehicle["thrust_lag"] + 1.5 * dt
    fastest = min(_PHASE / lag, _FASTEST)
    k_v = min(fastest, _acceleration(vehicle) / (_FULL_THRUST * cruise))
    k_r = fastest
    k_psi = min(k_r / _HEADING, float(np.sqrt(vehicle["Fr_max"] / vehicle["m44"])))
    raised = max(1.0, float(np.sqrt(_ABOVE_MUNK * munk_rate(vehicle, cruise) ** 2 / (k_r * k_psi))))
    return np.array([k_v, raised * k_r, raised * k_psi])


def rule(vehicle: Vehicle, inner: Array, *, cruise: float, dt: float) -> dict[str, float]:
    """Return every gain by name, from k_v, k_r and k_psi (3,) and the vehicle.

    - k1, k2 = k_v/5 (separation of the loops), at most a/U: from the distance U/k1, at which the commanded speed is U,
      full thrust can stop the vehicle. Without heave thrust, k2 has no effect.
    - lookahead = 4 R at least (two hull lengths), 5 U/k_v at least (U/lookahead is the bandwidth of the cross-track
      loop), U²/a at least (distance in which full thrust turns the velocity into a new leg). wait = lookahead.
    - margin = 0.2 R, at least 0.05 m; reaction = τ + 0.2/k_v (lag, sampling, and the part of the velocity loop's
      response that passes before it brakes); brake = 0.7 of the thrust. The law itself divides by the larger mass.
    - kappa = k1: the avoidance is as fast as the tracking. spin ≤ half the yaw rate of full moment, 0.45 rad/s.
    - patience = 60 s, at least 40 R/U; ilos_sigma = U/4; alos_gamma = 1/(4 lookahead²): the estimates of the current
      are slower than the cross-track loop.
    - k_i = 0: guidance integrates the velocity. The gains of sensors do not depend on the vehicle.
    """
    k_v, k_r, k_psi = (float(value) for value in inner)
    horizontal, vertical = _acceleration(vehicle), vehicle["Fw_max"] / vehicle["m33"]
    radius, lag = vehicle["radius"], vehicle["thrust_lag"] + 1.5 * dt
    k1 = min(k_v / _OUTER, horizontal / cruise)
    lookahead = max(_HULLS * radius, _OUTER * cruise / k_v, cruise**2 / horizontal)
    return {
        "k1": k1,
        "k2": min(k_v / _OUTER, vertical / cruise) if vertical > 0 else k_v / _OUTER,
        "lookahead": lookahead,
        "ilos_sigma": cruise / 4,
        "alos_gamma": 0.25 / lookahead**2,
        "wait": lookahead,
        "patience": max(_PATIENCE, _LENGTHS * radius / cruise),
        "k_psi": k_psi,
        "spin": min(0.45, vehicle.steady_yaw(1.0, cruise) / 2),
        "k_v": k_v,
        "k_r": k_r,
        "k_i": 0.0,
        "margin": max(_GAP * radius, _LEAST_GAP),
        "reaction": lag + 0.2 / k_v,
        "brake": _BRAKE,
        "kappa": k1,
        "k3": 1.0,
        "delta": 0.0,
        "lambda1": 3.0,
        "lms_step": 0.5,
        "beta_max": 0.2,
    }


def _acceleration(vehicle: Vehicle) -> float:
    # [m/s²] full thrust of the weaker horizontal axis that has thrust, by the larger mass; as in the law's braking
    forces = [force for force in (vehicle["Fu_max"], vehicle["Fv_max"]) if force > 0]
    return min(forces) / max(vehicle["m11"], vehicle["m22"])
