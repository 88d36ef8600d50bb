"""Identification of a vehicle from a log by output-error least squares, with 95 % intervals and identifiability test.

The simulated motion is fitted to the measured motion (Ljung 1999, section 7.4; Tischler & Remple 2012). Measurement
noise therefore does not bias the estimated masses and drag, as it would if measured velocities were differentiated. If
the noise in each column of the log is white, the result is the maximum-likelihood estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.vehicle.dynamics import PLANT_DISTURBANCE, build_plant
from surctl.vehicle.motion_log import LOG_MOTION, MotionLog
from surctl.vehicle.parameters import PARAMETERS, Parameter, Vehicle

__all__ = ["FITTED", "Identified", "identify"]

FITTED = (
    "m11", "m22", "m33", "m44", "Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr", "thrust_lag",
)  # fmt: skip
"""Parameters that can be identified from a log."""

_MASS_OF = dict(zip(FITTED[4:12], 2 * FITTED[:4], strict=True))  # mass on the axis of each drag parameter
_STEP = 0.05  # [s] longest integration step
_LEAST_LAG = 0.02  # [s] smallest thrust lag; a smaller one would need shorter integration steps
_PRIOR = 2.0  # prior standard deviation of the relative change of a parameter
_NARROW = 0.5  # largest ratio of half-interval to value of an identified parameter
_CONVERGED = 1e-6  # relative change of the cost at which a fit has converged
_TRIES = 40
_FIRST_ROWS, _LONGER, _NEAR = 50, 1.5, 1e-3  # first fit: number of log lines, growth per fit, tolerance
_ROUNDS = 4  # largest number of alternations between fit and noise estimate
_WHITE = 4.0  # correlation of neighbouring residuals over its standard deviation, above which they are not white noise
_ROUNDING = 1e-6  # [m, rad, m/s, rad/s] residual standard deviation that is only rounding
_NORMAL = 1.959963984540054


@dataclass(frozen=True, eq=False)
class Identified:
    """The result of fitting a vehicle to a log.

    Attributes:
        vehicle: the vehicle with the fitted values, whose ranges are their 95 % intervals; parameters that are not
            identified have the values of `start`.
        start: the vehicle whose parameters are the initial values of the fit.
        estimates: for every fitted parameter by name, the estimate and half the width of its 95 % interval.
        identified: names of the parameters whose 95 % interval is sufficiently narrow.
        noise: standard deviation of the residuals, by column of the log.
        notes: possible reasons why the 95 % intervals are wrong.
    """

    vehicle: Vehicle
    start: Vehicle
    estimates: Mapping[str, tuple[float, float]]
    identified: tuple[str, ...]
    noise: Mapping[str, float]
    notes: tuple[str, ...]


def identify(log: MotionLog, start: Vehicle, *, name: str) -> Identified:
    """Fit masses, drag and thrust lag of the vehicle `start` to a log, together with the unknown initial motion.

    The model assumes still water, and thrust that follows its command with a first-order lag. The fit also estimates
    the thrust at the start of the log. If `start` has no thrust lag, the fitted vehicle has no thrust lag. Thrust
    limits and radius are those of `start`, because they cannot be identified from a log.

    Raises:
        InputError: no simulated motion is finite, which shows that the columns of motion and thrust do not match.

    Example:
        >>> import numpy as np
        >>> from surctl.vehicle import MotionLog, identify, load_vehicle
        >>> boat, t = load_vehicle("sur400"), 0.1 * np.arange(300)
        >>> force = np.where(t % 10 < 5, 4.0, -2.0)  # N, in surge; the true motion uses Euler steps of 1 ms
        >>> motion, thrust, x, u, f = np.zeros((300, 8)), np.outer(force, [1, 0, 0, 0]), 0.0, 0.0, 4.0
        >>> for k in range(1, 300):
        ...     for _ in range(100):
        ...         f += 1e-3 * (force[k - 1] - f) / 0.3
        ...         x, u = x + 1e-3 * u, u + 1e-3 * (f - 2.0 * u - 29.5 * u * abs(u)) / 60.0
        ...     motion[k, [0, 4]] = x, u
        >>> result = identify(MotionLog(t, motion, thrust, "log.csv"), boat, name="heavier")
        >>> round(result.estimates["m11"][0], 1), "m11" in result.identified, "m22" in result.identified
        (60.0, True, False)
    """
    from scipy.optimize import least_squares  # slow to import

    problem = _Problem(log, start)
    present = np.isfinite(log.motion)
    noise = np.array([_roughness(log.motion[p, k]) for k, p in enumerate(present.T)])
    theta, converged = _begun(log, start, noise), False
    for _ in range(_ROUNDS):
        theta = _simulable(problem, theta, noise)
        fit = least_squares(
            problem.residuals, theta, problem.jacobian, problem.bounds, ftol=_CONVERGED, max_nfev=_TRIES, args=(noise,)
        )
        converged = fit.status > 0
        theta, before = fit.x, noise
        left = problem.misfit(theta)
        freedom = 1.0 - len(theta) / max(int(present.sum()), len(theta) + 1)
        left_over = [np.mean(left[p, k] ** 2) if p.any() else 1.0 for k, p in enumerate(present.T)]
        noise = np.maximum(np.sqrt(np.array(left_over) / freedom), 1e-9)
        if np.allclose(noise, before, rtol=1e-3):
            break
    spread = _spread(problem.jacobian(theta, noise))
    estimates = {
        key: (float(problem.start[k] + problem.scale[k] * theta[k]), float(_NORMAL * problem.scale[k] * spread[k]))
        for k, key in enumerate(problem.names)
    }
    moved = _moved(problem.velocities(theta), noise, np.atleast_1d(present.any(axis=0)))
    identified = _identified(estimates, dict(zip(problem.names, problem.scale, strict=True)), moved)
    return Identified(
        _vehicle(start, estimates, identified, log, name),
        start,
        estimates,
        identified,
        {c: float(noise[k]) for k, c in enumerate(LOG_MOTION) if present[:, k].any()},
        (() if converged else ("the fit has not converged: estimates and intervals are rough",))
        + _notes(left, present),
    )


def _begun(log: MotionLog, start: Vehicle, noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an initial guess of θ, fitted to the first lines of the log, then to 1.5 times as many, and so on.

    Over the whole log, a simulated heading may be wrong by more than half a turn; then the fit would end in a local
    minimum. Over a short part of the log, the error of the simulated heading is smaller.
    """
    from scipy.optimize import least_squares

    theta, rows = _Problem(log, start).first, _FIRST_ROWS
    while rows < len(log.time):
        if np.isfinite(log.motion[:rows]).any():
            part = _Problem(MotionLog(log.time[:rows], log.motion[:rows], log.thrust[:rows], log.source), start)
            theta = _simulable(part, theta, noise)
            theta = least_squares(
                part.residuals, theta, part.jacobian, part.bounds, ftol=_NEAR, max_nfev=_TRIES, args=(noise,)
            ).x
        rows = int(rows * _LONGER)
    return theta


