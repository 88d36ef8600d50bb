"""Velocities that the vehicle's thrusters can reach within one step, as a limit for a task stack."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from surctl.errors import InputError, nearest
from surctl.marine.vehicle.dynamics import coriolis_force, damping_force
from surctl.tasks import ThrustLimit
from surctl.tasks.rows import checked_column
from surctl.tasks.task import Expression

__all__ = ["plant_thrust_limit"]

_NEEDED = ("mass", "linear_drag", "quadratic_drag", "thrust_limit")


def plant_thrust_limit(
    nu: Expression,
    parameters: Mapping[str, Expression],
    *,
    dt: Expression,
    water: Expression = (0.0, 0.0, 0.0),
    force: Expression = (0.0, 0.0, 0.0, 0.0),
    name: str = "thrust",
) -> ThrustLimit:
    """Return the thrust limit for the Coriolis and drag forces of the vehicle model.

    Args:
        nu: (4,) present velocity over ground in the body frame {B} [m/s, rad/s].
        parameters: `mass`, `linear_drag`, `quadratic_drag` and `thrust_limit`, each (4,), as numbers or SX; see
            `PLANT_PARAMETERS`. Other parameters are ignored.
        dt: time in which the vehicle is to reach v [s].
        water: (3,) velocity of the water in {B} [m/s], that is, the current rotated from the earth frame to {B}.
            Forces depend on the velocity relative to the water, and the water's velocity rotates in {B} at the
            negative yaw rate.
        force: (4,) known force on the vehicle in {B} [N, N m].
        name: name of the limit.

    Raises:
        InputError: a parameter is missing, or `ThrustLimit` rejects a value.

    Example:
        >>> from surctl.marine.vehicle import PLANT_PARAMETERS, load_vehicle, plant_parameters, plant_thrust_limit
        >>> numbers = PLANT_PARAMETERS.unpack(plant_parameters(load_vehicle("sur400")))
        >>> limit = plant_thrust_limit([0.1, 0, 0, 0], numbers, dt=0.05)
        >>> [row.name for row in limit.rows()]
        ['thrust.Fu', 'thrust.Fv', 'thrust.Fw', 'thrust.Fr']
    """
    for key in _NEEDED:
        if key not in parameters:
            raise InputError("is missing", key=f"limit {name}: {key}", remedy=nearest(key, parameters))
    p = {key: checked_column(name, key, parameters[key], 4, finite=True) for key in _NEEDED}
    velocity = checked_column(name, "nu", nu, 4, finite=True)
    current = checked_column(name, "water", water, 3, finite=True)
    relative = velocity - ca.vertcat(current, 0)
    turning = ca.vertcat(velocity[3] * current[1], -velocity[3] * current[0], 0, 0)
    load = coriolis_force(relative, p) + damping_force(relative, p) - p["mass"] * turning
    load -= checked_column(name, "force", force, 4, finite=True)
    most = p["thrust_limit"]
    return ThrustLimit(velocity, p["mass"], load=load, lower=-most, upper=most, dt=dt, name=name)
