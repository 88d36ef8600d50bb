"""Two arms: carry a bar that neither arm lets go

The left hand stays where it holds the bar, which is its target in the frame of the right hand and the first task. Then
the right hand moves to its targets. The last one lies behind the column between the arms, so the bar stops before it.
"""

from pathlib import Path

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

from surctl.robot import Capsule, StackController, load_urdf

DT, MARGIN, ACCELERATION = 0.01, 0.02, 10.0  # s, m, rad/s^2
JOINTS = (  # height above the joint before [m], axis, largest angle [rad]
    ("0.3", "0 0 1", 2.8), ("0", "0 1 0", 2.2), ("0.4", "0 1 0", 2.6),
    ("0.2", "0 0 1", 2.8), ("0.2", "0 1 0", 1.9), ("0.1", "0 0 1", 3.0),
)  # fmt: skip
LINK = """<link name="{0}"><collision><origin xyz="0 0 {1}"/><geometry><capsule radius="{2}" length="{3}"/></geometry>
    </collision></link>"""
urdf = '<robot name="pair">' + LINK.format("column", 0.35, 0.1, 0.5)
for side, y in (("right", -0.35), ("left", 0.35)):
    urdf += f"""<link name="{side}0"/><joint name="{side}" type="fixed"><parent link="column"/><child link="{side}0"/>
        <origin xyz="0 {y} 0"/></joint>"""
    for k, (z, axis, most) in enumerate(JOINTS, start=1):
        shape = {3: (0.1, 0.05, 0.2), 4: (0.05, 0.05, 0.1), 6: (0.05, 0.03, 0.1)}.get(k)
        name = f"{side}{k}"
        urdf += LINK.format(name, *shape) if shape else f'<link name="{name}"/>'
        urdf += f"""<joint name="{name}" type="revolute"><parent link="{side}{k - 1}"/><child link="{name}"/>
            <origin xyz="0 0 {z}"/><axis xyz="{axis}"/><limit lower="-{most}" upper="{most}" velocity="2" effort="9"/>
            </joint>"""
urdf += (
    """<link name="bar"/><joint name="grasp" type="fixed"><parent link="right6"/><child link="bar"/></joint></robot>"""
)
Path("pair.urdf").write_text(urdf)
arms = load_urdf("pair.urdf")
q = [np.array([0.2, 0.7, 1.2, 0, -0.3, 0, -0.2, 0.7, 1.2, 0, -0.3, 0])]
begin = arms.pose("right6", q[0])
held = np.linalg.inv(begin) @ arms.pose("left6", q[0])
bar = Capsule(0.2 * held[:3, 3], 0.8 * held[:3, 3], 0.02)
right = arms.frame_task("right6", target="right", gain=4, max_speed=0.3, max_rate=1.0)
grip = arms.frame_task("left6", target="grip", relative_to="right6", gain=8)
apart = arms.self_collision(margin=MARGIN, shapes={"bar": [bar]})
tasks = [grip.position, grip.orientation, right.position, right.orientation, arms.posture_task("home", q[0])]
limits = [arms.joint_limits(acceleration=ACCELERATION), apart]
control = StackController(tasks, limits=limits, dt=DT, damping=0.05)
gap = ca.Function("gap", [arms.q], [ca.mmin(ca.vertcat(*(apart.distance(pair)[0] for pair in apart.pairs)))])
lifted = begin.copy()
lifted[2, 3] += 0.2
tilted = begin @ [[1, 0, 0, 0], [0, 0.8, -0.6, 0], [0, 0.6, 0.8, 0], [0, 0, 0, 1]]
behind = begin.copy()
behind[0, 3] -= 0.8
work = {"lift": lifted, "tilt": tilted, "pull": behind}
slip, shown = [], [0]
for name, goal in work.items():
    for _ in range(500):
        q.append(arms.integrate(q[-1], control.step(q[-1], right=goal, grip=held), DT))
        now = np.linalg.inv(arms.pose("right6", q[-1])) @ arms.pose("left6", q[-1])
        slip.append(1e3 * np.linalg.norm((now - held)[:3, 3]))
    shown.append(len(slip))
    error = 1e3 * np.linalg.norm((arms.pose("right6", q[-1]) - goal)[:3, 3])
    print(f"{name}: right hand {error:.2f} mm from its target, bar slips by at most {max(slip[-500:]):.2f} mm")
gaps = [1e3 * float(gap(at)) for at in q]
print(f"least gap {min(gaps):.2f} mm; at the end {', '.join(control.binding())} bind")

figure = plt.figure(figsize=(9, 4), layout="constrained")
space, plane = figure.add_subplot(121, projection="3d"), figure.add_subplot(122, xlabel="time [s]", ylabel="[mm]")
links = [*(f"left{k}" for k in range(7)), *(f"right{k}" for k in reversed(range(7)))]
for k in shown:
    space.plot(*np.transpose([arms.pose(link, q[k])[:3, 3] for link in links]), "o-", ms=3)
space.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title="poses at the targets")
space.set_aspect("equal")
space.locator_params(nbins=4)
plane.plot(DT * np.arange(len(gaps)), gaps, label="least gap")
plane.plot(DT * np.arange(len(slip)), slip, label="slip of the bar")
plane.axhline(1e3 * MARGIN, color="k", ls=":")
plane.set_title("gap and slip")
plane.legend()
figure.savefig("two_arms.png")
