"""Quadrotor: altitude in a gust, tuned by simulation

A PID law about the hover thrust. The search varies three gains, and simulates each gain set with eight combinations of
mass, motor lag and gust, which the law does not know. A disk margin is a condition.
"""

import math

import casadi as ca
import numpy as np

from surctl.ir import Layout, Port
from surctl.report import plot_record
from surctl.system import Action, Controller, Cost, Plant, System, run_system
from surctl.tuning import tune_system

MASS, GRAVITY, PERIOD, START, LAST = 0.5, 9.81, 0.01, 3.0, 2.0  # kg, m/s^2, s, s, s
WEIGHT = MASS * GRAVITY
INFLOW = 4 * 2.32e-4 * math.sqrt(WEIGHT / (4 * 5.57e-6))  # N s/m, loss of thrust of four rotors
HEIGHT, SPEED = Port("height", (1,), "m", "above the ground", 2.0), Port("speed", (1,), "m/s", "upwards")
THRUST, TARGET = Port("thrust", (1,), "N", "of the rotors", WEIGHT), Port("target", (1,), "m", "desired height", 2.0)
COMMAND = Layout((Port("tau", (1,), "N", "desired thrust"),))


def quadrotor(x, f, d, p):
    """Time derivative of height, speed and thrust; the air moves upwards at the speed of the gust."""
    air = x["speed"] - d["wind"]
    rate = (x["thrust"] - 0.01 * ca.fabs(air) * air - INFLOW * air) / p["mass"] - GRAVITY
    return {"height": x["speed"], "speed": rate, "thrust": (f["tau"] - x["thrust"]) / p["lag"]}


def hold(x, u, p):
    """PID law; the integral stops while the thrust is at a limit."""
    error = u["target"] - u["height"]
    free = WEIGHT + MASS * (p["k_p"] * error - p["k_d"] * u["speed"] + x["sum"])
    tau = ca.fmax(0, ca.fmin(3 * WEIGHT, free))
    return Action(tau, {"sum": ca.if_else(free == tau, x["sum"] + PERIOD * p["k_i"] * error, x["sum"])})


def gust(t, d):
    """Vertical wind: half a sine."""
    since = (t - START) / LAST
    return {"wind": ca.if_else(ca.logic_and(since > 0, since < 1), d["wind"] * ca.sin(math.pi * since), 0)}


def cost_rate(s):
    """Integrand of the cost: 1 for an error of 0.1 m, or a thrust of twice the weight."""
    return ((s.r["target"] - s.x["height"]) / 0.1) ** 2 + ((s.f["tau"] - WEIGHT) / WEIGHT) ** 2


gains = Layout((Port("k_p", (1,), "1/s^2", "", 6), Port("k_d", (1,), "1/s", "", 4), Port("k_i", (1,), "1/s^3", "", 2)))
unknown = Layout((Port("mass", (1,), "kg", "", MASS), Port("lag", (1,), "s", "of the motors", 0.05)))
wind = Layout((Port("wind", (1,), "m/s", "peak of the gust"),))
system = System(
    Plant("quadrotor", Layout((HEIGHT, SPEED, THRUST)), COMMAND, quadrotor, parameters=unknown, disturbances=wind),
    Controller(
        "altitude", PERIOD, Layout((HEIGHT, SPEED, TARGET)), COMMAND, hold,
        state=Layout((Port("sum", (1,), "m/s^2", "integral action"),)), gains=gains,
    ),
    costs={
        "cost": Cost(cost_rate, "integral", "s"),
        "worst": Cost(lambda s: ca.fabs(s.r["target"] - s.x["height"]), "max", "m"),
    },
    disturbance=gust,
)  # fmt: skip
rng = np.random.default_rng(1)
cases = {
    "plant.mass": rng.uniform(0.45, 0.6, 8),
    "plant.lag": rng.uniform(0.02, 0.08, 8),
    "disturbance.wind": rng.uniform(-4, 4, 8),
}
ranges = {"k_p": (1.0, 60.0), "k_d": (1.0, 20.0), "k_i": (0.1, 40.0)}
tuned = tune_system(system, 8.0, ranges, cases=cases, objective="cost", trials=60)
print(
    {name: float(f"{value:.3g}") for name, value in tuned.gains.items()},
    f"disk margin {tuned.figures['disk_margin'].value:.2f}",
)
for label, values in (("first gains", {}), ("tuned gains", tuned.gains)):
    record = run_system(system, 8.0, {**values, "disturbance.wind": -3})
    print(f"{label}: largest error in the gust {record['worst']:.3f} m")
plot_record(record).savefig("quadrotor_altitude.png")
