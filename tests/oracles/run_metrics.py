"""The metrics of a run from its record, in NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.marine.control import Law
from surctl.marine.simulation import Metrics, Record, Scenario
from surctl.marine.simulation.metrics import AT_LIMIT, MOVING, NEAR_TARGET, SIGN, avoidance_intervals
from surctl.marine.simulation.run import path_depths
from tests.oracles.path_follower import PlainFollower


def measure(scenario: Scenario, law: Law, record: Record, *, reason: str, least: float) -> Metrics:
    """Return the metrics of a record.

    `reason` says why the run ended; `least` is the smallest clearance [m] of the run.
    """
    where, thrust = record.eta[:, :2], record.tau[:, :2]
    follower = PlainFollower(scenario.path, visit=scenario.visit)
    away = follower.track(where)
    excluded = avoidance_intervals(record.telemetry[:, law.telemetry_slice("avoiding")].ravel(), away)
    apart = away**2 + (record.eta[:, 2] - path_depths(scenario, where)) ** 2
    steps = np.linalg.norm(np.diff(where, axis=0), axis=1)
    leg = scenario.target - scenario.path.waypoints[-2]
    past = (where - scenario.target) @ (leg / np.linalg.norm(leg))
    on_last = PlainFollower(scenario.path, visit=scenario.visit).legs(where) == len(scenario.path.waypoints) - 2
    near = on_last & (np.linalg.norm(where - scenario.target, axis=1) <= NEAR_TARGET)
    limit = _limits(law, record)
    jumps = np.diff(thrust, axis=0)
    crab = _attitude(scenario, law, record, excluded)
    return Metrics(
        reached=reason == "reached",
        time_s=round(float(record.time[-1]), 9),
        min_clearance_m=float(least),
        path_error_m=float(np.sqrt(np.mean(apart[~excluded]))) if not excluded.all() else float("nan"),
        deviation_m=float(np.sqrt(np.mean(away**2))),
        length_m=float(steps.sum()),
        effort_n=float(np.mean(np.hypot(thrust[:, 0], thrust[:, 1]))),
        stopped_because=reason,
        max_deviation_m=float(np.max(away)),
        missed_corner_m=follower.missed,
        overshoot_m=float(np.max(past[near], initial=0.0)),
        peak_thrust_share=float(np.max(np.abs(record.tau) / np.where(limit > 0, limit, np.inf))),
        saturated_share=float(np.mean(record.status % 2)),
        thrust_rate_n_per_s=float(np.sqrt(np.mean(np.sum(jumps**2, axis=1))) / law.dt) if len(jumps) else 0.0,
        crab_angle_deg=crab[0],
        max_crab_angle_deg=crab[1],
        heading_error_deg=crab[2],
        **_activity(law, record, limit),
        **_waste(scenario, law, record),
    )


def _attitude(scenario: Scenario, law: Law, record: Record, excluded: NDArray[np.bool_]) -> tuple[float, float, float]:
    # mean and largest crab angle outside avoidance, and rms heading error [deg]
    nothing = float("nan")
    u, v = record.nu[:, 0], record.nu[:, 1]
    moving = np.hypot(u, v) > MOVING * scenario.cruise
    if law.perception is not None or not moving.any():
        return nothing, nothing, nothing
    counted = moving & ~excluded
    crab = np.rad2deg(np.abs(np.arctan2(v[counted], u[counted])))
    off = record.eta[:, 3] - PlainFollower(scenario.path, visit=scenario.visit).directions(record.eta[:, :2])
    off = (off[moving] + np.pi) % (2 * np.pi) - np.pi
    error = float(np.rad2deg(np.sqrt(np.mean(off**2))))
    return (float(crab.mean()), float(crab.max()), error) if crab.size else (nothing, nothing, error)


def _limits(law: Law, record: Record) -> NDArray[np.float64]:
    # (n, 4) of each thrust command in its direction; a law may have more thrust ahead than astern
    limit = np.tile(record.law_parameters[law.gains.slice("thrust_limit")], (len(record.tau), 1))
    if "ahead_limit" in law.gains:
        most = record.law_parameters[law.gains.slice("ahead_limit")]
        limit[:, 0] = np.where(record.tau[:, 0] > 0, np.maximum(limit[:, 0], most), limit[:, 0])
    return limit


def _activity(law: Law, record: Record, limit: NDArray[np.float64]) -> dict[str, float]:
    # total variation of each axis, sign changes, share at the limit, energy
    variation = np.abs(np.diff(record.tau, axis=0)).sum(axis=0) / (max(len(record.tau) - 1, 1) * law.dt)
    names = ("surge_n", "sway_n", "heave_n", "yaw_n_m")
    changes = []
    for command, most in zip(record.tau.T, limit.T, strict=True):
        signs = np.sign(command[np.abs(command) > SIGN * most])
        changes.append(int(np.count_nonzero(np.diff(signs))))
    at_limit = np.mean(np.abs(record.tau) >= AT_LIMIT * np.where(limit > 0, limit, np.inf), axis=0)
    duration = len(record.tau) * law.dt
    columns = {f"variation_{name}_per_s": float(each) for name, each in zip(names, variation, strict=True)}
    return columns | {
        "sign_changes_per_s": sum(changes) / duration,
        "axis_sign_changes_per_s": max(changes) / duration,
        "axis_saturated_share": float(np.max(at_limit)),
        "energy_n15_s": float(np.sum(np.abs(record.tau[:, :3]) ** 1.5)) * law.dt,
    }


def _waste(scenario: Scenario, law: Law, record: Record) -> dict[str, float]:
    linear, quadratic = (
        float(record.law_parameters[law.gains.slice(name)][0]) for name in ("linear_drag", "quadratic_drag")
    )
    follower = PlainFollower(scenario.path, visit=scenario.visit)
    heading, direction = record.eta[:, 3], follower.directions(record.eta[:, :2])
    along = record.nu[:, 0] * np.cos(heading - direction) - record.nu[:, 1] * np.sin(heading - direction)
    current = scenario.disturbance.current_m_per_s
    speed = np.maximum(along - current[0] * np.cos(direction) - current[1] * np.sin(direction), 0.0)
    spent = float(np.hypot(record.tau[:, 0], record.tau[:, 1]).sum()) * law.dt
    wasted = max(spent - float((linear * speed + quadratic * speed**2).sum()) * law.dt, 0.0)
    return {"wasted_impulse_n_s": wasted, "wasted_share": wasted / spent if spent > 0 else 0.0}
