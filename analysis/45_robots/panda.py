"""A Panda from its URDF and SRDF files to C on an emulated Cortex-M7; needs the package example-robot-data."""

import numpy as np
from robots import folder_of_robots

from surctl.robot import StackController, load_urdf

files = folder_of_robots() / "panda_description"
arm = load_urdf(files / "urdf" / "panda_collision.urdf", lock=["panda_finger_joint1"])
tool = arm.frame_task("panda_link8", target="tool", gain=5, max_speed=0.3)
home = arm.posture_task("home", gain=1)
limits = [arm.joint_limits(acceleration=15), arm.self_collision(files / "srdf" / "panda.srdf", margin=0.01)]
control = StackController([tool.position, tool.orientation, home], limits=limits, dt=0.001)
q = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
print(control.step(q, tool=arm.pose("panda_link8", q + 0.2)), control.stage)
print(control.export("firmware", target="cortex-m7").summary())
