"""The state machine of a session: events from the autopilot and the law, states, and what is sent in each state.

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

from dataclasses import dataclass, replace
from typing import Literal

from surctl.marine.bridge.clock import Clock
from surctl.marine.bridge.limits import Limits

__all__ = [
    "Phase",
    "Sending",
    "Session",
    "after_arrival",
    "after_beat",
    "after_estimate",
    "after_law",
    "after_time",
    "sending",
]

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
        return known if known.phase == "released" and known.why == "disarmed" else _idle(known, now)
    if was is False:
        known = replace(known, permitted=True, refused=None)
        if known.phase in ("released", "arrived"):
            known = known.to("ready", now, "armed")
    if mode != steering_mode:  # a later change of mode must not hand the vehicle over
        known = replace(known, permitted=False)
        if known.phase in ("steering", "holding", "arrived"):
            return known.to("released", now, "the operator changed the mode")
    return known


def _idle(session: Session, now: float) -> Session:
    return session.to("ready", now, "not armed") if session.phase == "ready" else session


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
    session: Session,
    now: float,
    *,
    clock: Clock,
    steering_mode: int,
    obstacle: str,
    limits: Limits,
    dt: float = 0.0,
) -> Session:
    """Return the session at the begin of a control period.

    Args:
        session: the session.
        now: time [s].
        clock: the autopilot's clock.
        steering_mode: number of the mode in which the bridge may steer.
        obstacle: name of a moving obstacle that has been silent for too long; empty if there is none.
        limits: time-outs.
        dt: control period [s], for which a command acts.
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
        >>> from surctl.marine.bridge import Limits, Session, sending
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
