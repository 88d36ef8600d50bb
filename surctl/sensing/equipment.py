"""All that the robot senses with: as it is, and as its law believes it to be."""

from __future__ import annotations

from dataclasses import dataclass, field

from surctl.sensing.localisation.base_station import BaseStation, OwnState
from surctl.sensing.sonar.array import SonarArray

__all__ = ["Equipment"]


@dataclass(frozen=True, kw_only=True)
class Equipment:
    """Sonars, base station and own state.

    Attributes:
        array: the sonars.
        station: what tells of moving obstacles.
        own: what measures the robot itself; None: the law is told the truth.
    """

    array: SonarArray = field(default_factory=SonarArray)
    station: BaseStation = field(default_factory=BaseStation)
    own: OwnState | None = field(default_factory=OwnState)
