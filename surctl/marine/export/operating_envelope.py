"""Ranges for the input check of the exported C, derived from the site, the vehicle and the sensors of a mission."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from surctl.export.envelope import Envelope, Rate
from surctl.ir import Layout
from surctl.marine.control import Law
from surctl.marine.export.gain_ranges import ORDER_REASON, RANGE_REASON, box_of, gain_orders, gain_ranges
from surctl.marine.simulation import Scenario
from surctl.marine.vehicle import Vehicle

__all__ = ["operating_envelope"]

Vector = NDArray[np.float64]

_SLACK = 1.0  # [m] distance outside the site up to which a position is accepted
_TURNS = 1000.0  # [rad] largest heading, which may include whole turns
_OBSTACLE = 2.0  # [m/s] largest speed of an obstacle
_SAFETY = 2.0  # factor on the speed that the thrust sustains
_WATER = 0.5  # [m/s], [rad/s] speed that current and waves may add
_NOISE = (0.1, 0.1)  # [m], [rad] by which two measurements of one pose may differ
_SURPRISE = 0.3  # [m/s], [rad/s] by which a measured velocity may jump at once


def operating_envelope(
    law: Law, mission: Scenario, vehicle: Vehicle, gains: Layout, *, tuned: Vector | None = None
) -> Envelope:
    """Return the ranges of states, inputs and gains, and the limits of the thrust.

    A number without a known bound may be any finite number.

    Args:
        law: the law to export.
        mission: scenario; its site bounds positions, its path the progress along it, and its sensors the measured
            ranges.
        vehicle: vehicle model; its thrust and drag bound the speed.
        gains: layout of the gains that remain inputs of the exported law; `gain_ranges` gives their ranges.
        tuned: values (np,) that the ranges of the gains contain in any case.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.export import operating_envelope
        >>> from surctl.marine.simulation import law_numbers, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> law, p = build_law("closed_form"), law_numbers(mission, gains, vehicle)
        >>> within = operating_envelope(law, mission, vehicle, law.gains)
        >>> within.inputs[law.inputs.slice("eta")].round(2).tolist()
        [[-1.0, 4.0], [-1.0, 3.0], [-2.0, 1.0], [-1000.0, 1000.0]]
    """
    length, width, deep = mission.site
    fast = _SAFETY * _steady(vehicle) + _WATER
    place = [(-_SLACK, length + _SLACK), (-_SLACK, width + _SLACK), (-deep - _SLACK, _SLACK)]
    heading, size = (-_TURNS, _TURNS), float(np.hypot(length, width))
    far = (-size - _SLACK, 2 * size + _SLACK)
    contact = [far, far, (0.0, size), *([(-_OBSTACLE, _OBSTACLE)] * 2), (0.0, 1.0)]
    echo = mission.sensors.equipment.array.maximum
    inputs: Mapping[str, list[tuple[float, float]]] = {
        "eta": [*place, heading],
        "nu": [(-v, v) for v in fast],
        "contacts": contact,
        "contacts_fresh": [(0.0, 1.0)],
        "fix": place,
        "fix_fresh": [(0.0, 1.0)],
        "yaw": [heading],
        "yaw_rate": [(-fast[3], fast[3])],
        "samples": [(-_SLACK, echo + _SLACK)],
        "fresh": [(0.0, 1.0)],
        "working": [(0.0, 1.0)],
    }
    along = mission.path.length
    most = _integral(vehicle, fast)
    orders = gain_orders(gains, tuned)
    state: Mapping[str, list[tuple[float, float]]] = {
        "progress": [(0.0, along + 0.01)],
        "integral": [(-v, v) for v in most],
        "side": [(-1.0, 1.0)],
    }
    return Envelope(
        box_of(law.state, state),
        box_of(law.inputs, inputs),
        gain_ranges(law, mission, vehicle, gains, fast=fast, tuned=tuned),
        _rates(law.inputs, fast),
        {
            "ranges of position": f"site {mission.name}, {length:g} x {width:g} x {deep:g} m, and {_SLACK:g} m around",
            "ranges of velocity": f"{_SAFETY:g} times the largest speed of {vehicle.name}, and {_WATER:g} for currents",
            "jumps": "largest velocities, and the noise of two measurements",
            **({"ranges of gains": RANGE_REASON, "limits of thrust": f"those of {vehicle.name}"} if gains.size else {}),
            **({"order of gains": ORDER_REASON} if orders else {}),
        },
        _limits(vehicle) if gains.size else None,
        orders,
    )


def _limits(vehicle: Vehicle) -> Vector:
    # (4, 2) [N, N m]: least and largest thrust of the vehicle; thrusters are allocated within ± what they give
    if vehicle.actuators is not None:
        return np.column_stack([-vehicle.actuators.most, vehicle.actuators.most])
    return np.asarray(vehicle.thrust_range.T, dtype=float)


def _steady(vehicle: Vehicle) -> Vector:
    # (4,) [m/s, rad/s]: drag equals the largest thrust
    linear, quadratic, most = vehicle.linear_drag, vehicle.quadratic_drag, _thrust(vehicle)
    root = linear + np.sqrt(linear**2 + 4 * quadratic * most)
    steady = np.divide(2 * most, root, out=np.zeros(4), where=root > 0)
    if most[1] == 0 or vehicle.form.terms:
        # coupled motion: a craft drifts in a turn by no more than its speed ahead, and turns within twice its length
        steady[1] = max(steady[0], steady[1])
        steady[3] = max(steady[0] / (2 * vehicle["radius"]), steady[3])
    return np.asarray(steady, dtype=float)


def _thrust(vehicle: Vehicle) -> Vector:
    # (4,) [N, N m]: in the direction with more thrust
    return np.asarray(np.abs(vehicle.thrust_range).max(axis=0), dtype=float)


def _integral(vehicle: Vehicle, fast: Vector) -> Vector:
    # (4,): the thrust saturates at the bound, and integration stops
    drag = vehicle.linear_drag * fast + vehicle.quadratic_drag * fast**2
    return np.asarray((_thrust(vehicle) + drag) / vehicle.mass + 100.0 * fast, dtype=float)


def _rates(inputs: Layout, fast: Vector) -> tuple[Rate, ...]:
    rates: list[Rate] = []
    if "eta" in inputs:
        first = inputs.slice("eta").start
        ground = float(max(fast[:2]))
        for k, speed in enumerate((ground, ground, float(fast[2]), float(fast[3]))):
            rates.append(Rate(first + k, speed, _NOISE[k == 3], turn=k == 3))
    if "nu" in inputs:
        first = inputs.slice("nu").start
        rates += [Rate(first + k, _SAFETY, _SURPRISE) for k in range(4)]
    if "yaw" in inputs:
        rates.append(Rate(inputs.slice("yaw").start, float(fast[3]), _NOISE[1], turn=True))
    return tuple(rates)
