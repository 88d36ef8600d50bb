"""Stability margins of one loop at a time.

Tests compare the margins with those of python-control.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from surctl.verification.loops import Crossings

__all__ = [
    "LEAST_DELAY_MARGIN",
    "LoopMargins",
    "margins_from",
]

LEAST_DELAY_MARGIN = 0.2
"""Least delay margin [s] of each loop alone, in every check, goal and search: four control periods (*chosen*)."""


@dataclass(frozen=True)
class LoopMargins:
    """The stability margins of one loop while all other loops are closed.

    Attributes:
        name: name of the loop; see `loop_margins`.
        stable: whether the closed loop is stable; if it is not, both gain factors are 1 and all other values are 0.
        gain_margin: least factor > 1 on the loop gain that destabilises the loop; inf if no such factor exists.
        phase_margin_deg: least extra phase lag [deg] that destabilises the loop; inf if the gain never crosses 1.
        delay_margin_s: least extra delay [s] that destabilises the loop, which is the least ratio of phase margin to
            frequency over all gain crossings.
        disk_margin: radius α of the balanced disk margin (Seiler, Packard and Gahinet 2020), 0 … 2.
        crossover_rad_s: highest frequency [rad/s] at which the loop gain crosses 1; 0 if the loop gain never crosses 1.
        least_gain: largest factor < 1 on the loop gain that destabilises the loop; 0 if no such factor exists. A loop
            that is unstable when it is open always has a destabilising factor < 1.
    """

    name: str
    stable: bool
    gain_margin: float
    phase_margin_deg: float
    delay_margin_s: float
    disk_margin: float
    crossover_rad_s: float
    least_gain: float

    @classmethod
    def unstable(cls, name: str) -> LoopMargins:
        """Return the margins of a loop whose closed loop is unstable."""
        return cls(name, False, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    def to_dict(self) -> dict[str, Any]:
        """The margins as plain data for JSON; infinite margins stay inf."""
        return asdict(self)

    def line(self) -> str:
        """Return the margins as one line of text."""
        least = f" (and above {self.least_gain:.3g})" if self.least_gain > 0 else ""
        return (
            f"{self.name}: gain factor below {self.gain_margin:.4g}{least}, phase {self.phase_margin_deg:.4g} deg, "
            f"delay {self.delay_margin_s:.4g} s, disk margin {self.disk_margin:.3g}"
        )


def margins_from(name: str, crossings: Crossings) -> LoopMargins:
    """Return the margins of a stable closed loop from the crossings of its first operating point."""
    return LoopMargins(
        name,
        True,
        float(crossings.gain_margin[0]),
        float(crossings.phase_margin_deg[0]),
        float(crossings.delay_margin_s[0]),
        float(crossings.disk_margin[0]),
        float(crossings.crossover_rad_s[0]),
        float(crossings.least_gain[0]),
    )
