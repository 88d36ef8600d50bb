"""Linear metrics of many operating points at once (poles, eight loops, steps); the root locus over a parameter.

An operating point consists of gains, a vehicle and a cruise speed. Every metric is defined as in python-control
(`damp`, `stability_margins`, `disk_margins`, `step_info`), and tests compare the results with those of python-control.
The computation for all points together is about a hundred times faster than python-control.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest
from surctl.marine.simulation.metrics import MetricSpec
from surctl.marine.vehicle import PARAMETERS, PLANT_PARAMETERS, TERMS, PlantForm, Vehicle, plant_parameters
from surctl.marine.vehicle.dynamics import trim_function
from surctl.marine.vehicle.linearise import can_hold
from surctl.marine.verification.corners import corners
from surctl.marine.verification.cruise_loop import (
    LINEAR_GAINS,
    LOOP_NAMES,
    TRACKING_LAW,
    CruiseLoop,
    broken_loops,
    check_positive,
    cruise_loops,
    least_delay,
)
from surctl.marine.verification.linear.corner_margin import least_disk
from surctl.plotted import Plotted
from surctl.verification.loops import crossings_of, shape_of, state_blocks

STEP_NAMES = ("cross_track", "heading", "surge_speed")
_BAND = 0.02  # half-width of the settling band, as a share of the final value
_DECAYS = 10.0  # duration of the response, in time constants of the slowest pole
_LEVELS, _RATIO, _SAMPLES = 4, 8, 512  # number of time grids, each `_RATIO` times longer than the one before; samples


def step_system(loop: CruiseLoop, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the sampled systems (A, b, c) from a reference to the controlled variable; a leading axis holds the loops.

    `cross_track`: the path is displaced to one side by a step; all loops are closed. `heading`: the desired heading
    changes by a step, and the path does not change; all loops are closed. `surge_speed`: the desired surge speed
    changes by a step; the along-track loop is open, and the response is correct up to a constant factor.
    """
    opened, b, *_ = loop.opened({"cross_track": "y", "heading": "psi"}.get(name, "x"))
    measured, Cz = loop.plant[3], loop.direct[3]
    C = np.concatenate([measured, np.zeros((*measured.shape[:-1], len(loop.names.controller_states)))], axis=-1)
    if name == "cross_track":
        return loop.transition, -b, C[..., [1], :]
    if name == "heading":
        # only the thrust in yaw, and states of the law that change no other: in sway, ψ enters by the rotation into {B}
        others = np.any(Cz[..., :3, :] != 0, axis=tuple(range(Cz.ndim - 1)))
        driven = np.array([*np.zeros(len(loop.names.states), dtype=bool), *~others, False, False, False, True])
        return loop.transition, -b * driven[:, None], C[..., [3], :]
    # k1 x takes the place of the desired speed, up to a factor that does not change the metrics; x is then unused
    return opened[..., 1:, 1:], -b[..., 1:, :], C[..., [4], 1:]


