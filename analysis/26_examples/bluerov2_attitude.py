"""Example: depth, attitude and speed of a BlueROV2 in six degrees of freedom, by tasks in order of priority.

    python analysis/26_examples/bluerov2_attitude.py    # 10,000 runs; --quick: 100

Parameters of von Benzon et al. 2022. Status 0 if all is stable, a region is proved, and C equals Python.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np

from surctl.export import software_in_the_loop
from surctl.ir import Layout, Port
from surctl.lyapunov import continuous_dynamics, find_stability
from surctl.priority import nsb_symbolic
from surctl.system import Controller, Cost, Plant, System, every_combination, linearise, run_system, simulate_system
from surctl.tasks import wrap
from surctl.tuning import tune_system
from surctl.verification import system_margins

WEIGHT, BUOYANCY, ARM = 13.5 * 9.82, 1000 * 9.82 * 0.0134, -0.01  # N, N, m: centre of buoyancy above the origin
MASS = ca.DM([13.5 + 6.36, 13.5 + 7.12, 13.5 + 18.68, 0.26 + 0.189, 0.23 + 0.135, 0.37 + 0.222])  # kg, kg m^2
LINEAR, QUADRATIC = ca.DM([13.7, 0, 33, 0, 0.8, 0]), ca.DM([141, 217, 190, 1.19, 0.47, 1.5])  # N, N m over m/s, rad/s
MOST, PERIOD = ca.DM([40, 40, 40, 10, 10, 10]), 0.05  # N, N m, assumed; s
GAINS = Layout(tuple(Port(name, (1,), "1/s", "", k) for name, k in (("k_depth", 0.5), ("k_attitude", 1), ("k_nu", 2))))
Z, ANGLES = Port("z", (1,), "m", "depth"), Port("angles", (3,), "rad", "roll, pitch, yaw")
NU, FORCE = Port("nu", (6,), "m/s, rad/s", "velocity in {b}"), Port("tau", (6,), "N, N m", "in {b}")
TETHER, PITCHED = Port("tether", (3,), "N", "pull in {n}"), lambda s: ca.fabs(s.x["angles"][1]) > 1.4
DEPTH, ATTITUDE = Port("depth", (1,), "m", "desired depth"), Port("attitude", (3,), "rad", "desired roll, pitch, yaw")
INPUTS = Layout((Z, ANGLES, NU, DEPTH, ATTITUDE, Port("speed", (3,), "m/s", "desired velocity in {b}")))


def kinematics(angles):
    """R (3, 3) from {b} to {n}, and J (3, 3) from the rates in {b} to those of roll, pitch and yaw."""
    (sr, sp, sy), (cr, cp, cy) = (ca.vertsplit(of(angles)) for of in (ca.sin, ca.cos))
    R = ca.vertcat(
        ca.horzcat(cy * cp, cy * sp * sr - sy * cr, sy * sr + cy * cr * sp),
        ca.horzcat(sy * cp, cy * cr + sr * sp * sy, sp * sy * cr - cy * sr),
        ca.horzcat(-sp, cp * sr, cp * cr),
    )
    return R, ca.vertcat(ca.horzcat(1, sr * sp / cp, cr * sp / cp), ca.horzcat(0, cr, -sr), ca.horzcat(0, sr, cr) / cp)


def loads(angles, nu):
    """C(nu) nu + D(nu) nu + g (6,): Coriolis terms, damping, weight and buoyancy."""
    P, H, turn = MASS[:3] * nu[:3], MASS[3:] * nu[3:], nu[3:]
    coriolis = ca.vertcat(ca.cross(turn, P), ca.cross(turn, H) + ca.cross(nu[:3], P))
    down = kinematics(angles)[0][2, :].T  # the vertical in {b}
    lift = ca.vertcat(-(WEIGHT - BUOYANCY) * down, BUOYANCY * ca.cross(ca.DM([0, 0, ARM]), down))
    return coriolis + (LINEAR + QUADRATIC * ca.fabs(nu)) * nu + lift


def rov(x, f, d, p):
    """x' of M nu' + C(nu) nu + D(nu) nu + g = f + Rᵀ d; without x and y, on which nothing depends."""
    R, J = kinematics(x["angles"])
    total = f["tau"] + ca.vertcat(R.T @ d["tether"], ca.SX.zeros(3)) - loads(x["angles"], x["nu"])
    return {"z": R[2, :] @ x["nu"][:3], "angles": J @ x["nu"][3:], "nu": total / MASS}


def by_priority(x, u, p, order, limited=True):
    """Forces (6,) for the tasks named in `order`, highest priority first."""
    (R, J), none = kinematics(u["angles"]), ca.SX.zeros(3, 3)
    tasks = {
        "depth": (ca.horzcat(R[2, :], none[0, :]), p["k_depth"] * (u["depth"] - u["z"])),
        "attitude": (ca.horzcat(none, J), p["k_attitude"] * wrap(u["attitude"] - u["angles"])),
        "speed": (ca.horzcat(ca.SX.eye(3), none), u["speed"]),
    }
    change = p["k_nu"] * (nsb_symbolic([tasks[name] for name in order]) - u["nu"])
    tau = loads(u["angles"], u["nu"]) + MASS * change
    return ca.fmax(-MOST, ca.fmin(MOST, tau)) if limited else tau


def cost_rate(s):
    """Integrand of the cost: 1 for an error of 0.1 m or 0.1 rad, or for one force at its limit."""
    error = ca.vertcat(s.r["depth"] - s.x["z"], wrap(s.r["attitude"] - s.x["angles"]))
    return ca.sumsqr(error) / 0.1**2 + ca.sumsqr(s.f["tau"] / MOST)


def closed_loop(*order):
    """The vehicle under the law with this order of tasks."""
    plant = Plant("bluerov2", Layout((Z, ANGLES, NU)), Layout((FORCE,)), rov, disturbances=Layout((TETHER,)))
    tasks = partial(by_priority, order=order)
    law = Controller("bluerov2_tasks", PERIOD, INPUTS, Layout((FORCE,)), tasks, gains=GAINS)
    return System(plant, law, 2, {"cost": Cost(cost_rate, "integral", "s")}, {"pitched": PITCHED})


def main() -> int:
    """Print the example; 1 if the loop is unstable, its claim is not proved, or C differs from Python."""
    sets, rng = 10 if sys.argv[1:] == ["--quick"] else 100, np.random.default_rng(1)
    task = {"reference.depth": 2.0, "reference.attitude": [[0, -0.35, 1]], "reference.speed": [[0.4, 0, 0]]}
    for order in (("speed", "attitude", "depth"), ("depth", "attitude", "speed")):
        system, last = closed_loop(*order), run_system(closed_loop(*order), 20.0, task)
        print(f"{', '.join(order)}: depth {last['z'][-1, 0]:.3f} m, surge {last['nu'][-1, 0]:.3f} m/s")
    ranges = {"k_depth": (0.1, 6.0), "k_attitude": (0.1, 10.0), "k_nu": (0.3, 20.0)}
    tried = {name: rng.uniform(*ends, sets) for name, ends in ranges.items()}
    most = {"start.angles": [0.6, 0.6, 2], "reference.attitude": [0.6, 0.6, 2], "disturbance.tether": [4, 4, 4]}
    starts = {name: rng.uniform(-1, 1, (sets, 3)) * ends for name, ends in most.items()}
    starts["reference.depth"] = rng.uniform(-2, 2, sets)
    runs = simulate_system(system, 20.0, every_combination(tried, starts))
    print(f"sweep: {len(runs.time):,} runs, {np.mean(runs.stopped == 'time'):.1%} of them to their end")
    tuned = tune_system(system, 20.0, ranges, cases=starts, trials=3 * sets)
    print(*tuned.lines(), sep="\n")
    linear = linearise(system, {**tuned.gains, **task, "start.z": 2.0, "start.angles": task["reference.attitude"]})
    print(*(margin.line() for margin in system_margins(linear)), sep="\n")
    law = replace(system.controller, law=partial(system.controller.law, limited=False))
    depth = continuous_dynamics(replace(system, controller=law), {"z": (-1, 1), "nu[2]": (-1, 1)}, values=tuned.gains)
    claim = find_stability(depth, degree=2, time_limit=20.0)
    print(f"claim, depth at level attitude below the limits: {claim.verdict}: {claim.volume:.0%} of the box")
    report = software_in_the_loop(system.controller, run_system(system, 20.0, {**tuned.gains, **task}))
    print(report.summary())
    return 0 if report.exact and not tuned.unmet and claim.verdict == "proved" else 1


if __name__ == "__main__":
    sys.exit(main())
