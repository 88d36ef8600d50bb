"""The numbers that the paper reports for a scenario."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from surctl.files import Strict
from surctl.marine.simulation.obstacle import Positive

__all__ = ["PaperFigure"]

_OF = {
    "time_kind": "time_s",
    "time_of": "time_s",
    "position_error_kind": "position_error_m",
    "position_error_of": "position_error_m",
}


class PaperFigure(Strict):
    """The numbers that the paper reports for a scenario; numbers that the paper does not state are left out.

    Attributes:
        result: the result in words; empty if the paper has no such scenario.
        time_s: time to the target; `time_kind` says whether the time is approximate or an upper limit; `time_of` says
            whether the paper states the time for this run, for every run of a series, or for the mean of a series.
        position_error_m: position error E_p to the reference path outside avoidance; `position_error_kind` and
            `position_error_of` correspond to `time_kind` and `time_of`.
        detected_s: approximate time at which the robot detects the moving obstacle.
        passed_s: approximate time from which the moving obstacles are behind the robot.
        transients_s: approximate times at which avoidance disturbs the path tracking.
    """

    result: str = ""
    time_s: Positive | None = None
    time_kind: Literal["about", "less than"] = "about"
    time_of: Literal["run", "series", "series mean"] = "run"
    position_error_m: Positive | None = None
    position_error_kind: Literal["about", "less than"] = "less than"
    position_error_of: Literal["run", "series", "series mean"] = "series"
    detected_s: Positive | None = None
    passed_s: Positive | None = None
    transients_s: tuple[Positive, ...] = ()

    @model_validator(mode="after")
    def _of_something(self) -> PaperFigure:
        for key, figure in _OF.items():
            if key in self.model_fields_set and getattr(self, figure) is None:
                raise ValueError(f"{key} describes {figure}, which is missing; add {figure} or remove {key}")
        return self
