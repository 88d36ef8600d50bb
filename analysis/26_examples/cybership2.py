"""Example: dynamic positioning of CyberShip II by four thrusters under a nonlinear PID law.

    python analysis/26_examples/cybership2.py    # 10,000 runs; --quick: 100, no proof

Skjetne, Smogeli and Fossen 2004. Status 0 if all is stable, a region is proved, and C equals Python.
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
from surctl.system import Action, Controller, Cost, Plant, System, linearise, run_system, simulate_system
from surctl.tasks import wrap
from surctl.tuning import tune_system
from surctl.verification import system_margins

M11, M22, M23, M33 = 23.8 + 2.0, 23.8 + 10.0, 23.8 * 0.046, 1.76 + 1.0  # kg, kg, kg m, kg m^2
M = np.array([[M11, 0, 0], [0, M22, M23], [0, M23, M33]])
ARMS = (0.078, 0.45, -0.45)  # m: main propellers beside the centre line; tunnel thrusters ahead and behind, assumed
T = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [ARMS[0], -ARMS[0], ARMS[1], ARMS[2]]])  # port, starboard, bow, stern
MOST = ca.DM([4.0, 4.0, 2.0, 2.0])  # N, assumed
PERIOD = 0.1  # s
ETA, NU = Port("eta", (3,), "m, m, rad", "place and heading in {n}"), Port("nu", (3,), "m/s, m/s, rad/s", "in {b}")
TARGET = Port("target", (3,), "m, m, rad", "desired place and heading in {n}")
THRUST = Layout((Port("tau", (4,), "N", "of port and starboard propeller, bow and stern thruster"),))


def rotation(heading):
    """R (3, 3) from {b} to {n}."""
    c, s = ca.cos(heading), ca.sin(heading)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))


def ship(x, f, d, p):
    """x' of M nu' + C(nu) nu + D(nu) nu = T f + Rᵀ d."""
    u, v, r = ca.vertsplit(x["nu"])
    au, av, ar = ca.fabs(u), ca.fabs(v), ca.fabs(r)
    c13, c23 = -(M22 * v + M23 * r), M11 * u
    coriolis = ca.vertcat(c13 * r, c23 * r, -c13 * u - c23 * v)
    damping = ca.vertcat(
        (0.72253 + 1.32742 * au + 5.86643 * u**2) * u,
        (0.88965 + 36.47287 * av + 0.805 * ar) * v + (7.25 + 0.845 * av + 3.45 * ar) * r,
        (-0.0313 - 3.95645 * av - 0.13 * ar) * v + (1.9 - 0.08 * av + 0.75 * ar) * r,
    )
    R = rotation(x["eta"][2])
    total = ca.DM(T) @ f["tau"] + R.T @ d["waves"] - coriolis - damping
    return {"eta": R @ x["nu"], "nu": ca.DM(np.linalg.inv(M)) @ total}


def errors(eta, target):
    """Position error in {b} and heading error in (-π, π], (3, 1)."""
    return rotation(eta[2]).T @ ca.vertcat(eta[:2] - target[:2], wrap(eta[2] - target[2]))


def positioning(x, u, p, limited=True):
    """PID law with gains M ω², 2 ζ ω M and M ω³ / n; a thruster at its limit, if any, stops the integral action."""
    e, w = errors(u["eta"], u["target"]), p["omega"]
    force = -ca.DM(M) @ (w**2 * e + 2 * p["zeta"] * w * u["nu"]) - rotation(u["eta"][2]).T @ x["total"]
    free = ca.DM(np.linalg.pinv(T)) @ force
    thrust = ca.fmax(-MOST, ca.fmin(MOST, free)) if limited else free
    within = ca.sum1(ca.fabs(free - thrust)) == 0
    grown = x["total"] + PERIOD * w**3 / p["n"] * (rotation(u["eta"][2]) @ ca.DM(M) @ e)
    return Action(thrust, {"total": ca.if_else(within, grown, x["total"])}, status=ca.if_else(within, 0, 1))


def cost_rate(s):
    """Integrand of the cost: 1 for an error of 0.1 m, of 0.1 rad, or thrusts of 1 N together."""
    e = errors(s.x["eta"], s.r["target"])
    return ca.sumsqr(e) / 0.1**2 + ca.sumsqr(s.f["tau"])


waves = Layout((Port("waves", (3,), "N, N, N m", "constant load in {n}"),))
OMEGA, ZETA = Port("omega", (1,), "rad/s", "natural frequency", 0.4), Port("zeta", (1,), "1", "damping", 0.9)
gains = Layout((OMEGA, ZETA, Port("n", (1,), "1", "larger: slower integral action", 8.0)))
total = Layout((Port("total", (3,), "N, N, N m", "integral action in {n}"),))
plant = Plant("cybership2", Layout((ETA, NU)), THRUST, ship, disturbances=waves)
law = Controller("cybership2_pid", PERIOD, Layout((ETA, NU, TARGET)), THRUST, positioning, state=total, gains=gains)
COSTS = {
    "cost": Cost(cost_rate, "integral", "s"),
    "settling": Cost(lambda s: ca.norm_2(errors(s.x["eta"], s.r["target"])[:2]) - 0.05, "last_time", "s"),
}
system = System(plant, law, substeps=2, costs=COSTS)


def main() -> int:
    """Print the example; 1 if the loop is unstable, its claim is not proved, or C differs from Python."""
    (count, few), rng = (100, 20) if sys.argv[1:] == ["--quick"] else (10_000, 100), np.random.default_rng(1)
    load = {"disturbance.waves": [[0.6, -0.4, 0.1]]}
    ranges = {"omega": (0.1, 3.0), "zeta": (0.4, 4.0), "n": (3.0, 100.0)}
    tried = {name: rng.uniform(*ends, count) for name, ends in ranges.items()}
    most = {"start.eta": [2, 2, 3], "disturbance.waves": [0.3, 0.3, 0.3]}
    starts = {name: rng.uniform(-1, 1, (count, 3)) * ends for name, ends in most.items()}
    runs = simulate_system(system, 60.0, {**tried, **starts})
    print(f"sweep: {len(runs.time):,} runs, {np.mean(runs.stopped == 'time'):.1%} of them to their end")
    cases = {name: rows[:few] for name, rows in starts.items()}
    tuned = tune_system(system, 60.0, ranges, cases=cases, trials=few)
    print(*tuned.lines(), sep="\n")
    print(*(margin.line() for margin in system_margins(linearise(system, {**tuned.gains, **load}))), sep="\n")
    if few == 100:  # the proof takes longer than all else
        free = replace(system, controller=replace(law, law=partial(positioning, limited=False)))
        within = {"eta[0]": (-2.0, 2.0), "nu[0]": (-1.0, 1.0), "controller.total[0]": (-4.0, 4.0)}
        claim = find_stability(continuous_dynamics(free, within, values=tuned.gains), degree=2, time_limit=20.0)
        print(f"claim, motion along the hull below the limits: {claim.verdict}: {claim.volume:.0%} of the box")
    record = run_system(system, 60.0, {**tuned.gains, **load, "start.eta": [[1.5, -1.0, 0.8]]})
    print(f"one run: within 0.05 m from {record['settling']:.1f} s on")
    report = software_in_the_loop(law, record)
    print(report.summary())
    return 0 if report.exact and not tuned.unmet and (few < 100 or claim.verdict == "proved") else 1


if __name__ == "__main__":
    sys.exit(main())
