"""Pendulum on a cart: linear-quadratic state feedback

The plant is linearised and sampled, python-control computes the gain, and the margins of the sampled loop are printed
before the nonlinear run. Cart and pole of Barto, Sutton and Anderson (1983).
"""

import casadi as ca
import control
import numpy as np

from surctl.ir import Layout, Port
from surctl.report import plot_record
from surctl.system import Controller, Plant, System, linearise, linearise_plant, run_system
from surctl.verification import system_disk_margin, system_margins

GRAVITY, CART, POLE, HALF, LIMIT, PERIOD = 9.8, 1.0, 0.1, 0.5, 10.0, 0.02  # m/s^2, kg, kg, m, N, s
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
    """Time derivative of the state; the pole is a uniform rod."""
    s, c = ca.sin(x["angle"]), ca.cos(x["angle"])
    drive = (f["tau"] + POLE * HALF * x["rate"] ** 2 * s) / (CART + POLE)
    turn = (GRAVITY * s - c * drive) / (HALF * (4 / 3 - POLE * c**2 / (CART + POLE)))
    slow = drive - POLE * HALF * turn * c / (CART + POLE)
    return {"place": x["speed"], "angle": x["rate"], "speed": slow, "rate": turn}


def feedback(x, u, p):
    """Force of the state feedback, within its limit."""
    return ca.fmax(-LIMIT, ca.fmin(LIMIT, -ca.dot(p["K"], ca.vertcat(*(u[port.name] for port in STATE)))))


plant = Plant("cart_pole", STATE, FORCE, cart_pole)
sampled = control.sample_system(linearise_plant(plant), PERIOD, "zoh")
K = np.asarray(control.dlqr(sampled.A, sampled.B, np.diag([4, 25, 0, 0]), [[1 / LIMIT**2]])[0])
gains = Layout((Port("K", (4,), "1", "state feedback, in SI units", K.ravel()),))
system = System(plant, Controller("pendulum_lqr", PERIOD, STATE, FORCE, feedback, gains=gains))

linear = linearise(system)
print("K =", np.round(K.ravel(), 1), "largest |pole| =", f"{abs(linear.poles()).max():.3f}")
for m in system_margins(linear, "tau"):
    print(f"{m.name}: phase margin {m.phase_margin_deg:.0f}°, delay margin {1e3 * m.delay_margin_s:.0f} ms")
print(f"disk margin {system_disk_margin(linear, 'tau').guaranteed:.2f}")
record = run_system(system, 6.0, {"start.place": 0.8, "start.angle": 0.3})
print(f"after 6 s: cart at {record['place'][-1, 0]:.3f} m, pole at {record['angle'][-1, 0]:.4f} rad")
plot_record(record).savefig("pendulum_lqr.png")
