"""Integrate the plant between two firings of the sonars."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import on_vectors
from surctl.marine.vehicle import PlantForm, build_plant
from surctl.marine.vehicle.dynamics import PAPER

__all__ = ["advance", "advanced"]

_RK4_STEPS = (0.010, 0.010, 0.005)


def advance(form: PlantForm = PAPER) -> ca.Function:
    """Return a CasADi function that integrates the plant over 25 ms by RK4, in steps of 10, 10 and 5 ms.

    The function computes the new plant state from the plant state x, the commanded thrust, the disturbance d and the
    plant parameters p.

    Args:
        form: the optional terms of the vehicle's dynamics, `Vehicle.form`.

    Example:
        >>> from surctl.marine.simulation import advance
        >>> from surctl.marine.vehicle import PLANT_DISTURBANCE, PLANT_STATE, load_vehicle, plant_parameters
        >>> boat, still = load_vehicle("sur400"), PLANT_DISTURBANCE.pack()
        >>> x, p = PLANT_STATE.pack({"nu": [0.2, 0, 0, 0]}), plant_parameters(boat)
        >>> after = advance(boat.form)(x, [0, 0, 0, 0], still, p)
        >>> round(float(after[0]) * 1000, 2)  # mm after 25 ms
        4.99
    """
    return _advance(form)


@cache
def _advance(form: PlantForm) -> ca.Function:
    ode = build_plant(form).ode
    x, tau, d, p = (ca.SX.sym(n, ode.numel_in(i)) for i, n in enumerate(("x", "tau", "d", "p")))
    state = x
    for h in _RK4_STEPS:
        k1 = ode(state, tau, d, p)
        k2 = ode(state + h / 2 * k1, tau, d, p)
        k3 = ode(state + h / 2 * k2, tau, d, p)
        k4 = ode(state + h * k3, tau, d, p)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function("advance", [x, tau, d, p], [state], {"cse": True})


@cache
def advanced(form: PlantForm) -> Callable[..., list[NDArray[np.float64]]]:
    """Return `advance` as a function of NumPy vectors."""
    return on_vectors(_advance(form))
