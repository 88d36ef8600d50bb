"""The path of a scenario file: `path_m`, then `[[leg]]` with arcs and climbs, then `[survey]`; paths it refuses.

A leg is a straight line, or an arc through its end. An arc becomes a polyline whose chords deviate from it by at most
`arc_error_m`. The law follows this polyline, for two reasons. First, the law's equations (8)-(12) do not need the turn
rate of the path: it cancels in the derivative of the Lyapunov function, so a path that turns in small steps has the
same proof as a path that turns steadily. Second, the exported law keeps its input, an array of waypoints.

Between two depths, the path rises or sinks along the new leg at the vertical speed `climb_m_per_s`, and then keeps the
leg's depth. A leg that is too short for its change of depth is an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import asin, ceil, cos, floor, hypot, pi, radians, sin, sqrt
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from surctl.errors import InputError
from surctl.files import Strict
from surctl.marine.control.closing import CLIMB
from surctl.marine.guidance import BEND, MAX_WAYPOINTS, PASS, VISIT, Path
from surctl.marine.simulation.obstacle import Point, Positive

_ARC_ERROR = 0.001
"""Largest distance [m] between an arc and its chords, if the file does not state another (*chosen*)."""

_RISE_SPEED = 0.05
"""Vertical speed [m/s] of a change of depth, if the file does not state another: half the law's limit (*chosen*)."""

MAX_POINTS = 100_000
"""Largest number of points of a path that this module generates (*chosen*: loaded in some seconds)."""

PERIOD = 0.05  # [s] control period, in which the target point must not pass more than one waypoint

Corner = Literal["visit", "pass"]


class Leg(Strict):
    """One leg of a route: a straight line or an arc to `to_m`.

    `radius_m` and `turn` make it an arc of this radius that turns left or right; `large_arc` selects the arc of more
    than half a circle. `speed_m_per_s` and `depth_m` hold on this leg, in place of the scenario's cruise speed, and of
    the depth of the leg before. `corner` holds at the end of the leg.
    """

    to_m: Point
    radius_m: Positive | None = None
    turn: Literal["left", "right"] | None = None
    large_arc: bool = False
    speed_m_per_s: Positive | None = None
    depth_m: float | None = None
    corner: Corner | None = None

    @model_validator(mode="after")
    def _complete(self) -> Leg:
        if (self.radius_m is None) != (self.turn is None):
            raise ValueError('an arc needs radius_m and turn; write both, turn = "left" or "right", or none')
        if self.large_arc and self.radius_m is None:
            raise ValueError("a straight leg has no large arc; add radius_m and turn, or remove large_arc")
        return self


class Survey(Strict):
    """Parallel lines that cover a rectangle (kind `lawnmower`).

    The first line begins at `corner_m` and goes `length_m` towards `heading_deg` (from x towards y); the others follow
    on the side `side`, `spacing_m` apart, up to `width_m`. The ends of neighbouring lines are connected by straight
    legs (`ends` = "square") or by half circles ("round").
    """

    kind: Literal["lawnmower"]
    corner_m: Point
    length_m: Positive
    width_m: Positive
    spacing_m: Positive
    heading_deg: float = 0.0
    side: Literal["left", "right"] = "left"
    ends: Literal["square", "round"] = "square"
    speed_m_per_s: Positive | None = None
    depth_m: float | None = None
    corner: Corner | None = None

    @model_validator(mode="after")
    def _fits(self) -> Survey:
        if self.spacing_m > self.width_m:
            raise ValueError("spacing_m is larger than width_m, so there is only one line; reduce it")
        points = 2 * (self.width_m / self.spacing_m + 1)  # a float, which may be infinite
        if not points <= MAX_POINTS:
            raise ValueError(f"spacing_m gives {points:.3g} points, more than {MAX_POINTS:,}; raise it")
        return self

    def legs(self) -> list[Leg]:
        """Return the survey as legs, of which the first leads to `corner_m`."""
        lines = floor(self.width_m / self.spacing_m + 1e-9) + 1
        angle, left = radians(self.heading_deg), 1 if self.side == "left" else -1
        ahead, across = (cos(angle), sin(angle)), (-left * sin(angle), left * cos(angle))
        common = {"speed_m_per_s": self.speed_m_per_s, "depth_m": self.depth_m, "corner": self.corner}
        legs: list[Leg] = []
        for line in range(lines):
            ends = (0.0, self.length_m) if line % 2 == 0 else (self.length_m, 0.0)
            for k, along in enumerate(ends):
                x, y = (
                    round(self.corner_m[i] + along * ahead[i] + line * self.spacing_m * across[i], 9) for i in (0, 1)
                )
                arc = {}
                if k == 0 and line and self.ends == "round":
                    turn = self.side if line % 2 else ("right" if self.side == "left" else "left")
                    arc = {"radius_m": self.spacing_m / 2, "turn": turn}
                legs.append(Leg(to_m=(x, y), **common, **arc))  # type: ignore[arg-type]
        return legs


