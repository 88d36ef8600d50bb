"""Linearisation of a vehicle as a python-control system; whether its thrust, or a law, can hold a cruise speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.marine.vehicle.dynamics import (
    PAPER,
    PLANT_DISTURBANCE,
    build_plant,
    plant_parameters,
    plant_state,
    trim_function,
    trim_thrust,
    trim_tilt,
)
from surctl.marine.vehicle.parameters import Vehicle
from surctl.marine.vehicle.specs import PlantForm

TILT_NAMES = ("phi", "theta", "p", "q")
STATE_NAMES = ("x", "y", "z", "psi", "u", "v", "w", "r", "Fu", "Fv", "Fw", "Fr")
THRUST_NAMES = ("Fu_cmd", "Fv_cmd", "Fw_cmd", "Fr_cmd")
_FORCES = ("N", "N", "N", "N m")
SIGNAL_UNITS = dict(
    zip(
        (*STATE_NAMES, *THRUST_NAMES, *TILT_NAMES),
        ("m", "m", "m", "rad", "m/s", "m/s", "m/s", "rad/s", *_FORCES, *_FORCES, "rad", "rad", "rad/s", "rad/s"),
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
        The StateSpace system with inputs `THRUST_NAMES`, and with states and outputs `state_names(vehicle)`, in the
        units `SIGNAL_UNITS`.

    Raises:
        InputError: the operating point needs more thrust than the vehicle has.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle import linearise, load_vehicle
        >>> plant = linearise(load_vehicle("sur400"), np.array([0.15, 0.0, 0.0, 0.0]))
        >>> plant.input_labels[0], plant.state_labels[4], round(float(plant.A[4, 4]), 4)
        ('Fu_cmd', 'u', -0.217)
    """
    import control  # imported here because the import takes seconds

    nu = np.asarray(nu, dtype=float)
    _check_trim(vehicle, nu)
    (a,), (b,), _ = plant_jacobians(plant_parameters(vehicle)[None], nu[None], psi=psi, form=vehicle.form)
    keep = dynamic_states(vehicle.form, lagged=vehicle["thrust_lag"] > 0)
    names = labelled(state_names(vehicle), units=units)
    return control.ss(
        a[np.ix_(keep, keep)],
        b[keep],
        np.eye(len(keep)),
        np.zeros((len(keep), 4)),
        states=names,
        outputs=names,
        inputs=labelled(THRUST_NAMES, units=units),
        name=vehicle.name,
    )


def dynamic_states(form: PlantForm, *, lagged: bool) -> list[int]:
    """Return the places of a plant's states that have dynamics: without thrust lag, the thrust has none."""
    return [k for k in range(plant_state(form).size) if lagged or not 8 <= k < len(STATE_NAMES)]


