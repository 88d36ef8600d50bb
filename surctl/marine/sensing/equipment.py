"""The sensors of the robot, and what its law assumes of them: surface model, floor, limit of a search."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf, pi
from types import MappingProxyType
from typing import Literal, get_args

from surctl.errors import InputError
from surctl.marine.sensing.localisation.base_station import BaseStation, OwnState
from surctl.marine.sensing.sonar.array import SonarArray

SurfaceModel = Literal["diffuse", "smooth", "specular"]
"""What a law assumes of surfaces.

`diffuse`: every surface answers from every direction, so silence means free water, and a reading beyond the nearest
point of a known wall is a fault of the sonar. `smooth`: a known wall surely answers near its normal only, so a reading
is a fault only if it is beyond a wall that the beam meets near its normal; obstacles answer within about 22° of their
normal, so for 9 s silence clears a mark only from directions from which the mark was heard (see `mapping.firing`), and
a face within the blind range goes on where it is silent (see `control.perception`). `specular`: obstacles are mirrors,
so this lasts as long as the mark, and a cell that was silent may cause an echo from another direction. With `smooth`
and `specular`, the robot turns such that its beams sweep past an obstacle from back to front."""

SURFACE_MODELS: tuple[SurfaceModel, ...] = get_args(SurfaceModel)

INCIDENCE_LIMITS: Mapping[SurfaceModel, float | None] = MappingProxyType(
    {"diffuse": None, "smooth": pi / 8, "specular": pi / 36}
)
"""Angle from its normal [rad] within which a face of an obstacle answers, as each `SurfaceModel` assumes; None: any."""


@dataclass(frozen=True, kw_only=True)
class Equipment:
    """The sonars, the base station and the measurement of the robot's own state.

    Attributes:
        array: the sonar array.
        station: the base station, which measures moving obstacles.
        own: measurement of the robot's own position and motion; None: the law receives the true values.
        surface_model: what the law assumes of surfaces, see `SurfaceModel`.
        floor: depth [m] of a floor that answers the sonars: the law takes an echo from its range, or from beyond, for
            no obstacle. None: the law expects no echo of the floor.
        search_limit: time [s] without progress along the path after which a law that recognises dead ends gives up,
            also if it still searches new places (see `control.dead_end`). None: no limit.
    """

    array: SonarArray = field(default_factory=SonarArray)
    station: BaseStation = field(default_factory=BaseStation)
    own: OwnState | None = field(default_factory=OwnState)
    surface_model: SurfaceModel = "diffuse"
    floor: float | None = None
    search_limit: float | None = None

    def __post_init__(self) -> None:
        if self.surface_model not in SURFACE_MODELS:
            remedy = f"write {' or '.join(SURFACE_MODELS)}"
            raise InputError("is not known", key="surface_model", value=self.surface_model, remedy=remedy)
        if self.floor is not None and not 0.0 < self.floor < inf:
            raise InputError("must be greater than 0", key="floor", value=self.floor, remedy="give the depth in m")
        if self.search_limit is not None and not 0.0 < self.search_limit < inf:
            remedy = "give the time in s, or leave it out for no limit"
            raise InputError("must be greater than 0", key="search_limit", value=self.search_limit, remedy=remedy)

    @property
    def assumed(self) -> Equipment:
        """The equipment without what the law cannot know: from which directions the true surfaces answer."""
        return replace(self, array=replace(self.array, incidence_limit=None))
