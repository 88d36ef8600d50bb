"""By how much a scenario's numbers may be off."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from surctl.files import Strict

__all__ = ["Uncertainty"]

Share = Annotated[float, Field(ge=0, lt=1)]


class Uncertainty(Strict):
    """`[uncertainty]` of a scenario file: what a Monte Carlo campaign draws, evenly and independently.

    Attributes:
        vehicle: whether the vehicle that is flown is drawn within the ranges of its file; the law keeps the file's
            values.
        obstacle_size: largest share by which an obstacle is larger or smaller, both edges of a box alike (*chosen*).
        obstacle_speed: largest share by which a moving obstacle is faster or slower (*chosen*).
    """

    vehicle: bool = True
    obstacle_size: Share = 0.1
    obstacle_speed: Share = 0.2
