"""Example: depth, attitude and speed of a BlueROV2 in six degrees of freedom, by tasks in order of priority.

    python analysis/26_examples/bluerov2_attitude.py    # 10,000 runs; --quick: 100
Parameters of von Benzon et al. 2022. Status 0 if the loop is stable, a region is proved, and C equals Python."""

from __future__ import annotations

import sys

import casadi as ca
import numpy as np
from claimed import motion, print_claim
from worked import back_to_back, choose, draw, half_turn, print_margins, sizes, sweep

from surctl.ir import Layout, Port
from surctl.priority import nsb_symbolic
from surctl.system import Controller, Cost, Plant, System, linearise, run_system

WEIGHT, BUOYANCY, ARM = 13.5 * 9.82, 1000 * 9.82 * 0.0134, -0.01  # N, N, m: centre of buoyancy above the origin
MASS = ca.DM([13.5 + 6.36, 13.5 + 7.12, 13.5 + 18.68, 0.26 + 0.189, 0.23 + 0.135, 0.37 + 0.222])  # kg, kg m^2
LINEAR = ca.DM([13.7, 0, 33, 0, 0.8, 0])  # N s/m, N m s
QUADRATIC = ca.DM([141, 217, 190, 1.19, 0.47, 1.5])  # N s^2/m^2, N m s^2
MOST = ca.DM([40, 40, 40, 10, 10, 10])  # N, N m, assumed
PERIOD = 0.05  # s
NOMINAL = {"k_depth": 0.5, "k_attitude": 1.0, "k_nu": 2.0}  # 1/s

Z, ANGLES = Port("z", (1,), "m", "depth"), Port("angles", (3,), "rad", "roll, pitch, yaw")
NU, FORCE = Port("nu", (6,), "m/s, rad/s", "velocity in {b}"), Port("tau", (6,), "N, N m", "in {b}")
DEPTH, ATTITUDE = Port("depth", (1,), "m", "desired depth"), Port("attitude", (3,), "rad", "desired roll, pitch, yaw")
SPEED = Port("speed", (3,), "m/s", "desired velocity in {b}")
INPUTS = Layout((Z, ANGLES, NU, DEPTH, ATTITUDE, SPEED))


def kinematics(angles):
    """R (3, 3) from {b} to {n}, and J (3, 3) from the rates in {b} to those of roll, pitch and yaw."""
    (sr, sp, sy), (cr, cp, cy) = (ca.vertsplit(of(angles)) for of in (ca.sin, ca.cos))
    R = ca.vertcat(
        ca.horzcat(cy * cp, cy * sp * sr - sy * cr, sy * sr + cy * cr * sp),
        ca.horzcat(sy * cp, cy * cr + sr * sp * sy, sp * sy * cr - cy * sr),
        ca.horzcat(-sp, cp * sr, cp * cr),
    )
    J = ca.vertcat(ca.horzcat(1, sr * sp / cp, cr * sp / cp), ca.horzcat(0, cr, -sr), ca.horzcat(0, sr / cp, cr / cp))
    return R, J


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


def by_priority(order):
    """Law that gives the tasks named in `order`, highest priority first, to `nsb_symbolic`."""

    def law(x, u, p, limited=True):
        R, J = kinematics(u["angles"])
        none, turn = ca.SX.zeros(3, 3), half_turn(u["attitude"] - u["angles"])
        tasks = {
            "depth": (ca.horzcat(R[2, :], none[0, :]), p["k_depth"] * (u["depth"] - u["z"])),
            "attitude": (ca.horzcat(none, J), p["k_attitude"] * turn),
            "speed": (ca.horzcat(ca.SX.eye(3), none), u["speed"]),
        }
        desired = nsb_symbolic([tasks[name] for name in order])
        tau = loads(u["angles"], u["nu"]) + p["k_nu"] * MASS * (desired - u["nu"])
        return ca.fmax(-MOST, ca.fmin(MOST, tau)) if limited else tau

    return law


def cost_rate(s):
    """Integrand of the cost: 1 for an error of 0.1 m or 0.1 rad, or for one force at its limit."""
    error = ca.vertcat(s.r["depth"] - s.x["z"], half_turn(s.r["attitude"] - s.x["angles"]))
    return ca.sumsqr(error) / 0.1**2 + ca.sumsqr(s.f["tau"] / MOST)


def closed_loop(*order):
    """The vehicle under the law with this order of tasks."""
    tether = Layout((Port("tether", (3,), "N", "pull in {n}"),))
    gains = Layout(tuple(Port(name, (1,), "1/s", "", value) for name, value in NOMINAL.items()))
    law = Controller("bluerov2_tasks", PERIOD, INPUTS, Layout((FORCE,)), by_priority(order), gains=gains)
    plant = Plant("bluerov2", Layout((Z, ANGLES, NU)), Layout((FORCE,)), rov, disturbances=tether)
    stops = {"pitched": lambda s: ca.fabs(s.x["angles"][1]) > 1.4}
    return System(plant, law, 2, {"cost": Cost(cost_rate, "integral", "s")}, stops)


def main() -> int:
    """Print the example; 1 if the loop is unstable, its claim is not proved, or C differs from Python."""
    sets, states = sizes(__doc__)
    task = {"reference.depth": 2.0, "reference.attitude": [[0, -0.35, 1]], "reference.speed": [[0.4, 0, 0]]}
    for order in (("depth", "attitude", "speed"), ("speed", "attitude", "depth")):
        last = run_system(closed_loop(*order), 20.0, task)
        print(f"{', '.join(order)}: depth {last['z'][-1, 0]:.3f} m, surge {last['nu'][-1, 0]:.3f} m/s")
    system = closed_loop("depth", "attitude", "speed")
    tried = draw(sets, 1, {"k_depth": (0.1, 6), "k_attitude": (0.1, 10), "k_nu": (0.3, 20)})
    most, pull = np.array([0.6, 0.6, 2]), np.full(3, 4.0)
    ranges = {"start.angles": (-most, most), "reference.depth": (-2, 2), "reference.attitude": (-most, most)}
    starts = draw(states, 2, {**ranges, "disturbance.tether": (-pull, pull)})
    cost, commands = sweep(system, 20.0, tried, starts), tuple(f"tau[{k}]" for k in range(6))
    cruise = {**task, "start.z": 2.0, "start.angles": task["reference.attitude"]}
    best = choose(system, tried, cost, commands, cruise)
    stable = print_margins(linearise(system, {**best, **cruise}), *commands, "z")
    record = run_system(system, 20.0, {**best, **task})
    print(f"the first run: depth {record['z'][-1, 0]:.3f} m, surge {record['nu'][-1, 0]:.3f} m/s")
    depth = motion(system, {"z": (-1, 1), "nu[2]": (-1, 1)}, best, limited=False)
    proved = print_claim(depth, "depth at level attitude, while no force is at its limit", first=sets < 100)
    return 0 if back_to_back(record) and stable and proved else 1


if __name__ == "__main__":
    sys.exit(main())
