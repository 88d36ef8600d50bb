"""Ranges of the gains that the guard of the exported C accepts: no gain set within them is without meaning."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from surctl.ir import Layout
from surctl.marine.control import GAINS, GainSpec, Law, law_source
from surctl.marine.control.ports import OF_VEHICLE
from surctl.marine.guidance.braking import brakes_of
from surctl.marine.simulation import Scenario
from surctl.marine.vehicle import Vehicle

__all__ = ["ORDER_REASON", "RANGE_REASON", "box_of", "gain_orders", "gain_ranges"]

Vector = NDArray[np.float64]
Box = Mapping[str, list[tuple[float, float]]]

RANGE_REASON = "sign and unit; feedback gains up to 1/period; 0.5 to 2 times the vehicle's numbers; places in the site"

ORDER_REASON = "each wall's minimum is at most its maximum, and `cruise` at most `cap`"

_LEAST = 1e-3  # least value of a gain that must be greater than 0
_WIDE = 10.0  # a gain without another bound may be this many times its default
_HOURS = 86400.0  # [s] longest patience
_REACTION = 10.0  # [s] longest reaction time


def gain_ranges(
    law: Law, mission: Scenario, vehicle: Vehicle, gains: Layout, *, fast: Vector, tuned: Vector | None = None
) -> Vector:
    """Return the least and the largest accepted value (np, 2) of each gain; any finite number where nothing is known.

    A feedback gain is at most one per control period, because a larger gain overshoots in a single step. A length is at
    most the diagonal of the site, and a place lies in the site. The parameters of the vehicle model are between half of
    and twice those of the vehicle; the thrust limit is at most the vehicle's, and the hull at least.

    Args:
        law: the law to export.
        mission: scenario; its site bounds lengths and places.
        vehicle: vehicle model.
        gains: layout of the gains.
        fast: largest speeds (4,) [m/s, rad/s] that the guard accepts.
        tuned: values (np,) that the ranges contain in any case.
    """
    bounds = {**_control(law, mission, fast), **_of_vehicle(law, mission, vehicle)}
    bounds |= {**_model(vehicle, fast), **_mission(mission, fast)}
    box = box_of(gains, bounds)
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


def box_of(layout: Layout, known: Box) -> Vector:
    """Return ranges (n, 2) of all numbers of a layout; a port that is not in `known` has ±inf."""
    rows: list[Vector] = []
    for port in layout:
        bounds = np.array(known.get(port.name, [(-np.inf, np.inf)]), dtype=float)
        rows.append(np.tile(bounds, (port.size // len(bounds), 1)))
    return np.vstack([np.zeros((0, 2)), *rows])


def _control(law: Law, mission: Scenario, fast: Vector) -> Box:
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


def _of_vehicle(law: Law, mission: Scenario, vehicle: Vehicle) -> Box:
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


def _model(vehicle: Vehicle, fast: Vector) -> Box:
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


def _mission(mission: Scenario, fast: Vector) -> Box:
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
