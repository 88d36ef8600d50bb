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
        estimate: largest age of the position and attitude from which a command is computed. Beyond it the command is
            neutral; steering goes on when newer estimates arrive.
        heartbeat: longest silence of the autopilot's heartbeat, which it sends each second.
        reply: longest time without a reply to TIMESYNC: the autopilot no longer hears the bridge.
        lost: longest time without a usable estimate, or of refused control steps, after which the bridge steers again
            only when the operator disarms and arms the vehicle.
        obstacle: longest silence of a moving obstacle; its last motion is continued until then.
        release: time for which neutral commands are sent before the bridge is silent.
    """

    estimate: float = 0.5
    heartbeat: float = 3.0
    reply: float = 3.0
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
