"""The linearised loops as python-control systems, for functions such as `control.bode_plot` or `control.root_locus`.

The systems have the matrices that `surctl verify` uses, so python-control and `surctl verify` give equal results.
Signal names include units. Root loci and margins of one loop need no further package. `control.disk_margins` of several
loops at once needs slycot (GPL), which is not installed with surctl; use `disk_margin` of this package instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.linearise import STATE_NAMES, THRUST_NAMES, labelled, state_names
from surctl.marine.verification.cascade import LOOP_NAMES, Cascade, build_cascade
from surctl.marine.verification.linear.sampled import check_delay, open_transition
from surctl.marine.verification.linear.side import open_loop
from surctl.verification.loops import state_blocks

__all__ = ["closed_system", "loop_system", "open_system", "sampled_loop_system"]

_AXES = 4
_AT = (*THRUST_NAMES, *STATE_NAMES[:_AXES])
"""The signal at which each loop of `LOOP_NAMES` is opened."""


def loop_system(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    loop: str,
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    delay: float | None = None,
) -> Any:
    """Return the open-loop transfer function L(s) of one loop, with all other loops closed, as a `control.StateSpace`.

    The feedback sign is negative; `loop_margins` computes the margins of this L. L works with `control.margin(L)`,
    `control.disk_margins(L, omega)` and `control.root_locus(L)`. Because of the Padé approximation of the delay, L is
    not valid above the Nyquist frequency π/dt; `surctl verify` does not use L above this frequency.

    Args:
        vehicle: the plant.
        gains: the gains by name, as in `build_cascade`.
        loop: one of `LOOP_NAMES`. The loops surge, sway, heave and yaw are opened at the thrust command; along_track,
            cross_track, depth and heading at the measured x_e, y_e, z_e [m], ψ [rad].
        cruise: cruise speed U [m/s].
        dt: control period [s].
        model: the controller's model of the vehicle; default the vehicle itself.
        delay: loop delay [s], by a third-order Padé approximation; default 1.5 dt, 0 for none.

    Returns:
        A system with one input, the signal injected where the loop is opened, and one output, the signal that returns
            there; both have the same unit. The system contains only the states coupled to the loop: surge and heave are
            decoupled from sway and yaw.

    Raises:
        InputError: the name of the loop is unknown, or `build_cascade` rejects its arguments.
    """
    at = _place(loop)
    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=dt, model=model, delay=delay)
    A, b, c = cascade.at_thrust(at) if at < _AXES else cascade.at_output(at - _AXES)
    return _only_loop(A, b, c, _states(vehicle, cascade), at)


def open_system(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    place: str,
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    delay: float | None = None,
) -> Any:
    """Return the open-loop transfer matrix L(s) of all loops opened at once, as a `control.StateSpace`.

    The feedback sign is negative; `disk_margin` computes the disk margin of this L.

    Args:
        vehicle, gains, cruise, dt, model, delay: see the arguments of `loop_system`.
        place: where the loops are opened, one of `DISK_PLACES`: thrust (4 channels), measurement (4 channels), both (8
            channels).

    Raises:
        InputError: `place` is not one of `DISK_PLACES`, or `build_cascade` rejects its arguments.
    """
    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=dt, model=model, delay=delay)
    loop = open_loop(cascade, place)
    places = {"thrust": range(4), "measurement": range(4, 8), "both": range(8)}[place]
    return _system(loop.A, loop.B, loop.C, loop.D, _states(vehicle, cascade), _broken(places), name=place)


def closed_system(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    delay: float | None = None,
) -> Any:
    """Return the closed loop about straight cruise, as a `control.StateSpace`.

    The inputs are a reference pose x_ref, y_ref, z_ref [m], psi_ref [rad], which is subtracted from the measured pose,
    and a disturbance Fu_dist, Fv_dist, Fw_dist [N], Fr_dist [N m], which is added to the thrust command. The outputs
    are the deviations from the cruise: x, y, z [m], psi [rad], u, v, w [m/s], r [rad/s]. The arguments are those of
    `loop_system`.

    Raises:
        InputError: `build_cascade` rejects its arguments.
    """
    import control  # slow to import, so only when it is needed

    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=dt, model=model, delay=delay)
    enter = np.hstack([cascade.B @ cascade.K[:, :_AXES], cascade.B[:, :_AXES]])
    pose = [f"{name}_ref [{unit}]" for name, unit in zip(STATE_NAMES[:4], ("m", "m", "m", "rad"), strict=True)]
    disturbances = [f"{name}_dist [{unit}]" for name, unit in zip(STATE_NAMES[8:], ("N", "N", "N", "N m"), strict=True)]
    return control.ss(
        cascade.closed,
        enter,
        cascade.C[:8],
        np.zeros((8, 8)),
        states=_states(vehicle, cascade),
        inputs=pose + disturbances,
        outputs=labelled(STATE_NAMES[:8]),
        name=f"{vehicle.name} closed",
    )


def sampled_loop_system(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    loop: str,
    *,
    cruise: float,
    period: float,
    delay: int = 0,
    model: Vehicle | None = None,
) -> Any:
    """Return one exactly sampled open loop L(z) as a discrete-time `control.StateSpace`; see `sampled_poles`.

    The thrust is constant over each period and acts `delay` whole periods after the measurement. All other loops are
    closed.

    Args:
        vehicle, gains, loop, cruise, model: see the arguments of `loop_system`.
        period: control period T [s], which becomes the system's `dt`.
        delay: delay in whole periods, at least 0.

    Raises:
        InputError: the name of the loop is unknown, the delay is not a whole number, or `build_cascade` rejects its
            arguments.
    """
    at = _place(loop)
    check_delay(delay)
    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=period, model=model, delay=0.0)
    rest, enter, law = open_transition(cascade, period, delay)
    states = _states(vehicle, cascade) + [f"{n}_{k}" for k in range(1, delay + 1) for n in labelled(THRUST_NAMES)]
    if at < _AXES:
        b, c = enter[:, [at]], -law[[at]]
        A = rest + enter @ law + b @ c
    else:
        c = np.zeros((1, len(rest)))
        c[:, : cascade.C.shape[1]] = cascade.C[at - _AXES]
        opened = cascade.K.copy()
        opened[:, at - _AXES] = 0.0
        rest_opened, _, law_opened = open_transition(replace(cascade, K=opened), period, delay)
        A = rest_opened + enter @ law_opened
        b = (A - rest - enter @ law) @ c.T  # the measurement is one of the states
    return _only_loop(A, b, c, states, at, dt=period)


def _place(loop: str) -> int:
    if loop not in LOOP_NAMES:
        raise InputError("no such loop", key="loop", value=loop, remedy=nearest(loop, LOOP_NAMES))
    return LOOP_NAMES.index(loop)


def _broken(places: Sequence[int]) -> list[str]:
    return labelled([_AT[k] for k in places])


def _states(vehicle: Vehicle, cascade: Cascade) -> list[str]:
    plant = labelled(state_names(vehicle))
    inner = [f"xi_{name}" for name in LOOP_NAMES[: cascade.K.shape[0] - _AXES]]
    lags = cascade.A.shape[0] - len(plant) - len(inner)
    late = [f"{name}_delay_{k}" for name in THRUST_NAMES for k in range(1, lags // _AXES + 1)]
    return plant + late + inner


def _only_loop(
    A: NDArray[np.float64],
    b: NDArray[np.float64],
    c: NDArray[np.float64],
    states: list[str],
    at: int,
    *,
    dt: float = 0.0,
) -> Any:
    # states of decoupled axes would cancel and reduce accuracy
    block = next(k for k in state_blocks((A - b @ c)[None]) if np.any(b[k] != 0))
    A, b, c = A[np.ix_(block, block)], b[block], c[:, block]
    return _system(A, b, c, np.zeros((1, 1)), [states[k] for k in block], _broken([at]), name=LOOP_NAMES[at], dt=dt)


def _system(
    A: NDArray[np.float64],
    B: NDArray[np.float64],
    C: NDArray[np.float64],
    D: NDArray[np.float64],
    states: list[str],
    broken: list[str],
    *,
    name: str,
    dt: float = 0.0,
) -> Any:
    import control  # slow to import, so only when it is needed

    back = [f"{signal} back" for signal in broken]
    return control.ss(A, B, C, D, dt, states=states, inputs=broken, outputs=back, name=f"loop {name}")
