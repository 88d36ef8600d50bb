"""What the paper reports of a scenario, in numbers."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from surctl.files import Strict
from surctl.simulation.obstacle import Positive

__all__ = ["PaperFigure"]

_OF = {
    "time_kind": "time_s",
    "time_of": "time_s",
    "position_error_kind": "position_error_m",
    "position_error_of": "position_error_m",
}


class PaperFigure(Strict):
    """What the paper reports of the scenario; what it does not state is left out.

    Attributes:
        result: in words; empty where the paper has no such scenario.
        time_s: to the target; `time_kind` says whether about so much or less, `time_of` whether the paper states it
            of this run, of every run of a series, or of a series' mean.
        position_error_m: E_p to the reference path outside the avoidance, with kind and scope alike.
        detected_s: when the moving obstacle is detected, about.
        passed_s: when the moving obstacles are behind the robot, about.
        transients_s: when avoidance disturbs the tracking, about.
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
                raise ValueError(f"{key} speaks of {figure}, which is not given; add {figure} or remove {key}")
        return self
