"""Rehearsals (`--dry-run`): lost and late frames, acts of operator and link, and what the vehicle then did."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from math import inf
from typing import Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from surctl.errors import InputError
from surctl.marine.bridge.autopilot import SimulatedSub
from surctl.marine.bridge.bridge import Bridge
from surctl.marine.bridge.live import SessionLog
from surctl.marine.simulation.sensors import FIRING

# A simulated link: frames that are lost, late, out of order, repeated or damaged


@dataclass(frozen=True, kw_only=True)
class LinkQuality:
    """Quality of a simulated link, for each direction.

    Attributes:
        loss: probability in [0, 1] that a frame is lost.
        delay: delay of a frame [s].
        jitter: largest further delay [s], random for each frame, so that frames overtake each other.
        damaged: probability that a byte of a frame is changed, or that the frame is cut.
        repeated: probability that a frame arrives twice.
    """

    loss: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0
    damaged: float = 0.0
    repeated: float = 0.0

    def __post_init__(self) -> None:
        """Raise InputError for a probability outside [0, 1], or a time outside [0, 60] s."""
        for each in fields(self):
            most, unit = (60.0, " s") if each.name in ("delay", "jitter") else (1.0, "")
            if not 0.0 <= (value := getattr(self, each.name)) <= most:
                raise InputError("is out of range", key=each.name, value=value, remedy=f"give 0 to {most:g}{unit}")


@dataclass
class Channel:
    """One direction of a simulated link; while `cut` is True, nothing arrives that is sent."""

    quality: LinkQuality = field(default_factory=LinkQuality)
    seed: int = 0
    cut: bool = False
    _queue: list[tuple[float, int, bytes]] = field(default_factory=list, init=False)
    _count: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.seed, 36])

    def send(self, frame: bytes, now: float) -> None:
        """Send a frame at `now` [s]."""
        q, rng = self.quality, self._rng
        numbers = rng.random(5).tolist()
        if self.cut or numbers[0] < q.loss:
            return
        if numbers[1] < q.damaged:
            frame = self._damaged(frame)
        for _ in range(2 if numbers[2] < q.repeated else 1):
            self._count += 1
            late = q.delay + q.jitter * float(rng.random()) if q.jitter else q.delay
            heapq.heappush(self._queue, (now + late, self._count, frame))

    def _damaged(self, frame: bytes) -> bytes:
        at = int(self._rng.integers(len(frame)))
        if self._rng.random() < 0.3:
            return frame[:at] or b"\xfd"
        changed = bytearray(frame)
        changed[at] ^= int(self._rng.integers(1, 256))
        return bytes(changed)

    def arrived(self, now: float) -> list[bytes]:
        """Return the frames that have arrived by `now` [s], in the order of their arrival."""
        frames = []
        while self._queue and self._queue[0][0] <= now + 1e-9:
            frames.append(heapq.heappop(self._queue)[2])
        return frames


Action: TypeAlias = Literal[
    "arm", "disarm", "manual", "alt_hold", "guided", "reboot", "cut", "mute", "deaf", "blind", "join", "quit"
]

ACTIONS: tuple[Action, ...] = get_args(Action)

_READY = 3.0  # [s] after which the operator arms
_QUIET = 5.0  # [s] after the last event and the end of arming, when the rehearsal ends
_LEFT = 1.0  # [s] after arrival, when the operator disarms


class Act(NamedTuple):
    """What happens at a time [s]: the operator arms, disarms or sets a mode; the autopilot restarts (`reboot`).

    `cut` ends both directions of the link, `mute` the one from the autopilot, `deaf` the one to it; `blind` ends its
    position and attitude alone. `join` undoes these. `quit` ends the bridge without a last command, as kill -9 does.
    """

    time: float
    action: Action


@dataclass(frozen=True)
class RehearsalResult:
    """Result of a rehearsed session.

    Attributes:
        arrived: whether the vehicle reached the end of the path.
        time: time of steering until arrival, or until the end [s].
        clearance: least distance from the hull to an obstacle or wall [m].
        steered: time of steering in all [s].
        phases: number of control periods by phase.
        neutral_after: for each loss, restart, change of mode or disarming (time, action): the time after which the
            commanded thrust at the vehicle was neutral for good or until the operator armed again [s].
        missed: acts whose time lies after the end of the rehearsal.
        begun: number of times at which the bridge began to steer, also after a gap.
        bad: number of invalid frames that the bridge received.
        commands: numbers of the commands (COMMAND_LONG) that the bridge sent.
        texts: texts for the operator.
    """

    arrived: bool
    time: float
    clearance: float
    steered: float
    phases: Mapping[str, int]
    neutral_after: Sequence[tuple[Act, float]]
    missed: Sequence[Act]
    begun: int
    bad: int
    commands: frozenset[int]
    texts: Sequence[tuple[float, str]]

    @property
    def touched(self) -> bool:
        """Whether the hull touched an obstacle or wall; the rehearsal goes on after it."""
        return self.clearance <= 0.0


@dataclass
class Rehearsal:
    """A rehearsal while it runs, at the time `now` [s]; `down` and `up` are links from and to the autopilot."""

    bridge: Bridge
    sub: SimulatedSub
    down: Channel
    up: Channel
    log: SessionLog | None = None
    now: float = 0.0
    quit: bool = False
    thrusts: list[tuple[float, bool, bool]] = field(default_factory=list)

    def advance(self, *, period: bool) -> None:
        """Advance by 25 ms; with `period`, the bridge runs a control period first."""
        now = self.now
        for frame in self.down.arrived(now):
            if not self.quit:
                self._logged(frame, sent=False)
                self.bridge.hear(frame, now)
        if period and not self.quit:
            for frame in self.bridge.period(now):
                self._logged(frame, sent=True)
                self.up.send(frame, now)
            if self.log is not None:
                self.log.period(self.bridge)
        for frame in self.up.arrived(now):
            for reply in self.sub.hear(frame, now):
                self.down.send(reply, now)
        for frame in self.sub.advance(now):
            self.down.send(frame, now)
        acts = bool(np.any(np.abs(self.sub.pilot_thrust(now)) > 1e-9))
        self.thrusts.append((now, acts, self.sub.armed))
        self.now = now + FIRING

    def _logged(self, frame: bytes, *, sent: bool) -> None:
        if self.log is not None:
            self.log.frame(self.now, frame, sent=sent)

    def act(self, action: Action) -> None:
        """Do what an `Act` says, now."""
        if action in ("arm", "disarm", "reboot"):
            getattr(self.sub, action)(self.now)
        elif action in ("cut", "mute", "deaf", "blind", "join"):
            self.down.cut, self.up.cut = action in ("cut", "mute"), action in ("cut", "deaf")
            self.sub.blind = action == "blind"
        elif action == "quit":
            self.quit = True
        else:
            self.sub.set_mode(action, self.now)


def rehearse(
    bridge: Bridge,
    sub: SimulatedSub,
    *,
    link: LinkQuality | None = None,
    seed: int = 0,
    acts: Sequence[Act] | None = None,
    limit: float | None = None,
    each: Callable[[Rehearsal], None] | None = None,
    log: SessionLog | None = None,
) -> RehearsalResult:
    """Run a session with the simulated autopilot and return its result.

    Args:
        bridge: the bridge, before its first period.
        link: quality of the link in each direction; default: no loss and no delay.
        seed: seed of the link's losses.
        acts: what happens when. If nobody arms, the operator arms after 3 s; he disarms 1 s after the arrival.
        limit: longest simulated time [s]; default: the scenario's time limit.
    """
    quality = link or LinkQuality()
    run = Rehearsal(bridge, sub, Channel(quality, 2 * seed), Channel(quality, 2 * seed + 1), log)
    plan = bridge.plan
    end = plan.scenario.time_limit if limit is None else limit
    pending = list(acts or ())
    if not any(act.action == "arm" for act in pending):
        pending.append(Act(_READY, "arm"))
    pending.sort(key=lambda act: act.time)  # acts of one time stay in the given order
    done: list[Act] = []
    counts: dict[str, int] = {}
    began = arrived = left = inf
    quiet = 0.0
    begun, last, every = 0, "waiting", round(plan.law.dt / FIRING)
    steps = int(end / FIRING)
    for k in range(steps):
        while pending and pending[0].time <= run.now + 1e-9:
            act = pending.pop(0)
            run.act(act.action)
            done.append(act)
        run.advance(period=k % every == 0)
        if k % every:
            continue
        phase = bridge.session.phase
        counts[phase] = counts.get(phase, 0) + 1
        if phase == "steering" and last != "steering":
            begun += 1
            began = min(began, run.now)
        if phase == "arrived" and arrived == inf:
            arrived = run.now
            left = run.now + _LEFT
        last = phase
        if each is not None:
            each(run)
        if run.now >= left and sub.armed:
            run.act("disarm")
        if sub.armed or pending:
            quiet = run.now
        if run.now >= min(left + 1.0, quiet + _QUIET):
            break
    time = min(arrived, run.now) - began if began < inf else 0.0
    return RehearsalResult(
        arrived < inf, time, sub.least, counts.get("steering", 0) * plan.law.dt, counts,
        [(act, _neutral(run, act, done)) for act in done if act.action not in ("arm", "join", plan.mapping.mode.name)],
        pending, begun, bridge.wire.bad, frozenset(sub.commands), bridge.texts,
    )  # fmt: skip


def _neutral(run: Rehearsal, act: Act, done: Sequence[Act]) -> float:
    # time from the act to the last command that was not neutral, before the next time the operator arms
    until = next((other.time for other in done if other.time > act.time and other.action in ("arm", "join")), inf)
    acting = [time for time, acts, _ in run.thrusts if acts and act.time <= time < until]
    return max(acting) + FIRING - act.time if acting else 0.0
