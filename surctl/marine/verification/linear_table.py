"""Linear metrics of many operating points at once (poles, eight loops, steps); the root locus over a parameter.

An operating point consists of gains, a vehicle and a cruise speed. The metrics are those of any linear loop
(`LoopMargins`, and the goals `Settling` and `Overshoot`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest
from surctl.marine.simulation.metrics import MetricSpec
from surctl.marine.vehicle import PARAMETERS, TERMS, Vehicle
from surctl.marine.verification.corners import corners
from surctl.marine.verification.cruise_loop import (
    LINEAR_GAINS,
    POSE,
    THRUSTS,
    TRACKING_LAW,
    CruisePoint,
    cruise_groups,
    each_loop,
)
from surctl.system import LinearLoop
from surctl.tuning.loop_goal_types import Overshoot, Settling
from surctl.tuning.loop_goals import LoopGoal
from surctl.verification.sampled_margins import SampledLoop, corners_of, margins_of

LOOP_NAMES = {name: name for name in THRUSTS} | dict(
    zip(POSE, ("along_track", "cross_track", "depth", "heading"), strict=True)
)
"""Name of each loop in columns, by the signal at which it is opened."""

_CHUNK = 64  # points computed together, so that their frequency responses fit in the cache

_MOST_MARGINS = 10_000
_margins: dict[bytes, tuple[float, float]] = {}  # by digest: each round of a tuning judges gain sets again

_OF_PLANT = (
    "m11", "m22", "m33", "m44", "Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr", "Fu_max", "thrust_lag", *TERMS,
)  # fmt: skip

LINEAR_PARAMETERS: tuple[str, ...] = (
    *LINEAR_GAINS, "k_i", "scenario.cruise", *(f"{kind}.{name}" for kind in ("vehicle", "plant") for name in _OF_PLANT)
)  # fmt: skip
"""The parameters on which the linear metrics depend; no other parameter changes them."""

_MARGINS = {
    "gain_margin": MetricSpec("1", "least factor > 1 on the loop gain that destabilises", "high"),
    "phase_margin_deg": MetricSpec("deg", "least extra phase lag that destabilises", "high"),
    "delay_margin_s": MetricSpec("s", "least extra delay that destabilises", "high"),
    "disk_margin": MetricSpec("1", "disk margin of one loop alone, 0 to 2", "high"),
    "sensitivity_peak": MetricSpec("1", "largest |S| over frequency", "low"),
    "rejection_rad_per_s": MetricSpec("rad/s", "frequency up to which |S| is at most -3 dB", "high"),
    "crossover_rad_per_s": MetricSpec("rad/s", "highest frequency with |L| = 1", None),
}
_WORST = ("disk_margin", "delay_margin_s")  # at the worst corner of the ranges
_OVER = {name: name for name in ("gain_margin", "phase_margin_deg", "sensitivity_peak")}
_OVER["single_loop_disk_margin"] = "disk_margin"
"""The margin of which each column has the worst value over the loops."""
_STEPS = ("x", "y", "psi")  # measured outputs with columns about a step of their setpoint

LINEAR_METRICS: Mapping[str, MetricSpec] = {
    "slowest_pole_per_s": MetricSpec("1/s", "largest real part of a closed-loop pole", "low"),
    "least_damping": MetricSpec("1", "least damping ratio of the closed-loop poles; 1 if all poles are real", "high"),
    "disk_margin": MetricSpec("1", "all loops at once, at commands or measurements, worst corner, 0 to 2", "high"),
    "delay_margin_s": MetricSpec("s", "least extra delay of one loop alone, worst corner of the ranges", "high"),
    **{
        name: replace(_MARGINS[of], meaning=f"{_MARGINS[of].meaning}, worst over all loops, nominal vehicle")
        for name, of in _OVER.items()
    },
    **{
        f"{name}.{loop}": replace(m, meaning=f"{m.meaning}, loop {loop}, nominal vehicle")
        for loop in LOOP_NAMES.values()
        for name, m in _MARGINS.items()
    },
    **{
        f"{name}.{LOOP_NAMES[s]}": MetricSpec(unit, f"{what} of a step of the setpoint of {s}", "low")
        for name, unit, what in (
            ("settling_time_s", "s", "2 % settling time"),
            ("overshoot", "1", "overshoot, as a share,"),
        )
        for s in _STEPS
    },
}
"""The metrics that `linear_table` computes, by column name."""


def linear_table(
    vehicle: Vehicle,
    values: Mapping[str, ArrayLike],
    *,
    base: Mapping[str, float],
    cruise: ArrayLike,
    dt: float,
    model: Vehicle | None = None,
    columns: Collection[str] = tuple(LINEAR_METRICS),
    workers: int = 1,
    law: str = TRACKING_LAW,
    uncertainty: float | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Compute the linear metrics of n operating points; return one array (n,) for every requested metric.

    The columns `disk_margin`, as in `law_corners`, and `delay_margin_s` are those of the worst
    corner of the ranges; parameters in `values` are exact. All other metrics are those of the plant.

    At an unstable point the margins have the values that `LoopMargins` states for an unstable loop; settling time and
    overshoot are infinite. If the vehicle's thrust cannot hold the cruise speed, the point has no linear model, and
    every column is NaN.

    Args:
        vehicle: the plant.
        values: mapping from parameter names (`LINEAR_PARAMETERS`) to values, scalar or (n,); other names are ignored.
            `vehicle.*` changes the plant and the controller's model, `plant.*` the plant alone; `plant.*` takes
            precedence.
        base: gains that apply if `values` does not contain them.
        cruise: cruise speed U [m/s], (n,) or scalar; ignored if `values` has `scenario.cruise`.
        dt: control period [s].
        model: the controller's model of the vehicle; default the vehicle itself.
        columns: names of the metrics to compute, keys of `LINEAR_METRICS`. Those at the worst corner take most of the
            computing time.
        workers: number of threads; the results do not depend on this number.
        law: a law for which `has_cruise_loop` holds.
        uncertainty: relative uncertainty in place of the ranges, see `corners`.

    Raises:
        InputError: a column is unknown, a gain is missing or out of its bounds, a vehicle parameter has the wrong
            sign, or the shapes disagree.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import linear_table
        >>> gains = load_gains("default").values
        >>> table = linear_table(load_vehicle("sur400"), {"k_v": [1.0, 2.0, 4.0]}, base=gains, cruise=0.15, dt=0.05)
        >>> table["disk_margin"].round(2).tolist(), table["delay_margin_s"].round(2).tolist()
        ([0.76, 0.74, 0.46], [0.49, 0.41, 0.16])
    """
    for name in columns:
        if name not in LINEAR_METRICS:
            raise InputError("no such column", key="columns", value=name, remedy=nearest(name, LINEAR_METRICS))
    points, stated = _read_points(vehicle, values, base=base, cruise=cruise, model=model)
    table = {name: np.full(len(points), np.nan) for name in columns}

    def fill(chunk: tuple[NDArray[np.intp], LinearLoop]) -> None:
        at, loops = chunk
        figures = _figures(loops, columns=columns)
        for name in columns:
            if name in figures:
                table[name][at] = figures[name]

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(fill, cruise_groups(points, dt=dt, law=law, most=_CHUNK)))
        if worst := [name for name in _WORST if name in columns]:
            tried = corners(vehicle, uncertainty, known={name.partition(".")[2] for name in values}).vehicles

            def least(k: int) -> tuple[float, float]:
                corner = [points[k]._replace(plant=one.with_values(stated[k])) for one in tried]
                return _worst_margins(each_loop(corner, dt=dt, law=law))

            margins = np.reshape(list(pool.map(least, range(len(points)))), (-1, len(_WORST)))
            for name in worst:
                table[name] = margins[:, _WORST.index(name)]
    return table


