"""BlueROV2: depth, attitude and speed by priority

With the bow 20 degrees down, a surge of 0.4 m/s contradicts a constant depth. The order of the tasks decides which of
them is given up. Parameters of von Benzon et al. (2022).
"""

import casadi as ca

from surctl.ir import Layout, Port
from surctl.priority import nsb_symbolic
from surctl.report import plot_record
from surctl.system import Controller, Plant, System, run_system

WEIGHT, BUOYANCY, ARM = 13.5 * 9.82, 1000 * 9.82 * 0.0134, -0.01  # N, N, m
MASS = ca.DM([13.5 + 6.36, 13.5 + 7.12, 13.5 + 18.68, 0.26 + 0.189, 0.23 + 0.135, 0.37 + 0.222])  # kg, kg m^2
LINEAR, QUADRATIC = ca.DM([13.7, 0, 33, 0, 0.8, 0]), ca.DM([141, 217, 190, 1.19, 0.47, 1.5])
MOST = ca.DM([40, 40, 40, 10, 10, 10])  # N, N m, assumed
Z, ANGLES = Port("z", (1,), "m", "depth"), Port("angles", (3,), "rad", "roll, pitch, yaw")
NU, FORCE = Port("nu", (6,), "m/s, rad/s", "velocity of the hull"), Port("tau", (6,), "N, N m", "force on the hull")
DEPTH, ATTITUDE = Port("depth", (1,), "m", "desired depth"), Port("attitude", (3,), "rad", "desired roll, pitch, yaw")
SPEED = Port("speed", (3,), "m/s", "desired velocity of the hull")


def kinematics(angles):
    """Rotation (3, 3) from the hull to the world, and the matrix (3, 3) from body rates to angle rates."""
    (sr, sp, sy), (cr, cp, cy) = (ca.vertsplit(of(angles)) for of in (ca.sin, ca.cos))
    R = ca.vertcat(
        ca.horzcat(cy * cp, cy * sp * sr - sy * cr, sy * sr + cy * cr * sp),
        ca.horzcat(sy * cp, cy * cr + sr * sp * sy, sp * sy * cr - cy * sr),
        ca.horzcat(-sp, cp * sr, cp * cr),
    )
    return R, ca.vertcat(
        ca.horzcat(1, sr * sp / cp, cr * sp / cp), ca.horzcat(0, cr, -sr), ca.horzcat(0, sr / cp, cr / cp)
    )


def loads(angles, nu):
    """Coriolis terms, damping, weight and buoyancy (6,)."""
    P, H, turn = MASS[:3] * nu[:3], MASS[3:] * nu[3:], nu[3:]
    down = kinematics(angles)[0][2, :].T
    lift = ca.vertcat(-(WEIGHT - BUOYANCY) * down, BUOYANCY * ca.cross(ca.DM([0, 0, ARM]), down))
    return (
        ca.vertcat(ca.cross(turn, P), ca.cross(turn, H) + ca.cross(nu[:3], P))
        + (LINEAR + QUADRATIC * ca.fabs(nu)) * nu
        + lift
    )


def rov(x, f, d, p):
    """Time derivative of depth, angles and velocity."""
    R, J = kinematics(x["angles"])
    return {
        "z": R[2, :] @ x["nu"][:3],
        "angles": J @ x["nu"][3:],
        "nu": (f["tau"] - loads(x["angles"], x["nu"])) / MASS,
    }


def by_priority(*order):
    """Law that gives the named tasks, highest priority first, to the null-space solution."""

    def law(x, u, p):
        R, J = kinematics(u["angles"])
        none, turn = ca.SX.zeros(3, 3), u["attitude"] - u["angles"]
        tasks = {
            "depth": (ca.horzcat(R[2, :], none[0, :]), 2.0 * (u["depth"] - u["z"])),
            "attitude": (ca.horzcat(none, J), 4.0 * turn),
            "speed": (ca.horzcat(ca.SX.eye(3), none), u["speed"]),
        }
        desired = nsb_symbolic([tasks[name] for name in order])
        return ca.fmax(-MOST, ca.fmin(MOST, loads(u["angles"], u["nu"]) + 8.0 * MASS * (desired - u["nu"])))

    return law


task = {"reference.depth": 2.0, "reference.attitude": [[0, -0.35, 1]], "reference.speed": [[0.4, 0, 0]]}
for order in (("speed", "attitude", "depth"), ("depth", "attitude", "speed")):
    force = Layout((FORCE,))
    law = Controller("bluerov2", 0.05, Layout((Z, ANGLES, NU, DEPTH, ATTITUDE, SPEED)), force, by_priority(*order))
    record = run_system(System(Plant("bluerov2", Layout((Z, ANGLES, NU)), force, rov), law, 2), 15.0, task)
    print(
        f"{' > '.join(order)}: depth {record['z'][-1, 0]:.2f} m of 2 m, surge {record['nu'][-1, 0]:.2f} m/s of 0.4 m/s"
    )
plot_record(record).savefig("bluerov2_attitude.png")
