"""Linearisation of a vehicle, as a python-control system with named signals."""

from __future__ import annotations

from collections.abc import Sequence
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

__all__ = [
    "SIGNAL_UNITS",
    "STATE_NAMES",
    "THRUST_NAMES",
    "check_trim",
    "labelled",
    "linearise",
    "plant_jacobians",
    "within_limits",
]

STATE_NAMES = ("x", "y", "z", "psi", "u", "v", "w", "r", "Fu", "Fv", "Fw", "Fr")
THRUST_NAMES = ("Fu_cmd", "Fv_cmd", "Fw_cmd", "Fr_cmd")
SIGNAL_UNITS = dict(
    zip(
        (*STATE_NAMES, *THRUST_NAMES),
        ("m", "m", "m", "rad", "m/s", "m/s", "m/s", "rad/s", *2 * ("N", "N", "N", "N m")),
        strict=True,
    )
)
"""Unit of each signal, by name."""


def linearise(vehicle: Vehicle, nu: NDArray[np.float64], psi: float = 0.0, *, units: bool = False) -> Any:
    """Return a `control.StateSpace` from thrust command to the whole plant state, linearised about trimmed motion.

    Args:
        vehicle: the vehicle; its trim thrust must lie strictly inside the thrust limits.
        nu: body velocity (4,) [m/s, rad/s] of the operating point in still water.
        psi: heading [rad].
        units: whether to append units to the signal names, as in "u [m/s]".

    Returns:
        The StateSpace system with inputs `THRUST_NAMES`, and with states and outputs `STATE_NAMES`, in the units
        `SIGNAL_UNITS`. If `thrust_lag` is 0, the system does not contain the four thrust states.

    Raises:
        InputError: the operating point needs more thrust than the vehicle has.

    Example:
        >>> import numpy as np
        >>> from surctl.vehicle import linearise, load_vehicle
        >>> plant = linearise(load_vehicle("sur400"), np.array([0.15, 0.0, 0.0, 0.0]))
        >>> plant.input_labels[0], plant.state_labels[4], round(float(plant.A[4, 4]), 4)
        ('Fu_cmd', 'u', -0.217)
    """
    import control  # imported here because the import takes seconds

    nu = np.asarray(nu, dtype=float)
    check_trim(vehicle, nu)
    (a,), (b,), _ = plant_jacobians(plant_parameters(vehicle)[None], nu[None], psi=psi)
    keep = len(STATE_NAMES) if vehicle["thrust_lag"] > 0 else 8
    names = labelled(STATE_NAMES[:keep], units=units)
    return control.ss(
        a[:keep, :keep],
        b[:keep],
        np.eye(keep),
        np.zeros((keep, 4)),
        states=names,
        outputs=names,
        inputs=labelled(THRUST_NAMES, units=units),
        name=vehicle.name,
    )


def check_trim(vehicle: Vehicle, nu: NDArray[np.float64]) -> None:
    """Raise InputError if the vehicle lacks the thrust to hold the body velocity nu (4,) [m/s, rad/s]."""
    tau = trim_thrust(vehicle, nu)
    if not np.all(within_limits(tau, vehicle.thrust_limit)):
        raise InputError(
            f"needs thrust {np.round(tau, 2).tolist()}, but the limits are {vehicle.thrust_limit.tolist()} (N, N m)",
            key="operating point nu",
            value=nu.tolist(),
            remedy="linearise at a slower speed",
        )


def within_limits(tau: NDArray[np.float64], limit: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return for each thrust whether it lies strictly inside its limit; a thrust of 0 needs no thruster.

    Example:
        >>> import numpy as np
        >>> from surctl.vehicle.linearise import within_limits
        >>> within_limits(np.array([3.0, 0.0, -5.0]), np.array([5.0, 0.0, 5.0])).tolist()
        [True, True, False]
    """
    inside: NDArray[np.bool_] = (np.abs(tau) < limit) | (tau == 0)
    return inside


def labelled(names: Sequence[str], *, units: bool = True) -> list[str]:
    """Return the signal names with their units appended, as in "u [m/s]"; dimensionless signals have no unit."""
    return [f"{name} [{SIGNAL_UNITS[name]}]" if units and name in SIGNAL_UNITS else name for name in names]


def plant_jacobians(
    parameters: NDArray[np.float64], nu: NDArray[np.float64], *, psi: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return ∂ẋ/∂x and ∂ẋ/∂τ of n plants, each linearised about its own trimmed motion in still water.

    Args:
        parameters: (n, 17), one plant per row, as `plant_parameters` returns it.
        nu: (n, 4) body velocity of each plant [m/s, rad/s].
        psi: heading [rad] of all plants.

    Returns:
        Three arrays. A (n, 12, 12): state matrices ∂ẋ/∂x, in the order of `STATE_NAMES`; B (n, 12, 4): input matrices
        ∂ẋ/∂τ, with columns in the order of `THRUST_NAMES`; trim thrust (n, 4) [N, N m]. If the trim thrust of a plant
        exceeds a thrust limit, its matrix B describes no possible motion.

    Example:
        >>> import numpy as np
        >>> from surctl.vehicle import load_vehicle, plant_jacobians, plant_parameters
        >>> pair = np.array([plant_parameters(load_vehicle(name)) for name in ("sur400", "sur540-flooded")])
        >>> a, b, tau = plant_jacobians(pair, np.tile([0.15, 0.0, 0.0, 0.0], (2, 1)))
        >>> a.shape, a[:, 4, 4].round(4).tolist()
        ((2, 12, 12), [-0.217, -0.2105])
    """
    count = len(nu)
    tau = np.asarray(trim_function()(nu.T, parameters.T)).T
    x = np.hstack([np.zeros((count, 3)), np.full((count, 1), psi), nu, tau])
    a, b = build_plant().jacobians(x.T, tau.T, np.tile(PLANT_DISTURBANCE.pack(), (count, 1)).T, parameters.T)
    # CasADi returns the matrices of many calls side by side
    return (
        np.asarray(a).reshape(x.shape[1], count, -1).swapaxes(0, 1),
        np.asarray(b).reshape(x.shape[1], count, -1).swapaxes(0, 1),
        tau,
    )
