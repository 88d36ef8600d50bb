"""Example: the altitude of a quadrotor with motor lag and drag in a vertical gust.

    python analysis/26_examples/quadrotor_altitude.py    # 10,000 runs, then a search; --quick: 100 runs

Parameters of the AscTec Hummingbird. Status 0 if the loop is stable, a region is proved, and C equals Python.
"""

from __future__ import annotations

import math
import sys

import casadi as ca
from claimed import motion, print_claim
from worked import LEAST, back_to_back, choose, draw, named, print_margins, sizes, sweep

from surctl.ir import Layout, Port
from surctl.system import Action, Controller, Cost, Plant, System, linearise, run_system
from surctl.tuning import tune_system

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


system = System(
    Plant(
        "quadrotor",
        Layout((HEIGHT, SPEED, THRUST)),
        COMMAND,
        quadrotor,
        parameters=Layout((Port("mass", (1,), "kg", "", MASS), Port("lag", (1,), "s", "of the motors", 0.05))),
        disturbances=Layout((Port("wind", (1,), "m/s", "upwards, peak of the gust"),)),
    ),
    Controller(
        "quadrotor_altitude",
        PERIOD,
        Layout((HEIGHT, SPEED, TARGET)),
        COMMAND,
        hold,
        state=Layout((Port("sum", (1,), "m/s^2", "integral action"),)),
        gains=Layout((K_P, K_D, K_I)),
    ),
    substeps=1,
    costs={
        "cost": Cost(cost_rate, "integral", "s"),
        "error_in_gust": Cost(lambda s: ca.fabs(s.r["target"] - s.x["height"]) * (s.t >= GUST[0]), "max", "m"),
    },
    stops={"ground": lambda s: s.x["height"] < 0},
    disturbance=gust,
)


def main() -> int:
    """Print the example; 1 if the loop is unstable, its claim is not proved, or C differs from Python."""
    sets, states = sizes(__doc__)
    record = run_system(system, 12.0, {"disturbance.wind": -3})
    print(f"one run, default gains: cost {record['cost']:.4g}, in the gust {record['error_in_gust']:.3f} m")
    ranges = {"k_p": (1.0, 60.0), "k_d": (1.0, 20.0), "k_i": (0.0, 40.0)}
    tried = draw(sets, 1, ranges)
    starts = draw(states, 2, {"start.height": (1, 3), "start.speed": (-1, 1), "plant.mass": (0.45, 0.6),
                              "plant.lag": (0.02, 0.08), "disturbance.wind": (-4, 4)})  # fmt: skip
    cost = sweep(system, 12.0, tried, starts)
    choose(system, tried, cost, ("tau",), {})
    tuned = tune_system(system, 12.0, ranges, cases=starts, objective="cost", trials=6 * sets, least_disk_margin=LEAST)
    best, tried = tuned.gains, f"{tuned.trials} gain sets of {states} runs"
    print(f"search: {named(best)}, cost {tuned.costs['cost']:.4g}, {tried}")
    record = run_system(system, 12.0, {**best, "disturbance.wind": -3})
    print(f"the same run: cost {record['cost']:.4g}, in the gust {record['error_in_gust']:.3f} m")
    about, values = "integral action, as long as no limit of thrust is reached", {**best, "start.height": 2.0}
    within = {"height": (1, 3), "speed": (-3, 3), "thrust": (0, 2 * WEIGHT)}
    if sets < 100:  # the state of the controller takes most of a minute more
        proved = print_claim(motion(system, within, values | {"k_i": 0}, limited=False), f"without {about}", first=True)
    else:
        within = {"height": (1.7, 2.3), "speed": (-0.9, 0.9), "thrust": (0.5 * WEIGHT, 1.5 * WEIGHT)}
        within |= {"controller.sum": (-0.9, 0.9)}
        proved = print_claim(motion(system, within, values, limited=False), f"with {about}", 90.0)
    stable = print_margins(linearise(system, best), "tau", "height", "speed")
    return 0 if back_to_back(record) and stable and proved else 1


if __name__ == "__main__":
    sys.exit(main())
