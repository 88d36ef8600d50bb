"""The law in another form: constant gains, its C in a run (`--controller`), or behind a link with loss and delay.

The robot applies the newest command that it received until this command is too old; then the robot applies zero thrust
(fail-safe). Losses and delays are simulated: a seed determines the losses, and a delay is a whole number of control
periods. The real messages arrive without loss, and simulated time does not advance while the other process computes.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export.bundle import law_id
from surctl.export.contract import Exportable, WrappedLaw, command_size, glance
from surctl.export.emulated import LineDown, Reply, SerialLine
from surctl.export.envelope import Envelope, Records
from surctl.export.precision import Guarded, Rounded, differing, replayed, rounded
from surctl.ir import (
    Block,
    Call,
    Layout,
    Port,
    Program,
    Real,
    Routine,
    Step,
    compile_block,
    lower,
    on_vectors,
    reads,
    replay,
    without_libm,
)
from surctl.ir.folding import with_constants
from surctl.ir.procedure import Procedure
from surctl.marine.control import Law
from surctl.marine.control.build import in_real
from surctl.marine.simulation.metrics import GONE, LATE
from surctl.noise import NOISE_STATE, draw_uniforms, noise_states
from surctl.system import ControllerStep
from surctl.system.controller import finite_step

Vector = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ClosedForm(WrappedLaw):
    """A law without perception, rewritten for a target.

    Attributes:
        block: from state x, inputs u and gains p to tau, x_next, status and telemetry; an instruction list if the law
            is in closed form.
        gains: names and sizes of the gains p; empty if the gains became constants.
        constants: gains that became constants (np,), in the order of the law's gains; None if the gains stayed inputs.
    """

    law: Law
    block: Block
    gains: Layout
    constants: Vector | None = None

    @cached_property
    def constant_table(self) -> tuple[tuple[Port, Vector], ...]:
        """Return the name, size and values of every gain that became a constant."""
        if self.constants is None:
            return ()
        return tuple((port, self.constants[self.law.gains.slice(port.name)]) for port in self.law.gains)

    def initial_state(self) -> Vector:
        """Return the controller state before the first step (nx,)."""
        return self.law.initial_state()

    def step(self, x: Vector, u: Vector, p: Vector) -> ControllerStep:
        """Run one step; if an input or a result is not finite, return tau = 0, x_next = x and status NONFINITE."""
        return finite_step(self, partial(replay, self.block), x, u, p)


def closed_form(law: Law, *, real: Real = "float64", constants: Vector | None = None) -> Exportable:
    """Return the law rewritten for a target, or the law itself if nothing has to change.

    For a law that is not in closed form, `in_real` sets the solver tolerances to those of the target's precision.

    Args:
        real: precision of the target; in float32, shorter polynomials of float accuracy compute sin, cos and atan2.
        constants: gains (np,) that become constants of the code; values that follow from these constants are computed
            at export. None leaves the gains as inputs.

    Raises:
        InputError: constants are given for a law with perception, or their number is not np.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.export import closed_form
        >>> from surctl.marine.simulation import law_numbers, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> law, p = build_law("closed_form"), law_numbers(mission, gains, vehicle)
        >>> shipped = closed_form(law, real="float32", constants=p)
        >>> law.gains.size, shipped.gains.size, shipped.block.operations < law.block.operations
        (70, 0, True)
    """
    closed = law.mode == "nsb" and law.perception is None and law.base is None
    if law.perception is not None and constants is not None:
        remedy = "set --sensing truth, or omit this option"
        raise InputError("are only for laws without perception", key="constant-gains", remedy=remedy)
    if closed and real == "float64" and constants is None:
        return law
    shipped = ClosedForm(law, without_libm(law.stages.closed, real), law.gains) if closed else in_real(law, real)
    if constants is None:
        return shipped
    x, u, p = shipped.block.inputs
    folded = _with_constant_input(shipped.block, 2, constants)
    block = replace(folded, inputs=(x, u, (p[0], 0)))  # the constants replace the third input, which is then empty
    return ClosedForm(law, block, Layout(()), np.array(constants, dtype=float))


def _with_constant_input(block: Block, at: int, constants: Vector) -> Block:
    """Return a block in which constants replace one input; if a loop reads this input, the constants form an array."""
    name = block.inputs[at][0]
    left = tuple(entry for k, entry in enumerate(block.inputs) if k != at)
    if isinstance(block, Program):
        folded = with_constants(block, at, [float(v) for v in constants])
        moved = [
            replace(i, args=(i.args[0] - (i.args[0] > at), *i.args[1:])) if i.op == "input" else i
            for i in folded.instructions
        ]
        return replace(folded, inputs=left, instructions=tuple(moved))
    if isinstance(block, Procedure):  # as a step, it reads the array of the constants
        results = tuple(own for own, _ in block.outputs)
        call = Call(block, tuple(own for own, _ in block.inputs), results)
        block = Routine(f"{block.name}_folded", block.inputs, (call,), results)
    steps: list[Step] = []
    for step in block.steps:
        if isinstance(step, Call) and name in step.args and not isinstance(step.block, Procedure):
            here = step.args.index(name)
            args = tuple(arg for k, arg in enumerate(step.args) if k != here)
            steps.append(Call(_with_constant_input(step.block, here, constants), args, step.results))
        else:
            steps.append(step)
    if any(name in reads(step) for step in steps):
        values = ca.SX(ca.DM(constants))
        steps.insert(0, Call(lower(ca.Function(f"{block.name}_constants", [], [values], [], [name])), (), (name,)))
    return replace(block, inputs=left, steps=tuple(steps))


_STREAM = 1 << 62  # first noise stream of the connections, far from the streams of the runs


@dataclass(frozen=True)
class LinkFaults:
    """Simulated faults of the connection, and the largest age of a command that the robot applies.

    Attributes:
        loss: probability in [0, 1] that a message is lost; losses are independent in each direction.
        delay: time from a request to the arrival of its reply [s], rounded up to whole control periods.
        deadline: age of a command beyond which the robot applies zero thrust [s].
        seed: seed of the random losses.
    """

    loss: float = 0.0
    delay: float = 0.0
    deadline: float = 0.25
    seed: int = 0

    def __post_init__(self) -> None:
        """Raise InputError for a loss outside [0, 1] or a time outside [0, 3600] s."""
        if not 0.0 <= self.loss <= 1.0:
            raise InputError("is not a probability", key="link-loss", value=self.loss, remedy="use 0 to 1")
        for key in ("delay", "deadline"):
            value = getattr(self, key)
            if not 0.0 <= value <= 3600.0:
                raise InputError("is not a valid time", key=f"link-{key}", value=value, remedy="give 0 to 3600 s")


@dataclass(frozen=True)
class LinkReport:
    """Statistics of the connection over one run.

    Attributes:
        name, id, real: name of the controller, hash of what it computes, and its precision.
        answered: number of steps that the controller computed.
        lost: number of lost messages, to and from the controller.
        failsafe: number of control periods with fail-safe thrust, because no valid command was available.
        gone_s: simulated time at which the connection ended [s], None if the connection did not end.
        gone_because: reason why the connection ended.
        round_trip_ms: (mean, largest) time from request to reply [ms], on this machine's clock.
        differing: number of computed steps whose bytes differ from the law in Python.
        first: index of the first differing step, None if no step differs.
    """

    name: str
    id: str
    real: str
    steps: int
    answered: int
    lost: tuple[int, int]
    failsafe: int
    gone_s: float | None
    gone_because: str
    round_trip_ms: tuple[float, float]
    differing: int
    first: int | None

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data for JSON."""
        return {
            "controller": self.name,
            "id": self.id,
            "real": self.real,
            "steps": self.steps,
            "answered": self.answered,
            "lost_requests": self.lost[0],
            "lost_replies": self.lost[1],
            "failsafe_steps": self.failsafe,
            "gone_s": self.gone_s,
            "gone_because": self.gone_because or None,
            "round_trip_ms": list(self.round_trip_ms),
            "differing": self.differing,
            "first_differing": self.first,
        }

    def line(self) -> str:
        """Return the report as one line of text."""
        verdict = "all as in Python to the last bit"
        if self.differing:
            verdict = f"{self.differing} DIFFER from Python, first step {self.first}"
        parts = [f"{self.name} in {self.real}: {self.answered} of {self.steps} steps answered, {verdict}"]
        if any(self.lost):
            parts.append(f"{self.lost[0]} requests and {self.lost[1]} replies lost")
        if self.failsafe:
            parts.append(f"{self.failsafe} periods with fail-safe thrust")
        if self.gone_s is not None:
            parts.append(f"gone at {self.gone_s:.2f} s: {self.gone_because}")
        return "; ".join(parts)


