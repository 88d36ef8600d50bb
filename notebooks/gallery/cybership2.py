"""CyberShip II: dynamic positioning with four thrusters

A nonlinear PID law holds place and heading of a model ship under a constant load. The run and the exported C are
compared at every step. Model of Skjetne, Smogeli and Fossen (2004).
"""

import tempfile
from pathlib import Path

import casadi as ca
import numpy as np

from surctl.export import build_controller, compare_runs, write_bundle
from surctl.ir import Layout, Port
from surctl.marine.export import build_bundle
from surctl.report import plot_record
from surctl.system import Action, Controller, Plant, System, run_system

M11, M22, M23, M33 = 23.8 + 2.0, 23.8 + 10.0, 23.8 * 0.046, 1.76 + 1.0  # kg, kg, kg m, kg m^2
M = np.array([[M11, 0, 0], [0, M22, M23], [0, M23, M33]])
T = np.array([[1, 1, 0, 0], [0, 0, 1, 1], [0.078, -0.078, 0.45, -0.45]])  # port, starboard, bow, stern
MOST, PERIOD = ca.DM([4.0, 4.0, 2.0, 2.0]), 0.1  # N, s
ETA, NU = (
    Port("eta", (3,), "m, m, rad", "place and heading"),
    Port("nu", (3,), "m/s, m/s, rad/s", "velocity of the hull"),
)
TARGET = Port("target", (3,), "m, m, rad", "desired place and heading")
THRUST = Layout((Port("tau", (4,), "N", "port, starboard, bow, stern"),))


def rotation(heading):
    """Rotation (3, 3) from the hull to the world."""
    c, s = ca.cos(heading), ca.sin(heading)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))


def ship(x, f, d, p):
    """Time derivative of place and velocity: M nu' + C(nu) nu + D(nu) nu = T f + R' d."""
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
    total = ca.DM(T) @ f["tau"] + R.T @ d["load"] - coriolis - damping
    return {"eta": R @ x["nu"], "nu": ca.DM(np.linalg.inv(M)) @ total}


def positioning(x, u, p):
    """PID law with one frequency; a saturated thruster stops the integral action."""
    gap = u["eta"] - u["target"]
    R, w = rotation(u["eta"][2]), p["omega"]
    e = R.T @ ca.vertcat(gap[0], gap[1], ca.atan2(ca.sin(gap[2]), ca.cos(gap[2])))
    free = ca.DM(np.linalg.pinv(T)) @ (-ca.DM(M) @ (w**2 * e + 1.8 * w * u["nu"]) - R.T @ x["total"])
    thrust = ca.fmax(-MOST, ca.fmin(MOST, free))
    grown = x["total"] + PERIOD * w**3 / 8 * (R @ ca.DM(M) @ e)
    return Action(thrust, {"total": ca.if_else(ca.sum1(ca.fabs(free - thrust)) == 0, grown, x["total"])})


load = Layout((Port("load", (3,), "N, N, N m", "constant load in the world frame"),))
gains = Layout((Port("omega", (1,), "rad/s", "natural frequency", 0.6),))
total = Layout((Port("total", (3,), "N, N, N m", "integral action"),))
plant = Plant("cybership2", Layout((ETA, NU)), THRUST, ship, disturbances=load)
law = Controller("cybership2_pid", PERIOD, Layout((ETA, NU, TARGET)), THRUST, positioning, state=total, gains=gains)
record = run_system(System(plant, law), 60.0, {"start.eta": [[1.5, -1.0, 0.8]], "disturbance.load": [[0.6, -0.4, 0.1]]})
print("distance to the target after 60 s:", f"{np.hypot(*record['eta'][-1, :2]):.3f} m")
with tempfile.TemporaryDirectory() as folder:
    bundle = build_bundle(law, law.gains.unpack(record.controller[2]))
    write_bundle(bundle, Path(folder, "c"))
    (report,) = compare_runs(build_controller(law, bundle, Path(folder, "c")), [record])
print(f"C against Python over {report.steps} steps: largest difference {report.tau.absolute:.1e} N")
plot_record(record).savefig("cybership2.png")
