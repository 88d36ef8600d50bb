"""Panda: reach around its own base without self-collision

The hand of a Panda arm moves from its right side to its left, low and close to the base, where the straight way leads
through the arm's own column. Capsules around base, forearm and hand keep 10 mm apart, and all joint limits hold.
"""

from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from surctl.robot import Capsule, StackController, load_urdf

DT, MARGIN, ACCELERATION = 0.01, 0.01, 15.0  # s, m, rad/s^2
JOINTS = (  # place [m] and turn about x [rad] in the link before, position limits [rad], largest speed [rad/s]
    ("0 0 0.333", 0.0, -2.8973, 2.8973, 2.175),
    ("0 0 0", -np.pi / 2, -1.7628, 1.7628, 2.175),
    ("0 -0.316 0", np.pi / 2, -2.8973, 2.8973, 2.175),
    ("0.0825 0 0", np.pi / 2, -3.0718, -0.0698, 2.175),
    ("-0.0825 0.384 0", -np.pi / 2, -2.8973, 2.8973, 2.61),
    ("0 0 0", np.pi / 2, -0.0175, 3.7525, 2.61),
    ("0.088 0 0", np.pi / 2, -2.8973, 2.8973, 2.61),
)
urdf = '<robot name="panda"><link name="link0"/>'
for k, (xyz, roll, lower, upper, speed) in enumerate(JOINTS, start=1):
    urdf += f"""<link name="link{k}"/><joint name="joint{k}" type="revolute"><origin xyz="{xyz}" rpy="{roll} 0 0"/>
        <parent link="link{k - 1}"/><child link="link{k}"/><axis xyz="0 0 1"/>
        <limit lower="{lower}" upper="{upper}" velocity="{speed}" effort="87"/></joint>"""
urdf += """<link name="hand"/><joint name="flange" type="fixed"><origin xyz="0 0 0.21" rpy="0 0 -0.785"/>
    <parent link="link7"/><child link="hand"/></joint></robot>"""
Path("panda.urdf").write_text(urdf)
arm = load_urdf("panda.urdf")
shapes = {
    "link0": [Capsule((-0.09, 0, 0.06), (-0.06, 0, 0.06), 0.06)],
    "link1": [Capsule((0, 0, -0.333), (0, 0, -0.05), 0.06)],
    "link5": [Capsule((0, 0, -0.31), (0, 0, -0.21), 0.06)],
    "hand": [Capsule((0, -0.05, -0.07), (0, 0.05, -0.07), 0.04), Capsule((0, 0, -0.07), (0, 0, -0.01), 0.03)],
}
tool = arm.frame_task("hand", target="tool", gain=5, max_speed=0.3, max_rate=1.0)
apart = arm.self_collision(shapes=shapes, margin=MARGIN)
tasks = [tool.position, tool.orientation, arm.posture_task("home")]
limits = [arm.joint_limits(acceleration=ACCELERATION), apart]
gap = ca.Function("gap", [arm.q], [ca.mmin(ca.vertcat(*(apart.distance(pair)[0] for pair in apart.pairs)))])
START, END = ([turn, 0.2, 0.0, -2.9, 0.0, 3.1, 0.8] for turn in (-1.9, 1.9))
goal = arm.pose("hand", END)
runs = {}
for label, chosen in (("without barriers", limits[:1]), ("with barriers", limits)):
    control = StackController(tasks, limits=chosen, dt=DT, damping=0.05)
    q, speeds = [np.array(START)], []
    for _ in range(600):
        speeds.append(control.step(q[-1], tool=goal))
        q.append(arm.integrate(q[-1], speeds[-1], DT))
    runs[label] = 1e3 * np.array([float(gap(at)) for at in q])
    error = 1e3 * np.linalg.norm(arm.pose("hand", q[-1])[:3, 3] - goal[:3, 3])
    print(f"{label}: {error:.3f} mm from the target after 6 s, least gap {runs[label].min():.1f} mm")

figure = plt.figure(figsize=(9, 4), layout="constrained")
space, plane = figure.add_subplot(121, projection="3d"), figure.add_subplot(122, xlabel="time [s]", ylabel="gap [mm]")
for k in range(0, 601, 100):
    points = [arm.pose(name, q[k])[:3, 3] for name in arm.links]
    space.plot(*np.transpose(points), "o-", ms=3, color=plt.cm.viridis(k / 600))
space.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title="poses, one per second")
space.set_aspect("equal")
space.locator_params(nbins=4)
for label, values in runs.items():
    plane.plot(DT * np.arange(len(values)), values, label=label)
plane.axhline(1e3 * MARGIN, color="k", ls=":")
plane.set_title("least distance")
plane.legend()
figure.savefig("panda_reach.png")
