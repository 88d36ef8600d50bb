"""The sensing equipment of the robot, with its true properties or with the properties that the control law assumes."""

from __future__ import annotations

from dataclasses import dataclass, field

from surctl.sensing.localisation.base_station import BaseStation, OwnState
from surctl.sensing.sonar.array import SonarArray

__all__ = ["Equipment"]


@dataclass(frozen=True, kw_only=True)
class Equipment:
    """The sonars, the base station and the measurement of the robot's own state.

    Attributes:
        array: the sonar array.
        station: the base station, which measures moving obstacles.
        own: measurement of the robot's own position and motion; None: the law receives the true values.
    """

    array: SonarArray = field(default_factory=SonarArray)
    station: BaseStation = field(default_factory=BaseStation)
    own: OwnState | None = field(default_factory=OwnState)
