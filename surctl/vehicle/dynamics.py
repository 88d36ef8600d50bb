"""The dynamics, equation (3) of the paper, with current, optional heave drag, thrust limits and thrust lag.

Added mass is part of the inertia matrix that the model inverts. A model that instead feeds back the added-mass force
from a delayed acceleration diverges if the added mass exceeds the dry mass, as the added mass of this robot does.
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
        Port("linear_drag", (4,), "N s/m, N m s", "linear drag Xu, Yv, Zw, Nr"),
        Port("quadratic_drag", (4,), "N s^2/m^2, N m s^2", "quadratic drag Xuu, Yvv, Zww, Nrr"),
        Port("thrust_limit", (4,), "N, N m", "largest thrust on each axis, in both directions"),
        Port("thrust_lag", (1,), "s", "time constant of the first-order thrust lag; 0 for none"),
    )
)


def plant_parameters(vehicle: Vehicle) -> NDArray[np.float64]:
    """Return the parameters of a vehicle as a flat vector (17,) with the layout `PLANT_PARAMETERS`.

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
    """Return the drag D(ν)ν (4,) of equation (3): the sum of linear and quadratic drag on each axis [N, N m]."""
    return p["linear_drag"] * nu + p["quadratic_drag"] * nu * ca.fabs(nu)


def coriolis_force(nu: ca.SX, p: dict[str, ca.SX]) -> ca.SX:
    """Return the Coriolis term C(ν)ν (4,) of a diagonal M: (−m22 v r, m11 u r, 0, (m22 − m11) u v) [N, N m]."""
    m = p["mass"]
    return ca.vertcat(-m[1] * nu[1] * nu[3], m[0] * nu[0] * nu[3], 0, (m[1] - m[0]) * nu[0] * nu[1])


@dataclass(frozen=True)
class Plant:
    """The differential equation of the vehicle, with every parameter as an input.

    Attributes:
        ode: function that computes ẋ (12,) from state x (12,), tau_command (4,), disturbance d (7,) and parameters p
            (17,); `PLANT_STATE`, `PLANT_DISTURBANCE` and `PLANT_PARAMETERS` name their entries.
        jacobians: function with the arguments of `ode` that computes exact ∂ẋ/∂x (12, 12) and ∂ẋ/∂tau_command (12, 4).
    """

    ode: ca.Function
    jacobians: ca.Function


@cache
def build_plant() -> Plant:
    """Return the differential equation of the vehicle, equations (1)–(3) of the paper.

    A constant irrotational current enters as ν_r = ν − ν_c in every hydrodynamic and inertial term (Fossen 2021,
    property 10.1). In the body frame {B}, the current vector ν_c rotates at −r, opposite to the vehicle's yaw rate r.
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
    """Return the trim thrust τ = C(ν)ν + D(ν)ν (4,) [N, N m], which holds the body velocity ν (4,) in still water.

    Example:
        >>> import numpy as np
        >>> from surctl.vehicle import load_vehicle, trim_thrust
        >>> trim_thrust(load_vehicle("sur400"), np.array([0.15, 0.0, 0.0, 0.2])).round(3).tolist()
        [0.964, 1.5, 0.0, 0.064]
    """
    return np.asarray(trim_function()(nu, plant_parameters(vehicle))).reshape(4)


@cache
def trim_function() -> ca.Function:
    """Return a CasADi function of (ν, p) that computes the trim thrust; ν and p may have one column for each plant."""
    flat, parameters = PLANT_PARAMETERS.symbols("p")
    velocity = ca.SX.sym("nu", 4)
    return ca.Function(
        "trim", [velocity, flat], [coriolis_force(velocity, parameters) + damping_force(velocity, parameters)]
    )


def steady_speed(force: float, linear: float, quadratic: float) -> float:
    """Return the speed u [m/s] at which the drag X u + X₂ u² equals the force F ≥ 0 [N].

    The speed is u = (−X + √(X² + 4 X₂ F)) / (2 X₂), with F = `force`, X = `linear` and X₂ = `quadratic`.

    Example:
        >>> from surctl.vehicle import load_vehicle, steady_speed
        >>> boat = load_vehicle("sur400")
        >>> round(steady_speed(boat["Fu_max"], boat["Xu"], boat["Xuu"]), 3)  # m/s at full thrust
        0.379
    """
    if quadratic == 0:
        return force / linear if linear > 0 else float("inf")
    return float((-linear + np.sqrt(linear**2 + 4 * quadratic * force)) / (2 * quadratic))
