"""The segment of a path that a robot is on, in NumPy: a second implementation of `follow_on`."""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, hypot, inf, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.marine.guidance import BEND, PASSED, SKIPS, VISIT, Path

_SHORT_CUT = 3.0


class PlainFollower:
    """The segment of a path that a robot is on, and the robot's progress on this segment."""

    def __init__(self, path: Path, *, visit: float | None = None) -> None:
        self._points = [(float(x), float(y)) for x, y in path.waypoints]
        kinds = [VISIT if visit is not None else 0.0] * len(self._points) if path.kinds is None else path.kinds.tolist()
        self._visit = [visit if kind == VISIT else None for kind in kinds]
        self._corner = [kind != BEND for kind in kinds]
        self._skips = SKIPS if path.fed else 1
        self._rises = [0.0] * len(self._points) if path.rises is None else path.rises.tolist()
        self.leg, self.along = 0, 0.0
        self._missed, self._before, self._nearest = 0.0, 0.0, inf  # [m²] at earlier corners, the last, the next one

    @property
    def missed(self) -> float:
        """Largest distance [m] at which a corner was passed so far; 0 before the first corner."""
        return sqrt(max(self._missed, self._before))

    @property
    def last(self) -> bool:
        """Whether the robot is on the last path segment."""
        return self.leg == len(self._points) - 2

    def move(self, x: float, y: float) -> None:
        """Update the present path segment for the robot's new position (x, y) [m] in {E}."""
        (ax, ay), (bx, by) = self._points[self.leg : self.leg + 2]
        length = hypot(bx - ax, by - ay)
        ux, uy = (bx - ax) / length, (by - ay) / length
        self.along = min(max(self.along, (x - ax) * ux + (y - ay) * uy), length)
        if self.leg:
            self._before = min(self._before, (x - ax) ** 2 + (y - ay) ** 2)
        rest = (x - ax - self.along * ux) ** 2 + (y - ay - self.along * uy) ** 2
        self._nearest = min(self._nearest, (x - bx) ** 2 + (y - by) ** 2)
        most, least, left, skips, along = _SHORT_CUT**2 * rest, rest, length - self.along, 0, 0.0
        for k in range(1, self._skips + 1):
            if self.leg + k > len(self._points) - 2:
                break
            (px, py), (qx, qy) = self._points[self.leg + k : self.leg + k + 2]
            size = hypot(qx - px, qy - py)
            vx, vy = (qx - px) / size, (qy - py) / size
            beyond = min(max((x - px) * vx + (y - py) * vy, 0.0), size)
            visit = self._visit[self.leg + k]
            if visit is not None:
                if k == 1 and (x - px) ** 2 + (y - py) ** 2 <= visit**2:
                    skips, along = 1, beyond
                break
            apart = (x - px - beyond * vx) ** 2 + (y - py - beyond * vy) ** 2
            if apart < least and (left + beyond) ** 2 <= most:
                least, skips, along = apart, k, beyond
            left = left + size
        if skips:
            self._pass(skips, x, y)
            self.leg, self.along = self.leg + skips, along

    def _pass(self, skips: int, x: float, y: float) -> None:
        missed, before = max(self._missed, self._before), self._nearest
        for k in range(1, skips + 1):
            px, py = self._points[self.leg + k]
            if k > 1:
                missed, before = max(missed, before), (x - px) ** 2 + (y - py) ** 2
            before = before if self._corner[self.leg + k] else 0.0
        self._missed, self._before, self._nearest = missed, before, inf

    def track(self, places: ArrayLike) -> NDArray[np.float64]:
        """Move the robot to each position (n, 2) [m] in turn; return the distances (n,) [m] to the path."""
        return self._over(places, self.distance)

    def rises(self, places: ArrayLike) -> NDArray[np.float64]:
        """Move the robot to each position (n, 2) [m] in turn; return the heights (n,) [m] above the mission's depth."""
        return self._over(places, lambda _x, _y: self.rise)

    def legs(self, places: ArrayLike) -> NDArray[np.float64]:
        """Move the robot to each position (n, 2) [m] in turn; return the numbers (n,) of its path segments."""
        return self._over(places, lambda _x, _y: float(self.leg))

    @property
    def rise(self) -> float:
        """Height of the path above the mission's depth [m] at the robot's progress."""
        (ax, ay), (bx, by) = self._points[self.leg : self.leg + 2]
        low, high = self._rises[self.leg : self.leg + 2]
        return low + (high - low) * (self.along / hypot(bx - ax, by - ay))

    def directions(self, places: ArrayLike) -> NDArray[np.float64]:
        """Move the robot to each position (n, 2) [m] in turn; return the directions (n,) [rad] of its path segments."""
        return self._over(places, self._direction)

    def _over(self, places: ArrayLike, figure: Callable[[float, float], float]) -> NDArray[np.float64]:
        figures = []
        for x, y in np.asarray(places, dtype=float).tolist():
            self.move(x, y)
            figures.append(figure(x, y))
        return np.array(figures)

    def _direction(self, _x: float, _y: float) -> float:
        (ax, ay), (bx, by) = self._points[self.leg : self.leg + 2]
        # past the end of a segment, which of two segments is nearer is a matter of rounding: the next one counts
        if not self.last and self.along >= hypot(bx - ax, by - ay) * PASSED:
            (ax, ay), (bx, by) = self._points[self.leg + 1 : self.leg + 3]
        return atan2(by - ay, bx - ax)

    def distance(self, x: float, y: float) -> float:
        """Return the distance [m] from (x, y) to the nearest of the previous, the present and the next path segment."""
        return min(
            _apart(self._points[k], self._points[k + 1], x, y)
            for k in range(max(self.leg - 1, 0), min(self.leg + 2, len(self._points) - 1))
        )


def _apart(a: tuple[float, float], b: tuple[float, float], x: float, y: float) -> float:
    px, py, dx, dy = x - a[0], y - a[1], b[0] - a[0], b[1] - a[1]
    t = min(max((px * dx + py * dy) / (dx * dx + dy * dy), 0.0), 1.0)
    return hypot(px - t * dx, py - t * dy)
