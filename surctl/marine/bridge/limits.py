"""Time-outs of a session with an autopilot."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import isfinite

from surctl.errors import InputError

__all__ = ["Limits"]


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
            value = getattr(self, each.name)
            if not (isfinite(value) and value > 0):
                raise InputError("is not a valid time", key=each.name, value=value, remedy="give seconds, above 0")
        if self.estimate > self.lost:
            raise InputError(
                f"is above lost = {self.lost:g} s", key="estimate", value=self.estimate, remedy="give a shorter time"
            )

    def oldest(self, trip: float) -> float:
        """Return the largest age [s] of an estimate when its command reaches the vehicle, for a round trip [s].

        Example:
            >>> from surctl.marine.bridge import Limits
            >>> Limits().oldest(0.1), Limits().oldest(0.6)
            (0.45, 0.75)
        """
        return min(max(self.estimate, trip + self.slack), self.lost)