class Route(Strict):
    """The entries of a scenario file that describe its path."""

    path_m: tuple[Point, ...] = ()
    leg: tuple[Leg, ...] = ()
    survey: Survey | None = None
    arc_error_m: Positive = _ARC_ERROR
    climb_m_per_s: Annotated[float, Field(gt=0, le=CLIMB)] = _RISE_SPEED

    def path(self, *, depth: float, cruise: float, cap: float, corners: Corner) -> Path:
        """Return the path; the InputError for a mistake names the key and the remedy, but not the file.

        Args:
            depth: z of the mission [m], at which the path begins.
            cruise: speed [m/s] on legs without a speed of their own.
            cap: largest speed [m/s] that a leg may have.
            corners: what holds at corners that do not say.
        """
        listed = [(f"leg.{k}", leg) for k, leg in enumerate(self.leg)]
        points = [*self.path_m]
        if self.survey is not None:
            legs = self.survey.legs()
            if not points:
                points, legs = [legs[0].to_m], legs[1:]
            elif not self.leg and points[-1] == legs[0].to_m:
                legs = legs[1:]
            listed += [("survey", leg) for leg in legs]
        if not points:
            raise InputError(
                "is missing", key="path_m", remedy="give the start [[x, y]] and the corners, or add a [survey]"
            )
        if not listed:
            return Path(np.array(points))
        _check(listed, cap)
        return _Drawing(self, points, depth, cruise, corners).path(listed, cap)


def _check(listed: Sequence[tuple[str, Leg]], cap: float) -> None:
    for key, leg in listed:
        if leg.speed_m_per_s is not None and leg.speed_m_per_s > cap:
            problem = f"is above cap_m_per_s = {cap:g}"
            remedy = "lower it or raise the cap"
            raise InputError(problem, key=f"{key}.speed_m_per_s", value=leg.speed_m_per_s, remedy=remedy)


@dataclass
class _Row:
    place: Point
    rise: float
    speed: float
    kind: float


