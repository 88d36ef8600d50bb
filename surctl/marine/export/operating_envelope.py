"""Ranges that the guard of exported C checks (inputs, states, gains, thrust), from site, vehicle and sensors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from surctl.export.envelope import Envelope, Rate
from surctl.ir import Layout
from surctl.marine.control import GAINS, GainSpec, Law, law_source
from surctl.marine.control.ports import OF_VEHICLE
from surctl.marine.guidance.braking import brakes_of
from surctl.marine.simulation import Scenario
from surctl.marine.vehicle import Vehicle

Vector = NDArray[np.float64]
_Box = Mapping[str, list[tuple[float, float]]]

_RANGE_REASON = "sign and unit; feedback gains up to 1/period; 0.5 to 2 times the vehicle's numbers; places in the site"

_ORDER_REASON = "each wall's minimum is at most its maximum, and `cruise` at most `cap`"

_LEAST = 1e-3  # least value of a gain that must be greater than 0
_WIDE = 10.0  # a gain without another bound may be this many times its default
_HOURS = 86400.0  # [s] longest patience
_REACTION = 10.0  # [s] longest reaction time


def _gain_ranges(
    law: Law, mission: Scenario, vehicle: Vehicle, gains: Layout, *, fast: Vector, tuned: Vector | None = None
) -> Vector:
    """Return the least and the largest accepted value (np, 2) of each gain; any finite number where nothing is known.

    A feedback gain is at most one per control period, because a larger gain overshoots in a single step. A length is at
    most the diagonal of the site, and a place lies in the site. The parameters of the vehicle model are between half of
    and twice those of the vehicle; the thrust limit is at most the vehicle's, and the hull at least. The ranges contain
    the values `tuned` (np,) in any case; `fast` (4,) are the largest speeds [m/s, rad/s] that the guard accepts.
    """
    bounds = {**_control(law, mission, fast), **_of_vehicle(law, mission, vehicle)}
    bounds |= {**_model(vehicle, fast), **_mission(mission, fast)}
    box = _box_of(gains, bounds)
    if tuned is not None and gains.size:
        box = np.column_stack([np.minimum(box[:, 0], tuned), np.maximum(box[:, 1], tuned)])
    return box


def gain_orders(gains: Layout, tuned: Vector | None = None) -> tuple[tuple[int, int], ...]:
    """Return pairs of indices of gains of which the first must not be larger; only pairs that `tuned` (np,) obeys."""
    pairs = []
    if "walls" in gains:
        first = gains.slice("walls").start
        pairs += [(first, first + 1), (first + 2, first + 3)]
    if "cruise" in gains and "cap" in gains:
        pairs.append((gains.slice("cruise").start, gains.slice("cap").start))
    return tuple(pair for pair in pairs if tuned is None or tuned[pair[0]] <= tuned[pair[1]])


def _box_of(layout: Layout, known: _Box) -> Vector:
    """Return ranges (n, 2) of all numbers of a layout; a port that is not in `known` has ±inf."""
    rows: list[Vector] = []
    for port in layout:
        bounds = np.array(known.get(port.name, [(-np.inf, np.inf)]), dtype=float)
        rows.append(np.tile(bounds, (port.size // len(bounds), 1)))
    return np.vstack([np.zeros((0, 2)), *rows])


def _control(law: Law, mission: Scenario, fast: Vector) -> _Box:
    size = float(np.hypot(*mission.site[:2]))
    most = {"1/s": 1.0 / law.dt, "1/s^2": 1.0 / law.dt**2, "m": size, "m/s": float(fast[0]), "rad/s": float(fast[3])}
    named = {"patience": _HOURS, "reaction": _REACTION}
    own = dict(law_source(law.ref).gains)
    ranges = {}
    for name, spec in {**GAINS, **own}.items():
        high = named.get(name, most.get(spec.unit, np.inf)) if name in GAINS else _widest(spec)
        high = min(high, spec.below)
        if name in GAINS and not np.isfinite(high):
            high = _WIDE * max(1.0, spec.default or 0.0)
        ranges[name] = [(0.0 if spec.zero_allowed else min(_LEAST, spec.default or _LEAST), high)]
    return ranges


def _of_vehicle(law: Law, mission: Scenario, vehicle: Vehicle) -> _Box:
    # numbers of the law's own that follow from the vehicle: a thrust limit at most the vehicle's, a share within 0 and
    # 1, and the others up to twice the vehicle's number, with its sign
    ranges: dict[str, list[tuple[float, float]]] = {}
    for name, spec in law_source(law.ref).gains.items():
        if spec.from_vehicle:
            value = OF_VEHICLE[name](vehicle, mission.cruise)
            low, high = {"fin_share": (0.0, 1.0), "ahead_limit": (0.0, value)}.get(name, (0.0, 2.0 * value))
            ranges[name] = [(min(low, high), max(low, high))]
    return ranges


def _widest(spec: GainSpec) -> float:
    # a gain of the user's own law: ten times its default or its largest value in sweeps
    return _WIDE * max(spec.default or 0.0, *(spec.range or (0.0,)), 1e-9)


def _model(vehicle: Vehicle, fast: Vector) -> _Box:
    half, turn = (0.5, 2.0), float(fast[3])
    drags = {name: getattr(vehicle, name) for name in ("linear_drag", "quadratic_drag")}
    brakes = brakes_of(vehicle)
    stopping = (*brakes.masses, brakes.most, brakes.lag, brakes.linear[1], brakes.quadratic[1])
    return {
        "mass": _around(vehicle.mass, half),
        **{name: _drag(drag) for name, drag in drags.items()},
        "thrust_limit": _around(vehicle.thrust_limit, (0.1, 1.0)),
        "hull": _around(np.array([vehicle["radius"]]), (1.0, 2.0)),
        "stopping": _around(np.array(stopping), half),
        "spin_limit": [(-turn, turn)],
    }


def _drag(values: Vector) -> list[tuple[float, float]]:
    # up to twice the largest of the three forces, also on an axis without drag
    most = max(float(values[:3].max()), 0.0)
    return [(min(0.0, 2.0 * float(v)), 2.0 * max(float(v), most)) for v in values]


def _around(values: Vector, factors: tuple[float, float]) -> list[tuple[float, float]]:
    low, high = factors
    return [(low * float(v), high * float(v)) for v in values]


def _mission(mission: Scenario, fast: Vector) -> _Box:
    length, width, deep = (float(v) for v in mission.site)
    size, ground = float(np.hypot(length, width)), float(max(fast[:2]))
    return {
        "waypoints": [(0.0, length), (0.0, width)],
        "depth": [(-deep, 0.0)],
        "cruise": [(0.0, ground)],
        "cap": [(_LEAST, ground)],
        "walls": [(0.0, length), (0.0, length), (0.0, width), (0.0, width)],
        "launch": [(0.0, size)],
        "visit": [(0.0, size)],
    }


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
        mission: scenario; its site bounds positions, its path the progress along it, and its sensors the measured
            ranges.
        vehicle: vehicle model; its thrust and drag bound the speed.
        gains: layout of the gains that remain inputs of the exported law; `_gain_ranges` gives their ranges.
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
    # of the integral, (4,): the thrust saturates at the bound, and integration stops
    drag = vehicle.linear_drag * fast + vehicle.quadratic_drag * fast**2
    most = (_thrust(vehicle) + drag) / vehicle.mass + 100.0 * fast
    orders = gain_orders(gains, tuned)
    state: Mapping[str, list[tuple[float, float]]] = {
        "progress": [(0.0, along + 0.01)],
        "integral": [(-v, v) for v in most],
        "side": [(-1.0, 1.0)],
    }
    return Envelope(
        _box_of(law.state, state),
        _box_of(law.inputs, inputs),
        _gain_ranges(law, mission, vehicle, gains, fast=fast, tuned=tuned),
        _rates(law.inputs, fast),
        {
            "ranges of position": f"site {mission.name}, {length:g} x {width:g} x {deep:g} m, and {_SLACK:g} m around",
            "ranges of velocity": f"{_SAFETY:g} times the largest speed of {vehicle.name}, and {_WATER:g} for currents",
            "jumps": "largest velocities, and the noise of two measurements",
            **(
                {"ranges of gains": _RANGE_REASON, "limits of thrust": f"those of {vehicle.name}"} if gains.size else {}
            ),
            **({"order of gains": _ORDER_REASON} if orders else {}),
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
