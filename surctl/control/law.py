"""The law: filter, guidance, tasks, priority and velocity control as one object with explicit state.

`closed` is the closed form (16). In the modes that keep limits the law is cut open at the priority solver: `pre`
before it, the solver as a routine with bounded loops, `post` after it. `block` is what runs and what is generated as
C, in every mode. Python, C, verification and tuning all see these instructions and no others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.control.perception import PerceptionStage
from surctl.control.stopping import Barrier, Movers
from surctl.errors import InputError
from surctl.guidance import AvoidanceForm, Guidance
from surctl.ir import Block, Layout, Port, on_vectors, runnable, to_casadi
from surctl.priority import Fallback, Level, Mode, PriorityProblem, PrioritySolution, Row, solve

__all__ = ["DEGRADED", "NONFINITE", "SATURATED", "SWITCHED", "TELEMETRY", "TRAPPED", "Law", "LawStep", "Stages"]

Vector: TypeAlias = NDArray[np.float64]

SATURATED, SWITCHED, DEGRADED, TRAPPED = 1, 2, 4, 8
NONFINITE = -2

TELEMETRY = (
    Port("tau", (4,), "N, N m", "thrust command F_u, F_v, F_w, F_r in {B}"),
    Port("nu_reference", (4,), "m/s, rad/s", "velocity that the priority solver asked for, in {B}"),
    Port("path_error", (2,), "m", "x_e and y_e of (8)"),
    Port("avoiding", (1,), "1", "1 while a contact changes the wish"),
    Port("nearest", (1,), "m", "smallest clearance that the law knows of"),
    Port("ranges", (4,), "m", "filtered sonar ranges"),
)

TRAPPED_PORT = Port(
    "trapped", (1,), "1", "1 from when it gave up in a dead end: it stands, and gives way to what moves"
)

DEPTH_PORT = Port(
    "depth_reference", (1,), "m", "z in {E} that it flies at or changes to; not the path's while it passes a dead end"
)


def scan_telemetry(sensors: int) -> tuple[Port, ...]:
    """The telemetry of a law that scans with so many sonars."""
    return (
        *(port for port in TELEMETRY if port.name != "ranges"),
        Port("ranges", (sensors,), "m", "filtered sonar ranges"),
        Port("bounds", (sensors,), "m", "by how much a range may be wrong"),
        Port("healthy", (sensors,), "1", "1 where a sonar may be believed"),
        Port("stopped", (1,), "1", "1 while it stands because it does not know what is ahead"),
    )


class LawStep(NamedTuple):
    """One control step.

    Attributes:
        tau: (4,) [N, N m] in {B}.
        x_next: next state, flat.
        status: 0, bits `SATURATED`, `SWITCHED`, `DEGRADED`, `TRAPPED`, or `NONFINITE` (then tau is 0, the state
            stays).
        telemetry: flat, the ports of `Law.outputs` after tau.
    """

    tau: Vector
    x_next: Vector
    status: int
    telemetry: Vector


class Stages:
    """Parts of a law, each made when it is first asked for; with the mathematical library's functions.

    Attributes:
        closed: (x, u, p) → (tau, x_next, status, telemetry) in closed form (16), whatever the law's mode.
        pre: (x, u, p) → (J row by row, references, rows of the priority tick, velocity box (8,)), and what else is
            known before the priority decision: next state but for the integral, telemetry after the wish, flags.
        post: (u, p, those three, nu_reference, stage of the priority tick) → as `closed`.
    """

    def __init__(self, closed: Callable[[], Block], pre: Callable[[], Block], post: Callable[[], Block]) -> None:
        self._closed, self._pre, self._post = closed, pre, post

    @cached_property
    def closed(self) -> Block:
        """See the attributes."""
        return self._closed()

    @cached_property
    def pre(self) -> Block:
        """See the attributes."""
        return self._pre()

    @cached_property
    def post(self) -> Block:
        """See the attributes."""
        return self._post()


@dataclass(frozen=True, eq=False)
class Law:
    """A controller: (state, input, gains) → (τ, next state, status).

    Attributes:
        name: C identifier.
        avoidance: form of (20).
        mode: priority mode.
        dt: control period [s].
        state, inputs, gains, outputs: layouts of the flat vectors.
        block: (x, u, p) → (tau, x_next, status, telemetry): `closed` in mode nsb; otherwise `pre`, the
            priority tick and `post` as one routine. Without the mathematical library: sin, cos and atan2 are written
            out in exact operations.
        stages: the law in closed form, and what stands before the priority solver and after it.
        levels: (name, rows, unit) of each priority level, highest first.
        rows: names of the rows: box, then barriers.
        barrier, movers, ladder: as `build_law` has them.
        senses: what runs before the decision, or None; the stages then take the decision's own state
            and what the senses tell as x and u.
        guidance: how the path is followed.
    """

    name: str
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

    @cached_property
    def function(self) -> ca.Function:
        """The closed form for CasADi: expressions, derivatives, numbers."""
        return to_casadi(self.stages.closed)

    def initial_state(self) -> Vector:
        """State before the first step."""
        return self.state.pack()

    def step(self, x: Vector, u: Vector, p: Vector) -> LawStep:
        """One step. NaN never becomes a command: a non-finite number anywhere gives zero thrust, `NONFINITE`.

        Raises:
            InputError: a vector that has not the size of its layout.
        """
        x, u, p = self._vectors(x, u, p)
        if not (np.isfinite(x).all() and np.isfinite(u).all() and np.isfinite(p).all()):
            return self._fail_safe(x)
        parts = self._run(x, u, p)
        if not all(np.isfinite(part).all() for part in parts):
            return self._fail_safe(x)
        tau, x_next, status, telemetry = parts
        return LawStep(tau, x_next, int(status[0]), telemetry)

    @cached_property
    def _run(self) -> Callable[[Vector, Vector, Vector], list[Vector]]:
        """CasADi's machine for the closed form; C for a block with loops, or its replay: the same numbers, slower."""
        closed = self.mode == "nsb" and self.perception is None
        return on_vectors(to_casadi(self.block).expand()) if closed else runnable(self.block)

    @cached_property
    def _before(self) -> Callable[..., list[Vector]]:
        """The stage before the solver in CasADi's machine."""
        return on_vectors(to_casadi(self.stages.pre).expand())

    @cached_property
    def _sense(self) -> Callable[..., list[Vector]]:
        assert self.perception is not None
        return runnable(self.perception.block)

    def telemetry_slice(self, name: str) -> slice:
        """Where an output port lies in the telemetry, which leaves tau out."""
        where = self.outputs.slice(name)
        return slice(where.start - 4, where.stop - 4)

    def problem(self, x: Vector, u: Vector, p: Vector) -> PriorityProblem:
        """The priority problem of one tick, as data with names on every row.

        Raises:
            InputError: a vector of another size than its layout's, or numbers that lead to one that is not finite.
        """
        x, u, p = self._vectors(x, u, p)
        if self.perception is not None:
            x, u = x[: -self.perception.state.size], self.decision_inputs(x, u, p)
        J, references, rows, *_ = self._before(x, u, p)
        # the bounds of a row may be absent: ±inf, but no NaN
        if not np.isfinite(J).all() or not np.isfinite(references).all() or np.isnan(rows).any():
            raise InputError("is not finite", key=f"{self.name}.problem", remedy="`step` refuses such a tick")
        levels, at = [], 0
        for name, count, unit in self.levels:
            here = slice(at, at + count)
            levels.append(Level(name, J.reshape(-1, 4)[here], references[here], unit=unit))
            at += count
        limits = [
            Row(name, "barrier" if row[6] else "actuator", row[:4], float(row[4]), float(row[5]))
            for name, row in zip(self.rows, rows.reshape(-1, 7), strict=True)
        ]
        # built by this class from finite numbers: the checks of build_problem were made once, at assembly
        return PriorityProblem(tuple(levels), tuple(limits))

    def decision_inputs(self, x: Vector, u: Vector, p: Vector) -> Vector:
        """What the senses tell the decision in one tick, flat as `senses.told` packs it; u for a law without senses.

        Raises:
            InputError: a vector that has not the size of its layout.
        """
        x, u, p = self._vectors(x, u, p)
        if self.perception is None:
            return u
        anew = [x[self.state.slice("changing")] < -0.5] if "changing" in self.state else []
        _, outputs = self._sense(x[-self.perception.state.size :], u, p, *anew)
        return np.asarray(outputs, dtype=np.float64).reshape(-1)

    def explained(self, x: Vector, u: Vector, p: Vector) -> PrioritySolution:
        """The priority decision of one tick with names and words: what `step` does, solved again in NumPy.

        Raises:
            InputError: a law with a bounded ladder, whose answers are not those of `solve` wherever it counts.
        """
        if self.fallback != "exact":
            raise InputError("is not explained", key="fallback", value=self.fallback, remedy="fly the exact one")
        return solve(self.problem(x, u, p), mode=self.mode)

    def _vectors(self, *vectors: Vector) -> list[Vector]:
        """x, u, p as flat vectors of the right sizes."""
        flat = []
        for vector, layout, name in zip(vectors, (self.state, self.inputs, self.gains), "xup", strict=True):
            array = np.asarray(vector)
            if array.size != layout.size or array.dtype.kind not in "fiu":
                raise InputError(
                    f"has shape {array.shape} of {array.dtype}",
                    key=f"{self.name}.{name}",
                    remedy=f"give {layout.size} real numbers, as its layout packs them",
                )
            flat.append(array.astype(float, copy=False).reshape(-1))
        return flat

    def _fail_safe(self, x: Vector) -> LawStep:
        return LawStep(np.zeros(4), np.array(x, dtype=float), NONFINITE, np.zeros(self.outputs.size - 4))
