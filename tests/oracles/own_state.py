"""The own-state filter in NumPy: an independent implementation with the results of `OwnStateFilter.update`."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, pi, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.marine.sensing.localisation.own_state import (
    BELIEVED_AFTER,
    LONGEST_AGE,
    UNKNOWN_SD,
    OwnEstimate,
    OwnStateFilter,
)

__all__ = ["own_state_step"]

Vector = NDArray[np.float64]


def own_state_step(
    own: OwnStateFilter,
    state: Mapping[str, Vector],
    *,
    fix: ArrayLike,
    fix_fresh: float,
    yaw: float,
    yaw_rate: float,
    tau: ArrayLike,
    model: Mapping[str, Vector],
    prefix: str = "",
) -> OwnEstimate[Vector]:
    """Return the estimate after one control step, as `OwnStateFilter.update` does, for NumPy arrays.

    Args:
        own: the filter.
        state: value of each entry of `own.ports(prefix)`, by name, as `Layout(own.ports(prefix)).unpack` returns; the
            function does not change these values.
        fix: (3,) position fix [m] in {E}.
        fix_fresh: 1 if a fix has arrived since the last step, else 0.
        yaw: measured ψ [rad].
        yaw_rate: measured r [rad/s].
        tau: (4,) force and moment command of the previous step, in {B} [N, N m].
        model: `mass`, `linear_drag`, `quadratic_drag`, `thrust_limit` of the vehicle model, (4,) each.
        prefix: prefix of the names of the state's entries.

    Example:
        >>> import numpy as np
        >>> from surctl.ir import Layout
        >>> from surctl.marine.sensing import OwnStateFilter
        >>> from tests.oracles.own_state import own_state_step
        >>> from surctl.marine.vehicle import load_vehicle
        >>> own, vehicle = OwnStateFilter(dt=0.05), load_vehicle("sur400")
        >>> names = ("mass", "linear_drag", "quadratic_drag", "thrust_limit")
        >>> model = {name: np.array(getattr(vehicle, name)) for name in names}
        >>> layout = Layout(own.ports())
        >>> state, still = layout.unpack(layout.pack()), {"yaw": 0.1, "yaw_rate": 0.0, "tau": np.zeros(4)}
        >>> for step in range(40):  # 2 s, a fix every 0.1 s
        ...     estimate = own_state_step(own, state, fix=[1.0, 2.0, -0.5], fix_fresh=step % 2, model=model, **still)
        ...     state = estimate.state
        >>> estimate.eta.round(3).tolist(), estimate.position_sd.round(4).tolist()
        ([1.0, 2.0, -0.5, 0.1], [0.0051])
    """
    old = {port.name.removeprefix(prefix): np.array(state[port.name], dtype=float) for port in own.ports(prefix)}
    begun = bool(old["begun"][0])
    psi, rate = old["turn"] if begun else (yaw, yaw_rate)
    limit = np.asarray(model["thrust_limit"], dtype=float)
    command = np.clip(np.asarray(tau, dtype=float), -limit, limit)
    left, mean = own.thrust_shares
    accelerations = old.get("accelerations", np.zeros((0, 3)))

    x = np.stack([old["position"], old["velocity"], old["disturbance"]])
    velocity = _carried(own, x, accelerations)[1]
    during = command + mean * (old["thrust"] - command)
    acceleration, turning = _acceleration(psi + 0.5 * own.dt * rate, velocity, rate, during, model, own.dt)
    accelerations = np.vstack([acceleration, accelerations])
    P = _grown(own, _square(old["covariance"]), accelerations[-1:])
    here, x = _corrected(
        own, old, _carried(own, x, accelerations[-1:]), P, np.asarray(fix, dtype=float), bool(fix_fresh)
    )
    accelerations = accelerations[:-1]

    after = rate + own.dt * turning
    ahead = psi + 0.5 * own.dt * (rate + after)
    turn = np.array([ahead, after]) + own.yaw_gains @ np.array([_wrap(yaw - ahead), yaw_rate - after])
    if not begun:
        turn = np.array([yaw, yaw_rate])
    turn[0] = _wrap(turn[0])

    position, velocity, _ = _carried(own, x, accelerations)
    now = _grown(own, _square(here["covariance"]), accelerations)
    known = bool(here["known"][0])
    new = {
        **here,
        "position": x[0],
        "velocity": x[1],
        "disturbance": x[2],
        "thrust": command + left * (old["thrust"] - command),
        "turn": turn,
        "begun": np.ones(1),
    }
    if own.late:
        new["accelerations"] = accelerations
    return OwnEstimate(
        {prefix + name: value for name, value in new.items()},
        np.append(position, turn[0]),
        np.append(_turned(-turn[0]) @ velocity, turn[1]),
        np.array([sqrt(max(now[0, 0], 0.0)) if known else UNKNOWN_SD]),
        np.array([sqrt(max(now[1, 1], 0.0)) if known else own.velocity_start_sd]),
        here["age"],
    )


def _carried(own: OwnStateFilter, x: Vector, accelerations: Vector) -> Vector:
    """Return position, velocity and disturbance (3, 3) after k steps with the accelerations (k, 3), newest first."""
    phi = own.step[0]
    for acceleration in accelerations[::-1]:
        x = phi @ x + np.outer([0.5 * own.dt**2, own.dt, 0.0], acceleration)
    return x


def _grown(own: OwnStateFilter, P: Vector, accelerations: Vector) -> Vector:
    """Return the covariance (3, 3) after k steps with the accelerations (k, 3), newest first."""
    phi, noise = own.step
    for acceleration in accelerations[::-1]:
        P = phi @ P @ phi.T + noise + (acceleration @ acceleration) * own.model_covariance
    return P


def _corrected(
    own: OwnStateFilter, old: Mapping[str, Vector], x: Vector, P: Vector, fix: Vector, fresh: bool
) -> tuple[dict[str, Vector], Vector]:
    """Return the filter's next stored values, and the state means (3, 3), corrected by the fix if one arrived.

    The state means refer to the time `latency` before the present.
    """
    known, refused, offset = bool(old["known"][0]), float(old["refused"][0]), old["offset"]
    age, R = min(float(old["age"][0]) + own.dt, LONGEST_AGE), own.position_sd**2
    error = fix - x[0]
    if not known:
        x, P = np.stack([np.zeros(3), x[1], x[2]]), np.zeros((3, 3))
    if fresh and known and error @ error <= own.gate**2 * (P[0, 0] + R):
        gain = P[:, 0] / (P[0, 0] + R)
        x, P = x + np.outer(gain, error), P - np.outer(gain, P[0, :])
        refused, age = 0.0, own.latency
    elif fresh:
        off = error - offset
        agrees = refused > 0 and off @ off <= own.gate**2 * (P[0, 0] + 2 * R)
        refused, offset = (refused + 1 if agrees else 1.0), error
        if not known or refused >= BELIEVED_AFTER:
            x, P = np.stack([fix, x[1], np.zeros(3)]), np.diag(own.start_variances)
            refused, age = 0.0, own.latency
    here = {
        "covariance": P[np.triu_indices(3)],
        "known": np.array([float(known or fresh)]),
        "refused": np.array([refused]),
        "offset": offset,
        "age": np.array([age]),
    }
    return here, x


def _acceleration(
    psi: float, velocity: Vector, rate: float, thrust: Vector, model: Mapping[str, Vector], dt: float
) -> tuple[Vector, float]:
    """Return the vehicle model's mean acceleration (3,) over a step in {E} [m/s²] and its yaw acceleration [rad/s²]."""
    nu = np.append(_turned(-psi) @ velocity, rate)
    mass = np.maximum(model["mass"], 1e-6)
    X, XX = np.asarray(model["linear_drag"]), np.asarray(model["quadratic_drag"])
    u, v, _, r = nu
    load = thrust - (X + XX * np.abs(nu)) * nu + (mass[1] - mass[0]) * np.array([v * r, u * r, 0.0, -u * v])
    a = load / (mass + 0.5 * dt * (X + 2 * XX * np.abs(nu)))
    return _turned(psi) @ a[:3], float(a[3])


def _turned(psi: float) -> Vector:
    c, s = cos(psi), sin(psi)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _square(upper: Vector) -> Vector:
    P = np.zeros((3, 3))
    P[np.triu_indices(3)] = upper
    return P + np.triu(P, 1).T


def _wrap(angle: float) -> float:
    # [rad], to (−π, π]
    turns = np.floor((pi - angle) / (2 * pi))
    once = float(angle + 2 * pi * turns)
    return once - 2 * pi if once > pi else once + 2 * pi if once <= -pi else once
