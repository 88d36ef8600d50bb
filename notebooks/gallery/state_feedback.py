"""Heading of a ship: state feedback from python-control

python-control places the poles of the sampled Nomoto model with a rudder servo. surctl simulates the same law with the
rudder's limit, and python-control the linear loop: as long as the rudder is within its limit, both agree.
"""

import casadi as ca
import control
import numpy as np

from surctl.ir import Layout, Port
from surctl.report import plot_record
from surctl.system import Controller, Plant, System, linearise, linearise_plant, run_system
from surctl.verification import system_disk_margin

GAIN, TIME, SERVO, LIMIT, PERIOD = 0.08, 12.0, 1.5, np.radians(25), 0.5  # 1/s, s, s, rad, s
STATE = Layout(
    (
        Port("heading", (1,), "rad", "heading"),
        Port("rate", (1,), "rad/s", "yaw rate"),
        Port("rudder", (1,), "rad", "angle of the rudder"),
    )
)
TARGET, RUDDER = Port("target", (1,), "rad", "desired heading"), Layout((Port("tau", (1,), "rad", "rudder command"),))


def ship(x, f, d, p):
    """Time derivative of the state: Nomoto's first-order model and the lag of the servo."""
    rate = (GAIN * x["rudder"] - x["rate"]) / TIME
    return {"heading": x["rate"], "rate": rate, "rudder": (f["tau"] - x["rudder"]) / SERVO}


def feedback(x, u, p):
    """Rudder command of the state feedback, within its limit."""
    state = ca.vertcat(u["heading"] - u["target"], u["rate"], u["rudder"])
    return ca.fmax(-LIMIT, ca.fmin(LIMIT, -ca.dot(p["K"], state)))


plant = Plant("nomoto", STATE, RUDDER, ship)
sampled = control.sample_system(linearise_plant(plant), PERIOD, "zoh")
K = np.asarray(control.place(sampled.A, sampled.B, np.exp(PERIOD * np.array([-0.1, -0.2, -0.9])))).ravel()
gains = Layout((Port("K", (3,), "1", "state feedback, in SI units", K),))
law = Controller("heading_feedback", PERIOD, Layout((*STATE.ports, TARGET)), RUDDER, feedback, gains=gains)
system = System(plant, law)

print("K =", K.round(2), f"disk margin {system_disk_margin(linearise(system), 'tau').guaranteed:.2f}")
loop = control.ss(sampled.A - sampled.B @ K[None], sampled.B * K[0], np.eye(3), 0, PERIOD)
for degrees in (5, 60):
    record = run_system(system, 80.0, {"reference.target": np.radians(degrees)})
    steps = np.arange(0, 80.0, PERIOD)
    linear = control.forced_response(loop, steps, np.full(len(steps), np.radians(degrees))).states[0]
    gap = np.degrees(abs(np.interp(steps, record.time, record["heading"][:, 0]) - linear).max())
    print(f"turn of {degrees}°: largest difference to python-control's linear loop {gap:.2g}°")
plot_record(record).savefig("state_feedback.png")
