"""Example: a pendulum on a cart with linear-quadratic state feedback, whose weights are chosen by simulation.

    python analysis/26_examples/pendulum_lqr.py    # 10,000 runs; --quick: 900

Cart and pole of Barto, Sutton and Anderson (1983). Status 0 if all is stable, the claim refuted, and C equals Python.
"""

from __future__ import annotations

import sys

import casadi as ca
import control
import numpy as np

from surctl.export import software_in_the_loop
from surctl.ir import Layout, Port
from surctl.lyapunov import Stability, continuous_dynamics, decide_motion
from surctl.system import (
    Controller,
    Cost,
    Plant,
    System,
    every_combination,
    linearise,
    linearise_plant,
    run_system,
    simulate_system,
)
from surctl.tuning import tune_system
from surctl.verification import system_margins
from surctl.verification.formula import from_casadi

GRAVITY, CART, POLE, HALF = 9.8, 1.0, 0.1, 0.5  # m/s^2, kg, kg, m: half the length of the pole
LIMIT = 10.0  # N
PERIOD = 0.02  # s
PLACE, ANGLE = Port("place", (1,), "m", "of the cart"), Port("angle", (1,), "rad", "of the pole, from upright")
STATE = Layout((PLACE, ANGLE, Port("speed", (1,), "m/s", "of the cart"), Port("rate", (1,), "rad/s", "of the pole")))
FORCE = Layout((Port("tau", (1,), "N", "force on the cart"),))


def cart_pole(x, f, d, p):
    """x' of the cart with its pole, a uniform rod."""
    s, c = ca.sin(x["angle"]), ca.cos(x["angle"])
    drive = (f["tau"] + POLE * HALF * x["rate"] ** 2 * s) / (CART + POLE)
    turn = (GRAVITY * s - c * drive) / (HALF * (4 / 3 - POLE * c**2 / (CART + POLE)))
    return {
        "place": x["speed"],
        "angle": x["rate"],
        "speed": drive - POLE * HALF * turn * c / (CART + POLE),
        "rate": turn,
    }


def feedback(x, u, p):
    """Force (1,) of the saturated state feedback."""
    state = ca.vertcat(*(u[port.name] for port in STATE))
    return ca.fmax(-LIMIT, ca.fmin(LIMIT, -ca.dot(p["K"], state)))


def cost_rate(s):
    """Integrand of the cost: 1 for an error of 0.5 m, of 0.2 rad, or half of the largest force."""
    return (s.x["place"] / 0.5) ** 2 + (s.x["angle"] / 0.2) ** 2 + (s.f["tau"] / (LIMIT / 2)) ** 2


def gain(weights):
    """K (4,) of `control.dlqr` for the sampled linearisation, for the weights of place, angle, speed and rate."""
    return np.asarray(control.dlqr(SAMPLED.A, SAMPLED.B, np.diag(weights), [[1 / LIMIT**2]])[0]).ravel()


plant = Plant("cart_pole", STATE, FORCE, cart_pole)
SAMPLED = control.sample_system(linearise_plant(plant), PERIOD, "zoh")
K = Layout((Port("K", (4,), "1", "in SI units", gain([1 / 0.5**2, 1 / 0.2**2, 0, 0])),))  # weights by Bryson's rule
system = System(
    plant,
    Controller("pendulum_lqr", PERIOD, STATE, FORCE, feedback, gains=K),
    substeps=2,
    costs={
        "cost": Cost(cost_rate, "integral", "s"),
        "settling": Cost(lambda s: ca.fabs(s.x["place"]) - 0.05, "last_time", "s"),
    },
    stops={
        "fallen": lambda s: ca.fabs(s.x["angle"]) > 1.2,
        "off_the_rail": lambda s: ca.fabs(s.x["place"]) > 2.4,
    },
)


def main() -> int:
    """Print the example; 1 if the loop is unstable, its claim is not refuted, or C differs from Python."""
    sets, rng = 30 if sys.argv[1:] == ["--quick"] else 100, np.random.default_rng(1)
    start = {"start.place": 0.8, "start.angle": 0.3}
    print(f"one run: K = {K.pack().round(2)}, settled at {run_system(system, 10.0, start)['settling']:.2f} s")
    weights = 10 ** rng.uniform([-1, -1, -3, -3], [2.5, 3, 1.5, 1.5], (sets, 4))
    most = {"start.place": 0.8, "start.angle": 0.3, "start.speed": 0.3, "start.rate": 0.3}
    starts = {name: rng.uniform(-end, end, sets) for name, end in most.items()}
    tried = np.array([gain(row) for row in weights])
    runs = simulate_system(system, 10.0, every_combination({"K": tried}, starts))
    print(f"sweep: {len(runs.time):,} runs, {np.mean(runs.stopped == 'time'):.1%} of them to their end")
    cost = np.where(runs.stopped == "time", runs["cost"], np.inf).reshape(sets, -1).mean(axis=1)
    near = {f"K[{k}]": (2 * value, value / 2) for k, value in enumerate(tried[cost.argmin()])}
    tuned = tune_system(system, 10.0, near, cases=starts, trials=6 * sets, least_disk_margin=0.2)
    print(*tuned.lines(), sep="\n")
    linear = linearise(system, tuned.gains)
    print(*(margin.line() for margin in system_margins(linear)), sep="\n")

    P = control.dlyap((SAMPLED.A - SAMPLED.B @ [list(tuned.gains.values())]).T, np.eye(4))
    within = {"place": (-2.4, 2.4), "angle": (-1.2, 1.2), "speed": (-20.0, 20.0), "rate": (-20.0, 20.0)}
    dynamics, x = continuous_dynamics(system, within, values=tuned.gains), ca.SX.sym("x", 4)
    (V,) = from_casadi(x, dynamics.names, [ca.bilin(ca.DM(P), x, x)])
    level = 0.99 * float((dynamics.box[1] ** 2 / np.diag(np.linalg.inv(P))).min())  # the largest ellipsoid in the box
    claim = decide_motion(Stability(dynamics, V, level), time_limit=20.0)
    print(f"claim, V of the linear loop decreases with the force limit: {claim.verdict}, {claim.reason}")
    report = software_in_the_loop(system.controller, run_system(system, 10.0, {**tuned.gains, **start}))
    print(report.summary())
    return 0 if report.exact and not tuned.unmet and claim.verdict == "refuted" else 1


if __name__ == "__main__":
    sys.exit(main())
