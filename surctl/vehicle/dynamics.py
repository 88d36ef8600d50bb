"""Dynamics (3) with current, optional linear heave drag, thrust limits and first-order thrust lag.

Added mass is folded into the inverted inertia: a plant that feeds back lagged added-mass acceleration diverges
when the added mass exceeds the dry mass, as it does for this robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Layout, Port
from surctl.vehicle.kinematics import jacobian, planar_rotation
from surctl.vehicle.parameters import Vehicle

__all__ = [
    "PLANT_DISTURBANCE",
    "PLANT_PARAMETERS",
    "PLANT_STATE",
    "Plant",
    "build_plant",
    "plant_parameters",
    "steady_speed",
    "trim_thrust",
]

PLANT_STATE = Layout(
    (
        Port("eta", (4,), "m, rad", "position x, y, z and heading psi in {E}"),
        Port("nu", (4,), "m/s, rad/s", "ground velocity u, v, w and yaw rate r in {B}"),
        Port("tau", (4,), "N, N m", "thrust after its lag, in {B}"),
    )
)
PLANT_DISTURBANCE = Layout(
    (
        Port("current", (3,), "m/s", "current in {E}, constant and irrotational"),
        Port("force", (4,), "N, N m", "disturbance force in {E} and yaw moment"),
    )
)
PLANT_PARAMETERS = Layout(
    (
        Port("mass", (4,), "kg, kg m^2", "diagonal of M: rigid-body and added mass"),
        Port("linear_drag", (4,), "N s/m, N m s", "Xu, Yv, Zw, Nr"),
        Port("quadratic_drag", (4,), "N s^2/m^2, N m s^2", "Xuu, Yvv, Zww, Nrr"),
        Port("thrust_limit", (4,), "N, N m", "largest thrust per axis, both signs"),
        Port("thrust_lag", (1,), "s", "first-order lag; 0 for none"),
    )
)


def plant_parameters(vehicle: Vehicle) -> NDArray[np.float64]:
    """The vehicle as the flat vector `PLANT_PARAMETERS` describes, (17,).

    Example:
        >>> from surctl.vehicle import PLANT_PARAMETERS, load_vehicle, plant_parameters
        >>> numbers = plant_parameters(load_vehicle("sur400"))
        >>> numbers.size, PLANT_PARAMETERS.split(numbers)["mass"].tolist()
        (17, [50.0, 50.0, 50.0, 0.6])
    """
    return PLANT_PARAMETERS.pack(
        {
            "mass": vehicle.mass,
            "linear_drag": vehicle.linear_drag,
            "quadratic_drag": vehicle.quadratic_drag,
            "thrust_limit": vehicle.thrust_limit,
            "thrust_lag": vehicle["thrust_lag"],
        }
    )


def damping_force(nu: ca.SX, p: dict[str, ca.SX]) -> ca.SX:
    """D(ν)ν of (3), (4,): linear and quadratic drag per axis [N, N m]."""
    return p["linear_drag"] * nu + p["quadratic_drag"] * nu * ca.fabs(nu)


def coriolis_force(nu: ca.SX, p: dict[str, ca.SX]) -> ca.SX:
    """C(ν)ν for diagonal M, (4,): (−m22 v r, m11 u r, 0, (m22 − m11) u v) [N, N m]."""
    m = p["mass"]
    return ca.vertcat(-m[1] * nu[1] * nu[3], m[0] * nu[0] * nu[3], 0, (m[1] - m[0]) * nu[0] * nu[1])


@dataclass(frozen=True)
class Plant:
    """The vehicle's differential equation, symbolic in every parameter.

    Attributes:
        ode: (x (12,), tau_command (4,), d (7,), p (17,)) → ẋ (12,); layouts `PLANT_STATE`,
            `PLANT_DISTURBANCE`, `PLANT_PARAMETERS`.
        jacobians: the same arguments → (∂ẋ/∂x (12, 12), ∂ẋ/∂tau_command (12, 4)), exact.
    """

    ode: ca.Function
    jacobians: ca.Function


@cache
def build_plant() -> Plant:
    """Assemble (1)–(3).

    A constant irrotational current enters through ν_r = ν − ν_c in every hydrodynamic and inertial term
    (Fossen 2021, property 10.1); in {B} it turns with the vehicle: ν̇_c = −r S ν_c.
    """
    x, state = PLANT_STATE.symbols("x")
    d, disturbance = PLANT_DISTURBANCE.symbols("d")
    p, parameters = PLANT_PARAMETERS.symbols("p")
    command = ca.SX.sym("tau_command", 4)
    nu, psi = state["nu"], state["eta"][3]

    limit, lag = parameters["thrust_limit"], parameters["thrust_lag"]
    saturated = ca.fmin(ca.fmax(command, -limit), limit)
    lagged = lag > 0
    thrust = ca.if_else(lagged, state["tau"], saturated)
    thrust_rate = ca.if_else(lagged, (saturated - state["tau"]) / ca.fmax(lag, 1e-3), 0)

    to_body = planar_rotation(psi).T
    current = ca.vertcat(to_body @ disturbance["current"][:2], disturbance["current"][2], 0)
    current_rate = ca.vertcat(nu[3] * current[1], -nu[3] * current[0], 0, 0)
    force = ca.vertcat(to_body @ disturbance["force"][:2], disturbance["force"][2:])
    nu_r = nu - current
    load = thrust + force - coriolis_force(nu_r, parameters) - damping_force(nu_r, parameters)
    rate = ca.vertcat(jacobian(psi) @ nu, load / parameters["mass"] + current_rate, thrust_rate)

    names = ["x", "tau_command", "d", "p"]
    arguments = [x, command, d, p]
    return Plant(
        ca.Function("ode", arguments, [rate], names, ["rate"]),
        ca.Function("jacobians", arguments, [ca.jacobian(rate, x), ca.jacobian(rate, command)], names, ["A", "B"]),
    )


def trim_thrust(vehicle: Vehicle, nu: NDArray[np.float64]) -> NDArray[np.float64]:
    """Thrust (4,) [N, N m] that holds the body velocity ν (4,) in still water: τ = C(ν)ν + D(ν)ν.

    Example:
        >>> import numpy as np
        >>> from surctl.vehicle import load_vehicle, trim_thrust
        >>> trim_thrust(load_vehicle("sur400"), np.array([0.15, 0.0, 0.0, 0.2])).round(3).tolist()
        [0.964, 1.5, 0.0, 0.064]
    """
    return np.asarray(trim_function()(nu, plant_parameters(vehicle))).reshape(4)


@cache
def trim_function() -> ca.Function:
    """(ν, p) → `trim_thrust`, both in columns for many at once."""
    flat, parameters = PLANT_PARAMETERS.symbols("p")
    velocity = ca.SX.sym("nu", 4)
    return ca.Function(
        "trim", [velocity, flat], [coriolis_force(velocity, parameters) + damping_force(velocity, parameters)]
    )


def steady_speed(force: float, linear: float, quadratic: float) -> float:
    """Speed [m/s] at which drag X u + X₂ u² equals a force ≥ 0 [N]: (−X + √(X² + 4 X₂ F)) / (2 X₂).

    Example:
        >>> from surctl.vehicle import load_vehicle, steady_speed
        >>> boat = load_vehicle("sur400")
        >>> round(steady_speed(boat["Fu_max"], boat["Xu"], boat["Xuu"]), 3)  # m/s at full thrust
        0.379
    """
    if quadratic == 0:
        return force / linear if linear > 0 else float("inf")
    return float((-linear + np.sqrt(linear**2 + 4 * quadratic * force)) / (2 * quadratic))
