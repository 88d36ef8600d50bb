"""The sensing equipment of the robot, with its true properties or with the properties that the control law assumes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from surctl.errors import InputError
from surctl.sensing.localisation.base_station import BaseStation, OwnState
from surctl.sensing.sonar.array import SonarArray

__all__ = ["SURFACE_MODELS", "Equipment", "SurfaceModel"]

SurfaceModel = Literal["diffuse", "smooth-walls", "specular"]
"""What a law assumes of surfaces.

`diffuse`: every surface answers from every direction, so silence means free water, and a reading beyond the nearest
point of a known wall is a fault of the sonar. `smooth-walls`: a known wall surely answers near its normal only, so a
reading is a fault only if it is beyond a wall that the beam meets near its normal. `specular`: obstacles are smooth
too, so silence clears a mark only from directions from which the mark was heard (see `mapping.directions`)."""

SURFACE_MODELS: tuple[SurfaceModel, ...] = get_args(SurfaceModel)


@dataclass(frozen=True, kw_only=True)
class Equipment:
    """The sonars, the base station and the measurement of the robot's own state.

    Attributes:
        array: the sonar array.
        station: the base station, which measures moving obstacles.
        own: measurement of the robot's own position and motion; None: the law receives the true values.
        surface_model: what the law assumes of surfaces, see `SurfaceModel`.
    """

    array: SonarArray = field(default_factory=SonarArray)
    station: BaseStation = field(default_factory=BaseStation)
    own: OwnState | None = field(default_factory=OwnState)
    surface_model: SurfaceModel = "diffuse"

    def __post_init__(self) -> None:
        """Check the values; raise an InputError that names an invalid value."""
        if self.surface_model not in SURFACE_MODELS:
            remedy = f"write {' or '.join(SURFACE_MODELS)}"
            raise InputError("is not known", key="surface_model", value=self.surface_model, remedy=remedy)

    @property
    def assumed(self) -> Equipment:
        """The equipment without what the law cannot know: from which directions the true surfaces answer."""
        return replace(self, array=replace(self.array, incidence_limit=None))
