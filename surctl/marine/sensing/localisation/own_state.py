"""The own-state filter: a Kalman filter for position and velocity from late camera fixes, IMU and vehicle model.

The filter estimates the position at the time `latency` before the present, so a standard Kalman update compares each
fix with the position at the time of its measurement, even after long gaps. From there, it predicts the present position
with the accelerations of the steps since, which it stores in a ring buffer. They come from the vehicle model (equation
(3) of the paper) under the last command, with thrust limit and lag, and with drag at the estimated ground velocity,
turned into {E}. A disturbance acceleration in {E} represents all model errors (mass, drag, waves, current).

The coordinates x, y and z share one covariance, which ignores that drag damps the motion: in a gap between fixes, it is
too large rather than too small. Yaw and yaw rate are measured in every step, so their Kalman gains are constant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import exp, pi
from typing import Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_number
from surctl.ir import Port
from surctl.marine.sensing.localisation.base_station import whole_steps

_LEAST_MASS = 1e-6  # [kg]


def _believed_acceleration(
    psi: ca.SX, velocity: ca.SX, rate: ca.SX, thrust: ca.SX, model: Mapping[str, ca.SX], dt: float
) -> tuple[ca.SX, ca.SX]:
    """Return the mean acceleration (3,) in {E} [m/s²] and yaw acceleration [rad/s²] over a step, by equation (3).

    The integration step is linearly implicit, with the drag at the middle of the step, so it is stable for any drag.
    For accelerations in {E}, the Coriolis force vanishes except for (m22 − m11)(v r, u r, 0, −u v) in {B}.
    """
    c, s = ca.cos(psi), ca.sin(psi)
    nu = ca.vertcat(c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0], velocity[2], rate)
    linear, quadratic = model["linear_drag"], model["quadratic_drag"]
    mass = ca.fmax(model["mass"], _LEAST_MASS)
    uneven = (mass[1] - mass[0]) * ca.vertcat(nu[1] * rate, nu[0] * rate, 0, -nu[0] * nu[1])
    load = thrust + uneven - linear * nu - quadratic * nu * ca.fabs(nu)
    a = load / (mass + 0.5 * dt * (linear + 2 * quadratic * ca.fabs(nu)))
    return ca.vertcat(c * a[0] - s * a[1], s * a[0] + c * a[1], a[2]), a[3]


def _from_upper(upper: ca.SX) -> ca.SX:
    """Return a covariance (3, 3) from the 6 numbers of its upper triangle."""
    a, b, c, d, e, f = (upper[k] for k in range(6))
    return ca.vertcat(ca.horzcat(a, b, c), ca.horzcat(b, d, e), ca.horzcat(c, e, f))


def _wrapped(angle: ca.SX) -> ca.SX:
    """Return the angle [rad] wrapped to (−π, π]."""
    turn = 2.0 * pi
    once = angle + turn * ca.floor((pi - angle) / turn)
    return once - turn * (once > pi) + turn * (once <= -pi)


Matrix = NDArray[np.float64]
T = TypeVar("T")

_RECURSION_STEPS = 4000  # steps; the slowest error decays within a few hundred

LONGEST_LATENCY = 1.0  # [s] with a longer latency the model no longer predicts the present (design choice)
LONGEST_AGE = 60.0  # [s] limit of a fix's age; this value also means that no fix has arrived
BELIEVED_AFTER = 3  # number of consecutive refused fixes that agree with each other, after which the filter restarts
UNKNOWN_SD = 100.0  # [m] standard deviation of the position before the first fix
_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # stored entries of a covariance


class OwnEstimate(NamedTuple, Generic[T]):
    """The estimate after a step, as SX columns from `OwnStateFilter.update` or as arrays from `own_state_step`."""

    state: dict[str, T]
    """Next state: value of each entry, by name."""
    eta: T
    """(4,) present x, y, z [m] and ψ [rad] in {E}, with ψ in (−π, π]."""
    nu: T
    """(4,) present u, v, w [m/s] and r [rad/s] over ground, in {B}."""
    position_sd: T
    """(1,) standard deviation of each of x, y, z [m]; `UNKNOWN_SD` before the first fix."""
    velocity_sd: T
    """(1,) standard deviation of each of u, v, w [m/s]."""
    age: T
    """(1,) time since the measurement of the last accepted fix [s]: `latency` when the fix arrives, at most
    `LONGEST_AGE`, and `LONGEST_AGE` before the first fix."""


@dataclass(frozen=True, kw_only=True)
class OwnStateFilter:
    """The parameters of the own-state filter.

    Attributes:
        dt: control period [s].
        latency: age of a fix when it arrives [s], a multiple of dt below `LONGEST_LATENCY`.
        position_sd: standard deviation of each coordinate of a fix [m].
        yaw_sd: standard deviation of the measured yaw [rad].
        rate_sd: standard deviation of the measured yaw rate [rad/s].
        disturbance_sd: standard deviation of the disturbance acceleration, which the vehicle model does not contain,
            along each axis of {E} [m/s²] (design choice, see `analysis/11_own_state`).
        disturbance_time: correlation time of the disturbance acceleration [s] (design choice).
        acceleration_noise: white acceleration noise that is always present [m/s^1.5] (design choice).
        model_noise: additional white acceleration noise for each m/s² of modelled acceleration [s^0.5] (design
            choice), because the errors from a wrong mass and from thrust noise grow with the thrust.
        yaw_acceleration_noise: white noise [rad/s^1.5] that represents the unmodelled yaw acceleration (design choice).
        velocity_start_sd: standard deviation of the velocity when the filter starts from a fix [m/s] (design choice).
        thrust_lag: time constant of the thrust's first-order lag in the vehicle model [s]; 0 for no lag.
        gate: number of standard deviations from the estimate beyond which a fix is refused (design choice).
    """

    dt: float
    latency: float = 0.1
    position_sd: float = 0.01
    yaw_sd: float = 0.01
    rate_sd: float = 0.005
    disturbance_sd: float = 0.005
    disturbance_time: float = 10.0
    acceleration_noise: float = 0.003
    model_noise: float = 0.3
    yaw_acceleration_noise: float = 0.1
    velocity_start_sd: float = 0.1
    thrust_lag: float = 0.3
    gate: float = 5.0

    def __post_init__(self) -> None:
        for name, unit in _POSITIVE.items():
            check_number(f"own_state.{name}", getattr(self, name), unit=unit)
        for name, unit in _AT_LEAST_ZERO.items():
            check_number(f"own_state.{name}", getattr(self, name), unit=unit, zero=True)
        if self.latency >= LONGEST_LATENCY:
            raise InputError(
                f"must be less than {LONGEST_LATENCY:g} s", key="own_state.latency", value=self.latency, remedy="give s"
            )
        whole_steps("own_state.latency", self.latency, dt=self.dt)

    @property
    def late(self) -> int:
        """Number of control steps between the measurement of a fix and its arrival."""
        return whole_steps("own_state.latency", self.latency, dt=self.dt)

    @cached_property
    def step(self) -> tuple[Matrix, Matrix]:
        """Transition matrix Φ and process-noise covariance Q (3, 3) of a step for one axis of {E}.

        The states are position, velocity, and a disturbance acceleration, which is constant within a step and decays
        with the time constant `disturbance_time` (first-order Gauss-Markov process). Q is the sum of the white noise
        and of the noise that keeps the standard deviation of the disturbance constant.
        """
        dt, time = self.dt, self.disturbance_time
        fresh = self.disturbance_sd**2 * (1.0 - exp(-2.0 * dt / time))
        noise = self._white(self.acceleration_noise) + np.diag([0.0, 0.0, fresh])
        return np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, exp(-dt / time)]]), noise

    def _white(self, size: float) -> Matrix:
        # covariance (3, 3) that white acceleration noise [m/s^1.5] adds to the states of one axis in a step
        dt = self.dt
        return size**2 * np.array([[dt**3 / 3, dt**2 / 2, 0.0], [dt**2 / 2, dt, 0.0], [0.0, 0.0, 0.0]])

    @cached_property
    def model_covariance(self) -> Matrix:
        """Covariance (3, 3) that is added to Q in a step for each (m/s²)² of modelled acceleration."""
        return self._white(self.model_noise)

    @cached_property
    def yaw_gains(self) -> Matrix:
        """Steady Kalman gains (2, 2): rows for estimated, columns for measured yaw and yaw rate."""
        F, Q = np.array([[1.0, self.dt], [0.0, 1.0]]), self._white(self.yaw_acceleration_noise)[:2, :2]
        R = np.diag([self.yaw_sd**2, self.rate_sd**2])
        P, K = R.copy(), np.zeros((2, 2))
        for _ in range(_RECURSION_STEPS):
            before = P
            P = F @ P @ F.T + Q
            K = P @ np.linalg.inv(P + R)
            P = P - K @ P
            if np.array_equal(P, before):
                break
        return K

    @property
    def start_variances(self) -> tuple[float, float, float]:
        """Variances of position, velocity and disturbance when the filter starts from a fix."""
        return self.position_sd**2, self.velocity_start_sd**2, self.disturbance_sd**2

    @property
    def thrust_shares(self) -> tuple[float, float]:
        """Share of the previous thrust that remains at the end of a step, and the mean of this share over the step."""
        if self.thrust_lag == 0:
            return 0.0, 0.0
        left = exp(-self.dt / self.thrust_lag)
        return left, (1.0 - left) * self.thrust_lag / self.dt

    def ports(self, prefix: str = "") -> tuple[Port, ...]:
        """Return the entries (name, shape, initial value) of the state.

        Position, velocity, disturbance and covariance refer to the time `latency` before the present.
        """
        modelled = "acceleration of the vehicle model in {E} in the last steps, newest first"
        ring = Port(f"{prefix}accelerations", (self.late, 3), "m/s^2", modelled)
        return (
            Port(f"{prefix}position", (3,), "m", f"x, y, z in {{E}}, {self.latency:g} s ago"),
            Port(f"{prefix}velocity", (3,), "m/s", f"velocity over ground in {{E}}, {self.latency:g} s ago"),
            Port(f"{prefix}disturbance", (3,), "m/s^2", "disturbance acceleration in {E}, which the model omits"),
            Port(f"{prefix}covariance", (6,), "SI", "covariance of one axis: rows of the upper triangle"),
            *((ring,) if self.late else ()),
            Port(f"{prefix}thrust", (4,), "N, N m", "present thrust of the vehicle model after its lag, in {B}"),
            Port(f"{prefix}turn", (2,), "rad, rad/s", "present yaw in {E} and yaw rate in {B}"),
            Port(f"{prefix}begun", (1,), "1", "1 after the first step"),
            Port(f"{prefix}known", (1,), "1", "1 after the first fix"),
            Port(f"{prefix}refused", (1,), "1", "number of consecutive refused fixes that agree"),
            Port(f"{prefix}offset", (3,), "m", "offset of the last refused fix from the estimate, in {E}"),
            Port(f"{prefix}age", (1,), "s", "time since the measurement of the last accepted fix", LONGEST_AGE),
        )

    def update(
        self,
        state: Mapping[str, ca.SX],
        *,
        fix: ca.SX,
        fix_fresh: ca.SX,
        yaw: ca.SX,
        yaw_rate: ca.SX,
        tau: ca.SX,
        model: Mapping[str, ca.SX],
        prefix: str = "",
    ) -> OwnEstimate[ca.SX]:
        """Return the estimate after one control step of the Kalman filter (see Brown and Hwang 2012, ch. 4).

        The filter starts from the first fix. The filter restarts from a refused fix if three consecutive fixes were
        refused and agree with each other. Refused fixes agree if their offsets from the estimate are equal within the
        gate. Offsets are compared, and not positions, because offsets do not contain the robot's own motion.

        Args:
            fix: (3,) position [m] in {E}, measured `latency` earlier; any finite values if no fix arrived.
            fix_fresh: 1 if a fix has arrived since the last step, else 0.
            yaw: measured ψ [rad], which may contain any number of full turns.
            tau: (4,) force and moment command of the previous step, in {B} [N, N m].
            model: `mass`, `linear_drag`, `quadratic_drag`, `thrust_limit` of the vehicle model, (4,) each.
        """
        old = {port.name.removeprefix(prefix): state[port.name] for port in self.ports(prefix)}
        begun = old["begun"] > 0.5
        psi, rate = ca.if_else(begun, old["turn"][0], yaw), ca.if_else(begun, old["turn"][1], yaw_rate)
        thrust, mean_thrust = self._thrust(old["thrust"], tau, model["thrust_limit"])
        accelerations = old.get("accelerations", ca.SX.zeros(0, 3))

        _, velocity = self._now(old["position"], old["velocity"], old["disturbance"], accelerations)
        acceleration, turning = _believed_acceleration(
            psi + 0.5 * self.dt * rate, velocity, rate, mean_thrust, model, self.dt
        )
        known = ca.vertcat(acceleration.T, accelerations)
        here = self._corrected(old, known[-1, :].T, fix, fix_fresh > 0.5)
        accelerations = known[:-1, :]

        after = rate + self.dt * turning
        innovation = ca.vertcat(_wrapped(yaw - psi - 0.5 * self.dt * (rate + after)), yaw_rate - after)
        turn = ca.vertcat(psi + 0.5 * self.dt * (rate + after), after) + ca.DM(self.yaw_gains) @ innovation
        turn = ca.if_else(begun, turn, ca.vertcat(yaw, yaw_rate))
        turn = ca.vertcat(_wrapped(turn[0]), turn[1])

        position, velocity = self._now(here["position"], here["velocity"], here["disturbance"], accelerations)
        c, s = ca.cos(turn[0]), ca.sin(turn[0])
        nu = ca.vertcat(c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0], velocity[2], turn[1])
        spread = self._spread(here["covariance"], accelerations)
        position_sd = ca.if_else(here["known"], spread[0], UNKNOWN_SD)
        velocity_sd = ca.if_else(here["known"], spread[1], self.velocity_start_sd)
        new = {**here, "thrust": thrust, "turn": turn, "begun": ca.SX(1)} | (
            {"accelerations": accelerations} if self.late else {}
        )
        named = {prefix + name: value for name, value in new.items()}
        return OwnEstimate(named, ca.vertcat(position, turn[0]), nu, position_sd, velocity_sd, here["age"])

    def _thrust(self, old: ca.SX, tau: ca.SX, limit: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the modelled thrust (4,) at the end of the step, and its mean (4,) over the step [N, N m]."""
        command = ca.fmin(ca.fmax(tau, -limit), limit)
        left, mean = self.thrust_shares
        return command + left * (old - command), command + mean * (old - command)

    def _now(self, position: ca.SX, velocity: ca.SX, disturbance: ca.SX, accelerations: ca.SX) -> tuple[ca.SX, ca.SX]:
        # position and velocity (3,) after k steps with the accelerations (k, 3)
        for k in reversed(range(accelerations.shape[0])):
            position, velocity, disturbance = self._moved(position, velocity, disturbance, accelerations[k, :].T)
        return position, velocity

    def _moved(
        self, position: ca.SX, velocity: ca.SX, disturbance: ca.SX, acceleration: ca.SX
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        change = self.dt * (acceleration + disturbance)
        left = float(self.step[0][2, 2])
        return position + self.dt * velocity + 0.5 * self.dt * change, velocity + change, left * disturbance

    def _corrected(self, old: Mapping[str, ca.SX], acceleration: ca.SX, fix: ca.SX, fresh: ca.SX) -> dict[str, ca.SX]:
        known, variance = old["known"] > 0.5, self.position_sd**2
        position, velocity, disturbance = self._moved(
            old["position"], old["velocity"], old["disturbance"], acceleration
        )
        P = self._grown(_from_upper(old["covariance"]), acceleration)
        error = fix - position
        inside = ca.sumsqr(error) <= self.gate**2 * (P[0, 0] + variance)
        accepted = ca.logic_and(fresh, ca.logic_and(known, inside))
        refused = ca.logic_and(fresh, ca.logic_not(accepted))
        agrees = ca.logic_and(
            old["refused"] > 0.5, ca.sumsqr(error - old["offset"]) <= self.gate**2 * (P[0, 0] + 2 * variance)
        )
        count = ca.if_else(
            accepted, 0.0, ca.if_else(refused, ca.if_else(agrees, old["refused"] + 1, 1.0), old["refused"])
        )
        first = ca.logic_or(ca.logic_not(known), count > BELIEVED_AFTER - 0.5)
        restart = ca.logic_and(refused, first)

        gain = ca.if_else(accepted, P[:, 0] / (P[0, 0] + variance), 0.0)
        corrected = ca.vertcat(*(P[i, j] - gain[i] * P[0, j] for i, j in _UPPER))
        start = self.start_variances
        anew = ca.DM([start[0], 0.0, 0.0, start[1], 0.0, start[2]])
        still = ca.logic_and(ca.logic_not(known), ca.logic_not(restart))  # without a fix, the covariance stays 0
        return {
            "position": ca.if_else(restart, fix, ca.if_else(known, position + gain[0] * error, 0.0)),
            "velocity": velocity + gain[1] * error,
            "disturbance": ca.if_else(restart, 0.0, disturbance + gain[2] * error),
            "covariance": ca.if_else(restart, anew, ca.if_else(still, 0.0, corrected)),
            "known": ca.logic_or(known, fresh),
            "refused": ca.if_else(restart, 0.0, count),
            "offset": ca.if_else(refused, error, old["offset"]),
            "age": ca.if_else(ca.logic_or(accepted, restart), self.latency, ca.fmin(old["age"] + self.dt, LONGEST_AGE)),
        }

    def _grown(self, P: ca.SX, acceleration: ca.SX) -> ca.SX:
        # the covariance grows more with a larger modelled acceleration
        phi, noise, model_covariance = ca.DM(self.step[0]), ca.DM(self.step[1]), ca.DM(self.model_covariance)
        grown: ca.SX = phi @ P @ phi.T + noise + ca.sumsqr(acceleration) * model_covariance
        return grown

    def _spread(self, covariance: ca.SX, accelerations: ca.SX) -> ca.SX:
        # present standard deviations (2,) of position [m] and velocity [m/s]
        P = _from_upper(covariance)
        for k in reversed(range(self.late)):
            P = self._grown(P, accelerations[k, :].T)
        spread: ca.SX = ca.sqrt(ca.fmax(ca.vertcat(P[0, 0], P[1, 1]), 0.0))
        return spread


_POSITIVE = {
    "dt": "s",
    "position_sd": "m",
    "yaw_sd": "rad",
    "rate_sd": "rad/s",
    "disturbance_sd": "m/s^2",
    "disturbance_time": "s",
    "acceleration_noise": "m/s^1.5",
    "yaw_acceleration_noise": "rad/s^1.5",
    "velocity_start_sd": "m/s",
    "gate": "standard deviations",
}
_AT_LEAST_ZERO = {"latency": "s", "thrust_lag": "s", "model_noise": "s^0.5"}
