"""A vehicle fitted to a log: output-error least squares with 95 % intervals, and what the log cannot tell.

The simulated motion is fitted to the measured one (Ljung 1999, section 7.4; Tischler & Remple 2012), so noise in the
measurements does not bias masses and drag, as it would if measured velocities were differentiated. With white noise
in each column the estimate is the maximum-likelihood one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
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
"""Parameters that a log tells something of."""

_MASS_OF = dict(zip(FITTED[4:12], 2 * FITTED[:4], strict=True))  # of each drag
_STEP = 0.05  # s; longest step of the integration
_LEAST_LAG = 0.02  # s; below it the integration would need shorter steps
_PRIOR = 2.0  # sd of the relative change of a parameter before the log is read
_NARROW = 0.5  # largest half-interval of a number that the log tells, over its size
_CONVERGED = 1e-6  # relative change of the cost that is none: a cost of 1000 counts in whole numbers
_TRIES = 40
_FIRST_ROWS, _LONGER, _NEAR = 50, 1.5, 1e-3  # of the fits that find where to begin, and when they are good enough
_ROUNDS = 4  # of fit and noise levels
_WHITE = 4.0  # correlation of neighbouring residuals, over its sd, from which they are no noise
_ROUNDING = 1e-6  # sd of what is left [m, rad, m/s, rad/s] that no instrument has
_NORMAL = 1.959963984540054


@dataclass(frozen=True, eq=False)
class Identified:
    """What a log tells.

    Attributes:
        vehicle: the fitted numbers with their intervals as ranges; what the log cannot tell is as in `start`.
        start: the vehicle that the fit began with.
        estimates: name → (estimate, half of its 95 % interval), of all that were fitted.
        identified: the names whose interval is narrow enough to be of use.
        noise: column → sd of what the fit leaves over.
        notes: what speaks against the intervals.
    """

    vehicle: Vehicle
    start: Vehicle
    estimates: Mapping[str, tuple[float, float]]
    identified: tuple[str, ...]
    noise: Mapping[str, float]
    notes: tuple[str, ...]


def identify(log: MotionLog, start: Vehicle, *, name: str) -> Identified:
    """Fit masses, drag and thrust lag of `start` to the log, with its unknown initial motion.

    Still water is assumed, and that the thrusters give what is commanded after a first-order lag. What they gave when
    the log began is fitted too. A start vehicle without lag keeps none. Thrust limits and radius are the
    start's: a log does not show them.

    Raises:
        InputError: the simulated motion is not finite: motion and thrust do not belong together.

    Example:
        >>> import numpy as np
        >>> from surctl.vehicle import MotionLog, identify, load_vehicle
        >>> boat, t = load_vehicle("sur400"), 0.1 * np.arange(300)
        >>> force = np.where(t % 10 < 5, 4.0, -2.0)  # N, in surge; Euler's steps of 1 ms are the truth
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
        theta = _flyable(problem, theta, noise)
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
        (() if converged else ("the fit has not settled: estimates and intervals are rough",)) + _notes(left, present),
    )


