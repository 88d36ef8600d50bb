"""Fit a vehicle to a log: parameters fitted, held or fixed at 0, notes on velocities, and fits that are refused.

The simulated motion is fitted to the measured motion (Ljung 1999, section 7.4; Tischler & Remple 2012). Measurement
noise therefore does not bias the estimated masses and drag, as it would if measured velocities were differentiated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle.identification.intervals import (
    Spread,
    at_rest,
    drift_note,
    few_thrusts,
    ill_excited,
    measured_forces,
    notes_of,
    slow_residuals,
    spread_of,
)
from surctl.marine.vehicle.identification.model import (
    CONSTANT_FORCE,
    MASS_OF,
    OFFSETS,
    Model,
    axes_of,
    drift_sections_of,
    sections_of,
)
from surctl.marine.vehicle.identification.prediction import Prediction, Trial, drift_trial, predict
from surctl.marine.vehicle.identification.solve import beginning, minimise, outliers, simulable, without_outliers
from surctl.marine.vehicle.motion_log import LOG_MOTION, LOG_THRUST, LOG_TILT, MotionLog
from surctl.marine.vehicle.parameters import Parameter, Vehicle
from surctl.marine.vehicle.specs import SPECS, TERMS


@dataclass(frozen=True, eq=False)
class Identified:
    """The result of fitting a vehicle to a log.

    Attributes:
        vehicle: the vehicle with the fitted values. Parameters that the log does not determine have the values of
            `start`, and the others are fitted again together with them. The range of an identified one is its interval.
        start: the vehicle whose parameters are the initial values of the fit.
        estimates: for every fitted parameter by name, and for the constant force (X0, Y0, Z0, N0), the estimate and
            half the width of its 95 % interval, with all parameters free. An estimate of drag may be negative.
        identified: names of the parameters whose 95 % interval is sufficiently narrow, without those held.
        held: names of the parameters with the value of `start`; a constant force that `start` does not have is 0.
        drifting: names of the constant forces that change in the log; `vehicle` has their mean.
        zeroed: names of the drag parameters that are 0 in `vehicle` because their estimates are negative.
        directions: the combinations of parameters that the log does not determine, one text each.
        noise: standard deviation of the residuals, by column of the log.
        notes: what is wrong with the model or the log.
        sections: number of parts of the log that were fitted, each with its own initial state.
    """

    vehicle: Vehicle
    start: Vehicle
    estimates: Mapping[str, tuple[float, float]]
    identified: tuple[str, ...]
    held: tuple[str, ...]
    drifting: tuple[str, ...]
    zeroed: tuple[str, ...]
    directions: tuple[str, ...]
    noise: Mapping[str, float]
    notes: tuple[str, ...]
    sections: int

    @property
    def constant_force(self) -> NDArray[np.float64]:
        """Constant force (4,) on the vehicle along its axes [N] and constant yaw moment [N m]."""
        return np.array([self.fitted_value(k) for k in CONSTANT_FORCE])

    @property
    def refusal(self) -> str:
        """Why the fit has no physical meaning, with the remedy; empty if it has one."""
        below = [
            f"{key} = {value:.3g} ± {half:.2g} {spec.unit}"
            for key, (value, half) in self.estimates.items()
            if not (spec := SPECS[key]).signed and value + half < 0
        ]
        remedy = "check the signs and scales of thrust and motion"
        return f"the log contradicts the model: {', '.join(below)} would be below 0; {remedy}" if below else ""

    def fitted_value(self, name: str) -> float:
        """Return the value of a parameter in the vehicle; 0 for a constant force that it does not have."""
        return self.vehicle.term(name)

    def start_value(self, name: str) -> float:
        """Return the value of a parameter in `start`; 0 for a constant force that it does not have."""
        return self.start.term(name)

    def unit(self, name: str) -> str:
        """Return the unit of a parameter."""
        return SPECS[name].unit


_SPAN, _SPAN_ROWS = 2.0, 10  # displacements are compared over this [s], or this many rows, whichever is longer
_GAP, _GAP_FACTOR = 0.5, 5.0  # displacements across a gap, longer than this [s] and than these periods, do not count
_AGREES = 0.3  # largest difference, relative to the displacement, that counts as agreement
_CLOSE, _FAR_CLOSER = 0.05, 0.2  # a difference above the first one is reported if a change reduces it to this share
_HELPS = 0.5  # of a larger difference, a change is named if it reduces the difference to this share
_ABOVE = 6.0  # standard deviations of the pose's noise that a displacement must have
_DEGREES = 180 / np.pi
_LEAST = 20  # displacements

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def velocity_notes(log: MotionLog) -> tuple[str, ...]:
    """Return one text for each velocity that does not follow from the pose, with the change that would make it follow.

    The displacement over some seconds is compared with the integral of the velocity, turned by the heading. A wrong
    frame, sign or unit in the map of a log makes them differ, as do a velocity through the water in a current, and
    clocks that differ.
    """
    notes = []
    motion = log.motion
    x, y, z, psi, u, v, w, r = motion[:, :8].T
    flat = _compared(
        log,
        x + 1j * y,
        (u + 1j * v) * np.exp(1j * psi),
        (
            ('velocities of the world frame (frame = "world")', u + 1j * v),
            ('velocities of the world frame (frame = "world")', -v + 1j * u),  # north and east, converted as if u, v
            ("the other sign of v", (u - 1j * v) * np.exp(1j * psi)),
            ("the other sign of the heading", (u + 1j * v) * np.exp(-1j * psi)),
            ("the other sign of the heading", (u + 1j * v) * -np.exp(-1j * psi)),  # the same in a log of frame ned
            ("the heading times 57.3 (radians, read as degrees)", (u + 1j * v) * np.exp(1j * _DEGREES * psi)),
            ("the heading divided by 57.3 (degrees, read as radians)", (u + 1j * v) * np.exp(1j * psi / _DEGREES)),
        ),
    )
    if flat:
        notes.append(f"u_m_per_s, v_m_per_s do not follow from x_m, y_m, psi_rad: {flat}")
    for pose, rate, names in ((z, w, ("z_m", "w_m_per_s")), (psi, r, ("psi_rad", "r_rad_per_s"))):
        text = _compared(log, pose.astype(complex), rate.astype(complex), ())
        if text:
            notes.append(f"{names[1]} does not follow from {names[0]}: {text}")
    return tuple(notes)


def _compared(log: MotionLog, pose: Complex, velocity: Complex, others: Sequence[tuple[str, Complex]]) -> str:
    """Return how far a velocity is from the pose, and which other velocity or factor is closer; "" if it agrees."""
    moved, first = _displacements(log, pose, velocity)
    if len(moved) < _LEAST:
        return ""
    size, difference = max(_rms(moved), _rms(first)), _rms(moved - first)
    bends = np.abs(np.diff(pose[np.isfinite(pose)], 2))
    noise = float(np.median(bends)) / np.sqrt(2.0) if len(bends) else 0.0  # jumps between runs do not count
    if difference <= _CLOSE * size or size <= _ABOVE * noise:
        return ""
    square = float(np.sum(np.abs(first) ** 2))
    factor = complex(np.vdot(first, moved)) / square if square > 0 else 1.0
    turned = f"{np.degrees(np.angle(factor)):.0f} deg more heading and " if others else ""
    named = f"{turned}the factor {abs(factor) if others else factor.real:.3g}"
    candidates = [(_rms(moved - factor * first), named)]
    candidates += [(_rms(np.subtract(*_displacements(log, pose, other))), name) for name, other in others]
    closest, best = min(candidates)
    if difference <= _AGREES * size and closest > _FAR_CLOSER * difference:
        return ""
    said = f"the displacements differ by {difference:.2g} of {size:.2g}"
    if closest > _HELPS * difference:
        return f"{said}; check frames, signs, units and clocks, or expect a current"
    return f"{said}, with {best} by {closest:.2g}; correct the map or the columns"


def _displacements(log: MotionLog, pose: Complex, velocity: Complex) -> tuple[Complex, Complex]:
    # displacements over the span, and integrals of the velocity over it, within the parts without a gap
    period = float(np.median(np.diff(log.time)))
    rows = max(int(np.ceil(_SPAN / period)), _SPAN_ROWS)
    known = np.isfinite(pose) & np.isfinite(velocity)
    time, place, rate = log.time[known], pose[known], velocity[known]
    if len(time) <= rows:
        return np.zeros(0, dtype=complex), np.zeros(0, dtype=complex)
    step = np.diff(time)
    integral = np.concatenate([[0], np.cumsum(step * (rate[1:] + rate[:-1]) / 2)])
    cuts = np.concatenate([[0], np.cumsum(step > max(_GAP, _GAP_FACTOR * period))])
    whole = cuts[rows:] == cuts[:-rows]
    return (place[rows:] - place[:-rows])[whole], (integral[rows:] - integral[:-rows])[whole]


def _rms(values: NDArray[np.number]) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2))) if len(values) else 0.0


_NARROW = 0.5  # largest ratio of half-interval to value of an identified parameter
_SMALL_FORCE = 0.1  # share of the thrust limit below which a constant force counts as small
_ROUNDS = 5  # largest number of alternations between fit and noise estimate
_STEADY, _ROUGH = 0.02, 1e-3  # relative change of the noise that ends them; of the cost that ends each fit
_MOST_TILT = np.radians(85.0)  # roll and pitch; at 90° the heading has no meaning
_REFITS = 6  # largest number of fits with more and more parameters held


@dataclass(frozen=True, eq=False)
class _Full:
    # the fit with all parameters free
    model: Model
    theta: Array
    noise: Array
    spread: Spread
    left: list[Array]  # residuals
    converged: bool
    rest: frozenset[str] = frozenset()  # masses of the axes that do not move, with a constant force
    trial: Trial | None = None  # of a drifting force, if residuals are slow

    @property
    def estimates(self) -> dict[str, tuple[float, float]]:
        half = self.model.scale * self.spread.half_intervals()
        return {k: (v, float(half[j])) for j, (k, v) in enumerate(self.model.values(self.theta).items())}


@np.errstate(over="ignore")  # a motion that overflows does not fit, and is refused
def identify(log: MotionLog, start: Vehicle, *, name: str) -> Identified:
    """Fit masses, drag, couplings, thrust lag and a constant force to a log, together with the unknown initial motion.

    If `start` rolls and pitches, its moments of inertia and drag in roll and pitch and its centre of gravity are fitted
    too. Its weight, its buoyancy and the points of attack of buoyancy and thrust are those of `start`.

    The model assumes still water, and thrust that follows its command with a first-order lag. The log is split at its
    gaps; each section has its own initial motion and thrust. If `start` has no thrust lag, the fitted vehicle has no
    thrust lag. Thrust limits and radius are those of `start`, because they cannot be identified from a log.

    Raises:
        InputError: `start` rolls and pitches, and the log has neither roll nor pitch, or they are near 90°; no
            simulated motion is finite, which shows that the columns of motion and thrust do not match; or the log has
            no part of sufficient length without a gap, or no thrust.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle import MotionLog, identify, load_vehicle
        >>> boat, t = load_vehicle("sur400"), 0.1 * np.arange(150)
        >>> force = np.where(t % 10 < 5, 4.0, -2.0)  # N, in surge; the true motion uses Euler steps of 1 ms
        >>> motion, thrust, x, u, f = np.zeros((150, 8)), np.outer(force, [1, 0, 0, 0]), 0.0, 0.0, 4.0
        >>> for k in range(1, 150):
        ...     for _ in range(100):
        ...         f += 1e-3 * (force[k - 1] - f) / 0.3
        ...         x, u = x + 1e-3 * u, u + 1e-3 * (f - 2.0 * u - 29.5 * u * abs(u)) / 60.0
        ...     motion[k, [0, 4]] = x, u
        >>> result = identify(MotionLog(t, motion, thrust, "log.csv"), boat, name="heavier")
        >>> round(result.estimates["m11"][0], 1), "m11" in result.identified, "m22" in result.identified
        (60.0, True, False)
    """
    if not log.thrust.any() and not start.form.tilts:  # free swinging shows ratios
        problem = "the log has no thrust, so no mass can be estimated from it"
        remedy = "give a log in which the vehicle is driven"
        raise InputError(problem, file=log.source, key=", ".join(LOG_THRUST), remedy=remedy)
    if not any(np.unique(column[np.isfinite(column)]).size > 1 for column in log.motion.T):
        problem = "the log has no motion: no column changes, so no parameter can be estimated from it"
        remedy = "give a log in which the vehicle moves"
        raise InputError(problem, file=log.source, key=", ".join(LOG_MOTION), remedy=remedy)
    if start.form.tilts:
        _check_tilt(log, start)
    full = _full_fit(log, start)
    model, estimates = full.model, full.estimates
    excluded = {k for k in estimates if axes_of(k) & full.rest}
    notes: list[str] = _outlier_note(model, log)
    notes += drift_note(model, full.theta, full.trial)
    notes += [] if full.converged else ["the fit has not converged: estimates and intervals are rough"]
    if "thrust_lag" in estimates:
        reason = few_thrusts(log, model.sections)
        if full.theta[model.names.index("thrust_lag")] <= model.low[model.names.index("thrust_lag")] + 1e-9:
            reason = f"its estimate {estimates['thrust_lag'][0]:.3g} s is the smallest value that the fit allows"
        if reason:
            excluded.add("thrust_lag")
            notes.append(f"thrust_lag is not determined: {reason}")
    identified = tuple(k for k in estimates if k not in excluded and _ratio(model, estimates, k) <= 1.0)
    # a force that drifts is not at its start value either; the vehicle has its mean
    drifting = frozenset(measured_forces(model) if model.drift else ())
    # a constant force that does not differ from 0 gets no entry in the vehicle
    small = {
        k
        for k in OFFSETS
        if k in estimates
        and abs(estimates[k][0]) <= estimates[k][1]
        and k not in start.parameters
        and k not in drifting
    }
    # only the ratio of drag to mass shows in a motion, so a mass that is not determined stays as it is
    masses = {k for k in model.masses if k in estimates and k not in identified}
    theta, held, zeroed = _consistent(full, excluded | small | masses, drifting)
    identified = tuple(k for k in identified if k not in held)
    notes += _negative_notes(zeroed, estimates)
    values = model.values(theta)
    coloured = notes_of(model, full.left)
    present = model.present
    result = Identified(
        start,
        start,
        estimates,
        identified,
        held,
        tuple(k for k in OFFSETS if k in drifting),
        zeroed,
        ill_excited(model, full.spread, estimates, full.rest),
        {c: float(full.noise[k]) for k, c in enumerate(model.columns) if present[:, k].any()},
        (*log.notes, *velocity_notes(log), *notes, *coloured),
        len(model.sections),
    )
    return replace(result, vehicle=_vehicle(result, values, log, name, coloured=bool(coloured)))


def _check_tilt(log: MotionLog, start: Vehicle) -> None:
    tilt = log.motion[:, 8:10]
    if not np.isfinite(tilt).any():
        problem = "rolls and pitches, and the log contains neither roll nor pitch"
        remedy = f"add columns ({', '.join(LOG_TILT[:2])}), or start from a vehicle without weight and buoyancy"
        raise InputError(problem, file=start.source or start.name, key="start", remedy=remedy)
    for row, column in np.argwhere(np.abs(tilt) >= _MOST_TILT):
        raise InputError(
            f"at {log.time[row]:g} s; the model needs less than {np.degrees(_MOST_TILT):.0f} degrees",
            file=log.source,
            key=LOG_TILT[column],
            value=round(float(tilt[row, column]), 3),
            remedy="check the unit, or cut this part out of the log",
        )


def _full_fit(log: MotionLog, start: Vehicle) -> _Full:
    log = without_outliers(log)
    full = _fit(Model(log, start, sections_of(log)))
    full = replace(full, rest=at_rest(full.model, full.theta, full.noise))
    if not slow_residuals(full.model, full.left):
        return full
    trial = drift_trial(log, start, full.theta[: full.model.size], full.noise)
    if trial is None or not trial.drifts:
        return replace(full, trial=trial)
    # a drifting force can explain any motion, also that of an axis at rest
    return replace(_fit(Model(log, start, drift_sections_of(log), drift=True)), rest=full.rest, trial=trial)


def _fit(model: Model) -> _Full:
    sections = model.sections
    noise = np.array([_roughness(model.motion[p, k]) for k, p in enumerate(model.present.T)])
    free = np.ones(model.size, dtype=bool)
    theta, converged = simulable(model, beginning(model, noise, free=free), noise, sections), False
    for attempt in range(_ROUNDS):
        theta, _ = minimise(model, theta, noise, sections, free=free, tolerance=_ROUGH)
        if attempt == 0:
            _omit_outliers(model, model.misfit(theta, sections))
        count = np.sum([model.present[s.rows].sum(axis=0) for s in sections], axis=0)
        freedom = 1.0 - len(theta) / max(int(count.sum()), len(theta) + 1)
        before = noise
        squares = np.sum([np.sum(e**2, axis=0) for e in model.misfit(theta, sections)], axis=0)
        noise = np.where(count > 0, np.maximum(np.sqrt(squares / np.maximum(count, 1) / freedom), 1e-9), 1.0)
        if np.allclose(noise, before, rtol=_STEADY):
            break
    theta, converged = minimise(model, theta, noise, sections, free=free)
    left = model.misfit(theta, sections)
    prior = model.prior(sections)[1]
    parts = model.slopes(theta, noise, sections)
    spread = spread_of(
        parts,
        [model.present[s.rows] for s in sections],
        prior[: model.size],
        prior[model.size : model.size + model.local],
    )
    return _Full(model, theta, noise, spread, left, converged)


def _omit_outliers(model: Model, left: list[Array]) -> None:
    # a glitch that is smaller than the motion shows in the residuals alone
    for section, e in zip(model.sections, left, strict=True):
        present = model.present[section.rows]
        values = np.where(present, e, np.nan)
        model.present[section.rows] = present & ~np.column_stack([outliers(column) for column in values.T])


def _outlier_note(model: Model, log: MotionLog) -> list[str]:
    measured = np.isfinite(log.motion[:, : len(model.columns)])
    number = (measured & ~model.present).sum(axis=0)
    listed = ", ".join(f"{k} of {column}" for k, column in zip(number, model.columns, strict=True) if k)
    return [f"outliers are not used: {listed}"] if listed else []


def _ratio(model: Model, estimates: Mapping[str, tuple[float, float]], name: str) -> float:
    """Return the half-interval of a parameter, relative to the largest one with which it counts as identified.

    The interval of a drag parameter, which may be 0, is relative to the larger of the estimate and the start value,
    that of a constant force to the larger of the estimate and a tenth of the thrust limit, that of a coordinate of the
    centre of gravity to the larger of the estimate and a fiftieth of the radius. A motion shows only the
    ratio of drag to mass. So if the mass of an axis is not identified, its drag is not identified either.
    """
    value, half = estimates[name]
    scale = float(model.scale[model.names.index(name)])
    if name not in model.masses and (name in MASS_OF or (name in TERMS and name not in OFFSETS)):
        own = half / (_NARROW * max(abs(value), scale))
        return max([own, *(_ratio(model, estimates, mass) for mass in axes_of(name))])
    reference = max(abs(value), _SMALL_FORCE * scale) if name in OFFSETS else value
    return half / (_NARROW * max(reference, 1e-12))


def _consistent(
    full: _Full, excluded: set[str], drifting: frozenset[str]
) -> tuple[Array, tuple[str, ...], tuple[str, ...]]:
    """Return θ of one consistent model, the names of its held parameters, and those of its drags fixed at 0.

    Parameters that the log does not determine are held at their start values, the worst first, until the others are
    determined together with them, except for the forces `drifting`; drags with a negative estimate are fixed at 0. The
    others are fitted again.
    """
    model, theta = full.model, full.theta.copy()
    held, zeroed = set(excluded), set[str]()
    for _ in range(_REFITS):
        values = model.values(theta)
        wrong = {k for k in MASS_OF if values.get(k, 0.0) < 0.0 and k not in held} - zeroed
        worse = _to_hold(full, held | zeroed | wrong, drifting, values)
        if not wrong and not worse and (held | zeroed) == _fixed(model, theta, held, zeroed):
            break
        zeroed |= wrong
        held |= worse
        for k, name in enumerate(model.names):
            if name in held or name in zeroed:
                theta[k] = -model.start[k] / model.scale[k] if name in zeroed else 0.0
        theta = simulable(model, theta, full.noise, model.sections)
        free = np.array([name not in held | zeroed for name in model.names])
        theta, _ = minimise(model, theta, full.noise, model.sections, free=free)
    return theta, tuple(k for k in model.names if k in held), tuple(k for k in model.names if k in zeroed)


def _fixed(model: Model, theta: Array, held: set[str], zeroed: set[str]) -> set[str]:
    # names that have the values at which they are to be fixed
    at = dict(zip(model.names, theta[: model.size], strict=True))
    zero = dict(zip(model.names, -model.start / model.scale, strict=True))
    return {k for k in held if at[k] == 0.0} | {k for k in zeroed if at[k] == zero[k]}


def _to_hold(full: _Full, fixed: set[str], drifting: frozenset[str], values: Mapping[str, float]) -> set[str]:
    # parameters to hold at their start values: the worst, then the worst of those left, until all are determined
    model, covariance, worse = full.model, full.spread.covariance, set[str]()
    while True:
        free = [k for k, name in enumerate(model.names) if name not in fixed | worse]
        others = [k for k in range(model.size) if k not in free]
        part = covariance[np.ix_(free, free)]
        if others:  # the covariance if the others are known
            cross = covariance[np.ix_(free, others)]
            part = part - cross @ np.linalg.lstsq(covariance[np.ix_(others, others)], cross.T, rcond=None)[0]
        half = full.spread.quantile * np.sqrt(np.maximum(np.diag(part), 0.0)) * model.scale[free]
        estimates = {name: (values[name], 0.0) for name in model.names}
        estimates |= {model.names[k]: (values[model.names[k]], float(h)) for k, h in zip(free, half, strict=True)}
        ratios = {k: _ratio(model, estimates, k) for j in free if (k := model.names[j]) not in drifting}
        worst = max(ratios, key=lambda k: (ratios[k], k not in MASS_OF), default=None)
        if worst is None or ratios[worst] <= 1.0:
            return worse
        worse.add(worst)


def _negative_notes(zeroed: tuple[str, ...], estimates: Mapping[str, tuple[float, float]]) -> list[str]:
    notes = []
    for key in zeroed:
        value, half = estimates[key]
        if value + half < 0:
            notes.append(
                f"drag below 0: the model is wrong ({key} = {value:.3g} ± {half:.2g}); {key} is fixed at 0 and the "
                "other parameters are fitted with it; check the signs and scales of thrust and motion"
            )
        else:
            notes.append(f"{key} is fixed at 0: its estimate alone ({value:.3g} ± {half:.2g}) may be negative")
    return notes


def _vehicle(result: Identified, values: Mapping[str, float], log: MotionLog, name: str, *, coloured: bool) -> Vehicle:
    # `coloured`: the residuals show that the model misses something
    span = f"{len(log.time)} rows, {log.time[-1] - log.time[0]:.4g} s"
    known = dict(result.start.parameters)
    for key, (estimate, half) in result.estimates.items():
        prior, spec = known.get(key), SPECS[key]
        if key in result.held and prior is None:
            continue  # a constant force that does not differ from 0
        if key in result.held and prior is not None:
            said = f"{prior.provenance} (not identifiable from {log.source})"
            known[key] = Parameter(prior.value, prior.unit, prior.range, said)
            continue
        value = values[key] if spec.signed else max(values[key], 0.0)
        low, high = min(estimate - half, value), max(estimate + half, value)
        bounds = (low if spec.signed else max(low, 0.0), high)
        if key in result.zeroed:
            said = f"fixed at 0, because its estimate from {log.source} is {estimate:.4g} ± {half:.2g}"
            wrong = estimate + half < 0
            known[key] = Parameter(0.0, spec.unit, None if wrong else bounds, said + "; the model is wrong" * wrong)
        elif key in result.identified:
            said = f"identified from {log.source}, {span}; range: 95 % interval"
            said += " of a model that misses something, so the true value may lie outside" * coloured
            known[key] = Parameter(value, spec.unit, bounds, said)
        elif key in result.drifting:
            said = f"mean of a force that drifts, fitted to {log.source}, {span}"
            known[key] = Parameter(value, spec.unit, bounds, said)
        else:
            said = f"fitted to {log.source}, {span}, together with the start values of {', '.join(result.held)}"
            known[key] = Parameter(value, spec.unit, None, said)
    return replace(result.start, name=name, note=f"{result.start.name} fitted to a log", parameters=known, source="")


def _roughness(values: Array) -> float:
    # sd of the second differences divided by √6: estimate of white noise on a smooth signal
    return max(float(np.std(np.diff(values, 2))) / np.sqrt(6.0), 1e-4) if len(values) > 2 else 1.0


HELD_OUT = 0.4
"""Share of a log, at its end, that is predicted by a fit to the rest."""


def held_out_windows(
    log: MotionLog, start: Vehicle, windows: Sequence[float], *, share: float = HELD_OUT
) -> tuple[Prediction, ...]:
    """Predict the last part of a log over windows of several lengths with one fit to the part before.

    Lengths for which the log has no window are omitted.

    Args:
        windows: lengths of the windows [s].
        share: share of the time that is predicted.
    """
    cut = int(np.searchsorted(log.time, log.time[0] + (1.0 - share) * (log.time[-1] - log.time[0])))
    results = []
    try:
        parts = log.halves(cut)
        fitted = identify(parts[0], start, name=start.name).vehicle
    except InputError:  # one part is too short, or has no motion
        return ()
    for window in windows:
        with suppress(InputError):  # no part of the log is so long
            results.append(predict(parts[1], fitted, window=window))
    return tuple(results)
