"""The uncertainty of a scenario's parameters."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from surctl.files import Strict

__all__ = ["Uncertainty"]

Share = Annotated[float, Field(ge=0, lt=1)]


class Uncertainty(Strict):
    """The table `[uncertainty]` of a scenario file, which controls the random draws of a Monte Carlo campaign.

    All parameters are drawn uniformly and independently.

    Attributes:
        vehicle: whether the simulated vehicle's parameters are drawn within the ranges of its file; the law keeps the
            file's values.
        obstacle_size: largest relative error of an obstacle's size (design choice); both edges of a box have the same
            error.
        obstacle_speed: largest relative error of a moving obstacle's speed (design choice).
    """

    vehicle: bool = True
    obstacle_size: Share = 0.1
    obstacle_speed: Share = 0.2