def _worst_margins(tried: Sequence[LinearLoop | None]) -> tuple[float, float]:
    # disk margin and delay margin over the corners that can hold the speed; NaN if the first, nominal one cannot
    nominal, *others = tried
    if nominal is None:
        return float("nan"), float("nan")
    matrices = (m.tobytes() for loop in tried if loop is not None for m in (*loop.plant, *loop.law))
    key = hashlib.sha256(b"".join((np.float64(nominal.dt).tobytes(), *matrices))).digest()
    if key not in _margins:
        if len(_margins) >= _MOST_MARGINS:
            _margins.clear()
        least = corners_of(SampledLoop(nominal), [("", loop) for loop in others], proved=False)
        _margins[key] = least.disk, least.delay.delay_s
    return _margins[key]


def _read_points(
    vehicle: Vehicle,
    values: Mapping[str, ArrayLike],
    *,
    base: Mapping[str, float],
    cruise: ArrayLike,
    model: Vehicle | None,
) -> tuple[list[CruisePoint], list[dict[str, float]]]:
    """Return the points that the arguments of `linear_table` describe, and the numbers stated of each plant."""
    known = {name: np.asarray(values[name], dtype=float) for name in LINEAR_PARAMETERS if name in values}
    speed = known.pop("scenario.cruise", np.asarray(cruise, dtype=float))
    try:
        shape = np.broadcast_shapes((1,), speed.shape, *(v.shape for v in known.values()))
    except ValueError:
        shapes = {name: v.shape for name, v in known.items()} | {"cruise": speed.shape}
        raise InputError(
            f"have shapes {shapes} that do not match", key="values", remedy="give each as (n,) or as one number"
        ) from None
    for key, column in known.items():
        name = key.partition(".")[2]
        if name and name not in vehicle.parameters:
            raise InputError(f"{vehicle.name} has no such term", key=key, remedy="add it to the vehicle file")
        if name:
            _check_parameter(name, key, column.reshape(-1))
    columns = {name: np.broadcast_to(column, shape).tolist() for name, column in known.items()}
    points, stated = [], []
    for k, u in enumerate(np.broadcast_to(speed, shape).tolist()):
        row = {name: column[k] for name, column in columns.items()}
        both, own = (
            {name.removeprefix(kind): value for name, value in row.items() if name.startswith(kind)}
            for kind in ("vehicle.", "plant.")
        )
        believed = model or vehicle
        believed = believed.with_values({name: value for name, value in both.items() if name in believed.parameters})
        gains = {**base, **{name: value for name, value in row.items() if "." not in name}}
        stated.append({**both, **own})
        points.append(CruisePoint(vehicle.with_values(stated[-1]), believed, gains, u))
    return points, stated


