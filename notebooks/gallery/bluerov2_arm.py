"""BlueROV2 with an arm: the tool stays still while a gust carries the vehicle off

The vehicle file is the base of an arm with four joints. The tool has the first priority, the station of the hull the
second. The gust is stronger than the thrusters; a controller that knows their limits moves the arm in time. The hull
follows the equations of motion of the file, without the reaction of the arm.
"""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from surctl.ir import Port
from surctl.marine.vehicle import PLANT_PARAMETERS, load_vehicle, plant_parameters, plant_thrust_limit
from surctl.robot import Input, StackController, load_urdf

DT, ACCELERATION = 0.02, 8.0  # s, rad/s^2
JOINTS = (  # parent, child, type, place in the parent [m], axis; z points down
    ("world", "carrier", "planar", "0 0 0", "0 0 1", 0), ("carrier", "hull", "prismatic", "0 0 0", "0 0 1", 9),
    ("hull", "turret", "revolute", "0.25 0 0.1", "0 0 1", 2.8), ("turret", "upper", "revolute", "0 0 0", "0 1 0", 2.2),
    ("upper", "fore", "revolute", "0.35 0 0", "0 1 0", 2.6), ("fore", "wrist", "revolute", "0.3 0 0", "0 1 0", 2.0),
    ("wrist", "tool", "fixed", "0.15 0 0", "0 0 1", 0),
)  # fmt: skip
urdf = '<robot name="rov"><link name="world"/>'
for parent, child, kind, xyz, axis, most in JOINTS:
    urdf += f"""<link name="{child}"/><joint name="{child}" type="{kind}"><parent link="{parent}"/>
        <child link="{child}"/><origin xyz="{xyz}"/><axis xyz="{axis}"/>
        <limit lower="-{most}" upper="{most}" velocity="1.5" effort="9"/></joint>"""
Path("rov.urdf").write_text(urdf + "</robot>")
rov = load_urdf("rov.urdf")
BASE = [0, 1, 3, 2]  # places of surge, sway, heave and yaw rate in v

numbers = PLANT_PARAMETERS.unpack(plant_parameters(load_vehicle("bluerov2-heavy")))
current = Input(Port("current", (2,), "m/s", "of the water, in the world"), ca.SX.sym("current", 2))
c, s = ca.cos(rov.q[2]), ca.sin(rov.q[2])
water = ca.vertcat(ca.horzcat(c, s) @ current.symbol, ca.horzcat(-s, c) @ current.symbol, 0)
thrust = plant_thrust_limit(rov.v[BASE], numbers, dt=DT, water=water)


class Thrust:
    """Thrust limits of the hull as limits of the whole robot."""

    def rows(self):
        return tuple(replace(row, a=row.a @ ca.SX.eye(rov.nv)[BASE, :]) for row in thrust.rows())


v = ca.SX.sym("v", 4)
needed = ca.Function("needed", [rov.q, rov.v, current.symbol, v], [thrust.needed(v)])
load = ca.Function("load", [rov.q, rov.v, current.symbol], [thrust.load])
START = np.array([0, 0, 0, 0, 0, -0.9, 1.6, 0.2])
STILL, STATION = rov.pose("tool", START), rov.pose("hull", START)
tool = rov.frame_task("tool", target="tool", gain=4).position
tool = replace(tool, inputs=(*tool.inputs, current))
hull = rov.frame_task("hull", target="station", gain=1, max_speed=0.3)
tasks = [tool, hull.position, hull.orientation, rov.posture_task("home", START)]
arm = rov.joint_limits(acceleration=dict.fromkeys(("turret", "upper", "fore", "wrist"), ACCELERATION))
most, mass = numbers["thrust_limit"], numbers["mass"]
paths, time = {}, DT * np.arange(1000)
gusts = np.clip(1 - abs(time - 6) / 2, 0, 1)[:, None] * [-0.65, 0.35] + [-0.1, 0.0]
for label, limits in (("thrust limits unknown", [arm]), ("thrust limits known", [Thrust(), arm])):
    control = StackController(tasks, limits=limits, dt=DT, damping=0.05)
    q, speed, paths[label] = START, np.zeros(rov.nv), []
    for flow in gusts:
        control.reset(speed)
        v = control.step(q, tool=STILL, station=STATION, current=flow)
        force = np.array(needed(q, speed, flow, v[BASE]))[:, 0]
        now, after = speed.copy(), v.copy()
        for _ in range(10):  # the hull is accelerated by what its thrusters give
            now[BASE] += DT / 10 * (np.clip(force, -most, most) - np.array(load(q, now, flow))[:, 0]) / mass
        after[BASE] = now[BASE]
        now[BASE], now[4:] = (speed[BASE] + after[BASE]) / 2, v[4:]
        q, speed = rov.integrate(q, now, DT), after
        off = [np.linalg.norm((rov.pose(link, q) - at)[:3, 3]) for link, at in (("tool", STILL), ("hull", STATION))]
        paths[label].append([*(1e3 * np.array(off)), (abs(force) / most).max()])
    (moved, drift, share), end = np.max(paths[label], axis=0), paths[label][-1][1]
    print(f"{label}: tool off by up to {moved:.1f} mm, hull by {drift:.0f} mm and {end:.2f} mm at the end")
    print(f"  largest commanded thrust {100 * share:.1f} % of the limit")

figure, axes = plt.subplots(2, 1, sharex=True, layout="constrained")
for label, path in paths.items():
    for ax, k in zip(axes, (0, 1), strict=True):
        ax.plot(time, np.array(path)[:, k], label=label)
axes[0].set(title="tool and hull in a gust", ylabel="tool off by [mm]")
axes[1].set(ylabel="hull off by [mm]", xlabel="time [s]")
axes[0].legend()
figure.savefig("bluerov2_arm.png")
