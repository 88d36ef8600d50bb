"""Many closed loops at once: plant, sensors, an estimator and the velocity controller, one column per run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal, NamedTuple, get_args

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.control.velocity import velocity_control
from surctl.ir import Layout, Port
from surctl.sensing import OwnState, OwnStateFilter
from surctl.sensing.localisation.design import steady_covariance
from surctl.simulation import advance
from surctl.vehicle import PLANT_DISTURBANCE, PLANT_STATE, Vehicle, plant_parameters

DT, HALVES = 0.05, 2  # [s]; calls of the plant in a control period
APPROACH = 0.3  # [1/s] of the position loop
CAP = 0.25  # [m/s] of the desired velocity
_BELIEVED = ("mass", "linear_drag", "quadratic_drag", "thrust_limit")
_GIVEN = (("fix", 3), ("fix_fresh", 1), ("yaw", 1), ("yaw_rate", 1), ("tau", 4))
MODEL = Layout(tuple(Port(name, (4,), "SI", "") for name in _BELIEVED))
GIVEN = Layout(tuple(Port(name, (size,), "SI", "") for name, size in _GIVEN))

Estimator = Literal["filter", "constant noise", "fixed gain", "as if now", "differences", "truth"]
ESTIMATORS: tuple[Estimator, ...] = get_args(Estimator)
"""Estimates that the controller may use: the filter's; that of a filter whose noise does not grow with the modelled
acceleration; of one with its steady-state gain; of one that ignores the delay of the fixes; the last fix with the
difference of the last two; or the true state."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Leg:
    """A duration [s] at a velocity in {E} [m/s]."""

    seconds: float
    velocity: tuple[float, float]


@dataclass(frozen=True)
class Mission:
    """Legs one after another, joined by at most `acceleration` [m/s²], under a constant spin [rad/s]."""

    legs: Sequence[Leg]
    spin: float
    acceleration: float = 0.04

    def path(self) -> tuple[Array, Array]:
        """Return position and velocity (steps, 3) in {E}."""
        wanted = np.vstack([np.tile((*leg.velocity, 0.0), (round(leg.seconds / DT), 1)) for leg in self.legs])
        velocity, now = np.zeros_like(wanted), np.zeros(3)
        for k, goal in enumerate(wanted):
            step = goal - now
            now = now + step * min(1.0, self.acceleration * DT / max(float(np.linalg.norm(step)), 1e-12))
            velocity[k] = now
        return np.cumsum(velocity, axis=0) * DT, velocity


@dataclass(frozen=True)
class Water:
    """A sinusoidal force [N] with a period [s] and a current [m/s], each in a random direction for every run."""

    wave: float = 0.0
    period: float = 3.0
    current: float = 0.0


class Flight(NamedTuple):
    """Results (steps, size, runs): true state, estimate, standard deviations of the filter, and command."""

    eta: Array
    nu: Array
    eta_hat: Array
    nu_hat: Array
    position_sd: Array
    velocity_sd: Array
    age: Array
    refused: Array
    tau: Array


def fly(
    vehicle: Vehicle,
    believed: Vehicle,
    mission: Mission,
    *,
    runs: int,
    seed: int,
    water: Water | None = None,
    sensors: OwnState | None = None,
    estimator: Estimator = "filter",
    k_v: float = 2.0,
) -> Flight:
    """Simulate `runs` loops together, with noise and directions from the seed.

    Args:
        vehicle: the simulated vehicle.
        believed: the vehicle in the model of filter and controller.
        mission: the reference.
        runs: number of runs.
        seed: the same for every estimator, so that all have the same noise.
        water: default still.
        sensors: default `OwnState()`.
        estimator: the estimate that the controller uses.
        k_v: bandwidth of the velocity loops [1/s].
    """
    rng, water, sensors = np.random.default_rng(seed), water or Water(), sensors or OwnState()
    known = _Known(estimator, sensors, runs)
    control, move = _control(runs, k_v), advance().map(runs)
    p = np.tile(plant_parameters(vehicle)[:, None], runs)
    model = np.tile(MODEL.pack({name: getattr(believed, name) for name in _BELIEVED})[:, None], runs)
    turns = rng.uniform(0, 2 * np.pi, (4, runs))
    d = np.zeros((PLANT_DISTURBANCE.size, runs))
    d[:2] = water.current * np.vstack([np.cos(turns[0]), np.sin(turns[0])])
    push = water.wave * np.vstack([np.cos(turns[1]), np.sin(turns[1])])
    x = np.tile(PLANT_STATE.pack()[:, None], runs)
    x[3] = turns[2]
    ring, tau, rows = [x[:3].copy()] * (sensors.fixes.late(DT) + 1), np.zeros((4, runs)), []
    for tick, (place, velocity) in enumerate(zip(*mission.path(), strict=True)):
        ring = [x[:3].copy(), *ring[:-1]]
        noise = rng.standard_normal((6, runs))
        told = [sensors.fix(ring[-1][:, k], tick, noise=noise[:4, k], dt=DT) for k in range(runs)]
        fix, fresh = np.array([t[0] for t in told]).T, np.array([[float(t[1]) for t in told]])
        imu = np.array([sensors.imu(x[:4, k], x[4:8, k], noise=noise[4:, k]) for k in range(runs)]).T
        given = np.vstack([fix, fresh, imu, tau])
        eta, nu, *rest = known.step(x, given, model)
        reference = np.tile(np.array([*place, *velocity, mission.spin])[:, None], runs)
        tau = np.array(control(eta, nu, reference, model))
        rows.append((x[:4], x[4:8], eta, nu, *rest, tau))
        for half in range(HALVES):
            d[3:5] = push * np.sin(2 * np.pi * (tick + half / HALVES) * DT / water.period + turns[3])
            x = np.array(move(x, tau, d, p))
    return Flight(*(np.array(column) for column in zip(*rows, strict=True)))