def _check_parameter(name: str, key: str, values: NDArray[np.float64]) -> None:
    spec = PARAMETERS.get(name) or TERMS[name]
    for value in values.tolist():
        if not spec.allows(value):
            raise InputError(f"must be {spec.bound}", key=key, value=value, remedy=spec.remedy)


def _figures(loops: LinearLoop, *, columns: Collection[str]) -> dict[str, NDArray[np.float64]]:
    rates, size = loops.rates, np.abs(loops.rates)
    damping = np.where(rates.imag != 0, -rates.real / np.where(size > 0, size, 1), 1.0)
    figures = {"slowest_pole_per_s": loops.slowest_per_s, "least_damping": damping.min(axis=1)}
    requested = {_OVER.get(name, name.partition(".")[0]) for name in columns if name not in _WORST}
    if requested & _MARGINS.keys():
        table = margins_of(loops, present := [name for name in LOOP_NAMES if name in loops.channels()])
        for name, metric in _MARGINS.items():
            key, none = name.replace("rad_per_s", "rad_s"), np.full(len(rates), np.nan)
            figures |= {f"{name}.{of}": table[at][key] if at in present else none for at, of in LOOP_NAMES.items()}
            worst = np.max if metric.better == "low" else np.min
            over = [new for new, of in _OVER.items() if of == name]
            figures |= {new: worst([table[at][key] for at in present], axis=0) for new in over}
    for signal in _STEPS if requested & {"settling_time_s", "overshoot"} else ():
        goals = {
            kind.TYPE: kind(name=signal, source=f"measured.{signal}", end=f"measured.{signal}", at_most=1.0)
            for kind in (Settling, Overshoot)
        }
        for name, kind in (("settling_time_s", "settling"), ("overshoot", "overshoot")):
            values = np.array([_value(goals[kind], loops[k]) for k in range(len(rates))])
            figures[f"{name}.{LOOP_NAMES[signal]}"] = values
    return figures


def _value(goal: LoopGoal, loop: LinearLoop) -> float:
    try:
        judged = goal.judge(loop)
    except InputError:  # the signal does not follow its setpoint
        return float("inf")
    return judged.value if np.isfinite(judged.normalised) else float("inf")


# Closed-loop poles as one parameter varies: a root locus over a gain, a vehicle parameter or the cruise speed


def sweep_locus(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    parameter: str,
    values: ArrayLike,
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    about: Mapping[str, float] = MappingProxyType({}),
    law: str = TRACKING_LAW,
) -> list[LinearLoop]:
    """Return the loops (n) over the values of one parameter, for a root locus (`surctl.report.plot_locus`).

    Args:
        vehicle: the plant.
        gains: all gains, as in `cruise_loop`.
        parameter: name of the parameter that varies, from `LINEAR_PARAMETERS`.
        values: (n,) values of the parameter.
        cruise: cruise speed U [m/s]; ignored if the cruise speed is the parameter that varies.
        dt: control period [s].
        model: the controller's model of the vehicle; default the vehicle itself.
        about: fixed values of other parameters by name; parameters that move no pole are ignored.
        law: a law for which `has_cruise_loop` holds.

    Raises:
        InputError: the parameter moves no pole, a value is out of bounds, or the vehicle cannot hold the cruise speed.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import sweep_locus
        >>> gains = load_gains("default").values
        >>> loops = sweep_locus(load_vehicle("sur400"), gains, "k_psi", [0.2, 0.4, 0.8, 1.6, 3.2], cruise=0.15, dt=0.05)
        >>> [round(float(loop.slowest_per_s), 2) for loop in loops]
        [-0.22, -0.22, -0.22, -0.22, 0.12]
    """
    if parameter not in LINEAR_PARAMETERS:
        raise InputError("moves no pole", key="locus", value=parameter, remedy=nearest(parameter, LINEAR_PARAMETERS))
    points, _ = _read_points(vehicle, {**about, parameter: values}, base=gains, cruise=cruise, model=model)
    loops = each_loop(points, dt=dt, law=law)
    able = [loop for loop in loops if loop is not None]
    if len(able) < len(loops):
        at = float(np.ravel(values)[loops.index(None)])
        raise InputError("needs more thrust than the vehicle has", key=parameter, value=at, remedy="cruise slower")
    return able