class _Drawing:
    """The rows of a path while legs are added to it."""

    def __init__(self, route: Route, points: Sequence[Point], depth: float, cruise: float, corners: Corner) -> None:
        self.route, self.depth, self.cruise = route, depth, cruise
        self.corner = {"visit": VISIT, "pass": PASS}
        self.usual = self.corner[corners]
        self.rows = [_Row((float(x), float(y)), 0.0, 0.0, self.usual) for x, y in points]

    def path(self, listed: Sequence[tuple[str, Leg]], cap: float) -> Path:
        for key, leg in listed:
            self._add(key, leg)
        rises, speeds, kinds = (np.array([getattr(r, n) for r in self.rows]) for n in ("rise", "speed", "kind"))
        plain = len(self.rows) <= MAX_WAYPOINTS and not rises.any() and not speeds.any()
        if plain and np.all(kinds == self.usual):
            return Path(np.array([r.place for r in self.rows]))
        return Path(np.array([r.place for r in self.rows]), rises, speeds, kinds)

    def _add(self, key: str, leg: Leg) -> None:
        start, end = self.rows[-1].place, (float(leg.to_m[0]), float(leg.to_m[1]))
        chord = hypot(end[0] - start[0], end[1] - start[1])
        if chord < 1e-6:
            problem = "is the point where the leg begins, so the leg has no length"
            remedy = "remove the leg; write a whole circle as two arcs"
            raise InputError(problem, key=f"{key}.to_m", value=list(leg.to_m), remedy=remedy)
        places = [start, end]
        if leg.radius_m is not None:
            if leg.radius_m < chord / 2 * (1 - 1e-9):
                problem = f"is too small: the ends of the leg are {chord:.4g} m apart"
                raise InputError(problem, key=f"{key}.radius_m", value=leg.radius_m, remedy=f"at least {chord / 2:.4g}")
            places = _arc(start, end, chord, leg, self.route.arc_error_m, MAX_POINTS - len(self.rows))
        rise = self.rows[-1].rise if leg.depth_m is None else leg.depth_m - self.depth
        places, rises = self._climbed(key, places, leg, rise)
        kind = self.usual if leg.corner is None else self.corner[leg.corner]
        for k, (place, height) in enumerate(zip(places[1:], rises[1:], strict=True)):
            last = k == len(places) - 2
            self.rows.append(_Row(place, height, leg.speed_m_per_s or 0.0, kind if last else BEND))

    def _climbed(self, key: str, places: list[Point], leg: Leg, rise: float) -> tuple[list[Point], list[float]]:
        """Return the leg's places and their heights, with one more place where the change of depth ends."""
        before, slowest = self.rows[-1].rise, max(leg.speed_m_per_s or self.cruise, 1e-9) * PERIOD
        speed = leg.speed_m_per_s or self.cruise
        needed = abs(rise - before) * speed / self.route.climb_m_per_s
        arcs = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(np.array(places), axis=0), axis=1))])
        if needed == 0.0:
            return places, [rise] * len(places)
        if needed > arcs[-1] + 1e-9:
            raise InputError(
                f"differs by {abs(rise - before):.4g} m from the depth before; at {self.route.climb_m_per_s:g} m/s and "
                f"a speed of {speed:g} m/s that takes {needed:.4g} m, but the leg is {arcs[-1]:.4g} m long",
                key=f"{key}.depth_m",
                value=leg.depth_m,
                remedy="make the leg longer or slower, or change the depth over several legs",
            )
        near = int(np.argmin(np.abs(arcs - needed)))
        if near == 0 or abs(arcs[near] - needed) > max(2 * slowest, 0.01):
            at = int(np.searchsorted(arcs, needed))
            share = (needed - arcs[at - 1]) / (arcs[at] - arcs[at - 1])
            (ax, ay), (bx, by) = places[at - 1], places[at]
            places = [*places[:at], (ax + share * (bx - ax), ay + share * (by - ay)), *places[at:]]
            arcs, near = np.insert(arcs, at, needed), at
        shares = np.minimum(arcs / arcs[near], 1.0)
        return places, [before + float(share) * (rise - before) if share < 1 else rise for share in shares]


def _arc(start: Point, end: Point, chord: float, leg: Leg, error: float, most: int) -> list[Point]:
    """Return the ends of the chords of an arc; all are on the arc, and no chord is further than `error` from it.

    More than `most` chords are an InputError.
    """
    radius = max(float(leg.radius_m or 0.0), chord / 2)
    half = asin(min(chord / (2 * radius), 1.0))
    turned = 2 * pi - 2 * half if leg.large_arc else 2 * half
    left = 1.0 if leg.turn == "left" else -1.0
    ahead = (end[0] - start[0]) / chord, (end[1] - start[1]) / chord
    # the centre is on the side of the turn, or on the other side if the arc is more than half a circle
    offset = left * radius * cos(half) * (-1.0 if leg.large_arc else 1.0)
    centre = (start[0] + end[0]) / 2 - ahead[1] * offset, (start[1] + end[1]) / 2 + ahead[0] * offset
    # arccos(1 - e) = 2 arcsin √(e/2), which does not lose a small e
    needed = turned / (4 * asin(sqrt(min(error / radius, 1.0) / 2)))
    if not needed <= most:
        problem = f"gives an arc of {radius:.4g} m radius {needed:.3g} points; a path has at most {MAX_POINTS:,} in all"
        raise InputError(problem, key="arc_error_m", value=error, remedy="raise it")
    count = max(ceil(needed - 1e-9), 2)
    x, y = start[0] - centre[0], start[1] - centre[1]
    places: list[Point] = [start]
    for k in range(1, count):
        angle = left * turned * k / count
        c, s = cos(angle), sin(angle)
        places.append((centre[0] + c * x - s * y, centre[1] + s * x + c * y))
    return [*places, end]
