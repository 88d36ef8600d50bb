"""A law that runs in another process: what the robot does with its answers, with late ones, and without any.

The robot gives its thrusters the newest command that it has, as long as that is young enough; then zero, which is the
fail-safe thrust. Loss and delay on the line are played here, by a seed, counted in whole control periods: the process
at the other end always gets and gives its messages at once, and simulated time does not run meanwhile.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.control import Law, LawStep
from surctl.errors import InputError
from surctl.export.bundle import law_id
from surctl.export.closed import closed_form
from surctl.export.contract import Exportable, thrust
from surctl.export.envelope import Envelope
from surctl.export.link import Line, LineDown, Reply
from surctl.export.precision import Guarded, Rounded, replayed, rounded
from surctl.export.records import Records
from surctl.ir import Real
from surctl.sensing import NoiseStream
from surctl.simulation import GONE, LATE

__all__ = ["LinkFaults", "LinkReport", "LinkedLaw"]

Vector = NDArray[np.float64]

_STREAM = 1 << 62  # the noise streams of the line, away from those of the runs


@dataclass(frozen=True)
class LinkFaults:
    """What is wrong with the line, and how long a command is believed.

    Attributes:
        loss: chance that a message is lost, each way by itself, in [0, 1].
        delay: from a question to the arrival of its answer [s], in whole periods, up.
        deadline: age of a command after which the thrusters are given zero [s].
        seed: of the losses.
    """

    loss: float = 0.0
    delay: float = 0.0
    deadline: float = 0.25
    seed: int = 0

    def __post_init__(self) -> None:
        """Raise InputError for a share that is none, or a time below 0."""
        if not 0.0 <= self.loss <= 1.0:
            raise InputError("is no chance", key="link-loss", value=self.loss, remedy="use 0 to 1")
        for key in ("delay", "deadline"):
            value = getattr(self, key)
            if not 0.0 <= value <= 3600.0:
                raise InputError("is no time", key=f"link-{key}", value=value, remedy="give seconds, at least 0")


@dataclass(frozen=True)
class LinkReport:
    """How the line did over one run.

    Attributes:
        name, id, real: of the controller.
        steps: control periods.
        answered: steps that the controller carried out.
        lost: messages lost, to and from it.
        failsafe: periods flown with the fail-safe thrust for want of a command.
        gone_s: simulated time from which on the controller was gone, None if it never was.
        gone_because: why it is taken for gone.
        round_trip_ms: mean and longest, of this machine's clock.
        differing: answered steps whose bytes are not those of the law in Python.
        first: the first of them.
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
        """Plain data for JSON."""
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
        """One line for people."""
        verdict = "all as in Python to the last bit"
        if self.differing:
            verdict = f"{self.differing} DIFFER from Python, first step {self.first}"
        parts = [f"{self.name} in {self.real}: {self.answered} of {self.steps} steps answered, {verdict}"]
        if any(self.lost):
            parts.append(f"{self.lost[0]} questions and {self.lost[1]} answers lost")
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
    """Steps a law over a line, as `surctl.simulation.simulate` wants its stepper.

    Attributes:
        law: the law in Python, the one that was exported.
        p: the gains that are flown, as they were exported (np,).
        line: to the controller.
        faults: of the line.
        envelope: what the controller's guard lets in; None: any finite number.
    """

    law: Exportable
    p: Vector
    line: Line
    faults: LinkFaults = field(default_factory=LinkFaults)
    envelope: Envelope | None = None

    def __post_init__(self) -> None:
        """Shake hands.

        Raises:
            InputError: the other end is another controller, or speaks no such link.
        """
        try:
            who = self.line.request()
            self.real: Real = "float64" if who.real == "float64" else "float32"
            self.shipped, self.gains = self._shipped(who.id)
            self.identity = law_id(self.shipped, self.gains, real=self.real)
            if who.id != self.identity:
                raise InputError(
                    f"runs controller {who.id[:12]} in {who.real}, these options make {self.identity[:12]}",
                    key="controller",
                    value=self.line.name,
                    remedy="export it with the same scenario, vehicle, gains, law, sensing and --real",
                )
            self.line.start(self.identity)
        except LineDown as reason:
            raise InputError(
                str(reason).removeprefix(self.line.name).strip(),
                key="controller",
                value=self.line.name,
                remedy="start the bundle's own: make controller && ./controller PORT",
            ) from None
        self._noise = NoiseStream(_STREAM + self.faults.seed)
        self._late = int(np.ceil(self.faults.delay / self.law.dt - 1e-9))
        self._believed = int(np.floor(self.faults.deadline / self.law.dt + 1e-9))
        self._period = 0
        self._state = rounded(self.law.initial_state(), self.real)
        self._pending: list[_Command] = []
        self._current: _Command | None = None
        self._log: list[tuple[Vector, Vector, Reply, int]] = []
        self._lost = [0, 0]
        self._failsafe = 0
        self._times: list[float] = []
        self._gone: tuple[float, str] | None = None
        self._telemetry = np.zeros(self.law.outputs.size - thrust(self.law).size)

    def _shipped(self, identity: str) -> tuple[Exportable, Vector]:
        """The law as it was exported, and its gains: those with constants if the controller has that id."""
        if not isinstance(self.law, Law):
            return self.law, self.p
        if self.law.perception is None:
            constant = closed_form(self.law, real=self.real, constants=self.p)
            if law_id(constant, np.zeros(0), real=self.real) == identity:
                return constant, np.zeros(0)
        return closed_form(self.law, real=self.real), self.p

    def __call__(self, x: Vector, u: Vector, p: Vector) -> LawStep:
        """What the thrusters get in this period, the controller's state and its newest telemetry; x is its own."""
        if self._gone is None:
            self._request(u)
        while self._pending and self._pending[0].arrives <= self._period:
            self._current = self._pending.pop(0)
            self._telemetry = self._current.reply.telemetry
        period, now = self._period, self._current
        self._period += 1
        if now is not None and self._gone is None and period - now.requested <= self._believed:
            return LawStep(now.reply.tau, self._state, now.reply.status, self._telemetry)
        self._failsafe += 1
        return LawStep(
            np.zeros(thrust(self.law).size), self._state, LATE if self._gone is None else GONE, self._telemetry
        )

    def _request(self, u: Vector) -> None:
        """One exchange, with what the line does to it."""
        to, back = (number < self.faults.loss for number in self._noise.uniforms(2))
        if to:
            self._lost[0] += 1
            return
        began = time.perf_counter()
        try:
            reply = self.line.step(self._period + 1, u)
        except LineDown as reason:
            why = str(reason).removeprefix(self.line.name).strip()
            self._gone = self._period * self.law.dt, why
            return
        self._times.append(1e3 * (time.perf_counter() - began))
        self._log.append((self._state, rounded(u, self.real), reply, self._period))
        self._state = reply.state
        if back:
            self._lost[1] += 1
            return
        self._pending.append(_Command(self._period + self._late, self._period, reply))

    def report(self) -> LinkReport:
        """How the line did; every answer is compared with the law in Python, stepped from the same state.

        All steps alike, the chains are alike, by induction from the initial state.
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
        """Which of the answers are not, byte by byte, those of Python; a NaN may have any bits."""
        if not self._log:
            return np.zeros(0, dtype=np.intp)
        X, U = (np.array([row[k] for row in self._log]) for k in (0, 1))
        P = np.tile(rounded(self.gains, self.real), (len(X), 1))
        law: Exportable = Rounded(self.shipped, self.real)
        if self.envelope is not None:
            gains = self.envelope.gains if self.gains.size else np.zeros((0, 2))
            law = Guarded(law, replace(self.envelope, gains=gains).fitted(self.shipped, self.real), self.real)
        counts = np.array([row[3] for row in self._log])
        rows = replayed(law, Records(X, U, P), counts < 0, counts=counts)
        mine = np.hstack([rows.tau, rows.state, rows.telemetry]).astype(self.real)
        theirs = np.array([np.frombuffer(row[2].raw, dtype=np.dtype(self.real).newbyteorder("<")) for row in self._log])
        bits = f"u{mine.itemsize}"
        same = (mine.view(bits) == theirs.astype(self.real).view(bits)) | (np.isnan(mine) & np.isnan(theirs))
        status = np.array([row[2].status for row in self._log])
        return np.flatnonzero(~same.all(axis=1) | (status != rows.status))
