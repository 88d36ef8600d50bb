"""Humanoid: reach for the floor without falling over

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
LINK = """<link name="{0}"><inertial><origin xyz="0 0 {1}"/><mass value="{2}"/></inertial></link>"""
urdf = '<robot name="humanoid">' + LINK.format("pelvis", 0.05, 8)


def chain(below, side, joints):
    """URDF text of joints in a row; on the right side, y and the turns about x and z are mirrored."""
    text, sign = "", -1 if side == "right_" else 1
    for name, axis, (x, y, z), lower, upper, mass, height in joints:
        if sign < 0 and axis != "y":
            lower, upper = -upper, -lower
        text += LINK.format(side + name, height, mass) + f"""<joint name="{side}{name}" type="revolute">
            <parent link="{below}"/><child link="{side}{name}"/><origin xyz="{x} {sign * y} {z}"/>
            <axis xyz="{AXES[axis]}"/><limit lower="{lower}" upper="{upper}" velocity="3" effort="99"/></joint>"""
        below = side + name
    return text


urdf += chain("pelvis", "", TORSO)
for side in ("left_", "right_"):
    urdf += chain("pelvis", side, LEG) + chain("chest", side, ARM)
    urdf += f"""<link name="{side}hand"/><joint name="{side}wrist" type="fixed"><parent link="{side}elbow"/>
        <child link="{side}hand"/><origin xyz="0 0 -0.3"/></joint>"""
Path("humanoid.urdf").write_text(urdf + "</robot>")
body = load_urdf("humanoid.urdf", base="floating")
BEND = {"hip": -0.5, "knee": 1.0, "ankle": -0.5, "elbow": -1.0}
START = body.neutral()
for side in ("left_", "right_"):
    for name, angle in BEND.items():
        START[body.coordinate(side + name).q] = angle
feet = [body.frame_task(f"{side}_foot", target=f"{side}_foot", gain=10) for side in ("left", "right")]
hand = body.frame_task("right_hand", target="hand", gain=4, max_speed=0.4).position
ground = {f"{side}_foot": body.pose(f"{side}_foot", START) for side in ("left", "right")}
balance = SetTask(
    name="balance", eta=body.q, sigma=body.centre_of_mass[0][:2], lower=LOW, upper=HIGH, gain=4, kinematics=body.rate_map
)
tasks = [*(part for foot in feet for part in (foot.position, foot.orientation)), balance, hand, body.posture_task("home", START)]
import time
t=time.time()
control = StackController(tasks, limits=[body.joint_limits(acceleration=ACCELERATION)], dt=DT, damping=0.05)
com = ca.Function("com", [body.q], [body.centre_of_mass[0]])
q, path, speeds = START, [], []
for name, goal in {"up": (0.3, -0.3, 0.8), "floor": (0.4, -0.2, -0.75), "beyond": (1.2, -0.3, -0.5)}.items():
    for _ in range(200):
        speeds.append(control.step(q, hand=[*goal, 0, 0, 0, 1], **ground))
        q = body.integrate(q, speeds[-1], DT)
        off = max(np.linalg.norm((body.pose(foot, q) - at)[:3, 3]) for foot, at in ground.items())
        path.append([*np.array(com(q))[:2, 0], 1e3 * off, np.linalg.norm(body.pose("right_hand", q)[:3, 3] - goal)])
    print(name, path[-1], np.max(path,0), np.min(path,0), control.stage, control.binding(), abs(np.diff(speeds,axis=0)).max()/DT, abs(speeds[-1]).max())
    print(time.time()-t)
