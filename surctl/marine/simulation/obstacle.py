"""The obstacles of a scenario file: keys of `[[obstacles]]`, what a shape needs, and distances between two."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from surctl.files import Strict
from surctl.marine.world import Heights

Point = tuple[float, float]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class Obstacle(Strict):
    """One obstacle of a scenario; lengths in m, speeds in m/s, positions in the earth frame {E} at the start.

    A box or a cylinder stands still except for its drift, a sinusoidal motion of amplitude `drift_m` whose direction
    and phase are random (determined by the seed). A `moving` obstacle goes in a straight line from `centre_m` to `to_m`
    and is removed on arrival if `removed` is true. `bottom_m` and `top_m` are the z coordinates of its lower and upper
    end, negative below the surface like the path's `depth_m`. Without `bottom_m` and `top_m`, the obstacle extends to
    the floor and to the surface. A moving obstacle is an upright cylinder. `reflector` names how its surface answers a
    sonar; without it, the obstacle answers as the scenario's echo model says.
    """

    name: str = Field(min_length=1)
    shape: Literal["box", "cylinder", "moving"]
    centre_m: Point
    size_m: tuple[Positive, Positive] | None = None
    radius_m: Positive | None = None
    drift_m: NotNegative = 0.0
    drift_period_s: Positive = 10.0
    to_m: Point | None = None
    speed_m_per_s: Positive | None = None
    removed: bool = True
    bottom_m: float | None = None
    top_m: float | None = None
    reflector: str | None = None

    @model_validator(mode="after")
    def _complete(self) -> Obstacle:
        if self.shape == "box" and self.size_m is None:
            raise ValueError("a box needs size_m; add size_m = [along x, along y]")
        if self.shape == "cylinder" and self.radius_m is None:
            raise ValueError("a cylinder needs radius_m; add radius_m")
        if self.shape != "box" and self.size_m is not None:
            raise ValueError(f'a {self.shape} obstacle takes no size_m; remove it or write shape = "box"')
        if self.shape == "moving" and (self.to_m is None or self.speed_m_per_s is None):
            raise ValueError("a moving obstacle needs to_m and speed_m_per_s; add both")
        if self.bottom_m is not None and self.top_m is not None and self.bottom_m >= self.top_m:
            raise ValueError("bottom_m is not below top_m; write z of both ends, negative below the surface")
        return self

    @property
    def still(self) -> bool:
        """Whether the obstacle stands still, except for its drift."""
        return self.shape != "moving"

    @property
    def heights(self) -> Heights:
        """Lowest and highest z of the obstacle [m]."""
        bottom, top = self.bottom_m, self.top_m
        return Heights(-inf if bottom is None else bottom, inf if top is None else top)

    @property
    def rounding(self) -> float:
        """Radius [m] of the obstacle; 0 for a box, and for a moving obstacle whose radius is that of the hull."""
        return 0.0 if self.size_m is not None else self.radius_m or 0.0

    def distance(self, point: Sequence[Any], size: Sequence[float] = (0.0, 0.0), radius: float = 0.0) -> Any:
        """Return the signed distance [m] from a point to the obstacle's surface at its start, without drift.

        With arrays of coordinates x and y, the result is an array. With `size` or `radius`, the distance is that from a
        box with these edges, or from a disc, about the point.
        """
        # a box has radius 0 and a cylinder has edge lengths 0, so one formula holds for every pair of shapes
        own = self.size_m or (0.0, 0.0)
        x, y = (np.abs(point[k] - self.centre_m[k]) - (own[k] + size[k]) / 2 for k in (0, 1))
        outside = np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0))
        return outside + np.minimum(np.maximum(x, y), 0.0) - self.rounding - radius

    def apart(self, other: Obstacle) -> float:
        """Return the signed distance [m] between two obstacles at their start; it is negative if they overlap."""
        return float(self.distance(other.centre_m, other.size_m or (0.0, 0.0), other.rounding))
