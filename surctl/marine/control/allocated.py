"""A law with allocation: the law's thrust command is distributed to the thrusters of the vehicle.

The command `tau` of the law becomes the force and yaw moment that the thrusters achieve together. So the filter of the
robot's own state uses the true thrust, the integral of an axis is held while the thrusters do not reach the command on
this axis (anti-windup), and the status contains `SATURATED` if they miss the command on any axis that they serve: the
side force of a rudder is not commanded, so it misses nothing. The limits of fins follow from the measured forward
speed `nu`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import casadi as ca

from surctl.errors import InputError
from surctl.ir import Call, Layout, Port, Program, Real, Routine, lower
from surctl.marine.allocation import allocation_block
from surctl.marine.control.law import SATURATED, Law
from surctl.marine.control.perception import LAST_THRUST
from surctl.marine.vehicle import Actuators, axis_limits
from surctl.priority.solver.elimination import FLOAT32, FLOAT64, Precision

__all__ = ["WORKING", "with_allocation"]

WORKING = "working"
"""Name of the input that says which thrusters work."""

_PRECISIONS = {"float64": FLOAT64, "float32": FLOAT32}


def _allocation_outputs(actuators: Actuators) -> tuple[Port, ...]:
    """Return the outputs (`Port`) that allocation appends to those of a law."""
    count, named = len(actuators.thrusters), ", ".join(actuators.names)
    joints = ", ".join(actuators.names[k] for k in actuators.swivels)
    angles = Port("thruster_angle", (len(actuators.swivels),), "rad", f"joint angles of {joints}")
    return (
        Port("tau_desired", (4,), "N, N m", "thrust command before the allocation, in {B}"),
        Port("thruster_force", (count,), "N", f"forces of {named}, along the push direction or the joint"),
        Port("thruster_command", (count,), "1", f"commands of {named}, from -1 to 1, by the inverse of their curves"),
        *((angles,) if joints else ()),
    )


@cache
def with_allocation(law: Law, actuators: Actuators, *, real: Real = "float64") -> Law:
    """Return the law with allocation to the thrusters; it has one more input, `working`, and further outputs.

    Example:
        >>> from surctl.marine.control import build_law, with_allocation
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law = with_allocation(build_law("closed_form"), load_vehicle("bluerov2-heavy").actuators)
        >>> [port.name for port in law.outputs][-3:], law.inputs.port("working").shape
        (['tau_desired', 'thruster_force', 'thruster_command'], (8,))
    """
    precision = _PRECISIONS[real]
    if actuators.fins and "nu" not in law.inputs:
        raise InputError(
            "measures no velocity, on which the force of a rudder depends",
            key="law",
            value=law.name,
            remedy="use true positions (--sensing truth)",
        )
    names = ", ".join(actuators.names)
    flags = Port(WORKING, (len(actuators.thrusters),), "1", f"1 for each thruster that works, else 0: {names}", 1.0)
    inputs = Layout((*law.inputs.ports, flags))
    outputs = Layout((*law.outputs.ports, *_allocation_outputs(actuators)))
    allocation = allocation_block(actuators, real)
    arrays = tuple(name for name, _ in allocation.outputs)
    steps = (
        Call(_apart(law, inputs, actuators), ("u",), ("u_law", WORKING)),
        Call(law.block, ("x", "u_law", "p"), ("desired", "x_law", "status_law", "telemetry_law")),
        Call(allocation, ("desired", WORKING), arrays),
        Call(
            _together(law, actuators, precision),
            ("x", "desired", "x_law", "status_law", "telemetry_law", *arrays),
            ("tau", "x_next", "status", "telemetry"),
        ),
    )
    sizes = (("x", law.state.size), ("u", inputs.size), ("p", dict(law.block.inputs)["p"]))
    block = Routine("allocated_law", sizes, steps, ("tau", "x_next", "status", "telemetry"))
    return replace(law, inputs=inputs, outputs=outputs, block=block, base=law, actuators=actuators)


def _apart(law: Law, inputs: Layout, actuators: Actuators) -> Program:
    u = ca.SX.sym("u", inputs.size)
    own = law.inputs.size
    shares = u[own:]
    if actuators.fins:
        speed = ca.fmax(u[law.inputs.slice("nu").start], 0)
        shares = ca.vertcat(
            *(u[own + k] * (speed * speed if k in actuators.fins else 1) for k in range(shares.numel()))
        )
    return lower(ca.Function("inputs_apart", [u], [u[:own], shares], ["u"], ["u_law", WORKING]))


def _together(law: Law, actuators: Actuators, precision: Precision) -> Program:
    sizes = {"x": law.state.size, "desired": 4, "x_law": law.state.size, "status_law": 1}
    sizes |= {"telemetry_law": law.outputs.size - 4, "achieved": 4, "components": actuators.matrix.shape[1]}
    sizes |= {"commands": len(actuators.thrusters)} | ({"angles": len(actuators.swivels)} if actuators.swivels else {})
    v = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    unit = actuators.largest * ca.DM([1.0, 1.0, 1.0, actuators.lever])
    missed = ca.fabs(v["achieved"] - v["desired"]) > precision.feasibility * unit
    if actuators.fins:
        driven = axis_limits(actuators, 1.0) > 0
        missed = ca.vertcat(*(missed[axis] if driven[axis] else 0 for axis in range(4)))
    entries = [v["x_law"][k] for k in range(law.state.size)]
    held = law.state.slice("integral")
    for axis, k in enumerate(range(held.start, held.stop)):
        entries[k] = ca.if_else(missed[axis], v["x"][k], entries[k])
    if LAST_THRUST.name in law.state:
        for axis, k in enumerate(range(*law.state.slice(LAST_THRUST.name).indices(law.state.size))):
            entries[k] = v["achieved"][axis]
    status = v["status_law"]
    odd = status - 2 * ca.floor(status / 2)
    status = ca.if_else(ca.logic_and(ca.mmax(missed) > 0, ca.eq(odd, 0)), status + SATURATED, status)
    forces = []
    for where in actuators.slices:
        part = v["components"][where]
        forces.append(part if part.numel() == 1 else ca.sqrt(ca.sumsqr(part)))
    angles = [v["angles"]] if "angles" in v else []
    telemetry = ca.vertcat(v["telemetry_law"], v["desired"], *forces, v["commands"], *angles)
    results = [v["achieved"], ca.vertcat(*entries), status, telemetry]
    names = ["tau", "x_next", "status", "telemetry"]
    return lower(ca.Function("allocated", list(v.values()), list(map(ca.densify, results)), list(v), names))