def state_names(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of the states of a vehicle's plant: `STATE_NAMES`, and `TILT_NAMES` if it rolls and pitches.

    If `thrust_lag` is 0, there are no thrust states.
    """
    names = (*STATE_NAMES, *TILT_NAMES)
    return tuple(names[k] for k in dynamic_states(vehicle.form, lagged=vehicle["thrust_lag"] > 0))


def _check_trim(vehicle: Vehicle, nu: NDArray[np.float64]) -> None:
    """Raise InputError if the vehicle lacks the thrust to hold the body velocity nu (4,) [m/s, rad/s]."""
    if not can_hold(trim_thrust(vehicle, nu), *vehicle.thrust_range):
        tau, (least, most) = trim_thrust(vehicle, nu), np.round(vehicle.thrust_range, 2)
        limits = f"the limits are {most.tolist()}"
        if (least != -most).any():
            limits = f"the thrust lies between {least.tolist()} and {most.tolist()}"
        problem = f"needs thrust {np.round(tau, 2).tolist()}, but {limits} (N, N m)"
        raise InputError(problem, key="operating point nu", value=nu.tolist(), remedy="linearise at a slower speed")


def ahead_limit(vehicle: Vehicle) -> float:
    """Return the largest surge thrust ahead [N] that a law commands.

    Law `steered`, of craft without sway force, gives all the thrust ahead. All other laws limit the thrust on each axis
    to the same value in both directions (`Vehicle.thrust_limit`).
    """
    return float((vehicle.thrust_limit if vehicle["Fv_max"] > 0 else vehicle.thrust_range[1])[0])


def command_range(vehicle: Vehicle) -> NDArray[np.float64]:
    """Return the least and the largest thrust (2, 4) [N, N m] that a law commands; ahead it is `ahead_limit`."""
    most = np.array(vehicle.thrust_limit)
    least = -most
    most[0] = ahead_limit(vehicle)
    return np.array([least, most])


def beyond_law(vehicle: Vehicle, cruise: float) -> str:
    """Return why a law cannot hold a cruise speed [m/s] that the thrusters could hold; empty if it can.

    Laws limit the thrust on each axis to the same value in both directions (`Vehicle.thrust_limit`), except the law of
    craft without sway force.
    """
    needed, limit = float(trim_thrust(vehicle, np.array([cruise, 0.0, 0.0, 0.0]))[0]), ahead_limit(vehicle)
    if needed < limit or vehicle["Fu_max"] <= limit:
        return ""
    return f"needs {needed:.3g} N ahead; the law gives at most {limit:.3g} N, the smaller of ahead and astern"


def check_cruise(vehicle: Vehicle, cruise: float) -> None:
    """Raise InputError if the vehicle, or a law within its symmetric limits, cannot hold a cruise speed [m/s]."""
    try:
        _check_trim(vehicle, np.array([cruise, 0.0, 0.0, 0.0]))
    except InputError as error:
        held = _largest_held(vehicle, cruise)
        remedy = f"{vehicle.name} holds at most {held:g} m/s" if held > 0 else f"{vehicle.name} holds no slower speed"
        raise InputError(error.problem, key="cruise", value=cruise, remedy=remedy) from None
    if beyond := beyond_law(vehicle, cruise):
        raise InputError(beyond, key="cruise", value=cruise, remedy=WITHIN_LAW)


def _largest_held(vehicle: Vehicle, cruise: float) -> float:
    # largest speed [m/s] below a cruise speed that a law holds, rounded down to mm/s
    low, high = 0.0, cruise
    while high - low > 1e-4:
        speed = (low + high) / 2
        thrust = trim_thrust(vehicle, np.array([speed, 0.0, 0.0, 0.0]))
        held = can_hold(thrust, *vehicle.thrust_range) and not beyond_law(vehicle, speed)
        low, high = (speed, high) if held else (low, speed)
    return float(np.floor(1e3 * low) / 1e3)


WITHIN_LAW = "lower the cruise speed or raise Fu_reverse"
_NONE = 1e-9  # [N, N m] rounding of a thrust that is zero


def can_hold(thrust: NDArray[np.float64], least: NDArray[np.float64], most: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether a thrust (…, 4) lies strictly inside its limits on each axis that has thrust.

    On an axis without thrust, the needed thrust must be zero.
    """
    inside: NDArray[np.bool_] = np.all(
        (least < thrust) & (thrust < most) | (np.abs(thrust) < _NONE) & (least == most), axis=-1
    )
    return inside


def labelled(names: Sequence[str], *, units: bool = True) -> list[str]:
    """Return the signal names with their units appended, as in "u [m/s]"; dimensionless signals have no unit."""
    return [f"{name} [{SIGNAL_UNITS[name]}]" if units and name in SIGNAL_UNITS else name for name in names]


def plant_jacobians(
    parameters: NDArray[np.float64],
    nu: NDArray[np.float64],
    *,
    psi: float = 0.0,
    form: PlantForm = PAPER,
    current: Sequence[float] | NDArray[np.float64] = (0.0, 0.0),
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return ∂ẋ/∂x and ∂ẋ/∂τ of n plants, each linearised about its own trimmed motion.

    Args:
        parameters: (n, …), one plant per row, as `plant_parameters` returns it.
        nu: (n, 4) body velocity of each plant [m/s, rad/s].
        psi: heading [rad] of all plants.
        form: the optional terms that all plants have.
        current: horizontal velocity (2,) of the water in {E} [m/s]; the trim is exact for a motion without yaw rate.

    Returns:
        Three arrays. A (n, 12, 12): state matrices ∂ẋ/∂x, in the order of `STATE_NAMES`, and (n, 16, 16) with the
        further states `TILT_NAMES` for vehicles that roll and pitch; B (n, 12, 4) or (n, 16, 4): input matrices
        ∂ẋ/∂τ, with columns in the order of `THRUST_NAMES`; trim thrust (n, 4) [N, N m]. If the trim thrust of a plant
        exceeds a thrust limit, its matrix B describes no possible motion.
    """
    count, (along, aside), (c, s) = len(nu), current, (np.cos(psi), np.sin(psi))
    through = nu - np.array([c * along + s * aside, c * aside - s * along, 0.0, 0.0])  # velocity through the water
    tau = np.asarray(trim_function(form)(through.T, parameters.T)).T
    tilt = np.asarray(trim_tilt(form)(through.T, parameters.T)).T if form.tilts else np.zeros((count, 0))
    x = np.hstack([np.zeros((count, 3)), np.full((count, 1), psi), nu, tau, tilt])
    water = PLANT_DISTURBANCE.pack({"current": [*current, 0.0]})
    a, b = build_plant(form).jacobians(x.T, tau.T, np.tile(water, (count, 1)).T, parameters.T)
    # CasADi returns the matrices of many calls side by side
    return (
        np.asarray(a).reshape(x.shape[1], count, -1).swapaxes(0, 1),
        np.asarray(b).reshape(x.shape[1], count, -1).swapaxes(0, 1),
        tau,
    )


def plant_system(vehicle: Vehicle, *, current: ArrayLike = (0.0, 0.0, 0.0), units: bool = True) -> Any:
    """Return a `control.NonlinearIOSystem` from thrust command to the whole plant state, continuous in time.

    `control.input_output_response` interpolates inputs between the given times, but the simulation of this toolkit
    holds inputs constant. `control.input_output_response` may also skip a short input. Therefore give times on both
    sides of a step of an input, and limit the step size with `solve_ivp_kwargs={"max_step": ...}`. With "rtol" and
    "atol" of 1e-12, the computed motion agrees with the fixed-step simulation to 1e-8 in SI units. `control.linearize`
    about trimmed motion gives the system that `linearise` returns.

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
