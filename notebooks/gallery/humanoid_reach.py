"""Humanoid: reach high, low and too far without falling over

A humanoid on a free base keeps both feet where they are, then its centre of mass above them, then moves its right hand
to targets. The last target is too far away: the hand comes as near as feet, balance and joints allow.
"""

from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from surctl.robot import StackController, load_urdf
from surctl.tasks import SetTask

DT, ACCELERATION, AXES = 0.02, 20.0, {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}  # s, rad/s^2
LOW, HIGH = (-0.03, -0.09), (0.1, 0.09)  # m, ends of the centre of mass
LEG = (  # joint and link, axis, place in the link before [m], position limits [rad], mass [kg], its height [m]
    ("hip_yaw", "z", (0, 0.09, -0.05), -0.7, 0.7, 1, 0), ("hip_roll", "x", (0, 0, 0), -0.5, 0.5, 1, 0),
    ("hip", "y", (0, 0, 0), -2.2, 0.7, 5, -0.2), ("knee", "y", (0, 0, -0.4), 0.0, 2.4, 3, -0.2),
    ("ankle", "y", (0, 0, -0.4), -1.0, 0.7, 0.5, 0), ("foot", "x", (0, 0, 0), -0.4, 0.4, 1, -0.05),
)  # fmt: skip
TORSO = (("waist", "z", (0, 0, 0.1), -1.5, 1.5, 4, 0.05), ("chest", "y", (0, 0, 0.1), -0.4, 1.2, 14, 0.2))
ARM = (
    ("shoulder", "y", (0, 0.2, 0.35), -3.0, 1.5, 1, 0), ("upper", "x", (0, 0, 0), -0.3, 2.5, 2, -0.15),
    ("twist", "z", (0, 0, -0.28), -1.5, 1.5, 0.5, 0), ("elbow", "y", (0, 0, 0), -2.4, 0.0, 1.5, -0.15),
)  # fmt: skip
PART = """<link name="{0}"><inertial><origin xyz="0 0 {1}"/><mass value="{2}"/></inertial></link>"""
HINGE = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{0}"/><origin xyz="{3} {4} {5}"/>
    <axis xyz="{6}"/><limit lower="{7}" upper="{8}" velocity="3" effort="99"/></joint>"""


def chain(below, side, joints):
    """URDF text of joints in a row; on the right side, y and the turns about x and z are mirrored."""
    text, sign = "", -1 if side == "right_" else 1
    for name, axis, (x, y, z), lower, upper, mass, height in joints:
        ends = (-upper, -lower) if sign < 0 and axis != "y" else (lower, upper)
        text += PART.format(side + name, height, mass)
        text += HINGE.format(side + name, "revolute", below, x, sign * y, z, AXES[axis], *ends)
        below = side + name
    return text


urdf = '<robot name="humanoid">' + PART.format("pelvis", 0.05, 8) + chain("pelvis", "", TORSO)
for side in ("left_", "right_"):
    urdf += chain("pelvis", side, LEG) + chain("chest", side, ARM) + f'<link name="{side}hand"/>'
    urdf += HINGE.format(f"{side}hand", "fixed", f"{side}elbow", 0, 0, -0.3, AXES["z"], 0, 0)
Path("humanoid.urdf").write_text(urdf + "</robot>")
body = load_urdf("humanoid.urdf", base="floating")
START = body.neutral()
for name, angle in {"hip": -0.5, "knee": 1.0, "ankle": -0.5, "elbow": -1.0}.items():
    START[[body.coordinate(side + name).q for side in ("left_", "right_")]] = angle
feet = [body.frame_task(f"{side}_foot", target=f"{side}_foot", gain=10) for side in ("left", "right")]
hand = body.frame_task("right_hand", target="hand", gain=4, max_speed=0.4).position
ground = {f"{side}_foot": body.pose(f"{side}_foot", START) for side in ("left", "right")}
balance = SetTask(
    name="balance",
    eta=body.q,
    sigma=body.centre_of_mass[0][:2],
    lower=LOW,
    upper=HIGH,
    gain=4,
    kinematics=body.rate_map,
)
stand = [task for foot in feet for task in (foot.position, foot.orientation)]
control = StackController(
    [*stand, balance, hand, body.posture_task("home", START)],
    limits=[body.joint_limits(acceleration=ACCELERATION)], dt=DT, damping=0.05,
)  # fmt: skip
com = ca.Function("com", [body.q], [body.centre_of_mass[0]])
q, centres, errors, shown = [START], [], [], [START]
for name, goal in {"high": (0.3, -0.3, 0.8), "low": (0.4, -0.2, -0.4), "too far": (1.2, -0.3, -0.4)}.items():
    slip = []
    for _ in range(250):
        q.append(body.integrate(q[-1], control.step(q[-1], hand=[*goal, 0, 0, 0, 1], **ground), DT))
        slip += [1e3 * np.linalg.norm((body.pose(foot, q[-1]) - at)[:3, 3]) for foot, at in ground.items()]
        centres.append(np.array(com(q[-1]))[:2, 0])
        errors.append(1e3 * np.linalg.norm(body.pose("right_hand", q[-1])[:3, 3] - goal))
    shown.append(q[-1])
    print(f"{name}: hand {errors[-1]:.2f} mm from its target, feet slip by at most {max(slip):.2f} mm")
low, high = 1e3 * np.min(centres, axis=0), 1e3 * np.max(centres, axis=0)
print(f"centre of mass: x from {low[0]:.1f} to {high[0]:.1f} mm, y from {low[1]:.1f} to {high[1]:.1f} mm")

figure = plt.figure(figsize=(9, 4), layout="constrained")
space, plane = figure.add_subplot(121, projection="3d"), figure.add_subplot(122, xlabel="x [m]", ylabel="y [m]")
for at, colour in zip(shown, ("C0", "C1", "C2", "C3"), strict=True):
    for tip in ("left_foot", "right_foot", "left_hand", "right_hand"):
        line = [tip]
        while (above := body.parent(line[-1])) not in (None, "world"):
            line.append(above)
        space.plot(*np.transpose([body.pose(link, at)[:3, 3] for link in line]), color=colour)
space.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title="poses at the targets")
space.set_aspect("equal")
space.locator_params(nbins=4)
plane.plot(*np.transpose(centres), label="centre of mass")
plane.add_patch(plt.Rectangle(LOW, HIGH[0] - LOW[0], HIGH[1] - LOW[1], fill=False, ls=":"))
plane.set_title("centre of mass over the feet")
plane.legend()
figure.savefig("humanoid_reach.png")
