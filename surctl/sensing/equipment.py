"""The sensing equipment of the robot, with its true properties or with the properties that the control law assumes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from surctl.errors import InputError
from surctl.sensing.localisation.base_station import BaseStation, OwnState
from surctl.sensing.sonar.array import SonarArray

__all__ = ["REFLECTORS", "Equipment", "Reflectors"]

Reflectors = Literal["specular", "diffuse"]
"""How surfaces reflect. `diffuse`: a surface answers from every direction, so silence means free water. `specular`: a
surface answers near its normal only, so silence frees a place only for directions from which a surface there would have
answered."""

REFLECTORS: tuple[Reflectors, ...] = get_args(Reflectors)


@dataclass(frozen=True, kw_only=True)
class Equipment:
    """The sonars, the base station and the measurement of the robot's own state.

    Attributes:
        array: the sonar array.
        station: the base station, which measures moving obstacles.
        own: measurement of the robot's own position and motion; None: the law receives the true values.
        reflectors: how the law assumes that surfaces reflect; see `Reflectors`.
    """

    array: SonarArray = field(default_factory=SonarArray)
    station: BaseStation = field(default_factory=BaseStation)
    own: OwnState | None = field(default_factory=OwnState)
    reflectors: Reflectors = "specular"

    def __post_init__(self) -> None:
        """Check the values; raise an InputError that names an invalid value."""
        if self.reflectors not in REFLECTORS:
            remedy = f"write {' or '.join(REFLECTORS)}"
            raise InputError("is not known", key="reflectors", value=self.reflectors, remedy=remedy)

    @property
    def assumed(self) -> Equipment:
        """The equipment without what the law cannot know: from which directions the true surfaces answer."""
        return replace(self, array=replace(self.array, incidence_limit=None))
