"""Example: the altitude of a quadrotor with motor lag and drag in a vertical gust.

    python analysis/26_examples/quadrotor_altitude.py    # 10,000 runs, then a search; --quick: 100 runs, no proof

Parameters of the AscTec Hummingbird. Status 0 if the loop is stable, a region is proved, and C equals Python.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np

from surctl.export import software_in_the_loop
from surctl.ir import Layout, Port
from surctl.lyapunov import continuous_dynamics, find_stability
from surctl.system import (
    Action,
    Controller,
    Cost,
    Plant,
    System,
    every_combination,
    linearise,
    run_system,
    simulate_system,
)
from surctl.tuning import tune_system
from surctl.verification import system_margins

MASS, GRAVITY = 0.5, 9.81  # kg, m/s^2
WEIGHT, BODY_DRAG = MASS * GRAVITY, 0.01  # N; N s^2/m^2, vertical
INFLOW = 4 * 2.32e-4 * math.sqrt(WEIGHT / (4 * 5.57e-6))  # N s/m, loss of thrust of four rotors at hover speed
LIMIT, PERIOD, GUST = 3 * WEIGHT, 0.01, (5.0, 2.0)  # N, assumed; s; begin and duration of the gust [s]

HEIGHT, SPEED = Port("height", (1,), "m", "above the ground", 1.0), Port("speed", (1,), "m/s", "upwards")
THRUST, TARGET = Port("thrust", (1,), "N", "of the rotors", WEIGHT), Port("target", (1,), "m", "desired height", 2.0)
COMMAND = Layout((Port("tau", (1,), "N", "desired thrust"),))
K_P, K_D, K_I = Port("k_p", (1,), "1/s^2", "", 6), Port("k_d", (1,), "1/s", "", 4), Port("k_i", (1,), "1/s^3", "", 2)


def quadrotor(x, f, d, p):
    """x' of the vertical motion; the air moves upwards at the speed d."""
    air = x["speed"] - d["wind"]
    drag = BODY_DRAG * ca.fabs(air) * air + INFLOW * air
    return {
        "height": x["speed"],
        "speed": (x["thrust"] - drag) / p["mass"] - GRAVITY,
        "thrust": (f["tau"] - x["thrust"]) / p["lag"],
    }


def hold(x, u, p, limited=True):
    """PID law about the hover thrust; the integral stops while the thrust is at a limit, if there are limits."""
    error = u["target"] - u["height"]
    free = WEIGHT + MASS * (p["k_p"] * error - p["k_d"] * u["speed"] + x["sum"])
    tau = ca.fmax(0, ca.fmin(LIMIT, free)) if limited else free
    grown = ca.if_else(free == tau, x["sum"] + PERIOD * p["k_i"] * error, x["sum"])
    return Action(tau, {"sum": grown}, status=free != tau)


def gust(t, d):
    """Wind speed: half a sine of amplitude d."""
    since = (t - GUST[0]) / GUST[1]
    return {"wind": ca.if_else(ca.logic_and(since > 0, since < 1), d["wind"] * ca.sin(math.pi * since), 0)}


def cost_rate(s):
    """Integrand of the cost: 1 for an error of 0.1 m, or a thrust of a fifth of the weight above or below hover."""
    return ((s.r["target"] - s.x["height"]) / 0.1) ** 2 + ((s.f["tau"] - WEIGHT) / (0.2 * WEIGHT)) ** 2


MODEL = Layout((Port("mass", (1,), "kg", "", MASS), Port("lag", (1,), "s", "of the motors", 0.05)))
WIND, SUM = Port("wind", (1,), "m/s", "upwards, peak of the gust"), Port("sum", (1,), "m/s^2", "integral action")
STATE, GAINS, INPUTS = Layout((HEIGHT, SPEED, THRUST)), Layout((K_P, K_D, K_I)), Layout((HEIGHT, SPEED, TARGET))
plant = Plant("quadrotor", STATE, COMMAND, quadrotor, parameters=MODEL, disturbances=Layout((WIND,)))
law = Controller("quadrotor_altitude", PERIOD, INPUTS, COMMAND, hold, state=Layout((SUM,)), gains=GAINS)
COSTS = {
    "cost": Cost(cost_rate, "integral", "s"),
    "error_in_gust": Cost(lambda s: ca.fabs(s.r["target"] - s.x["height"]) * (s.t >= GUST[0]), "max", "m"),
}
system = System(plant, law, 1, COSTS, {"ground": lambda s: s.x["height"] < 0}, disturbance=gust)


def main() -> int:
    """Print the example; 1 if the loop is unstable, its claim is not proved, or C differs from Python."""
    sets, rng = 10 if sys.argv[1:] == ["--quick"] else 100, np.random.default_rng(1)
    ranges = {"k_p": (1.0, 60.0), "k_d": (1.0, 20.0), "k_i": (0.1, 40.0)}
    tried = {name: rng.uniform(*ends, sets) for name, ends in ranges.items()}
    cases = {"start.height": (1, 3), "start.speed": (-1, 1), "plant.mass": (0.45, 0.6), "plant.lag": (0.02, 0.08)}
    starts = {name: rng.uniform(*ends, sets) for name, ends in {**cases, "disturbance.wind": (-4, 4)}.items()}
    runs = simulate_system(system, 12.0, every_combination(tried, starts))
    print(f"sweep: {len(runs.time):,} runs, {np.mean(runs.stopped == 'time'):.1%} of them to their end")
    tuned = tune_system(system, 12.0, ranges, cases=starts, trials=6 * sets)
    print(*tuned.lines(), sep="\n")
    linear = linearise(system, tuned.gains)
    print(*(margin.line() for margin in system_margins(linear)), sep="\n")
    good = not tuned.unmet
    if sets == 100:  # the proof takes a minute
        free = replace(system, controller=replace(law, law=partial(hold, limited=False)), disturbance=None)
        values = {**tuned.gains, "start.height": 2.0, "start.thrust": WEIGHT}
        within = {"height": (1.7, 2.3), "speed": (-0.9, 0.9), "thrust": (0.5 * WEIGHT, 1.5 * WEIGHT)}
        within["controller.sum"] = (-0.9, 0.9)
        claim = find_stability(continuous_dynamics(free, within, values=values), degree=2, time_limit=90)  # s
        print(f"claim, height below the limit of thrust: {claim.verdict}: {claim.volume:.0%} of the box")
        good &= claim.verdict == "proved"
    record = run_system(system, 12.0, {**tuned.gains, "disturbance.wind": -3})
    print(f"one run: cost {record['cost']:.4g}, in the gust {record['error_in_gust']:.3f} m")
    report = software_in_the_loop(law, record)
    print(report.summary())
    return 0 if report.exact and good else 1


if __name__ == "__main__":
    sys.exit(main())
