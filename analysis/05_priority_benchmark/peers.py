"""pink and mink on a minimal problem of their own: a robot with the four degrees of freedom of the vehicle.

Both are libraries of inverse kinematics: they weigh tasks instead of ranking them, and evaluate a robot model in
every step. On this problem (go to a point and hold the heading, which do not conflict, inside velocity limits) weights
and ranks give the same answer, so that it can be compared; the times are an indicator, not a race of equals.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from contender import Contender, Missing
from numpy.typing import NDArray

from surctl.priority import Level, Mode, Row, assemble, build_problem, solve
from surctl.tasks import HalfPlane, Stack, heading_task, position_task
from surctl.tasks.task import jacobian

__all__ = ["MINK", "PEER", "PEER_API", "PEER_FAST", "PEER_FILTER", "PINK", "peers"]

Array: TypeAlias = NDArray[np.float64]

PEER = "go to a point, hold the heading"
PEER_FAST, PEER_API = "surctl fast path: projected, their problem", "surctl build_problem + solve: their problem"
PEER_FILTER = "surctl fast path: filter, their problem"
PINK, MINK = "pink (pinocchio), daqp", "mink (mujoco), daqp"

_DT = 0.01  # s
_GAIN = 0.5
_LIMIT = np.array([0.6, 0.5, 0.4, 0.8])
_MJCF = """<mujoco><option timestep="0.01"/><worldbody><body name="vehicle">
<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
<joint name="z" type="slide" axis="0 0 1"/><joint name="psi" type="hinge" axis="0 0 1"/>
<geom type="sphere" size="0.2" mass="10"/></body></worldbody></mujoco>"""


def peers(count: int, *, seed: int, filtered: bool) -> list[Contender | Missing]:
    """Return the contenders with `count` poses and targets, some of which need a velocity outside the limits.

    Our fast path as a filter takes part if `filtered`.
    """
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(-2, 2, (count, 3)), rng.uniform(-1, 1, count)])
    targets = poses.copy()
    # hold the heading: with a turn their frame task requires a screw motion, which is another problem
    targets[:, :3] += 0.01 * rng.normal(size=(count, 3))
    ticks = list(zip(poses, targets, strict=True))
    found: list[Contender | Missing] = [
        Contender(PEER_FAST, PEER, _fast("projected"), ticks, ours=True, read=_in_world),
        Contender(PEER_API, PEER, _api(), ticks, ours=True),
    ]
    if filtered:
        found.append(Contender(PEER_FILTER, PEER, _fast("filter"), ticks, ours=True, read=_in_world))
    for name, packages, make in (
        (PINK, ("pink", "pinocchio"), _pink),
        (MINK, ("mink", "mujoco"), _mink),
    ):
        if all(importlib.util.find_spec(package) for package in packages):
            found.append(Contender(name, PEER, make(), ticks))
        else:
            found.append(Missing(name))
    return found


def _api() -> Callable[[Array, Array], Array]:
    rows = [Row(f"box.{name}", "actuator", np.eye(4)[i], -_LIMIT[i], _LIMIT[i]) for i, name in enumerate("xyzr")]
    place, turn = np.eye(4)[:3], np.eye(4)[3:]

    def run(pose: Array, target: Array) -> Array:
        x = _GAIN / _DT * (target - pose)
        return solve(build_problem([Level("position", place, x[:3]), Level("angle", turn, x[3:])], rows)).v

    return run


def _fast(mode: Mode) -> Callable[[Array, Array], Array]:
    """Tasks, their Jacobians at the pose, and the limits in one compiled call; limits in {E}, as theirs.

    The task rows are orthonormal, so that the nearest point to the law without limits (filter), the first task first
    (projected) and equal weights (theirs) are one point.
    """
    eta, wanted = ca.SX.sym("eta", 4), ca.SX.sym("wanted", 4)
    gain = _GAIN / _DT
    stack = Stack((position_task(eta, wanted[:3], gain=gain), heading_task(eta, wanted[3], gain=gain)))
    to_world = jacobian(eta[3])
    limits = [
        HalfPlane(f"box.{name}.{side}", sign * to_world[i, :].T, _LIMIT[i], kind="actuator")
        for i, name in enumerate("xyzr")
        for side, sign in (("upper", 1), ("lower", -1))
    ]
    tick = assemble(stack, limits, inputs={"eta": eta, "wanted": wanted}).step(mode)
    here, there = tick.inputs["eta"], tick.inputs["wanted"]

    def run(pose: Array, target: Array) -> Array:
        here[:] = pose
        there[:] = target
        tick.solve()
        return tick.v

    return run


def _in_world(v: Array, pose: Array, target: Array) -> Array:
    """Transform v from {B} to the joint coordinates of pink and mink."""
    c, s = math.cos(pose[3]), math.sin(pose[3])
    return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2], v[3]])


def _pink() -> Callable[[Array, Array], Array]:
    pink, pin = import_module("pink"), import_module("pinocchio")
    model: Any = pin.Model()
    parent = 0
    joints = (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ(), pin.JointModelRZ())
    for name, joint in zip(("x", "y", "z", "psi"), joints, strict=True):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), name)
    model.appendBodyToJoint(parent, pin.Inertia.FromSphere(10.0, 0.2), pin.SE3.Identity())
    model.addFrame(pin.Frame("vehicle", parent, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    model.velocityLimit = _LIMIT.copy()
    model.lowerPositionLimit, model.upperPositionLimit = np.full(4, -10.0), np.full(4, 10.0)
    configuration = pink.Configuration(model, model.createData(), np.zeros(4))
    task = pink.FrameTask("vehicle", position_cost=1.0, orientation_cost=1.0, gain=_GAIN)
    limits = [pink.limits.VelocityLimit(model)]

    def run(pose: Array, target: Array) -> Array:
        configuration.update(pose)
        task.set_target(pin.SE3(pin.utils.rotate("z", target[3]), target[:3]))
        return np.asarray(pink.solve_ik(configuration, [task], _DT, solver="daqp", limits=limits))

    return run


def _mink() -> Callable[[Array, Array], Array]:
    mink, mujoco = import_module("mink"), import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(_MJCF)
    configuration = mink.Configuration(model)
    task = mink.FrameTask("vehicle", "body", position_cost=1.0, orientation_cost=1.0, gain=_GAIN)
    limits = [mink.VelocityLimit(model, dict(zip(("x", "y", "z", "psi"), _LIMIT, strict=True)))]

    def run(pose: Array, target: Array) -> Array:
        configuration.update(pose)
        task.set_target(mink.SE3.from_rotation_and_translation(mink.SO3.from_z_radians(target[3]), target[:3]))
        return np.asarray(mink.solve_ik(configuration, [task], _DT, solver="daqp", limits=limits))

    return run
