"""Many closed loops at once: plant, sensors, an estimator and the velocity controller, one column per run."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import casadi as ca
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.ir import Layout, Port
from surctl.marine.control.closing import velocity_control
from surctl.marine.sensing import OwnState, OwnStateFilter
from surctl.marine.simulation.physics import advance
from surctl.marine.vehicle import PLANT_DISTURBANCE, PLANT_PARAMETERS, PLANT_STATE, Vehicle, plant_parameters
from tests.oracles.steady_state import steady_covariance

DT, HALVES = 0.05, 2  # [s]; calls of the plant in a control period
APPROACH = 0.3  # [1/s] of the position loop
CAP = 0.25  # [m/s] of the desired velocity
_BELIEVED = ("mass", "linear_drag", "quadratic_drag", "thrust_limit")
MODEL = Layout(tuple(Port(name, (4,), "SI", "") for name in _BELIEVED))

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
    place, velocity = mission.path()
    steps = len(place)
    turns = rng.uniform(0, 2 * np.pi, (4, runs))
    noise = rng.standard_normal((steps, 6, runs))
    ticks = np.arange(steps)
    reference = np.column_stack([place, velocity, np.full(steps, mission.spin)])
    own = _own(estimator, sensors)
    loop, state = _loop(steps, own, sensors, estimator, k_v)
    believes = {name: getattr(believed, name) for name in _BELIEVED}
    settled = _settled(own, sensors) if estimator == "fixed gain" else np.zeros(6)
    current = np.zeros((PLANT_DISTURBANCE.size, runs))
    current[:2] = water.current * np.vstack([np.cos(turns[0]), np.sin(turns[0])])
    same = np.concatenate([plant_parameters(vehicle), MODEL.pack(believes), settled])
    columns = []
    for k in range(runs):
        start = PLANT_STATE.pack()
        start[3] = turns[2, k]
        late = np.tile(start[:3], sensors.fixes.late(DT))
        push = water.wave * np.array([np.cos(turns[1, k]), np.sin(turns[1, k])])
        waves = [np.sin(2 * np.pi * (ticks + h / HALVES) * DT / water.period + turns[3, k]) for h in range(HALVES)]
        given = np.column_stack([ticks, noise[:, :, k], reference, *(wave[:, None] * push for wave in waves)])
        fixed = np.tile(np.concatenate([current[:, k], same])[:, None], steps)
        _, out = loop(state.pack({"plant": start, "late": late, "since": np.inf}), given.T, fixed)
        columns.append(np.array(out).T)
    ends = np.cumsum([4, 4, 4, 4, 1, 1, 1, 1])
    parts = np.split(np.stack(columns, axis=2), ends, axis=1)
    return Flight(*parts)


def _own(estimator: Estimator, sensors: OwnState) -> OwnStateFilter:
    """Return the filter whose estimate or standard deviations an estimator uses."""
    own = OwnStateFilter(dt=DT, latency=sensors.fixes.latency)
    if estimator == "as if now":
        return replace(own, latency=0.0)
    if estimator == "constant noise":
        return replace(own, model_noise=0.0)
    return replace(own, gate=1e6) if estimator == "fixed gain" else own


@cache
def _settled(own: OwnStateFilter, sensors: OwnState) -> Array:
    """Return the steady covariance just before a fix (6,), its upper triangle row by row."""
    P = steady_covariance(*own.step, fix_variance=own.position_sd**2, every=sensors.fixes.every(DT))
    whole: Array = own.step[0] @ P @ own.step[0].T + own.step[1]
    return whole[np.triu_indices(3)]


@cache
def _loop(
    steps: int, own: OwnStateFilter, sensors: OwnState, estimator: Estimator, k_v: float
) -> tuple[ca.Function, Layout]:
    """Return the function (state, given, constant) → (state, row of `Flight`) over control periods, and its state."""
    sizes = {"plant": PLANT_STATE.size, "late": 3 * sensors.fixes.late(DT), "tau": 4, "last": 3, "difference": 3}
    ports = [Port(name, (size,), "SI", "") for name, size in {**sizes, "since": 1}.items()]
    kept = Layout((*ports, *own.ports()))
    s, state = kept.symbols("s")
    tick, noise, reference = ca.SX.sym("tick"), ca.SX.sym("noise", 6), ca.SX.sym("reference", 7)
    waves = ca.SX.sym("waves", 2, HALVES)
    d, p = ca.SX.sym("d", PLANT_DISTURBANCE.size), ca.SX.sym("p", PLANT_PARAMETERS.size)
    m, model = MODEL.symbols("m")
    settled = ca.SX.sym("settled", 6)
    x = state["plant"]
    past = ca.vertcat(x[:3], state["late"])
    fix, fresh = sensors.fix_symbols(past[-3:], tick, noise=noise[:4], dt=DT)
    yaw, rate = sensors.imu_symbols(x[:4], x[4:8], noise=noise[4:])
    filtered = {port.name: state[port.name] for port in own.ports()}
    if estimator == "fixed gain":
        filtered["covariance"] = settled
    measured = {"fix": fix, "fix_fresh": fresh, "yaw": yaw, "yaw_rate": rate, "tau": state["tau"]}
    out = own.update(filtered, model=model, **measured)
    since = state["since"] + DT
    v = ca.if_else(fresh, (fix - state["last"]) / since, state["difference"])
    last = ca.if_else(fresh, fix, state["last"])
    eta, nu = out.eta, out.nu
    if estimator == "truth":
        eta, nu = x[:4], x[4:8]
    if estimator == "differences":
        c, s_ = ca.cos(yaw), ca.sin(yaw)
        eta = ca.vertcat(last, yaw)
        nu = ca.vertcat(c * v[0] + s_ * v[1], c * v[1] - s_ * v[0], v[2], rate)
    tau = _control(k_v)(eta, nu, reference, m)
    moved = x
    for half in range(HALVES):
        moved = advance()(moved, tau, ca.vertcat(d[:3], d[3:5] + waves[:, half], d[5:]), p)
    following = {"plant": moved, "late": past[:-3], "tau": tau, "last": last, "difference": v}
    following |= {"since": ca.if_else(fresh, 0.0, since), **out.state}
    row = ca.vertcat(x[:8], eta, nu, out.position_sd, out.velocity_sd, out.age, out.state["refused"], tau)
    given, constant = ca.vertcat(tick, noise, reference, ca.vec(waves)), ca.vertcat(d, p, m, settled)
    step = ca.Function("step", [s, given, constant], [kept.join(following), row], {"cse": True})
    return step.mapaccum(steps), kept


@cache
def _control(k_v: float) -> ca.Function:
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
    return ca.Function("control", [eta, nu, reference, m], [tau])
