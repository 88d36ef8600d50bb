"""Example: a pendulum on a cart with linear-quadratic state feedback, whose weights are chosen by simulation.

    python analysis/26_examples/pendulum_lqr.py            # 10,000 runs
    python analysis/26_examples/pendulum_lqr.py --quick    # 100 runs

Cart and pole of Barto, Sutton and Anderson (1983), no friction.
Status 0 if the loop is stable, its claim is refuted, and C equals Python, else 1.
"""

from __future__ import annotations

import sys

import casadi as ca
import control
import numpy as np
from claimed import print_refuted
from worked import Array, back_to_back, choose, draw, print_margins, sizes, sweep

from surctl.ir import Layout, Port
from surctl.lyapunov import continuous_dynamics
from surctl.system import Controller, Cost, Plant, System, linearise, linearise_plant, run_system

GRAVITY, CART, POLE, HALF = 9.8, 1.0, 0.1, 0.5  # m/s^2, kg, kg, m: half the length of the pole
LIMIT = 10.0  # N
PERIOD = 0.02  # s
STATE = Layout(
    (
        Port("place", (1,), "m", "of the cart"),
        Port("angle", (1,), "rad", "of the pole, from upright"),
        Port("speed", (1,), "m/s", "of the cart"),
        Port("rate", (1,), "rad/s", "of the pole"),
    )
)
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


plant = Plant("cart_pole", STATE, FORCE, cart_pole)
system = System(
    plant,
    Controller("pendulum_lqr", PERIOD, STATE, FORCE, feedback, gains=Layout((Port("K", (4,), "1", "in SI units"),))),
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


def gain(weights: Array) -> Array:
    """K (4,) of `control.dlqr` for the sampled linearisation, for the weights of place, angle, speed and rate."""
    return np.asarray(control.dlqr(SAMPLED.A, SAMPLED.B, np.diag(weights), [[1 / LIMIT**2]])[0]).ravel()


SAMPLED = control.sample_system(linearise_plant(plant), PERIOD, "zoh")


def main() -> int:
    """Print the example; 1 if the loop is unstable, its claim is not refuted, or C differs from Python."""
    sets, states = sizes(__doc__)
    bryson = gain(np.array([1 / 0.5**2, 1 / 0.2**2, 0, 0]))
    start = {"start.place": 0.8, "start.angle": 0.3}
    record = run_system(system, 10.0, {"K": bryson[None], **start})
    print(f"one run, weights by Bryson's rule: K = {bryson.round(2)}, settled at {record['settling']:.2f} s")
    weights = 10 ** draw(sets, 1, {"weights": (np.array([-1, -1, -3, -3.0]), np.array([2.5, 3, 1.5, 1.5]))})["weights"]
    starts = draw(
        states,
        2,
        {"start.place": (-0.8, 0.8), "start.angle": (-0.3, 0.3), "start.speed": (-0.3, 0.3), "start.rate": (-0.3, 0.3)},
    )
    gains = {"K": np.array([bryson, *map(gain, weights[1:])])}
    cost = sweep(system, 10.0, gains, starts)
    print(f"cost of the weights by Bryson's rule: {cost[0]:.4g}")
    best = choose(system, gains, cost, ("tau",), {})
    stable = print_margins(linearise(system, best), "tau", *(port.name for port in STATE))
    P = control.dlyap((SAMPLED.A - SAMPLED.B @ best["K"]).T, np.eye(STATE.size))
    within = {"place": (-2.4, 2.4), "angle": (-1.2, 1.2), "speed": (-20.0, 20.0), "rate": (-20.0, 20.0)}
    about = "V of the linear loop decreases with the force limit, in its largest ellipsoid on the rail within 1.2 rad"
    refuted = print_refuted(continuous_dynamics(system, within, values=best), P, about)
    return 0 if back_to_back(run_system(system, 10.0, {**best, **start})) and stable and refuted else 1


if __name__ == "__main__":
    sys.exit(main())
