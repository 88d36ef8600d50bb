"""A law as one object: its step, status bits, telemetry, explained priorities, and allocation to thrusters.

A block is an instruction list or a routine of `surctl.ir`. The block `closed` solves the task priorities by the closed
form, equation (16) of the paper. In the modes that respect limits, the law has three parts: the block `pre`, then the
priority solver as a routine with bounded loops, then the block `post`. In every mode, `block` is the complete law that
runs and that is exported as C. Python, C, verification and tuning all use this one block.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import Block, Call, Layout, Port, Program, Real, Routine, lower, on_vectors, to_casadi
from surctl.ir.native import runnable
from surctl.marine.allocation.program import allocation_block
from surctl.marine.control.perception import LAST_THRUST, PerceptionStage
from surctl.marine.control.ports import PARAMETERS
from surctl.marine.control.stopping import Barrier, Movers
from surctl.marine.guidance import AvoidanceForm, Guidance
from surctl.marine.vehicle import Actuators
from surctl.marine.vehicle.thruster_file import axis_limits
from surctl.priority import Fallback, Level, Mode, PriorityProblem, PrioritySolution, Row, solve
from surctl.priority.solver.elimination import FLOAT32, FLOAT64, Precision
from surctl.system.controller import ControllerStep, finite_step, step_vectors

Vector: TypeAlias = NDArray[np.float64]

SATURATED, SWITCHED, DEGRADED, TRAPPED = 1, 2, 4, 8

TELEMETRY = (
    Port("tau", (4,), "N, N m", "thrust command F_u, F_v, F_w, F_r in {B}"),
    Port("nu_reference", (4,), "m/s, rad/s", "velocity reference from the priority solver, limited, in {B}"),
    Port("path_error", (2,), "m", "along-track error x_e and cross-track error y_e of (8)"),
    Port("avoiding", (1,), "1", "1 while a contact changes the desired velocity"),
    Port("nearest", (1,), "m", "smallest clearance to any contact that the law knows"),
    Port("ranges", (4,), "m", "filtered sonar ranges"),
)

TRAPPED_PORT = Port(
    "trapped", (1,), "1", "1 after the law gave up in a dead end: it holds its place and avoids moving obstacles"
)

DEPTH_PORT = Port(
    "depth_reference", (1,), "m", "commanded z in {E}; it differs from the path's z while the robot passes a dead end"
)


def scan_telemetry(sensors: int) -> tuple[Port, ...]:
    """Return the telemetry entries (`Port`) of a law with a sonar map and `sensors` sonars."""
    return (
        *(port for port in TELEMETRY if port.name != "ranges"),
        Port("ranges", (sensors,), "m", "filtered sonar ranges"),
        Port("bounds", (sensors,), "m", "largest error of each range"),
        Port("healthy", (sensors,), "1", "1 where the law trusts the sonar"),
        Port("stopped", (1,), "1", "1 while the robot stops because it does not know what is ahead"),
    )


class Stages:
    """Parts of a law; each part is built when it is first used, and calls libm functions such as sin."""

    def __init__(self, closed: Callable[[], Block], pre: Callable[[], Block], post: Callable[[], Block]) -> None:
        self._closed, self._pre, self._post = closed, pre, post

    @cached_property
    def closed(self) -> Block:
        """Complete law with the closed form, equation (16) of the paper, in every mode.

        It maps (x, u, p) to (tau, x_next, status, telemetry).
        """
        return self._closed()

    @cached_property
    def pre(self) -> Block:
        """Part before the priority solver.

        It maps (x, u, p) to (J row by row, references, inequality constraints, velocity bounds (8,)), and the entries
        of `closing.Memory`.
        """
        return self._pre()

    @cached_property
    def post(self) -> Block:
        """Part after the priority solver.

        It maps (u, p, entries of `closing.Memory`, nu_reference, number of the solver's fallback) to (tau, x_next,
        status, telemetry).
        """
        return self._post()


@dataclass(frozen=True, eq=False)
class Law:
    """A controller, which maps (state, input, parameters) to (thrust command τ, next state, status, telemetry).

    Attributes:
        name: name of the law, a C identifier.
        ref: reference of the law's source, see `law_ref`.
        avoidance: form of the avoidance velocity, equation (20) of the paper.
        mode: priority mode.
        dt: control period [s].
        state, inputs, gains, outputs: layouts of the flat vectors.
        block: the complete law, which maps (x, u, p) to (tau, x_next, status, telemetry). In mode nsb it is `closed`;
            in other modes it combines `pre`, the priority solver and `post`. It calls no libm functions: sin, cos and
            atan2 are replaced by elementary operations.
        stages: the law in closed form (`closed`), and its parts before and after the priority solver (`pre`, `post`).
        levels: (name, number of rows of J, unit) of each task, highest priority first.
        rows: names of the inequality constraints: first the velocity bounds, then the barriers.
        perception: the part of the law that runs before the decision, or None. In a law with perception, the inputs x
            and u of `stages` are the state of the decision and the outputs of perception.
        guidance, barrier, movers, fallback: the arguments of `build_law`.
        base: the law without allocation, or None if the vehicle has no thrusters of its own; `stages`, `problem` and
            `explained` are those of the base.
        actuators: the thrusters to which the law allocates its thrust, or None.
    """

    name: str
    ref: str
    avoidance: AvoidanceForm
    mode: Mode
    dt: float
    state: Layout
    inputs: Layout
    gains: Layout
    outputs: Layout
    block: Block = field(repr=False)
    stages: Stages = field(repr=False)
    levels: tuple[tuple[str, int, str], ...]
    rows: tuple[str, ...]
    perception: PerceptionStage | None = None
    guidance: Guidance = "los"
    barrier: Barrier = "simple"
    movers: Movers = "predict"
    fallback: Fallback = "exact"
    base: Law | None = None
    actuators: Actuators | None = None

    @cached_property
    def function(self) -> ca.Function:
        """Return the law in closed form as a CasADi function, which takes symbols or numbers and is differentiable."""
        return to_casadi(self.stages.closed)

    def initial_state(self) -> Vector:
        """Return the state before the first step."""
        return self.state.pack()

    def step(self, x: Vector, u: Vector, p: Vector) -> ControllerStep:
        """Compute one control step; the status is 0, or a sum of `SATURATED`, `SWITCHED`, `DEGRADED`, `TRAPPED`.

        If an input or a result contains a number that is not finite, the thrust is 0, the state does not change, and
        the status is `NONFINITE`. The telemetry has all entries of `outputs` except the first, which is tau.

        Raises:
            InputError: a vector does not have the size of its layout.
        """
        return finite_step(self, self._run, *step_vectors(self, x, u, p))

    @cached_property
    def _run(self) -> Callable[[Vector, Vector, Vector], list[Vector]]:
        """Return the law as a function of NumPy vectors: CasADi runs the closed form, compiled C a routine with loops.

        Without a compiler, the routine runs in Python, which gives equal numbers more slowly.
        """
        closed = self.mode == "nsb" and self.perception is None and self.base is None
        return on_vectors(to_casadi(self.block).expand()) if closed else runnable(self.block, quick=True)

    @cached_property
    def _before(self) -> Callable[..., list[Vector]]:
        # the part of the law before the priority solver
        return on_vectors(to_casadi(self.stages.pre).expand())

    @cached_property
    def _sense(self) -> Callable[..., list[Vector]]:
        assert self.perception is not None
        return runnable(self.perception.block, quick=True)

    def telemetry_slice(self, name: str) -> slice:
        """Return the index range of an output in the telemetry vector, which does not contain tau."""
        where = self.outputs.slice(name)
        return slice(where.start - 4, where.stop - 4)

    def problem(self, x: Vector, u: Vector, p: Vector) -> PriorityProblem:
        """Return the priority problem of one control step, with a name for every inequality constraint.

        Raises:
            InputError: a vector does not have the size of its layout, or the problem contains a non-finite number.
        """
        x, u, p = step_vectors(self, x, u, p)
        if self.base is not None:
            return self.base.problem(x, u[: self.base.inputs.size], p)
        if self.perception is not None:
            x, u = x[: -self.perception.state.size], self.decision_inputs(x, u, p)
        J, references, rows, *_ = self._before(x, u, p)
        # a limit row without a bound has ±inf as bound, but a NaN is an error
        if not np.isfinite(J).all() or not np.isfinite(references).all() or np.isnan(rows).any():
            raise InputError("is not finite", key=f"{self.name}.problem", remedy="check x, u and p")
        levels, at = [], 0
        for name, count, unit in self.levels:
            here = slice(at, at + count)
            levels.append(Level(name, J.reshape(-1, 4)[here], references[here], unit=unit))
            at += count
        limits = [
            Row(name, "barrier" if row[6] else "actuator", row[:4], float(row[4]), float(row[5]))
            for name, row in zip(self.rows, rows.reshape(-1, 7), strict=True)
        ]
        # the numbers are finite and the law was checked at assembly, so the checks of build_problem are not repeated
        return PriorityProblem(tuple(levels), tuple(limits))

    def decision_inputs(self, x: Vector, u: Vector, p: Vector) -> Vector:
        """Return the inputs of the decision in one control step: a flat vector with the layout `perception.outputs`.

        For a law without perception, these inputs are u.

        Raises:
            InputError: a vector does not have the size of its layout.
        """
        x, u, p = step_vectors(self, x, u, p)
        if self.base is not None:
            return self.base.decision_inputs(x, u[: self.base.inputs.size], p)
        if self.perception is None:
            return u
        anew = [x[self.state.slice("changing")] < -0.5] if "changing" in self.state else []
        _, outputs = self._sense(x[-self.perception.state.size :], u, p[: PARAMETERS.size], *anew)
        return np.asarray(outputs, dtype=np.float64).reshape(-1)

    def explained(self, x: Vector, u: Vector, p: Vector) -> PrioritySolution:
        """Solve the priority problem of one control step; the solution names tasks, constraints and causes.

        Raises:
            InputError: the law has the fallback `bounded`, whose velocity can differ from that of `solve`.
        """
        if self.fallback != "exact":
            raise InputError("is not explained", key="fallback", value=self.fallback, remedy="use the exact fallback")
        return solve(self.problem(x, u, p), mode=self.mode)


# A law with allocation: the law's thrust command is distributed to the thrusters of the vehicle.
#
# The command `tau` of the law becomes the force and yaw moment that the thrusters achieve together. So the filter of
# the robot's own state uses the true thrust, the integral of an axis is held while the thrusters do not reach the
# command on this axis (anti-windup), and the status contains `SATURATED` if they miss the command on any axis that they
# serve: the side force of a rudder is not commanded, so it misses nothing. The limits of fins follow from the measured
# forward speed `nu`.


WORKING = "working"
"""Name of the input that says which thrusters work."""

PRECISIONS = {"float64": FLOAT64, "float32": FLOAT32}


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
    """Return the law with allocation to the thrusters; it has one more input, `working`, and further outputs."""
    precision = PRECISIONS[real]
    if actuators.fins and "nu" not in law.inputs:
        problem = "measures no velocity, on which the force of a rudder depends"
        raise InputError(problem, key="law", value=law.name, remedy="use true positions (--sensing truth)")
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
