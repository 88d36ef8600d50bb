"""The state machine of a session: when the law may steer, time-outs, clock offset, and what each state sends.

| phase | meaning | sent each control period |
|---|---|---|
| `waiting` | no autopilot has been heard | nothing |
| `ready` | the autopilot is heard; the operator has not armed, or not in the session's mode | nothing |
| `steering` | armed by the operator, in the mode, with fresh estimates | the law's command |
| `holding` | something that steering needs is missing | neutral |
| `released` | the operator changed the mode | neutral for a short time, then nothing |
| `arrived` | the vehicle reached the end of the path | neutral |

The bridge never arms, disarms or changes a mode. `permitted` is True from the moment at which the operator is seen to
arm the vehicle in the session's mode; a restart, a loss of the link, a change of mode, a refusing law, and arrival
clear it. Then only the operator can let the bridge steer again, by disarming and arming the vehicle.

The functions are pure: they map a state and an event to the next state, and know no sockets and no clock.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Literal

from surctl.errors import InputError, check_number

_BACK = 1.0  # [s] a time since boot that is older than the newest by more than this is that of a restarted autopilot
_AHEAD = 5.0  # [s] and one that is ahead of its time by more than this belongs to another autopilot
_MEMORY = 10.0  # [s] for which the best measurement of the offset is kept; clocks drift by far less than 1 ms in it


@dataclass(frozen=True)
class Clock:
    """Estimate of the offset between the clocks of bridge and autopilot, from round trips (TIMESYNC).

    The offset is that of the shortest round trip of the last 10 s, with equal delays in both directions. If they
    differ, an age is wrong by at most half the round trip.

    Attributes:
        offset: time of the bridge at which the autopilot started [s]; None before the first round trip.
        trip: duration of the round trip from which the offset comes [s].
        replied: time of the newest reply [s]; None before the first.
        best: time of the round trip from which the offset comes [s].
        newest: newest time since the autopilot's start [s], and the time of the bridge at which it arrived; None before
            the first.
        restarts: number of times that the time since start jumped.
    """

    offset: float | None = None
    trip: float = 0.0
    replied: float | None = None
    best: float = 0.0
    newest: tuple[float, float] | None = None
    restarts: int = 0

    def stamped(self, now: float, boot: float) -> Clock:
        """Return the clock after a message with the time `boot` [s] since the autopilot's start."""
        if self.newest is None:
            return replace(self, newest=(boot, now))
        last, arrived = self.newest
        if boot < last - _BACK or boot > last + (now - arrived) + _AHEAD:
            return Clock(newest=(boot, now), restarts=self.restarts + 1)
        return replace(self, newest=(boot, now)) if boot > last else self

    def reply(self, now: float, *, sent: float, boot: float) -> Clock:
        """Return the clock after a reply to a request that was sent at `sent` [s] and answered at `boot` [s]."""
        trip = now - sent
        if not 0.0 <= trip <= _MEMORY:
            return self
        known = self.stamped(now, boot)
        if known.offset is None or trip <= known.trip or now - known.best > _MEMORY:
            known = replace(known, offset=0.5 * (sent + now) - boot, trip=trip, best=now)
        return replace(known, replied=now)

    def measured(self, boot: float) -> float | None:
        """Return the time of the bridge [s] at which the autopilot's clock showed `boot`; None if it is unknown."""
        return None if self.offset is None else self.offset + boot


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Time-outs of a session [s]; every default is a design choice.

    Attributes:
        estimate: largest age that position and attitude may have at the vehicle while the command that follows from
            them acts there. Beyond it the command is neutral; steering goes on when newer estimates arrive.
        slack: on a link whose round trip is long, the age may be the round trip and this time, but at most `lost`: no
            loss can have an effect at the vehicle sooner than a round trip after it.
        heartbeat: longest silence of the autopilot's heartbeat, which it sends each second, or faster on request.
        reply: longest time without a reply to TIMESYNC: the autopilot no longer hears the bridge.
        lost: longest time without a usable estimate, or of refused control steps, after which the bridge steers again
            only when the operator disarms and arms the vehicle.
        obstacle: longest silence of a moving obstacle; its last motion is continued until then.
        release: time for which neutral commands are sent before the bridge is silent.
    """

    estimate: float = 0.45
    slack: float = 0.15
    heartbeat: float = 3.0
    reply: float = 2.0
    lost: float = 2.0
    obstacle: float = 1.0
    release: float = 0.5

    def __post_init__(self) -> None:
        """Raise InputError for a time that is not positive, or an `estimate` above `lost`."""
        for each in fields(self):
            check_number(each.name, getattr(self, each.name), unit="s")
        if self.estimate > self.lost:
            raise InputError(
                f"is above lost = {self.lost:g} s", key="estimate", value=self.estimate, remedy="give a shorter time"
            )

    def oldest(self, trip: float) -> float:
        """Return the largest age [s] of an estimate when its command reaches the vehicle, for a round trip [s]."""
        return min(max(self.estimate, trip + self.slack), self.lost)


Phase = Literal["waiting", "ready", "steering", "holding", "released", "arrived"]
Sending = Literal["nothing", "neutral", "command"]


_OTHER = "armed in another mode: set the mode, then disarm and arm"


@dataclass(frozen=True)
class Session:
    """State of a session.

    Attributes:
        phase: see the table of this module.
        why: reason for the phase, for the operator.
        since: time at which the phase began [s].
        beat: time of the newest heartbeat [s]; None before the first.
        armed, mode: armed state and mode number in the newest heartbeat; None before the first one since a restart.
        permitted: whether the operator has armed the vehicle in the session's mode since the last event that ended
            steering.
        missing: time since which no fresh estimate has been known [s]; None while there is one.
        refused: time since which the law refuses its steps [s]; None while it accepts them.
        estimate: time at which the newest usable estimate was measured [s].
        restarts: number of restarts of the autopilot.
    """

    phase: Phase = "waiting"
    why: str = "no heartbeat of an autopilot"
    since: float = 0.0
    beat: float | None = None
    armed: bool | None = None
    mode: int | None = None
    permitted: bool = False
    refused: float | None = None
    estimate: float | None = None
    restarts: int = 0

    def to(self, phase: Phase, now: float, why: str) -> Session:
        """Return the session in another phase, or with another reason."""
        return replace(self, phase=phase, why=why, since=self.since if phase == self.phase else now)


def after_beat(session: Session, now: float, *, armed: bool, mode: int, steering_mode: int) -> Session:
    """Return the session after a heartbeat; `steering_mode` is the number of the mode in which the bridge may steer."""
    was = session.armed
    known = replace(session, beat=now, armed=armed, mode=mode)
    if known.phase == "waiting":
        known = known.to("ready", now, "not armed")
    if not armed:
        known = replace(known, permitted=False)
        if known.phase in ("steering", "holding", "arrived"):
            return known.to("released", now, "disarmed")
        return known.to("ready", now, "not armed") if known.phase == "ready" else known
    if was is False:
        known = replace(known, permitted=True, refused=None)
        if known.phase in ("released", "arrived"):
            known = known.to("ready", now, "armed")
    if mode != steering_mode:  # a later change of mode must not hand the vehicle over
        known = replace(known, permitted=False)
        if known.phase in ("steering", "holding", "arrived"):
            return known.to("released", now, "the operator changed the mode")
    return known


def after_estimate(session: Session, measured: float) -> Session:
    """Return the session after an estimate of pose and velocity that was measured at `measured` [s]."""
    newest = measured if session.estimate is None else max(session.estimate, measured)
    return replace(session, estimate=newest)


def after_law(session: Session, now: float, *, status: int, limits: Limits) -> Session:
    """Return the session after a control step of the law; a negative status is a refused step."""
    if status >= 0:
        return replace(session, refused=None)
    since = now if session.refused is None else session.refused
    known = replace(session, refused=since)
    if now - since > limits.lost and known.phase == "steering":
        return replace(known, permitted=False).to("holding", now, f"the law refuses its inputs (status {status})")
    return known


def after_arrival(session: Session, now: float) -> Session:
    """Return the session after the vehicle reached the end of the path."""
    return replace(session, permitted=False).to("arrived", now, "reached the end of the path")


def after_time(
    session: Session, now: float, *, clock: Clock, steering_mode: int, obstacle: str, limits: Limits, dt: float = 0.0
) -> Session:
    """Return the session at the begin of a control period of `dt` [s], for which a command acts.

    `steering_mode` is the number of the mode in which the bridge may steer. `obstacle` names a moving obstacle that has
    been silent for too long; empty if there is none.
    """
    if session.phase == "waiting":
        return session
    if clock.restarts != session.restarts:
        known = replace(session, restarts=clock.restarts, permitted=False, armed=None, mode=None, estimate=None)
        return known.to(_stopped(session.phase), now, "the autopilot restarted")
    missing, lost = _missing(session, now + dt, clock, limits)
    if lost:
        session = replace(session, permitted=False)
        if session.phase == "steering" or session.phase == "holding":
            return session.to("holding", now, missing)
        return session if session.phase in ("released", "arrived") else session.to("ready", now, missing)
    if session.phase in ("released", "arrived"):
        return session
    if missing or obstacle:
        why = missing or f"no message of the moving obstacle {obstacle}"
        return session.to(_stopped(session.phase), now, why)
    if session.armed is None:
        return session.to(_stopped(session.phase), now, session.why)
    if not session.armed:
        return session.to("ready", now, "not armed")
    if not session.permitted:
        here = session.mode == steering_mode
        why = "armed before the bridge was ready, or in another mode: disarm and arm" if here else _OTHER
        return session.to(session.phase, now, session.why if session.phase == "holding" else why)
    if session.refused is not None and session.phase == "holding":
        session = replace(session, refused=None)
    return session.to("steering", now, "")


def _stopped(phase: Phase) -> Phase:
    return "holding" if phase == "steering" else phase


def _missing(session: Session, now: float, clock: Clock, limits: Limits) -> tuple[str, bool]:
    # what steering needs and does not have, and whether only the operator may let it go on
    if session.beat is None or now - session.beat > limits.heartbeat:
        return "no heartbeat of the autopilot", True
    if clock.replied is None:
        return "the autopilot has not answered TIMESYNC yet", False
    if now - clock.replied > limits.reply:
        return "the autopilot does not answer: it may not hear the bridge", True
    if session.estimate is None:
        return "no position and attitude", False
    age, oldest = now + 0.5 * clock.trip - session.estimate, limits.oldest(clock.trip)
    if age > oldest:
        return f"position or attitude is older than {oldest:.2g} s", age > limits.lost
    return "", False


def sending(session: Session, now: float, *, limits: Limits) -> Sending:
    """Return what the bridge sends in this control period.

    Example:
        >>> from surctl.marine.bridge.session import Limits, Session, sending
        >>> sending(Session(), 0.0, limits=Limits()), sending(Session("holding"), 0.0, limits=Limits())
        ('nothing', 'neutral')
    """
    if session.phase == "steering":
        return "command"
    if session.phase in ("holding", "arrived"):
        return "neutral"
    if session.phase == "released" and now - session.since <= limits.release:
        return "neutral"
    return "nothing"