def _begun(log: MotionLog, start: Vehicle, noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """θ of the first rows, then of half as many more, and so on.

    Over the whole log a simulated heading that is off by more than half a turn has minima of its own, in which the fit
    would stay; over a short one it is not.
    """
    from scipy.optimize import least_squares

    theta, rows = _Problem(log, start).first, _FIRST_ROWS
    while rows < len(log.time):
        if np.isfinite(log.motion[:rows]).any():
            part = _Problem(MotionLog(log.time[:rows], log.motion[:rows], log.thrust[:rows], log.source), start)
            theta = _flyable(part, theta, noise)
            theta = least_squares(
                part.residuals, theta, part.jacobian, part.bounds, ftol=_NEAR, max_nfev=_TRIES, args=(noise,)
            ).x
        rows = int(rows * _LONGER)
    return theta


def _flyable(problem: _Problem, theta: NDArray[np.float64], noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """θ itself, or as much of it as gives a motion that stays finite over the log.

    What a short log says of drag may be below 0, and over a longer one the motion then runs away.

    Raises:
        InputError: no motion is finite, not that of the start vehicle either: motion and thrust do not belong together.
    """
    for share in (1.0, 0.5, 0.25, 0.0):
        tried = np.concatenate([share * theta[: len(problem.names)], theta[len(problem.names) :]])
        for candidate in (tried, problem.first) if share == 0.0 else (tried,):
            with np.errstate(over="ignore", invalid="ignore"):
                cost = np.sum(problem.residuals(candidate, noise) ** 2)
            if np.isfinite(cost):
                return candidate
    raise InputError(
        "no motion fits it",
        file=problem.log.source,
        remedy="check units and signs of thrust and motion (x forward, y left, z up, psi counter-clockwise)",
    )


def _moved(velocities: NDArray[np.float64], noise: NDArray[np.float64], measured: NDArray[np.bool_]) -> frozenset[str]:
    """Masses of the axes that moved by more than noise.

    On an axis that stood still the fit makes of the noise a motion of its own, which its mass then seems to explain.
    """
    x, y, z, psi, *rates = noise  # where no velocity was measured: the noise of what it gives in a second
    has_rate = measured[4:]
    level = np.where(has_rate, rates, [max(x, y), max(x, y), z, psi])
    return frozenset(np.array(FITTED[:4])[np.sqrt(np.mean(velocities**2, axis=1)) > level].tolist())


def _identified(
    estimates: Mapping[str, tuple[float, float]], scale: Mapping[str, float], moved: frozenset[str]
) -> tuple[str, ...]:
    """The names whose interval is narrow: masses and lag against the estimate, drag, which may be 0, or the start.

    A motion shows drag over mass only, so that an axis whose mass is open leaves its drag open.
    """
    held = frozenset(FITTED[:4]) - moved

    def narrow(key: str) -> bool:
        value, half = estimates[key]
        return half <= _NARROW * (max(abs(value), scale[key]) if key in _MASS_OF else value)

    def shown(mass: str) -> bool:
        return narrow(mass) and mass not in held

    return tuple(key for key in estimates if narrow(key) and shown(_MASS_OF.get(key, key)))


def _spread(slope: NDArray[np.float64]) -> NDArray[np.float64]:
    """sd of each θ from the slopes of the residuals over their noise: √diag (SᵀS)⁻¹, where SᵀS is near singular too."""
    size = np.linalg.norm(slope, axis=0)
    size[size == 0] = 1.0  # the begin of what was not measured and acts on nothing
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
            said = f"{prior.provenance} ({log.source} cannot tell it)"
            known[key] = Parameter(prior.value, prior.unit, prior.range, said)
    return Vehicle(name, f"{start.name} fitted to a log", known)


def _roughness(values: NDArray[np.float64]) -> float:
    """A first guess of white noise on a smooth signal: sd of the second differences over √6."""
    return max(float(np.std(np.diff(values, 2))) / np.sqrt(6.0), 1e-4) if len(values) > 2 else 1.0


def _notes(left: NDArray[np.float64], present: NDArray[np.bool_]) -> tuple[str, ...]:
    """Columns whose residuals are no white noise: then the model leaves something out, and intervals are too short."""
    said = []
    for k, column in enumerate(LOG_MOTION):
        e = left[present[:, k], k]
        if len(e) < 3 or np.sqrt(np.mean(e**2)) < _ROUNDING:
            continue
        alike = float(e[1:] @ e[:-1] / (e @ e))
        if abs(alike) * np.sqrt(len(e)) > _WHITE:
            said.append(
                f"what is left of {column} is no white noise (correlation {alike:+.2f} from row to row): current, "
                "filtered measurements or another drag law; the intervals are too short"
            )
    return tuple(said)


class _Problem:
    """Residuals of a log over θ: relative changes of the parameters, then motion (8,) and thrust (4,) at its begin."""

    def __init__(self, log: MotionLog, start: Vehicle) -> None:
        self.log = log
        lagged = start["thrust_lag"] > 0
        self.names = tuple(k for k in FITTED if k != "thrust_lag" or lagged)
        self.start = np.array([start[k] for k in self.names])
        # a drag that is 0 at the start moves on the scale of what the axis has
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
        # masses stay positive; a drag near 0 may come out below it, else its interval would be wrong
        low = np.full(len(self.first), -np.inf)
        low[:4] = -0.95
        if lagged:
            low[len(self.names) - 1] = min(_LEAST_LAG / self.lag - 1.0, -1e-3)
        self.bounds = (low, np.full(len(low), np.inf))

    def _run(self, theta: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """States (12, n) over the log, and the parameters (13,)."""
        n = len(self.names)
        p = np.zeros(13)
        p[:n] = self.start + self.scale * theta[:n]
        begin, dt = theta[n:], np.diff(self.log.time)
        after = self.steps(begin, self.log.thrust[:-1].T, np.tile(p[:, None], len(dt)), dt[None, :])
        return np.column_stack([begin, np.asarray(after)]), p

    def velocities(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """(4, n) u, v, w, r as simulated."""
        return self._run(theta)[0][4:8]

    def misfit(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 8) simulated less measured; 0 where nothing was measured."""
        x, _ = self._run(theta)
        return np.where(self.present, x[:8].T - np.where(self.present, self.log.motion, 0.0), 0.0)

    def residuals(self, theta: NDArray[np.float64], noise: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([(self.misfit(theta) / noise)[self.present], self._prior(theta)])

    def _prior(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Holds what the log says nothing of: relative changes near 0, the first thrust near its command."""
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
    """(rows, n * width) side by side → (n, rows, width)."""
    flat = np.asarray(blocks)
    return flat.reshape(flat.shape[0], -1, width).transpose(1, 0, 2)


@cache
def _stepper(parts: int, lagged: bool) -> tuple[ca.Function, ca.Function]:
    """(x (12,), thrust (4,), p (13,) in the order of `FITTED`, dt) → the state after dt, and its Jacobians.

    RK4 in `parts` steps of the plant (1)–(3) in still water.
    """
    x, thrust, p, dt = ca.SX.sym("x", 12), ca.SX.sym("thrust", 4), ca.SX.sym("p", 13), ca.SX.sym("dt")
    limits = ca.DM.ones(4) * 1e12  # what was commanded is what acts
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
