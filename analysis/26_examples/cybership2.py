"""Example: dynamic positioning of CyberShip II by four thrusters under a nonlinear PID law.

    python analysis/26_examples/cybership2.py            # 10,000 runs
    python analysis/26_examples/cybership2.py --quick    # 100 runs

Coupled M, C(nu), D(nu) of Skjetne, Smogeli and Fossen 2004. Status 0 if all is stable and C equals Python.
"""

from __future__ import annotations

import sys

import casadi as ca
import numpy as np
from claimed import motion, print_claim
from worked import back_to_back, choose, draw, half_turn, print_margins, sizes, sweep

from surctl.ir import Layout, Port
from surctl.system import Action, Controller, Cost, Plant, System, linearise, run_system

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
    gap = ca.vertcat(eta[0] - target[0], eta[1] - target[1], half_turn(eta[2] - target[2]))
    return rotation(eta[2]).T @ gap


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
gains = Layout(
    (
        Port("omega", (1,), "rad/s", "natural frequency", 0.4),
        Port("zeta", (1,), "1", "damping", 0.9),
        Port("n", (1,), "1", "larger: slower integral action", 8.0),
    )
)
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
    sets, states = sizes(__doc__)
    load = {"disturbance.waves": [[0.6, -0.4, 0.1]]}
    start = {"start.eta": [[1.5, -1.0, 0.8]], **load}
    record = run_system(system, 60.0, start)
    print(f"one run, default gains: cost {record['cost']:.4g}, within 0.05 m from {record['settling']:.1f} s on")
    tried = draw(sets, 1, {"omega": (0.1, 3.0), "zeta": (0.4, 4.0), "n": (3, 100)})
    lowest, highest = np.array([-2, -2, -3]), np.array([2, 2, 3])
    starts = draw(
        states, 2, {"start.eta": (lowest, highest), "disturbance.waves": (-0.3 * np.ones(3), 0.3 * np.ones(3))}
    )
    cost, commands = sweep(system, 60.0, tried, starts), tuple(f"tau[{k}]" for k in range(4))
    best = choose(system, tried, cost, commands, load)
    record = run_system(system, 60.0, {**best, **start})
    print(f"the same run: cost {record['cost']:.4g}, within 0.05 m from {record['settling']:.1f} s on")
    stable = print_margins(linearise(system, {**best, **load}), *commands, "eta[2]")
    dynamics = motion(
        system, {"eta[0]": (-2, 2), "nu[0]": (-1, 1), "controller.total[0]": (-4, 4)}, best, limited=False
    )
    proved = print_claim(dynamics, "motion along the hull, as long as no limit of thrust is reached", first=sets < 100)
    return 0 if back_to_back(record) and stable and proved else 1


if __name__ == "__main__":
    sys.exit(main())
