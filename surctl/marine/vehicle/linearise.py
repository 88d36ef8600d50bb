"""A vehicle as the plant of a system; its linearisation; whether its thrust, or a law, can hold a cruise speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.marine.vehicle.dynamics import (
    PAPER,
    PLANT_DISTURBANCE,
    build_plant,
    plant_layout,
    plant_parameters,
    plant_state,
    trim_function,
    trim_thrust,
)
from surctl.marine.vehicle.parameters import Vehicle
from surctl.marine.vehicle.specs import PlantForm
from surctl.system import Parts, Plant

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


def linearise(vehicle: Vehicle, nu: NDArray[np.float64], psi: float = 0.0) -> Any:
    """Return a `control.StateSpace` from thrust command to the whole plant state, linearised about trimmed motion.

    Args:
        vehicle: the vehicle; its trim thrust must lie strictly inside the thrust limits.
        nu: body velocity (4,) [m/s, rad/s] of the operating point in still water.
        psi: heading [rad].

    Returns:
        The StateSpace system with inputs `THRUST_NAMES`, and with states and outputs `STATE_NAMES`, and `TILT_NAMES` if
        the vehicle rolls and pitches, in the units `SIGNAL_UNITS`. If `thrust_lag` is 0, there are no thrust states.

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
    names = [(*STATE_NAMES, *TILT_NAMES)[k] for k in keep]
    return control.ss(
        a[np.ix_(keep, keep)],
        b[keep],
        np.eye(len(keep)),
        np.zeros((len(keep), 4)),
        states=names,
        outputs=names,
        inputs=list(THRUST_NAMES),
        name=vehicle.name,
    )


def dynamic_states(form: PlantForm, *, lagged: bool) -> list[int]:
    """Return the places of a plant's states that have dynamics: without thrust lag, the thrust has none."""
    return [k for k in range(plant_state(form).size) if lagged or not 8 <= k < len(STATE_NAMES)]


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
    tau, tilt = (np.asarray(part).T for part in trim_function(form)(through.T, parameters.T))
    x = np.hstack([np.zeros((count, 3)), np.full((count, 1), psi), nu, tau, *([tilt] if form.tilts else [])])
    water = PLANT_DISTURBANCE.pack({"current": [*current, 0.0]})
    a, b = build_plant(form).jacobians(x.T, tau.T, np.tile(water, (count, 1)).T, parameters.T)
    # CasADi returns the matrices of many calls side by side
    return (
        np.asarray(a).reshape(x.shape[1], count, -1).swapaxes(0, 1),
        np.asarray(b).reshape(x.shape[1], count, -1).swapaxes(0, 1),
        tau,
    )


def vehicle_plant(vehicle: Vehicle, pose: ArrayLike = (0.0, 0.0, 0.0, 0.0)) -> Plant:
    """Return a vehicle as the plant of a system, for a controller of your own and for `to_control`.

    Args:
        vehicle: the vehicle, with its thrust limits and thrust lag; its numbers are the defaults of the parameters.
        pose: x, y, z [m] and heading [rad] at the start.

    Returns:
        The plant with the inputs `delivered`, the thrust command, and the current, wave and drift of the water.

    Example:
        >>> import control
        >>> import numpy as np
        >>> from surctl.marine.vehicle import load_vehicle, vehicle_plant
        >>> from surctl.system import to_control
        >>> plant, t = to_control(vehicle_plant(load_vehicle("sur400"))), np.linspace(0, 60, 301)
        >>> ahead = np.outer([5.0, *np.zeros(plant.ninputs - 1)], np.ones(301))  # N
        >>> states = control.input_output_response(plant, t, ahead).states
        >>> round(float(states[4, -1]), 2)  # m/s after a minute
        0.38
    """
    own, numbers, ode = plant_state(vehicle.form), plant_layout(vehicle.form), build_plant(vehicle.form).ode
    # the command of a law has the name `tau`, too
    renamed = (replace(port, name="thrust") if port.name == "tau" else port for port in own)
    state = valued(Layout(tuple(renamed)), {"eta": pose})

    def rate(x: Parts, f: Parts, d: Parts, p: Parts) -> Any:
        return ode(state.join(x), f["delivered"], PLANT_DISTURBANCE.join(f), numbers.join(p))

    parameters = valued(numbers, numbers.unpack(plant_parameters(vehicle)))
    return Plant("vehicle", state, Layout((*DELIVERED, *PLANT_DISTURBANCE)), rate, parameters)


DELIVERED = Layout((Port("delivered", (4,), "N, N m", "thrust command with the errors of the thrusters"),))


def valued(layout: Layout, values: Mapping[str, Any]) -> Layout:
    """Return a layout with these default values by name; a port without one keeps its own."""

    def one(port: Port) -> Port:
        default: Any = np.ravel(values[port.name]) if port.name in values else port.default
        return replace(port, default=default)

    return Layout(tuple(map(one, layout)))