class _Command(NamedTuple):
    arrives: int
    requested: int
    reply: Reply


@dataclass
class LinkedLaw:
    """Function that computes each control step of `surctl.marine.simulation.simulate` in another process.

    Attributes:
        law: the exported law in Python.
        p: gains of the run (np,), equal to the exported gains.
        line: connection to the controller.
        faults: simulated faults of the connection.
        envelope: ranges that the controller's input check accepts; None accepts any finite number.
        compact: True requests replies of few bytes, for a slow line; the state is then Python's own.
        fed: True if the controller feeds itself with a mission, so that the simulation's window is its own.
    """

    law: Exportable
    p: Vector
    line: SerialLine
    faults: LinkFaults = field(default_factory=LinkFaults)
    envelope: Envelope | None = None
    compact: bool = False
    fed: bool = False

    def __post_init__(self) -> None:
        """Check the identity of the controller, and start the controller.

        Raises:
            InputError: the other process is a different controller, or not an exported controller.
        """
        try:
            who = self.line.request()
            self.real: Real = "float64" if who.real == "float64" else "float32"
            self.shipped, self.gains = self._shipped(who.id)
            self.identity = law_id(self.shipped, self.gains, real=self.real)
            if who.id != self.identity:
                problem = f"runs controller {who.id[:12]} in {who.real}, but these options give {self.identity[:12]}"
                remedy = "export it with the same scenario, vehicle, gains and options (--law, --guidance, --barrier …)"
                raise InputError(problem, key="controller", value=self.line.name, remedy=remedy)
            self.line.start(self.identity)
        except LineDown as reason:
            problem = str(reason).removeprefix(self.line.name).strip()
            remedy = "start the controller of the bundle: make controller && ./controller PORT"
            raise InputError(problem, key="controller", value=self.line.name, remedy=remedy) from None
        state = ca.SX.sym("state", NOISE_STATE)
        self._draw = on_vectors(ca.Function("draw", [state], list(draw_uniforms(state, 2))))
        self._noise = noise_states([_STREAM + self.faults.seed])[0]
        self._late = int(np.ceil(self.faults.delay / self.law.dt - 1e-9))
        self._believed = int(np.floor(self.faults.deadline / self.law.dt + 1e-9))
        self._period = 0
        self._state = rounded(self.law.initial_state(), self.real)
        self._pending: list[_Command] = []
        self._current: _Command | None = None
        self._log: list[tuple[Vector, Vector, Reply, int, Vector]] = []
        self._accepted: tuple[Vector, Vector, int, Vector] | None = None
        self._lost = [0, 0]
        self._failsafe = 0
        self._times: list[float] = []
        self._gone: tuple[float, str] | None = None
        self._telemetry = np.zeros(self.law.outputs.size - command_size(self.law))

    def _shipped(self, identity: str) -> tuple[Exportable, Vector]:
        # the variant with constant gains if `identity` is its id
        if self.fed and (self.real != "float64" or self.faults.loss > 0.0):
            raise InputError(
                "stores its own mission: such a controller can be compared only in float64 and without lost messages",
                key="controller",
                value=self.line.name,
                remedy="export it in float64, and drop --link-loss",
            )
        if not isinstance(self.law, Law):
            return self.law, self.p
        if self.law.perception is None:
            constant = closed_form(self.law, real=self.real, constants=self.p)
            if law_id(constant, np.zeros(0), real=self.real) == identity:
                return constant, np.zeros(0)
        return closed_form(self.law, real=self.real), self.p

    def __call__(self, x: Vector, u: Vector, p: Vector) -> ControllerStep:
        """Return thrust, state and newest telemetry of this period; the other process uses its own state and gains."""
        if self._gone is None:
            self._request(x, u, p)
        while self._pending and self._pending[0].arrives <= self._period:
            self._current = self._pending.pop(0)
            self._telemetry = self._current.reply.telemetry
        period, now = self._period, self._current
        self._period += 1
        if now is not None and self._gone is None and period - now.requested <= self._believed:
            return ControllerStep(now.reply.tau, self._state, now.reply.status, self._telemetry)
        self._failsafe += 1
        return ControllerStep(
            np.zeros(command_size(self.law)), self._state, LATE if self._gone is None else GONE, self._telemetry
        )

    def _request(self, x: Vector, u: Vector, p: Vector) -> None:
        numbers, self._noise = self._draw(self._noise)
        to, back = numbers < self.faults.loss
        if to:
            self._lost[0] += 1
            return
        began = time.perf_counter()
        try:
            reply = self.line.step(self._period + 1, u, compact=self.compact)
        except LineDown as reason:
            why = str(reason).removeprefix(self.line.name).strip()
            self._gone = self._period * self.law.dt, why
            return
        self._times.append(1e3 * (time.perf_counter() - began))
        state = rounded(x, self.real) if self.fed else self._state
        gains = rounded(p if self.fed else self.gains, self.real)
        if self.compact:
            reply = self._completed(reply, state, rounded(u, self.real), gains)
        self._log.append((state, rounded(u, self.real), reply, self._period, gains))
        self._state = reply.state
        if back:
            self._lost[1] += 1
            return
        self._pending.append(_Command(self._period + self._late, self._period, reply))

    def _completed(self, reply: Reply, x: Vector, u: Vector, p: Vector) -> Reply:
        # a compact reply with the state and the telemetry of the same step in Python, after the last accepted one
        rows = [] if self._accepted is None else [self._accepted]
        rows.append((x, u, self._period, p))
        X, U, P = (np.array([row[k] for row in rows]) for k in (0, 1, 3))
        counts = np.array([row[2] for row in rows])
        mine = replayed(self._checked, Records(X, U, P), np.arange(len(rows)) < len(rows) - 1, counts=counts)
        if mine.status[-1] >= 0:
            self._accepted = rows[-1]
        return reply._replace(state=mine.state[-1], telemetry=mine.telemetry[-1])

    @cached_property
    def _checked(self) -> Exportable:
        # the controller in Python, with its input check
        law: Exportable = Rounded(self.shipped, self.real)
        if self.envelope is None:
            return law
        within = self.envelope
        if not self.gains.size:
            within = replace(within, gains=np.zeros((0, 2)), orders=())
        return Guarded(law, self.real, within.fitted(self.shipped, self.real))

    def report(self) -> LinkReport:
        """Return the statistics of the connection; each reply is compared with a step in Python from the same state.

        If all steps agree, the whole run agrees, by induction from the initial state.
        """
        gone = (None, "") if self._gone is None else self._gone
        trips = (float(np.mean(self._times)), float(np.max(self._times))) if self._times else (0.0, 0.0)
        wrong = self._differing()
        first = int(wrong[0]) if wrong.size else None
        return LinkReport(
            self.line.name, self.identity, self.real, self._period, len(self._log), (self._lost[0], self._lost[1]),
            self._failsafe, gone[0], gone[1], trips, len(wrong), first,
        )  # fmt: skip

    def _differing(self) -> NDArray[np.intp]:
        # replies that differ from Python in some byte; a NaN may have any bits
        if not self._log:
            return np.zeros(0, dtype=np.intp)
        X, U, P = (np.array([row[k] for row in self._log]) for k in (0, 1, 4))
        counts = np.array([row[3] for row in self._log])
        rows = replayed(self._checked, Records(X, U, P), counts < 0, counts=counts)
        whole = [rows.tau, rows.state, rows.telemetry]
        mine = np.hstack(self._glance(*whole) if self.compact else whole).astype(self.real)
        theirs = np.array([np.frombuffer(row[2].raw, dtype=np.dtype(self.real).newbyteorder("<")) for row in self._log])
        status = np.array([row[2].status for row in self._log])
        return np.union1d(differing(mine, theirs.astype(self.real)), np.flatnonzero(status != rows.status))

    def _glance(self, tau: Vector, state: Vector, telemetry: Vector) -> list[Vector]:
        # the numbers of a compact reply
        states, outputs = glance(self.law)
        return [
            tau,
            *(state[:, self.law.state.slice(port.name)] for port in states),
            *(np.hstack([tau, telemetry])[:, self.law.outputs.slice(port.name)] for port in outputs),
        ]


