"""The sensors of the robot, and what its law assumes of surfaces, of the floor and of a search."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf, pi

from surctl.errors import InputError
from surctl.marine.sensing.localisation.base_station import BaseStation, OwnState
from surctl.marine.sensing.sonar.array import SonarArray

INCIDENCE_LIMIT = pi / 8
"""Angle from its normal [rad] within which a face of an obstacle answers, as a law with sonars assumes.

It is that of the simulator of the paper. Known walls surely answer near their normal only (`control.beams.SURE`). For
9 s silence clears a mark only from directions from which the mark was heard (see `mapping.firing`), and a face within
the blind range goes on where it is silent (see `control.perception`)."""


@dataclass(frozen=True, kw_only=True)
class Equipment:
    """The sonars, the base station and the measurement of the robot's own state.

    Attributes:
        array: the sonar array.
        station: the base station, which measures moving obstacles.
        own: measurement of the robot's own position and motion; None: the law receives the true values.
        floor: depth [m] of a floor that answers the sonars: the law takes an echo from its range, or from beyond, for
            no obstacle. None: the law expects no echo of the floor.
        search_limit: time [s] without progress along the path after which a law that recognises dead ends gives up,
            also if it still searches new places (see `control.dead_end`). None: no limit.
    """

    array: SonarArray = field(default_factory=SonarArray)
    station: BaseStation = field(default_factory=BaseStation)
    own: OwnState | None = field(default_factory=OwnState)
    floor: float | None = None
    search_limit: float | None = None

    def __post_init__(self) -> None:
        if self.floor is not None and not 0.0 < self.floor < inf:
            raise InputError("must be greater than 0", key="floor", value=self.floor, remedy="give the depth in m")
        if self.search_limit is not None and not 0.0 < self.search_limit < inf:
            remedy = "give the time in s, or leave it out for no limit"
            raise InputError("must be greater than 0", key="search_limit", value=self.search_limit, remedy=remedy)

    @property
    def assumed(self) -> Equipment:
        """The equipment without what the law cannot know: from which directions the true surfaces answer."""
        return replace(self, array=replace(self.array, incidence_limit=None))
