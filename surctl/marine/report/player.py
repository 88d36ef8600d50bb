"""Conversion of a run to frames for the player of the HTML report: all moving objects as embedded JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from surctl.marine.report.animation import frame_steps
from surctl.marine.report.film import film_pictures
from surctl.marine.report.plan_view import body_middle, box_corners
from surctl.marine.simulation import Body, Run
from surctl.marine.world import Box
from surctl.report.document import Picture, Player

__all__ = ["player", "player_frames"]

_APART = 0.1  # [s] smallest time between two frames
_LARGEST = 150_000  # [byte] largest size of the frames
_STILL = 5e-4  # [m] an obstacle that moves less has one position


def player(run: Run, still: Picture, *, film: bool = False) -> Player:
    """Return the run as a `Player` of the report; `still` is the picture shown on paper and without scripts.

    Args:
        run: the run.
        still: picture of the whole run.
        film: whether MuJoCo's pictures of the scene are shown beside the plan view.

    Raises:
        ToolMissing: `film`, but MuJoCo, or a library that renders without a screen, is not installed.
    """
    steps, pictures = film_pictures(run) if film else ([], ())
    apart, frames = _APART, player_frames(run, filmed=steps)
    while len(frames) > _LARGEST:
        apart *= 1.05 * len(frames) / _LARGEST
        frames = player_frames(run, apart=apart, filmed=steps)
    grid = _grid(run)
    words = f"Animation with a grid of {grid:g} m; below it, clearance over time. The arrow keys move the slider."
    if film:
        words += " Beside it, the scene from above, from the side and from the robot's nose (MuJoCo)."
    return Player(frames, replace(still, caption=f"{still.caption} {words}"), f"Animation. {still.alt}", pictures)


def _grid(run: Run) -> float:
    return 1.0 if max(run.scenario.site[:2]) <= 25 else 10.0


def player_frames(run: Run, *, apart: float = _APART, filmed: Sequence[int] = ()) -> str:
    """Return the frames, at least `apart` [s] from each other, as one JSON text without any `<`.

    `filmed` are the control steps of which the report has a picture of the scene.

    Lengths are in m, angles in rad, times in s, and positions in the world frame {E} unless stated otherwise; values
    that are not finite are null. The `length` of a beam is negative if the sonar reads its maximum range.
    """
    record, scenario, steps = run.record, run.scenario, frame_steps(run, apart=apart)
    frames = {
        "site": [float(side) for side in scenario.site[:2]],
        "grid": _grid(run),
        "radius": run.vehicle["radius"],
        "path": _rounded(scenario.path.waypoints, 3),
        "time": _rounded(record.time[steps], 2),
        "place": _rounded(record.eta[steps, :2], 3),
        "heading": _rounded(record.eta[steps, 3], 3),
        "speed": _rounded(np.hypot(record.nu[steps, 0], record.nu[steps, 1]), 3),
        "clearance": _rounded(record.clearance[steps], 3),
        "avoiding": [int(a) for a in run.telemetry("avoiding")[steps, 0] > 0.5],
        "closest": int(np.argmin(record.clearance[steps])),
        "obstacles": _obstacles([record.obstacles[k] for k in steps]),
        "beams": _beams(run, steps),
    }
    if filmed:
        frames["filmed"] = _rounded(record.time[list(filmed)], 2)
    # only a "<" could end the script element that contains the text
    return json.dumps(frames, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _obstacles(frames: Sequence[Sequence[Body]]) -> list[dict[str, object]]:
    # one centre per frame, or a single centre if the obstacle is fixed
    entries: list[dict[str, object]] = []
    for name in dict.fromkeys(body.name for bodies in frames for body in bodies):
        history = [next((body for body in bodies if body.name == name), None) for bodies in frames]
        first = next(body for body in history if body is not None)
        outline: dict[str, object]
        if isinstance(first.shape, Box):
            outline = {"corners": _rounded(box_corners(first.shape), 3)}
        else:
            outline = {"radius": float(getattr(first.shape, "radius", 0.0))}
        places = [None if body is None else _rounded(body_middle(body), 3) for body in history]
        middles = np.array([body_middle(body) for body in history if body is not None])
        still = len(middles) == len(history) and float(np.ptp(middles, axis=0).max()) < _STILL
        entries.append({"name": name, **outline, "at": places[:1] if still else places})
    return entries


def _beams(run: Run, steps: Sequence[int]) -> list[dict[str, object]]:
    # apex and axis in {B}; a negative length means no echo
    if run.sensing != "sonar":
        return []
    array, ranges = run.scenario.sensors.array_on(run.vehicle["radius"]), run.telemetry("ranges")[steps]
    signed = np.where(ranges < array.maximum - array.resolution, ranges, -ranges)
    entries: list[dict[str, object]] = []
    for sensor in range(array.size):
        x, y, axis = array.apex(sensor, position=np.zeros(2), heading=0.0)
        where = {"apex": _rounded(np.array([x, y]), 3), "axis": round(axis, 4), "half": round(array.half_angle, 4)}
        entries.append({**where, "length": _rounded(signed[:, sensor], 2)})
    return entries


def _rounded(values: NDArray[np.float64], digits: int) -> list[object]:
    def rounded(value: object) -> object:
        if isinstance(value, list):
            return [rounded(one) for one in value]
        return round(float(value), digits) if isinstance(value, float) and isfinite(value) else None

    return [rounded(value) for value in np.asarray(values, dtype=float).tolist()]