class _Known:
    """An estimator and its state."""

    def __init__(self, estimator: Estimator, sensors: OwnState, runs: int) -> None:
        own = OwnStateFilter(dt=DT, latency=sensors.fixes.latency)
        if estimator == "as if now":
            own = replace(own, latency=0.0)
        if estimator == "constant noise":
            own = replace(own, model_noise=0.0)
        if estimator == "fixed gain":
            own = replace(own, gate=1e6)
        self.estimator, self.own = estimator, own
        self.function, self.layout = _filter(own, runs)
        self.state = np.tile(self.layout.pack()[:, None], runs)
        P = steady_covariance(*own.step, fix_variance=own.position_sd**2, every=sensors.fixes.every(DT))
        self.settled = own.step[0] @ P @ own.step[0].T + own.step[1]
        self.last, self.velocity, self.since = np.zeros((3, runs)), np.zeros((3, runs)), np.full(runs, np.inf)

    def step(self, x: Array, given: Array, model: Array) -> tuple[Array, ...]:
        """Return η̂, ν̂, their standard deviations, the age of the fix, and the number of fixes rejected in a row."""
        if self.estimator == "fixed gain":
            self.state[self.layout.slice("covariance")] = self.settled[np.triu_indices(3)][:, None]
        self.state, eta, nu, *rest = (np.array(v) for v in self.function(self.state, given, model))
        if self.estimator == "truth":
            eta, nu = x[:4], x[4:8]
        if self.estimator == "differences":
            eta, nu = self._differences(given[:3], given[3] > 0.5, given[4], given[5])
        return eta, nu, *rest, self.state[self.layout.slice("refused")]

    def _differences(self, fix: Array, fresh: NDArray[np.bool_], yaw: Array, rate: Array) -> tuple[Array, Array]:
        self.since = self.since + DT
        self.velocity = np.where(fresh, (fix - self.last) / self.since, self.velocity)
        self.last, self.since = np.where(fresh, fix, self.last), np.where(fresh, 0.0, self.since)
        v, c, s = self.velocity, np.cos(yaw), np.sin(yaw)
        return np.vstack([self.last, yaw]), np.vstack([c * v[0] + s * v[1], c * v[1] - s * v[0], v[2], rate])


@cache
def _filter(own: OwnStateFilter, runs: int) -> tuple[ca.Function, Layout]:
    layout = Layout(own.ports())
    x, state = layout.symbols("x")
    u, given = GIVEN.symbols("u")
    m, model = MODEL.symbols("m")
    out = own.update(state, model=model, **given)
    results = [layout.join(out.state), out.eta, out.nu, out.position_sd, out.velocity_sd, out.age]
    return ca.Function("own", [x, u, m], results, {"cse": True}).map(runs), layout


@cache
def _control(runs: int, k_v: float) -> ca.Function:
    """Return (η̂, ν̂, reference (7,), model) → τ: a position loop commands a velocity in {E}, the velocity controller
    thrust.
    """
    eta, nu, reference = ca.SX.sym("eta", 4), ca.SX.sym("nu", 4), ca.SX.sym("reference", 7)
    m, model = MODEL.symbols("m")
    wish = reference[3:6] + APPROACH * (reference[:3] - eta[:3])
    wish = wish * ca.fmin(1, CAP / ca.fmax(ca.norm_2(wish), 1e-9))
    c, s = ca.cos(eta[3]), ca.sin(eta[3])
    body = ca.vertcat(c * wish[0] + s * wish[1], c * wish[1] - s * wish[0], wish[2], reference[6])
    tau, _, _ = velocity_control(body, nu, ca.SX.zeros(4), model, k_v=k_v, k_r=2.0, k_i=0.0, dt=DT)
    return ca.Function("control", [eta, nu, reference, m], [tau]).map(runs)
