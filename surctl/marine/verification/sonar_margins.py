"""Margins of the linear loop of a law with sonars about a straight cruise, with its own-state filter and late fixes.

The loop is the code that runs: CasADi differentiates the own-state filter at its steady covariance, and the decision is
differentiated by central differences. The plant with its thrust lag is that of `plant_jacobians`; a command acts one
period late. The hull does not turn, no obstacle is near, and all water is known. Fixes come late, and not in every
period, so the loop repeats after a cycle of several periods: it is stable if the eigenvalues of the whole cycle lie in
the unit circle, apart from that of the heading: such a law turns to look around and holds no heading.

The band of law `calm` has two linear limits: for large signals it passes the demand (`still` = 0), for small ones it is
a lag of the time constant `settle`. Between them, the command differs from the demand by the half width of the band at
most, which is a bounded disturbance of the first loop: it cannot make that loop unstable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import to_casadi
from surctl.marine.control import Gains, Law, law_source
from surctl.marine.sensing import OwnState, OwnStateFilter
from surctl.marine.vehicle import PLANT_PARAMETERS, Vehicle, plant_parameters
from surctl.marine.vehicle.linearise import check_cruise, dynamic_states, plant_jacobians
from surctl.marine.vehicle.specs import AXES
from surctl.marine.verification.cruise_loop import FAR, law_numbers
from surctl.marine.verification.law_loop import delivered
from surctl.system.linear_loop import held_plant

Array = NDArray[np.float64]

_CONVERGED = 800  # periods until the covariance of the filter is steady
_STEADY = 600  # periods until the law's memory is that of a steady cruise
_LONGEST = 60  # periods of additional delay that are tried
_ANGLES = 19  # of factors in the upper half of the disk
_PRECISION = 2e-3  # of a disk margin
_HEADING = 1e-5  # distance of an eigenvalue from 1 that counts as that of the heading, which nothing holds
_STEP = 1e-6  # of the central differences
_FILTERED = ("position", "velocity", "disturbance", "accelerations", "thrust", "turn")  # the rest is constant
_REMEMBERED = ("eased", "pushed", "held")  # by the law; the target moves on without the measurements


@dataclass(frozen=True, eq=False)
class SonarLoop:
    """One cycle of the linear loop from one fix to the next.

    Attributes:
        dt: control period [s].
        periods: for each period of the cycle, the derivatives of the state of plant, filter and law, and of the thrust
            command, by that state.
        driven: derivative of that state by the thrust (…, 4) that the plant gets.
    """

    dt: float
    periods: tuple[tuple[Array, Array], ...]
    driven: Array

    def radius(self, factor: complex, delay: int, axes: tuple[int, ...]) -> float:
        """Return the largest eigenvalue of a cycle, with the commands of these axes times a factor, and later.

        Args:
            factor: factor of the thrust commands.
            delay: additional delay of these commands [periods].
            axes: 0 surge, 1 sway, 2 heave, 3 yaw.
        """
        waiting = 1 + delay * np.isin(np.arange(4), axes)  # commands of each axis, the newest first
        ends = np.cumsum(waiting)
        enters, shift = np.eye(ends[-1])[:, ends - waiting], np.eye(ends[-1], k=-1)
        shift[ends - waiting] = 0.0
        leaves = np.where(np.isin(np.arange(4), axes), factor, 1.0)[:, None] * np.eye(ends[-1])[ends - 1]
        total = np.eye(len(self.driven) + ends[-1], dtype=complex)
        for state, command in self.periods:
            total = np.block([[state, self.driven @ leaves], [enters @ command, shift]]) @ total
        values = np.linalg.eigvals(total)
        return float(np.abs(values[np.abs(values - 1) > _HEADING]).max())

    def stable(self) -> bool:
        """Return whether the loop is stable."""
        return self.radius(1.0, 0, (0,)) < 1

    def disk(self, axes: tuple[int, ...], *, angles: int = _ANGLES) -> float:
        """Return the largest α such that factors (1 + δ/2)/(1 − δ/2) leave the loop stable for |δ| < α, at some angles.

        Args:
            axes: axes whose commands have the factor.
            angles: number of angles of δ that are tried; the disk margin itself is not larger than the result.
        """

        def stays(size: float, angle: float) -> bool:
            delta = 0.5 * size * np.exp(1j * angle)
            return self.radius((1 + delta) / (1 - delta), 0, axes) < 1

        least = 1.99
        for angle in np.linspace(0, np.pi, angles).tolist():
            if stays(least, angle):
                continue
            low, high = 0.0, least
            while high - low > _PRECISION:
                middle = 0.5 * (low + high)
                low, high = (middle, high) if stays(middle, angle) else (low, middle)
            least = low
        return least

    def delay(self, axes: tuple[int, ...]) -> float:
        """Return the largest additional delay [s], in whole periods up to 60, that leaves the loop stable."""
        for k in range(1, _LONGEST + 1):
            if self.radius(1.0, k, axes) >= 1:
                return (k - 1) * self.dt
        return _LONGEST * self.dt


def sonar_loop(
    law: Law, vehicle: Vehicle, gains: Gains, *, cruise: float, own: OwnState, manoeuvre: float = 0.0
) -> SonarLoop:
    """Return the linear loop of a law with sonars about a straight cruise in open, known water.

    Args:
        law: a law with sonars and map, for example `build_law("calm", sonar=True)`.
        vehicle: the plant, and the law's model of it.
        gains: gains of the law.
        cruise: cruise speed [m/s].
        own: the measurement of the robot's own state; its fixes may come late.
        manoeuvre: acceleration [m/s²] at which the filter follows the fixes faster.

    Raises:
        InputError: the vehicle cannot cruise at that speed, or its masses in surge and sway differ.
    """
    check_cruise(vehicle, cruise)
    if vehicle["m11"] != vehicle["m22"]:
        problem = "differs from m11: a cruise turns the hull, and a law with sonars holds no heading"
        raise InputError(problem, key="m22", value=vehicle["m22"], remedy="take the margins by true positions")
    source = law_source(law.ref)
    noise = source.model_noise
    filt = OwnStateFilter(
        dt=law.dt, latency=own.fixes.latency, position_sd=own.position_sd,
        yaw_sd=own.yaw_sd, rate_sd=own.rate_sd, model_noise=noise,
        acceleration_noise=float(np.hypot(source.acceleration_noise, noise * manoeuvre)),
    )  # fmt: skip
    p = law_numbers(vehicle, gains.with_own(source.gains), cruise=cruise)
    p[law.gains.slice("spin")] = 0.0
    nu = np.array([cruise, 0.0, 0.0, 0.0])
    numbers = plant_parameters(vehicle)
    (A,), (B,), (trim,) = plant_jacobians(numbers[None], nu[None], form=vehicle.form)
    lagged = float(numbers[PLANT_PARAMETERS.slice("thrust_lag")][0]) > 0
    states = dynamic_states(vehicle.form, lagged=lagged)
    A, B = A[np.ix_(states, states)], B[states] @ delivered(vehicle, nu)
    Ad, Bd, _ = held_plant(A, B, np.zeros((len(A), 0)), law.dt)
    filtered = _filtered(filt, law.gains.unpack(p), nu, trim, every=max(1, round(own.fixes.period / law.dt)))
    (by_x, by_u), n = _decided(law, p, nu), filtered[0][0].shape[1]
    m = by_x.shape[1]
    a, b, c, d, q = np.cumsum([len(Ad), 3 * filt.late, n, 4, m]).tolist()  # plant, old positions, filter, thrust, law
    periods = []
    for by_z, by_fix, by_turn, by_tau in filtered:
        estimate, state = np.zeros((n + 8, q)), np.zeros((q, q))
        estimate[:, b:c], estimate[:, c:d] = by_z, by_tau
        estimate[:, slice(b - 3, b) if filt.late else slice(0, 3)] += by_fix
        estimate[:, [3, 7]] += by_turn
        decision = by_u @ estimate[n:]
        decision[:, d:] += by_x
        state[:a, :a], state[b:c], state[c:d], state[d:] = Ad, estimate[:n], decision[m:], decision[:m]
        if filt.late:  # the newest of the old positions is that of the plant
            state[a : a + 3, :3], state[a + 3 : b, a : b - 3] = np.eye(3), np.eye(b - a - 3)
        periods.append((state, decision[m:]))
    return SonarLoop(law.dt, tuple(periods), np.vstack([Bd, np.zeros((q - a, 4))]))


def _filtered(
    filt: OwnStateFilter, p: dict[str, Array], nu: Array, trim: Array, *, every: int
) -> tuple[tuple[Array, ...], ...]:
    ports = filt.ports()
    x = {port.name: ca.SX.sym(port.name, *_columns(port.shape)) for port in ports}
    tau, fix, fresh, turn = ca.SX.sym("tau", 4), ca.SX.sym("fix", 3), ca.SX.sym("fresh"), ca.SX.sym("turn", 2)
    model = {k: ca.SX(np.ravel(p[k])) for k in ("mass", "linear_drag", "quadratic_drag", "thrust_limit")}
    done = filt.update(x, fix=fix, fix_fresh=fresh, yaw=turn[0], yaw_rate=turn[1], tau=tau, model=model)
    arguments = [*(ca.vec(x[port.name]) for port in ports), tau, fix, fresh, turn]
    step = ca.Function("step", arguments, [ca.vec(done.state[port.name]) for port in ports])
    names = [name for name in _FILTERED if name in x]
    results = ca.vertcat(*(ca.vec(done.state[k]) for k in names), done.eta, done.nu)
    by = ca.vertcat(*(ca.vec(x[k]) for k in names), fix, turn, tau)
    slope = ca.Function("slope", arguments, [ca.jacobian(results, by)])
    state = [np.full(ca.vec(x[port.name]).shape, float(np.ravel(port.default)[0])) for port in ports]
    slopes: list[Array] = []
    start = _CONVERGED - _CONVERGED % every
    for k in range(start + every):  # the last cycle, which ends with a fix
        here = np.array([nu[0] * filt.dt * (k - filt.late), 0.0, 0.0])
        values = [*state, trim, here, float((k + 1) % every == 0), np.zeros(2)]
        if k >= start:
            slopes.append(np.array(slope(*values)))
        state = [np.array(each) for each in step(*values)]
    n = slopes[0].shape[0] - 8
    return tuple((J[:, :n], J[:, n : n + 3], J[:, n + 3 : n + 5], J[:, n + 5 :]) for J in slopes)


def _decided(law: Law, p: Array, nu: Array) -> tuple[Array, Array]:
    assert law.perception is not None
    outputs, size = law.perception.outputs, law.state.size - law.perception.state.size
    slices = {port.name: law.state.slice(port.name) for port in law.state.ports}
    x = law.initial_state()[:size]
    x[slices["progress"]] = FAR  # arc length of the path's middle
    for name in ("eased", "last_velocity"):
        if name in slices:
            x[slices[name]] = nu[:2]
    unknown, sonars = outputs.port("unknown").shape[0], outputs.port("sonars").shape[0]
    u = outputs.pack({
        "nu": nu, "unknown": np.tile([0.0, 0.0, 100.0], (unknown, 1)), "placed": 1.0, "echoed": 1.0,
        "sonars": np.tile([2.0, 0.01, 1.0, 0.0, 1.0, 0.0], (sonars, 1)),
    })  # fmt: skip
    xs, us = ca.SX.sym("x", size), ca.SX.sym("u", u.size)
    tau, x_next, *_ = to_casadi(law.stages.closed)(xs, us, ca.DM(p))
    integral = ("integral",) if p[law.gains.slice("k_i")][0] > 0 else ()
    remembered = [slices[name] for name in (*integral, *_REMEMBERED) if name in slices]
    chosen = np.concatenate([np.arange(size)[where] for where in remembered] or [np.zeros(0, dtype=int)])
    estimate = np.concatenate([np.arange(u.size)[outputs.slice(name)] for name in ("eta", "nu")])
    both = ca.Function("both", [xs, us], [ca.vertcat(x_next[chosen.tolist()], tau)])
    step = ca.Function("step", [xs, us], [x_next])
    for _ in range(_STEADY):
        x[chosen] = np.array(step(x, u)).ravel()[chosen]
    by_x = _slope(lambda v: both(v, u), x, chosen) if chosen.size else np.zeros((4, 0))
    return by_x, _slope(lambda v: both(x, v), u, estimate)


def _slope(function: Callable[[Array], ca.DM], at: Array, chosen: Array) -> Array:
    # central differences, since the law has square roots of 0 in a cruise
    steps = _STEP * np.eye(len(at))[chosen]
    ahead, behind = (np.hstack([np.array(function(at + sign * step)) for step in steps]) for sign in (1, -1))
    slope: Array = (ahead - behind) / (2 * _STEP)
    return slope


def _columns(shape: tuple[int, ...]) -> tuple[int, int]:
    return (shape[0], shape[1]) if len(shape) == 2 else (int(np.prod(shape)), 1)


@dataclass(frozen=True)
class SonarMargins:
    """Margins of the thrust loops in surge, sway and heave of a law with sonars, one loop at a time.

    Attributes:
        signals: the signals for which they hold: `large` (beyond the band of a calm law) or `small` (within).
        stable: whether the loop is stable.
        disk: least disk margin (3,).
        delay_s: additional delay (3,) that each loop bears [s], in whole periods.
        longest_s: longest delay that was tried [s].
    """

    signals: str
    stable: bool
    disk: tuple[float, ...]
    delay_s: tuple[float, ...]
    longest_s: float

    def line(self) -> str:
        """Return one line of text."""
        if not self.stable:
            return f"  {self.signals} signals: UNSTABLE"
        parts = [
            f"{axis} {m:.2f} and {'at least ' if t >= self.longest_s else ''}{t:.2f} s"
            for axis, m, t in zip(AXES[:3], self.disk, self.delay_s, strict=True)
        ]
        return f"  {self.signals} signals: disk margin and delay of the loop {', '.join(parts)}"

    def to_dict(self) -> dict[str, Any]:
        """Return the margins as plain data for JSON."""
        margins = {a: {"disk_margin": m, "delay_s": t} for a, m, t in zip(AXES, self.disk, self.delay_s, strict=False)}
        return {"signals": self.signals, "stable": self.stable, "loops": margins}


def sonar_margins(
    law: Law, vehicle: Vehicle, gains: Gains, *, cruise: float, own: OwnState | None = None
) -> tuple[SonarMargins, ...]:
    """Return the margins of a law with sonars, for large and for small signals.

    Args:
        law, vehicle, gains, cruise: as for `sonar_loop`.
        own: the measurement of the robot's own state; default `OwnState()`.

    Raises:
        InputError: as for `sonar_loop`.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import sonar_margins
        >>> law, craft = build_law("calm", sonar=True), load_vehicle("sur540-flooded")
        >>> large, small = sonar_margins(law, craft, load_gains("default"), cruise=0.2)
        >>> [round(min(m.disk), 2) for m in (large, small)], [round(min(m.delay_s), 2) for m in (large, small)]
        ([0.65, 0.42], [1.0, 0.7])
    """
    whole = gains.with_own(law_source(law.ref).gains)
    limits = {"large": {"still": 0.0}, "small": {}} if "still" in whole.values else {"all": {}}
    margins = []
    for signals, values in limits.items():
        loop = sonar_loop(law, vehicle, whole.with_values(values), cruise=cruise, own=own or OwnState())
        stable = loop.stable()
        places = [(k,) for k in range(3 if stable else 0)]
        disk, delay = tuple(loop.disk(axes) for axes in places), tuple(loop.delay(axes) for axes in places)
        margins.append(SonarMargins(signals, stable, disk, delay, _LONGEST * law.dt))
    return tuple(margins)
