"""Linearisation of the vehicle to python-control, with named signals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.vehicle.dynamics import (
    PLANT_DISTURBANCE,
    build_plant,
    plant_parameters,
    trim_function,
    trim_thrust,
)
from surctl.vehicle.parameters import Vehicle

__all__ = ["STATE_NAMES", "THRUST_NAMES", "linearise", "plant_jacobians"]

STATE_NAMES = ("x", "y", "z", "psi", "u", "v", "w", "r", "Fu", "Fv", "Fw", "Fr")
THRUST_NAMES = ("Fu_cmd", "Fv_cmd", "Fw_cmd", "Fr_cmd")


def linearise(vehicle: Vehicle, nu: NDArray[np.float64], psi: float = 0.0) -> Any:
    """`control.StateSpace` from thrust command to the whole plant state, about trimmed motion.

    Args:
        vehicle: the vehicle; its trim thrust must lie strictly inside the thrust limits.
        nu: body velocity (4,) [m/s, rad/s] of the operating point, still water.
        psi: heading [rad].

    Returns:
        StateSpace with states and outputs `STATE_NAMES` and inputs `THRUST_NAMES`. With `thrust_lag` 0 the four
        thrust states are removed, not kept as integrators.

    Raises:
        InputError: the operating point needs more thrust than the vehicle has.
    """
    import control  # seconds to import: only when asked for

    nu = np.asarray(nu, dtype=float)
    tau = trim_thrust(vehicle, nu)
    if np.any(np.abs(tau) >= vehicle.thrust_limit):
        raise InputError(
            f"needs thrust {np.round(tau, 2).tolist()} of at most {vehicle.thrust_limit.tolist()}",
            key="operating point nu",
            value=nu.tolist(),
            remedy="linearise at a slower speed",
        )
    (a,), (b,), _ = plant_jacobians(plant_parameters(vehicle)[None], nu[None], psi=psi)
    keep = len(STATE_NAMES) if vehicle["thrust_lag"] > 0 else 8
    names = list(STATE_NAMES[:keep])
    return control.ss(
        a[:keep, :keep],
        b[:keep],
        np.eye(keep),
        np.zeros((keep, 4)),
        states=names,
        outputs=names,
        inputs=list(THRUST_NAMES),
        name=vehicle.name,
    )


def plant_jacobians(
    parameters: NDArray[np.float64], nu: NDArray[np.float64], *, psi: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """∂ẋ/∂x and ∂ẋ/∂τ of many plants at once, each about its own trimmed motion in still water.

    Args:
        parameters: (n, 17) as `plant_parameters` lays them out.
        nu: (n, 4) body velocities [m/s, rad/s].
        psi: heading [rad] of all.

    Returns:
        A (n, 12, 12), B (n, 12, 4) in the order of `STATE_NAMES` and `THRUST_NAMES`, and the trim thrust (n, 4)
        [N, N m]. Where the trim is beyond a thrust limit, B is not the slope of anything that can be flown.
    """
    count = len(nu)
    tau = np.asarray(trim_function()(nu.T, parameters.T)).T
    x = np.hstack([np.zeros((count, 3)), np.full((count, 1), psi), nu, tau])
    a, b = build_plant().jacobians(x.T, tau.T, np.tile(PLANT_DISTURBANCE.pack(), (count, 1)).T, parameters.T)
    # CasADi puts the matrices of many calls side by side
    return (
        np.asarray(a).reshape(x.shape[1], count, -1).swapaxes(0, 1),
        np.asarray(b).reshape(x.shape[1], count, -1).swapaxes(0, 1),
        tau,
    )
