"""The plant, equations (1)–(3) of the paper, as a nonlinear system of python-control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.marine.vehicle.dynamics import PLANT_DISTURBANCE, build_plant, plant_parameters, plant_state
from surctl.marine.vehicle.linearise import THRUST_NAMES, dynamic_states, labelled, state_names
from surctl.marine.vehicle.parameters import Vehicle

__all__ = ["plant_system"]


def plant_system(vehicle: Vehicle, *, current: ArrayLike = (0.0, 0.0, 0.0), units: bool = True) -> Any:
    """Return a `control.NonlinearIOSystem` from thrust command to the whole plant state, continuous in time.

    `control.input_output_response` interpolates inputs between the given times, but the simulation of this toolkit
    holds inputs constant. `control.input_output_response` may also skip a short input. Therefore give times on both
    sides of a step of an input, and limit the step size with `solve_ivp_kwargs={"max_step": ...}`. With "rtol" and
    "atol" of 1e-12, the computed motion agrees with the fixed-step simulation (`surctl.marine.simulation.advance`) to
    1e-8 in SI units. `control.linearize` about trimmed motion gives the system that `linearise` returns.

    Args:
        vehicle: the vehicle; the system includes its thrust limits and thrust lag.
        current: steady current (3,) [m/s] in the world frame {E} (east, north, up).
        units: whether to append units to the signal names, as in "u [m/s]".

    Returns:
        The system with inputs `THRUST_NAMES`, and with states and outputs `state_names(vehicle)`.

    Raises:
        InputError: the current does not consist of three finite numbers.

    Example:
        >>> import control
        >>> import numpy as np
        >>> from surctl.marine.vehicle import load_vehicle, plant_system
        >>> system, t = plant_system(load_vehicle("sur400")), np.linspace(0, 60, 301)
        >>> ahead = np.outer([5.0, 0.0, 0.0, 0.0], np.ones(301))  # N
        >>> response = control.input_output_response(system, t, ahead)
        >>> round(float(response.states[4, -1]), 2)  # m/s after a minute
        0.38
    """
    import control  # imported here because the import takes seconds

    flow = np.asarray(current, dtype=float)
    if flow.shape != (3,) or not np.isfinite(flow).all():
        raise InputError("must be three finite numbers", key="current", value=current, remedy="give x, y, z in m/s")
    ode, p, d = build_plant(vehicle.form).ode, plant_parameters(vehicle), PLANT_DISTURBANCE.pack({"current": flow})
    keep = dynamic_states(vehicle.form, lagged=vehicle["thrust_lag"] > 0)
    whole = np.zeros(plant_state(vehicle.form).size)

    def rate(t: float, x: NDArray[np.float64], u: NDArray[np.float64], params: Mapping[str, Any]) -> Any:
        state = whole.copy()
        state[keep] = x
        return np.asarray(ode(state, u, d, p)).reshape(-1)[keep]

    names = labelled(state_names(vehicle), units=units)
    return control.nlsys(
        rate, None, inputs=labelled(THRUST_NAMES, units=units), outputs=names, states=names, name=vehicle.name
    )
