"""The autopilot's clock on the bridge's clock: age of its measurements, and restarts."""

from __future__ import annotations

from dataclasses import dataclass, replace

__all__ = ["Clock"]

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