def step_figures(
    loop: CruiseLoop, stable: NDArray[np.bool_]
) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return settling time [s] and overshoot of n loops for each step response; inf if unstable.

    The overshoot is a share of the step.
    """
    figures = {}
    for name in STEP_NAMES:
        settling, overshoot = (np.full(len(stable), np.inf) for _ in range(2))
        if stable.any():
            A, b, c = (m[stable] for m in step_system(loop, name))
            block = next(s for s in state_blocks(A) if np.any(b[:, s] != 0))
            A, b, c = A[:, block[:, None], block], b[:, block], c[:, :, block]
            settling[stable], overshoot[stable] = _step_figures(A, b, c, dt=float(np.max(loop.dt)))
        figures[name] = (settling, overshoot)
    return figures


def _step_figures(
    A: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64], *, dt: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return settling time and overshoot of stable sampled systems A (n, k, k), b (n, k, 1), c (n, 1, k).

    The response is 1 − d(t) with the remaining error d(t) = c A^(t/dt) x_∞/(c x_∞) and the final state x_∞ = (I − A)⁻¹
    b. The response is sampled on four time grids of whole periods, each eight times longer than the previous grid;
    together they resolve both an early peak and a late end. Between samples the response is interpolated.
    """
    rest = np.linalg.solve(np.eye(A.shape[-1]) - A, b)
    final = (c @ rest)[:, :, 0]
    slowest = -np.log(np.max(np.abs(np.linalg.eigvals(A)), axis=1)) / dt
    periods = np.ceil(_DECAYS / slowest / (_SAMPLES * _RATIO ** (_LEVELS - 1)) / dt).astype(int)
    step, power = periods * dt, _powers(A, periods)
    settling, peak, overshoot = np.zeros(len(A)), np.zeros(len(A)), np.zeros(len(A))
    for level in range(_LEVELS):
        rows, power = _sampled(power, c)
        d = (rows @ rest)[:, :, 0] / final
        later = _last_outside(d)
        # where a finer grid covers the time, the more exact result of the finer grid is kept
        newer = later >= (_SAMPLES // _RATIO if level else 0)
        settling = np.where(newer, later * step, settling)
        highest, refined = _peak(-d)
        higher = highest > peak + 1e-12
        peak, overshoot = np.where(higher, highest, peak), np.where(higher, refined, overshoot)
        step = step * _RATIO
    return settling, overshoot


def _powers(A: NDArray[np.float64], exponents: NDArray[np.intp]) -> NDArray[np.float64]:
    power: NDArray[np.float64] = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
    while exponents.any():
        power = np.where((exponents % 2 == 1)[:, None, None], power @ A, power)
        A, exponents = A @ A, exponents // 2
    return power


def _sampled(power: NDArray[np.float64], c: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return c Φ^j (n, `_SAMPLES` + 1, k) for j = 0 … `_SAMPLES`, and the matrix Φ^`_RATIO`; Φ is `power`."""
    rows, following = c, power
    while rows.shape[1] < _SAMPLES:
        rows = np.concatenate([rows, rows @ power], axis=1)
        power = power @ power
        if rows.shape[1] == _RATIO:
            following = power
    return np.concatenate([rows, c @ power], axis=1), following


def _last_outside(d: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sample after which d (n, m) stays within the settling band; 0 if d never leaves this band."""
    outside = np.abs(d) >= _BAND
    last = d.shape[1] - 1 - np.argmax(outside[:, ::-1], axis=1)
    here = np.minimum(last, d.shape[1] - 2)
    point = np.arange(len(d))
    before, after = np.abs(d[point, here]), np.abs(d[point, here + 1])
    share = np.where(before > after, (before - _BAND) / np.where(before > after, before - after, 1), 1.0)
    return np.where(outside.any(axis=1), here + np.clip(share, 0, 1), 0.0)


def _peak(y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the largest sample of y (n, m), at least 0, and the peak of the parabola through its neighbourhood."""
    at = np.clip(np.argmax(y, axis=1), 1, y.shape[1] - 2)
    point = np.arange(len(y))
    left, middle, right = y[point, at - 1], y[point, at], y[point, at + 1]
    bend = left - 2 * middle + right
    top = middle - np.where(bend < 0, (left - right) ** 2 / (8 * np.where(bend < 0, bend, -1)), 0)
    highest = np.maximum(y.max(axis=1), 0)
    return highest, np.maximum(np.where(middle >= np.maximum(left, right), top, highest), 0)


_CHUNK = 64  # points computed together, so that their frequency responses fit in the cache

_MOST_MARGINS = 10_000
_margins: dict[bytes, tuple[float, float]] = {}  # by digest: each round of a tuning judges gain sets again

_PLACES = {  # vehicle parameter → its index in the plant's flat vector
    name: PLANT_PARAMETERS.slice(group).start + k
    for group, names in (
        ("mass", ("m11", "m22", "m33", "m44")),
        ("linear_drag", ("Xu", "Yv", "Zw", "Nr")),
        ("quadratic_drag", ("Xuu", "Yvv", "Zww", "Nrr")),
        ("thrust_limit", ("Fu_max",)),
        ("thrust_lag", ("thrust_lag",)),
    )
    for k, name in enumerate(names)
}

LINEAR_PARAMETERS: tuple[str, ...] = (
    *LINEAR_GAINS,
    "k_i",
    "scenario.cruise",
    *(f"vehicle.{name}" for name in _PLACES),
    *(f"plant.{name}" for name in _PLACES),
    *(f"{kind}.{name}" for kind in ("vehicle", "plant") for name in TERMS),
)
"""The parameters on which the linear metrics depend; no other parameter changes them."""


_MARGINS = {
    "gain_margin": MetricSpec("1", "least factor > 1 on the loop gain that destabilises", "high"),
    "phase_margin_deg": MetricSpec("deg", "least extra phase lag that destabilises", "high"),
    "delay_margin_s": MetricSpec("s", "least extra delay that destabilises", "high"),
    "disk_margin": MetricSpec("1", "disk margin of one loop alone, 0 to 2", "high"),
}
_LEAST = {name: name for name in ("gain_margin", "phase_margin_deg")} | {"disk_margin": "single_loop_disk_margin"}
"""Name of the least value of each margin over the nominal single loops."""
_WORST = ("disk_margin", "delay_margin_s")  # at the worst corner of the ranges
_SINGLE = {least: name for name, least in _LEAST.items()}

_SHAPES = {
    "sensitivity_peak": MetricSpec("1", "largest |S| over frequency", "low"),
    "rejection_rad_per_s": MetricSpec("rad/s", "frequency up to which |S| is at most -3 dB", "high"),
    "crossover_rad_per_s": MetricSpec("rad/s", "highest frequency with |L| = 1", None),
}
LINEAR_METRICS: Mapping[str, MetricSpec] = {
    "slowest_pole_per_s": MetricSpec("1/s", "largest real part of a closed-loop pole", "low"),
    "least_damping": MetricSpec("1", "least damping ratio of the closed-loop poles; 1 if all poles are real", "high"),
    "disk_margin": MetricSpec("1", "all loops at once, at commands or measurements, worst corner, 0 to 2", "high"),
    "delay_margin_s": MetricSpec("s", "least extra delay of one loop alone, worst corner of the ranges", "high"),
    **{
        least: replace(_MARGINS[name], meaning=f"{_MARGINS[name].meaning}, least over all loops, nominal vehicle")
        for name, least in _LEAST.items()
    },
    **{
        f"{name}.{loop}": MetricSpec(m.unit, f"{m.meaning}, loop {loop}, nominal vehicle", m.better)
        for loop in LOOP_NAMES
        for name, m in _MARGINS.items()
    },
    "sensitivity_peak": MetricSpec("1", "largest |S| over frequency and all loops", "low"),
    **{f"{n}.{at}": replace(m, meaning=f"{m.meaning}, loop {at}") for at in LOOP_NAMES for n, m in _SHAPES.items()},
    **{f"settling_time_s.{s}": MetricSpec("s", f"2 % settling time of a step in {s}", "low") for s in STEP_NAMES},
    **{f"overshoot.{s}": MetricSpec("1", f"overshoot of a step in {s}, share of the step", "low") for s in STEP_NAMES},
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
) -> dict[str, NDArray[np.float64]]:
    """Compute the linear metrics of n operating points; return one array (n,) for every requested metric.

    The columns `disk_margin`, as in `verification.linear.corner_margin`, and `delay_margin_s` are those of the worst
    corner of the ranges; parameters in `values` are exact. All other metrics are those of the plant.

    At an unstable point the margins have the values that `LoopMargins` states for an unstable loop (1, 0, 0, 0);
    sensitivity peak, settling time and overshoot are infinite; the rejection frequency is 0; and the crossover is NaN.
    If the vehicle's thrust cannot hold the cruise speed, the point has no linear model and every column is NaN.

    Args:
        vehicle: the plant.
        values: mapping from parameter names (`LINEAR_PARAMETERS`) to values, scalar or (n,); other names are ignored.
            `vehicle.*` changes the plant and the controller's model, `plant.*` the plant alone; `plant.*` takes
            precedence.
        base: gains that apply if `values` does not contain them.
        cruise: cruise speed U [m/s], (n,) or scalar; ignored if `values` has `scenario.cruise`.
        dt: control period [s].
        model: the controller's model of the vehicle; default the vehicle itself.
        columns: names of the metrics to compute, keys of `LINEAR_METRICS`. Step responses take three quarters of the
            computing time, and margins take most of the remaining time.
        workers: number of threads; the results do not depend on this number.

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
    points = _read_points(vehicle, values, base=base, cruise=cruise, dt=dt, model=model, law=law)
    table = {name: np.full(points.count, np.nan) for name in columns}
    chunks = [group[at : at + _CHUNK] for group in _by_order(points) for at in range(0, len(group), _CHUNK)]

    def fill(chunk: NDArray[np.intp]) -> None:
        figures = _figures(points.loops(chunk), columns=columns)
        for name in columns:
            if name in figures:
                table[name][chunk] = figures[name]

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(fill, chunks))
        if worst := [name for name in _WORST if name in columns]:
            exact = {name.partition(".")[2] for name in values}
            tried = [
                _read_points(v, values, base=base, cruise=cruise, dt=dt, model=model or vehicle, law=law)
                for v in corners(vehicle, known=exact).vehicles
            ]
            able = np.flatnonzero(points.feasible)
            margins = np.reshape(list(pool.map(lambda k: _worst_margins(tried, int(k)), able)), (-1, len(_WORST)))
            for name in worst:
                table[name][able] = margins[:, _WORST.index(name)]
    return table


def _worst_margins(tried: Sequence[Points], k: int) -> tuple[float, float]:
    # disk margin and delay margin of point k, over the corners that can hold the speed
    groups = [[one for one in tried if one.feasible[k] and one.lagged[k] == lagged] for lagged in (True, False)]
    built = [_together(group, k) for group in groups if group]
    matrices = (m.tobytes() for loops in built for m in (*loops.plant, *loops.law))
    key = hashlib.sha256(b"".join((np.float64(tried[0].dt).tobytes(), *matrices))).digest()
    if key not in _margins:
        if len(_margins) >= _MOST_MARGINS:
            _margins.clear()
        _margins[key] = least_disk(built)[0], least_delay(built)[0]
    return _margins[key]


def _together(group: Sequence[Points], k: int) -> CruiseLoop:
    first = group[0]
    return cruise_loops(
        np.array([one.plant[k] for one in group]),
        {name: column[k] for name, column in first.gains.items()},
        cruise=first.cruise[k],
        dt=first.dt,
        model=first.model,
        believed=np.array([one.believed[k] for one in group]),
        law=first.law,
        form=first.form,
    )


@dataclass(frozen=True, eq=False)
class Points:
    """n operating points: plant and believed model (n, …) as in `plant_parameters`, gains (n,), cruise speeds (n,).

    `model` is the controller's nominal model, `form` has the optional terms of all plants.
    """

    plant: NDArray[np.float64]
    believed: NDArray[np.float64]
    gains: Mapping[str, NDArray[np.float64]]
    cruise: NDArray[np.float64]
    dt: float
    model: Vehicle
    form: PlantForm
    law: str = TRACKING_LAW

    @property
    def count(self) -> int:
        """The number n of points."""
        return len(self.cruise)

    @property
    def lagged(self) -> NDArray[np.bool_]:
        """Whether the plant has thrust lag, (n,)."""
        return np.asarray(self.plant[:, _PLACES["thrust_lag"]] > 0)

    @cached_property
    def feasible(self) -> NDArray[np.bool_]:
        """Whether the trim thrust at cruise lies strictly inside the thrust limits, (n,)."""
        nu = np.zeros((self.count, 4))
        nu[:, 0] = self.cruise
        trim = np.asarray(trim_function(self.form)(nu.T, self.plant.T)).T
        most = self.plant[:, PLANT_PARAMETERS.slice("thrust_limit")]
        least = -most  # a copy
        for axis, name in self.form.reverse():
            least[:, axis] = -self.plant[:, PLANT_PARAMETERS.size + self.form.terms.index(name)]
        return can_hold(trim, least, most)

    def loops(self, chosen: NDArray[np.intp]) -> CruiseLoop:
        """Build the loops of the chosen points; all of them must have the same order."""
        return cruise_loops(
            self.plant[chosen],
            {name: column[chosen] for name, column in self.gains.items()},
            cruise=self.cruise[chosen],
            dt=self.dt,
            model=self.model,
            believed=self.believed[chosen],
            law=self.law,
            form=self.form,
        )


def _read_points(
    vehicle: Vehicle,
    values: Mapping[str, ArrayLike],
    *,
    base: Mapping[str, float],
    cruise: ArrayLike,
    dt: float,
    model: Vehicle | None,
    law: str,
) -> Points:
    """Return the operating points that the arguments of `linear_table` describe."""
    known = {name: np.asarray(values[name], dtype=float) for name in LINEAR_PARAMETERS if name in values}
    speed = known.pop("scenario.cruise", np.asarray(cruise, dtype=float))
    try:
        (count,) = np.broadcast_shapes((1,), speed.shape, *(v.shape for v in known.values()))
    except ValueError:
        shapes = {name: v.shape for name, v in known.items()} | {"cruise": speed.shape}
        raise InputError(
            f"have shapes {shapes} that do not match", key="values", remedy="give each as (n,) or as one number"
        ) from None

    def column(value: ArrayLike) -> NDArray[np.float64]:
        return np.broadcast_to(np.asarray(value, dtype=float), (count,)).copy()

    gains = {n: column(known[n] if n in known else base[n]) for n in (*LINEAR_GAINS, "k_i") if n in known or n in base}
    flat = [np.tile(plant_parameters(v), (count, 1)) for v in (vehicle, model or vehicle)]
    for kind, targets in (("vehicle", flat), ("plant", flat[:1])):
        for key in [key for key in known if key.startswith(f"{kind}.")]:
            name = key.removeprefix(f"{kind}.")
            checked = column(known[key])
            _check_parameter(name, key, checked)
            for target, form in zip(targets, (vehicle.form, (model or vehicle).form), strict=False):
                if name in _PLACES:
                    target[:, _PLACES[name]] = checked
                elif name in form.terms:
                    target[:, PLANT_PARAMETERS.size + form.terms.index(name)] = checked
                elif target is flat[0]:
                    raise InputError(f"{vehicle.name} has no such term", key=key, remedy="add it to the vehicle file")
    check_positive({"cruise": column(speed)})
    return Points(flat[0], flat[1], gains, column(speed), dt, model or vehicle, vehicle.form, law)


def _by_order(points: Points) -> Iterator[NDArray[np.intp]]:
    """Yield the indices of the feasible points, in groups whose loops have equal states."""
    integral = points.gains.get("k_i", np.zeros(points.count)) > 0
    for lagged in (False, True):
        for integrated in (False, True):
            group = np.flatnonzero(points.feasible & (points.lagged == lagged) & (integral == integrated))
            if group.size:
                yield group


def _check_parameter(name: str, key: str, values: NDArray[np.float64]) -> None:
    spec = PARAMETERS.get(name) or TERMS[name]
    for value in values.tolist():
        if not spec.allows(value):
            raise InputError(f"must be {spec.bound}", key=key, value=value, remedy=spec.remedy)


def _figures(loops: CruiseLoop, *, columns: Collection[str]) -> dict[str, NDArray[np.float64]]:
    poles, stable, highest = loops.rates, loops.decays, np.pi / float(np.max(loops.dt))
    size = np.abs(poles)
    damping = np.where(poles.imag != 0, -poles.real / np.where(size > 0, size, 1), 1.0)
    figures = {"slowest_pole_per_s": poles[:, 0].real, "least_damping": damping.min(axis=1)}
    requested = {_SINGLE.get(name, name.partition(".")[0]) for name in columns if name not in _WORST}
    nothing = {"gain_margin": 1.0, "phase_margin_deg": 0.0, "delay_margin_s": 0.0, "disk_margin": 0.0}
    if requested & nothing.keys():
        for name, loop in zip(LOOP_NAMES, broken_loops(loops), strict=True):
            margins = crossings_of(loop, highest=highest)
            figures |= {f"{m}.{name}": np.where(stable, getattr(margins, m), left) for m, left in nothing.items()}
        least = {new: [figures[f"{m}.{name}"] for name in LOOP_NAMES] for m, new in _LEAST.items()}
        figures |= {name: np.min(values, axis=0) for name, values in least.items()}
    nowhere = {"sensitivity_peak": np.inf, "rejection_rad_per_s": 0.0, "crossover_rad_per_s": np.nan}
    if requested & nowhere.keys():
        for name, loop in zip(LOOP_NAMES, broken_loops(loops), strict=True):
            shape = shape_of(loop, highest=highest)
            figures |= {f"{m}.{name}": np.where(stable, getattr(shape, m), left) for m, left in nowhere.items()}
        figures["sensitivity_peak"] = np.max([figures[f"sensitivity_peak.{name}"] for name in LOOP_NAMES], axis=0)
    if requested & {"settling_time_s", "overshoot"}:
        for name, (settling, overshoot) in step_figures(loops, stable).items():
            figures |= {f"settling_time_s.{name}": settling, f"overshoot.{name}": overshoot}
    return figures


# Closed-loop poles as one parameter varies: a root locus over a gain, a vehicle parameter or the cruise speed


_HALVED = 8  # largest number of times that the step between two values is halved


@dataclass(frozen=True, eq=False)
class Locus(Plotted):
    """A root locus: the closed-loop poles for every value of one parameter; `plot()` draws them.

    Attributes:
        parameter: name of the parameter.
        values: (n,) values of the parameter, ascending or descending, in its unit.
        poles: (n, k) complex poles [rad/s]; a row holds the poles at one value, a column follows one pole over the
            values.
    """

    PLOT = "surctl.marine.report.margin_plots:plot_locus"

    parameter: str
    values: NDArray[np.float64]
    poles: NDArray[np.complex128]

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether every pole lies in the open left half-plane, (n,)."""
        stable: NDArray[np.bool_] = np.all(self.poles.real < -1e-9, axis=1)
        return stable


def sweep_locus(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    parameter: str,
    values: ArrayLike,
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    smooth: float = np.inf,
    about: Mapping[str, float] = MappingProxyType({}),
    law: str = TRACKING_LAW,
) -> Locus:
    """Compute the poles of the loop over the values of one parameter.

    The poles at neighbouring values are paired so that the sum of the distances between paired poles is smallest.

    Args:
        vehicle: the plant.
        gains: all gains, as in `loop_margins`.
        parameter: name of the parameter that varies, from `LINEAR_PARAMETERS`.
        values: (n,) values of the parameter, n ≥ 2, in ascending or descending order.
        cruise: cruise speed U [m/s]; ignored if the cruise speed is the parameter that varies.
        dt: control period [s].
        model: the controller's model of the vehicle; default the vehicle itself.
        smooth: largest allowed step of a pole between two neighbouring values, as a share of the pole's modulus. If a
            pole moves further, for example where two poles separate, values are inserted between two given values, down
            to a spacing of 2⁻⁸ of the given spacing.
        about: fixed values of other parameters by name; parameters that move no pole are ignored.
        law: a law for which `has_cruise_loop` holds.

    Raises:
        InputError: the parameter moves no pole, the values are not in order or out of bounds, the vehicle cannot hold
            the cruise speed, or the number of poles changes (because k_i or thrust_lag is 0 for some values and
            positive for others).

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import sweep_locus
        >>> gains = load_gains("default").values
        >>> locus = sweep_locus(load_vehicle("sur400"), gains, "k_psi", [0.2, 0.4, 0.8, 1.6, 3.2], cruise=0.15, dt=0.05)
        >>> locus.poles.shape, locus.poles.real.max(axis=1).round(2).tolist()
        ((5, 16), [-0.22, -0.22, -0.22, -0.22, 0.12])
    """
    if parameter not in LINEAR_PARAMETERS:
        raise InputError("moves no pole", key="locus", value=parameter, remedy=nearest(parameter, LINEAR_PARAMETERS))
    swept = np.atleast_1d(np.asarray(values, dtype=float))
    if swept.ndim != 1 or len(swept) < 2 or not (np.all(np.diff(swept) > 0) or np.all(np.diff(swept) < 0)):
        raise InputError(
            "needs at least two values in order", key=parameter, remedy="give a range, ascending or descending"
        )

    def followed(values: NDArray[np.float64]) -> NDArray[np.complex128]:
        points = _read_points(
            vehicle, {**about, parameter: values}, base=gains, cruise=cruise, dt=dt, model=model, law=law
        )
        if not points.feasible.all():
            at = float(values[np.argmin(points.feasible)])
            raise InputError("needs more thrust than the vehicle has", key=parameter, value=at, remedy="cruise slower")
        groups = list(_by_order(points))
        if len(groups) > 1:
            raise InputError(
                "changes the number of poles where it is 0", key=parameter, remedy="begin the range above 0"
            )
        return _paired(points.loops(groups[0]).rates)

    poles = followed(swept)
    for _ in range(_HALVED):
        sizes = np.abs(poles)
        far = np.abs(np.diff(poles, axis=0)) > smooth * np.maximum(sizes[1:], sizes[:-1])
        rough = np.flatnonzero(far.any(axis=1))
        if len(rough) == 0:
            break
        swept = np.insert(swept, rough + 1, (swept[rough] + swept[rough + 1]) / 2)
        poles = followed(swept)
    return Locus(parameter, swept, poles)


def _paired(poles: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Reorder the poles in every row of the array so that each pole is in the column of the pole it continues."""
    from scipy.optimize import linear_sum_assignment

    for before, after in pairwise(poles):
        _, order = linear_sum_assignment(np.abs(before[:, None] - after[None]))
        after[:] = after[order]
    return poles