def _simulable(problem: _Problem, theta: NDArray[np.float64], noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return θ, if necessary nearer to the start vehicle, so that the simulated motion over the log is finite.

    A fit to a short part of the log may give a negative drag. With a negative drag, the simulated motion over the whole
    log can diverge.

    Raises:
        InputError: no simulated motion is finite, not even for the start vehicle, so motion and thrust do not match.
    """
    for share in (1.0, 0.5, 0.25, 0.0):
        tried = np.concatenate([share * theta[: len(problem.names)], theta[len(problem.names) :]])
        for candidate in (tried, problem.first) if share == 0.0 else (tried,):
            with np.errstate(over="ignore", invalid="ignore"):
                cost = np.sum(problem.residuals(candidate, noise) ** 2)
            if np.isfinite(cost):
                return candidate
    raise InputError(
        "no simulated motion fits the log",
        file=problem.log.source,
        remedy="check units and signs of thrust and motion (x forward, y left, z up, psi counter-clockwise)",
    )


def _moved(velocities: NDArray[np.float64], noise: NDArray[np.float64], measured: NDArray[np.bool_]) -> frozenset[str]:
    """Return the names of the masses on axes that moved by more than the noise.

    If an axis is at rest, the fit interprets noise as motion, and the mass of this axis wrongly seems to be identified.
    """
    x, y, z, psi, *rates = noise  # an axis without a measured velocity uses the position noise per second
    has_rate = measured[4:]
    level = np.where(has_rate, rates, [max(x, y), max(x, y), z, psi])
    return frozenset(np.array(FITTED[:4])[np.sqrt(np.mean(velocities**2, axis=1)) > level].tolist())


def _identified(
    estimates: Mapping[str, tuple[float, float]], scale: Mapping[str, float], moved: frozenset[str]
) -> tuple[str, ...]:
    """Return the names of the parameters whose 95 % interval is narrow relative to the estimate.

    The interval of a drag parameter, which may be 0, is relative to the larger of the estimate and the start value. A
    motion shows only the ratio of drag to mass. So if the mass of an axis is not identified, its drag is not identified
    either.
    """
    held = frozenset(FITTED[:4]) - moved

    def narrow(key: str) -> bool:
        value, half = estimates[key]
        return half <= _NARROW * (max(abs(value), scale[key]) if key in _MASS_OF else value)

    def shown(mass: str) -> bool:
        return narrow(mass) and mass not in held

    return tuple(key for key in estimates if narrow(key) and shown(_MASS_OF.get(key, key)))


def _spread(slope: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard deviations √diag (SᵀS)⁻¹ of θ, where S is the Jacobian of the normalised residuals.

    The result is also valid if SᵀS is nearly singular.
    """
    size = np.linalg.norm(slope, axis=0)
    size[size == 0] = 1.0  # initial value of a quantity that is not measured and has no effect
    _, s, vh = np.linalg.svd(slope / size, full_matrices=False)
    s = np.maximum(s, len(slope) * np.finfo(float).eps * s[0])
    sd: NDArray[np.float64] = np.linalg.norm(vh.T / s, axis=1) / size
    return sd


def _vehicle(
    start: Vehicle, estimates: Mapping[str, tuple[float, float]], identified: tuple[str, ...], log: MotionLog, name: str
) -> Vehicle:
    span = f"{len(log.time)} rows, {log.time[-1] - log.time[0]:.4g} s"
    known = dict(start.parameters)
    for key in FITTED:
        if key in identified:
            value, half = estimates[key]
            said = f"identified from {log.source}, {span}; range: 95 % interval"
            bounds = max(value - half, 0.0), max(value + half, 0.0)
            known[key] = Parameter(max(value, 0.0), PARAMETERS[key].unit, bounds, said)
        elif key in estimates:
            prior = known[key]
            said = f"{prior.provenance} (not identifiable from {log.source})"
            known[key] = Parameter(prior.value, prior.unit, prior.range, said)
    return replace(start, name=name, note=f"{start.name} fitted to a log", parameters=known, source="")


def _roughness(values: NDArray[np.float64]) -> float:
    # sd of the second differences divided by √6: estimate of white noise on a smooth signal
    return max(float(np.std(np.diff(values, 2))) / np.sqrt(6.0), 1e-4) if len(values) > 2 else 1.0


def _notes(left: NDArray[np.float64], present: NDArray[np.bool_]) -> tuple[str, ...]:
    # if the residuals are not white, model or data are incomplete and the intervals are too short
    said = []
    for k, column in enumerate(LOG_MOTION):
        e = left[present[:, k], k]
        if len(e) < 3 or np.sqrt(np.mean(e**2)) < _ROUNDING:
            continue
        alike = float(e[1:] @ e[:-1] / (e @ e))
        if abs(alike) * np.sqrt(len(e)) > _WHITE:
            said.append(
                f"the residual of {column} is not white noise (correlation {alike:+.2f} from row to row), so the "
                "intervals are too short; possible causes: a current, filtered measurements, another drag law"
            )
    return tuple(said)


class _Problem:
    """The residuals of a log as a function of the vector θ of fitted quantities.

    θ contains the relative changes of the parameters, the motion (8,) at the start of the log, and the thrust (4,) at
    the start of the log.
    """

    def __init__(self, log: MotionLog, start: Vehicle) -> None:
        self.log = log
        lagged = start["thrust_lag"] > 0
        self.names = tuple(k for k in FITTED if k != "thrust_lag" or lagged)
        self.start = np.array([start[k] for k in self.names])
        # a drag whose start value is 0 is scaled by the quadratic drag of its axis
        floor = {"X": start["Xuu"], "Y": start["Yvv"], "Z": start["Zww"], "N": start["Nrr"]}
        self.scale = np.array(
            [v if v > 0 else max(0.1 * floor.get(k[0], 1.0), 1e-3) for k, v in zip(self.names, self.start, strict=True)]
        )
        self.lag = start["thrust_lag"]
        self.present = np.isfinite(log.motion)
        step, slope = _stepper(int(np.ceil(np.diff(log.time).max() / _STEP)), lagged)
        self.steps, self.slopes = step.mapaccum(len(log.time) - 1), slope.map(len(log.time) - 1)
        began = [log.motion[p, k][0] if p.any() else 0.0 for k, p in enumerate(self.present.T)]
        self.first = np.concatenate([np.zeros(len(self.names)), began, log.thrust[0]])
        self.thrust = start.thrust_limit
        # masses are positive; an estimate of a drag near 0 may be negative, otherwise its interval would be wrong
        low = np.full(len(self.first), -np.inf)
        low[:4] = -0.95
        if lagged:
            low[len(self.names) - 1] = min(_LEAST_LAG / self.lag - 1.0, -1e-3)
        self.bounds = (low, np.full(len(low), np.inf))

    def _run(self, theta: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        # simulated states (12, n) over the log, and parameters (13,)
        n = len(self.names)
        p = np.zeros(13)
        p[:n] = self.start + self.scale * theta[:n]
        begin, dt = theta[n:], np.diff(self.log.time)
        after = self.steps(begin, self.log.thrust[:-1].T, np.tile(p[:, None], len(dt)), dt[None, :])
        return np.column_stack([begin, np.asarray(after)]), p

    def velocities(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        # u, v, w, r (4, n)
        return self._run(theta)[0][4:8]

    def misfit(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        # simulated minus measured motion (n, 8); 0 where no measurement exists
        x, _ = self._run(theta)
        return np.where(self.present, x[:8].T - np.where(self.present, self.log.motion, 0.0), 0.0)

    def residuals(self, theta: NDArray[np.float64], noise: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([(self.misfit(theta) / noise)[self.present], self._prior(theta)])

    def _prior(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        # holds unobservable θ near a prior: unchanged parameters, initial thrust as commanded
        return np.concatenate([theta[: len(self.names)] / _PRIOR, (theta[-4:] - self.log.thrust[0]) / self.thrust])

    def jacobian(self, theta: NDArray[np.float64], noise: NDArray[np.float64]) -> NDArray[np.float64]:
        x, p = self._run(theta)
        n, rows = len(self.names), len(self.log.time)
        over_x, over_p = self.slopes(x[:, :-1], self.log.thrust[:-1].T, p, np.diff(self.log.time))
        steps, turns = _cut(over_x, 12), _cut(over_p, 13)
        here = np.hstack([np.zeros((12, n)), np.eye(12)])
        all_rows = np.empty((rows, 8, n + 12))
        all_rows[0] = here[:8]
        for k in range(rows - 1):
            here = steps[k] @ here
            here[:, :n] += turns[k][:, :n] * self.scale
            all_rows[k + 1] = here[:8]
        prior = np.zeros((n + 4, n + 12))
        prior[:n, :n] = np.eye(n) / _PRIOR
        prior[n:, -4:] = np.diag(1 / self.thrust)
        return np.vstack([(all_rows / noise[:, None])[self.present], prior])


def _cut(blocks: ca.DM, width: int) -> NDArray[np.float64]:
    # (rows, n * width) → (n, rows, width)
    flat = np.asarray(blocks)
    return flat.reshape(flat.shape[0], -1, width).transpose(1, 0, 2)


@cache
def _stepper(parts: int, lagged: bool) -> tuple[ca.Function, ca.Function]:
    """Return two functions of state x (12,), thrust (4,), p (13,) and dt: the state after dt, and its Jacobians.

    The functions integrate equations (1)–(3) of the paper in still water by RK4 in `parts` steps. The parameters p have
    the order of `FITTED`.
    """
    x, thrust, p, dt = ca.SX.sym("x", 12), ca.SX.sym("thrust", 4), ca.SX.sym("p", 13), ca.SX.sym("dt")
    limits = ca.DM.ones(4) * 1e12  # the thrust in the log is not limited again
    plant = ca.vertcat(p[0:4], p[4:8], p[8:12], limits, p[12] if lagged else 0)
    still = ca.DM.zeros(PLANT_DISTURBANCE.size)
    ode, state, h = build_plant().ode, x, dt / parts
    for _ in range(parts):
        k1 = ode(state, thrust, still, plant)
        k2 = ode(state + h / 2 * k1, thrust, still, plant)
        k3 = ode(state + h / 2 * k2, thrust, still, plant)
        k4 = ode(state + h * k3, thrust, still, plant)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    arguments = [x, thrust, p, dt]
    return (
        ca.Function("step", arguments, [state], {"cse": True}),
        ca.Function("slope", arguments, [ca.jacobian(state, x), ca.jacobian(state, p)], {"cse": True}),
    )