@dataclass
class CompiledLaw:
    """Function that computes each control step of `surctl.marine.simulation.simulate` by the law's C, compiled here.

    Raises:
        ToolMissing: there is no C compiler.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.export import CompiledLaw
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law = build_law("closed_form")
        >>> stepper, gains = CompiledLaw(law), load_gains("default")
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=gains, law=law, stepper=stepper)
        >>> run.metrics.reached, stepper.report().differing
        (True, 0)
    """

    law: Law
    _log: list[tuple[Vector, ...]] = field(default_factory=list, init=False, repr=False)
    _times: list[float] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        self._native = compile_block(self.law.block)

    def __call__(self, x: Vector, u: Vector, p: Vector) -> ControllerStep:
        """Return one control step; numbers that are not finite are left to the law in Python."""
        began = time.perf_counter()
        parts = self._native(x, u, p)
        self._times.append(1e3 * (time.perf_counter() - began))
        self._log.append((x, u, p, *parts))
        if not all(np.isfinite(one).all() for one in (x, u, p, *parts)):
            return self.law.step(x, u, p)
        tau, x_next, status, telemetry = parts
        return ControllerStep(tau, x_next, int(status[0]), telemetry)

    def report(self) -> LinkReport:
        """Return the statistics of the run; every step is compared with the replay of the law in Python."""
        columns = [np.array(column) for column in zip(*self._log, strict=True)]
        wrong = np.zeros(0, dtype=np.intp)
        if columns:
            wrong = differing(np.hstack(replay(self.law.block, *columns[:3])), np.hstack(columns[3:]))
        trips = (float(np.mean(self._times)), float(np.max(self._times))) if self._times else (0.0, 0.0)
        steps = len(self._log)
        first = int(wrong[0]) if wrong.size else None
        identity = self.law.block.digest()
        return LinkReport(
            "the law's C", identity, "float64", steps, steps, (0, 0), 0, None, "", trips, len(wrong), first
        )
