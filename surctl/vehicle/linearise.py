"""Linearisation of the vehicle to python-control, with named signals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.vehicle.dynamics import PLANT_DISTURBANCE, PLANT_STATE, build_plant, plant_parameters, trim_thrust
from surctl.vehicle.parameters import Vehicle

__all__ = ["STATE_NAMES", "THRUST_NAMES", "linearise"]

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
    x = PLANT_STATE.pack({"eta": [0, 0, 0, psi], "nu": nu, "tau": tau})
    a, b = build_plant().jacobians(x, tau, PLANT_DISTURBANCE.pack(), plant_parameters(vehicle))
    keep = len(STATE_NAMES) if vehicle["thrust_lag"] > 0 else 8
    names = list(STATE_NAMES[:keep])
    return control.ss(
        np.asarray(a)[:keep, :keep],
        np.asarray(b)[:keep],
        np.eye(keep),
        np.zeros((keep, 4)),
        states=names,
        outputs=names,
        inputs=list(THRUST_NAMES),
        name=vehicle.name,
    )
