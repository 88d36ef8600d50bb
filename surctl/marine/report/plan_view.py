"""Plan view of a run: path, trajectory, hulls, moving obstacles, walls and sonar beams."""

from __future__ import annotations

from dataclasses import dataclass
from math import isinf

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, PathPatch, Polygon, Rectangle, Wedge
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from surctl.marine.simulation import Body, Run
from surctl.marine.simulation.run import depth_changes
from surctl.marine.simulation.scenario import Shape
from surctl.marine.world import Box, Disc, Heights, Wall
from surctl.own_code import label
from surctl.report.theme import (
    AVOIDING,
    GOOD,
    INK,
    MUTED,
    OBSTACLE,
    ROBOT,
    dress,
    lay_out,
    legend_below,
    new_axes,
    printable,
)

INSTANT = "#6D28D9"
"""Colour that marks the instant at which sonar beams are shown."""


@dataclass(frozen=True)
class Beam:
    """The beam of one sonar in the world frame {E}, drawn as a cone whose length is the filtered range.

    Attributes:
        apex: position of the sonar (x, y) [m].
        axis: direction of the cone's axis [rad].
        half_angle: half of the cone's opening angle [rad].
        length: filtered range [m].
        echo: whether the sonar received an echo; False if it reads its maximum range.
    """

    apex: tuple[float, float]
    axis: float
    half_angle: float
    length: float
    echo: bool


def beams_at(run: Run, step: int) -> tuple[Beam, ...]:
    """Return the beams of all sonars at a control period; empty if the law uses true positions instead of sonar."""
    if run.sensing != "sonar":
        return ()
    array = run.scenario.sensors.array_on(run.vehicle["radius"])
    x, y, _, heading = run.record.eta[step]
    beams = []
    for sensor, length in enumerate(run.record.telemetry[step, run.law.telemetry_slice("ranges")].tolist()):
        at_x, at_y, axis = array.apex(sensor, position=(x, y), heading=heading)
        echo = length < array.maximum - array.resolution
        beams.append(Beam((float(at_x), float(at_y)), float(axis), array.half_angle, length, echo))
    return tuple(beams)


def beam_patch(beam: Beam) -> Wedge:
    """Return the beam as a matplotlib patch in the world frame {E} [m], filled if there is an echo, else dashed."""
    middle, half = np.rad2deg(beam.axis), np.rad2deg(beam.half_angle)
    return Wedge(
        beam.apex,
        beam.length,
        middle - half,
        middle + half,
        facecolor=INSTANT if beam.echo else "none",
        edgecolor=INSTANT,
        linestyle="-" if beam.echo else "--",
        alpha=0.22 if beam.echo else 0.45,
        linewidth=0.9,
        zorder=1.8,
    )


_SNAPSHOTS = 9  # largest number of hulls drawn along a run
_NICE = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)  # [s]
_STILL = 1e-3  # [m] an obstacle that moves less is drawn once


def describe(run: Run) -> str:
    """Describe a run in one line: scenario, vehicle, law, sensing and seed."""
    law = label(run.law.ref)
    return f"{run.scenario.name}: {run.vehicle.name}, law {law} ({run.law.mode}), {run.sensing}, seed {run.seed}"


def plot_run(run: Run, ax: Axes | None = None) -> Axes:
    """Plot the plan view of a run, x and y in the world frame {E} [m]; numbers in hulls and obstacles are times [s].

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report import plot_run
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law, gains = build_law("closed_form"), load_gains("default")
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=gains, law=law)
        >>> ax = plot_run(run)
        >>> ax.get_title("left"), ax.get_xlabel(), ax.get_ylabel()
        ('pool-behind: sur400, law closed_form (nsb), truth, seed 0', 'x in {E} [m]', 'y in {E} [m]')
    """
    length, width, _ = run.scenario.site
    alone = ax is None
    if ax is None:
        height = float(np.clip(7.6 * width / length + 1.5, 3.6, 7.6))
        ax = new_axes(9.0, height)
    draw_ground(ax, run)
    steps = _snapshots(run)
    _draw_obstacles(ax, run, steps)
    if run.sensing == "sonar":
        _draw_beams(ax, run, _closest(run))
    _draw_track(ax, run)
    for k in steps:
        _draw_hull(ax, run, k)
    _add_legend(ax, run)
    if alone:
        lay_out(ax)
    return ax


def _snapshots(run: Run) -> list[int]:
    """Return indices of control periods at round times so far apart that hulls hardly overlap, and the last index."""
    time, m = run.record.time, run.metrics
    apart = 1.4 * run.vehicle["radius"] * m.time_s / max(m.length_m, 1e-9)  # [s] to travel 0.7 diameters
    least = max(m.time_s / _SNAPSHOTS, apart)
    step = next((s for s in _NICE if s >= least), _NICE[-1])
    steps = {int(np.argmin(np.abs(time - t))) for t in np.arange(0.0, m.time_s - 0.4 * step, step)}
    return sorted(steps | {len(time) - 1})


def _closest(run: Run) -> int:
    # the sonar beams are most informative here
    positions = run.record.eta[:, :2]
    nearest = [
        min((body.shape.nearest(at)[0] for body in bodies), default=np.inf)
        for at, bodies in zip(positions, run.record.obstacles, strict=True)
    ]
    return int(np.argmin(nearest))


def draw_ground(ax: Axes, run: Run) -> None:
    """Draw the site with the solid ground around it, the path, its start and target, and where a run ended before."""
    dress(ax, title=describe(run), x="x in {E} [m]", y="y in {E} [m]")
    length, width, _ = run.scenario.site
    rim = 0.03 * max(length, width)
    frame = [(-rim, -rim), (length + rim, -rim), (length + rim, width + rim), (-rim, width + rim), (-rim, -rim)]
    water = [(0, 0), (0, width), (length, width), (length, 0), (0, 0)]
    codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY]
    solid = Outline(np.array(frame + water, dtype=float), [*codes, *codes])
    ax.add_patch(PathPatch(solid, facecolor="#E8EAED", edgecolor=MUTED, hatch="////", linewidth=0.0, zorder=0.5))
    ax.add_patch(Rectangle((0, 0), length, width, fill=False, edgecolor=INK, linewidth=1.4, zorder=0.6))
    points = run.scenario.path.waypoints
    ax.plot(points[:, 0], points[:, 1], color=INK, linestyle="--", linewidth=1.1, zorder=3)
    x, y = run.scenario.start
    ax.plot(x, y, marker="s", color=INK, markersize=6, markerfacecolor="white", zorder=5.5, linestyle="none")
    x, y = run.scenario.target
    ax.plot(x, y, marker="*", color=GOOD, markersize=13, markeredgecolor="white", zorder=5.5, linestyle="none")
    if not run.metrics.reached:
        x, y = run.record.eta[-1, :2]
        ax.plot(x, y, marker="X", color=AVOIDING, markersize=11, markeredgecolor="white", zorder=6.5, linestyle="none")
    ax.set(aspect="equal", xlim=(-rim, length + rim), ylim=(-rim, width + rim))


def body_outline(shape: Shape) -> Patch:
    """Return a disc or box as a matplotlib patch in the world frame {E} [m]; TypeError for a wall."""
    if isinstance(shape, Disc):
        return Circle((shape.center[0], shape.center[1]), shape.radius)
    if isinstance(shape, Box):
        return Polygon(box_corners(shape) + np.array(shape.center))
    raise TypeError(f"a {type(shape).__name__} is not a body in the water")


def box_corners(box: Box) -> NDArray[np.float64]:
    """Return the corners (4, 2) of a box relative to its centre, in {E} [m]."""
    c, s = np.cos(box.angle), np.sin(box.angle)
    half = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(box.size) / 2
    return np.asarray(half @ np.array([[c, s], [-s, c]]))


def body_middle(body: Body) -> NDArray[np.float64]:
    """Return the centre (2,) of a body in {E} [m]; TypeError for a wall."""
    if isinstance(body.shape, Wall):
        raise TypeError("a wall is not a body in the water")
    return np.asarray(body.shape.center, dtype=float)


def _draw_obstacles(ax: Axes, run: Run, steps: list[int]) -> None:
    # at the times of the hulls; moving obstacles are fainter earlier, drifting obstacles are outlines
    for name in dict.fromkeys(body.name for bodies in run.record.obstacles for body in bodies):
        history = {k: b for k, bodies in enumerate(run.record.obstacles) for b in bodies if b.name == name}
        middles = np.array([body_middle(body) for body in history.values()])
        travels = next(iter(history.values())).moving
        shown = [k for k in steps if k in history] or [max(history)]
        if np.ptp(middles, axis=0).max() < _STILL:
            shown = shown[-1:]
        for rank, k in enumerate(shown):
            share = (rank + 1) / len(shown)
            alpha = 0.2 + 0.55 * share if travels else 0.75
            _draw_body(ax, history[k], alpha=alpha, filled=travels or k == shown[-1])
            if travels:
                _label(ax, body_middle(history[k]), f"{run.record.time[k]:.3g}", "white", OBSTACLE)
        if travels:
            ax.plot(middles[:, 0], middles[:, 1], color=OBSTACLE, linestyle=":", linewidth=1.2, zorder=1.5)
        body = history[shown[0]]
        _name(ax, run, body, name if body.heights.whole else f"{name}, {_height_text(body.heights)}")


def _height_text(heights: Heights) -> str:
    if isinf(heights.bottom):
        return f"below z {heights.top:g} m"
    return f"above z {heights.bottom:g} m" if isinf(heights.top) else f"z {heights.bottom:g} to {heights.top:g} m"


def _draw_body(ax: Axes, body: Body, *, alpha: float, filled: bool) -> None:
    patch = body_outline(body.shape)
    patch.set(facecolor=OBSTACLE if filled else "none", edgecolor=INK, linewidth=0.8, alpha=alpha, zorder=2)
    ax.add_patch(patch)


def _name(ax: Axes, run: Run, body: Body, name: str) -> None:
    # beside the obstacle, on the side towards the middle of the site
    patch = body_outline(body.shape).get_extents()  # in data units, because the patch is not in any axes yet
    x, y = body_middle(body)
    up = y < run.scenario.site[1] / 2
    at = (x, patch.y1 if up else patch.y0)
    ax.annotate(
        printable(name), at, xytext=(0, 4 if up else -4), textcoords="offset points", ha="center", fontsize=8,
        va="bottom" if up else "top", color=INK, parse_math=False, zorder=7,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8},
    )  # fmt: skip


def _label(ax: Axes, at: NDArray[np.float64], text: str, colour: str, ground: str) -> None:
    box = {"facecolor": ground, "edgecolor": "none", "alpha": 0.8, "boxstyle": "round,pad=0.15"}
    ax.text(at[0], at[1], text, ha="center", va="center", fontsize=7, color=colour, bbox=box, zorder=6, clip_on=True)


def _draw_track(ax: Axes, run: Run) -> None:
    # the trajectory is highlighted where the law avoids
    track = run.record.eta[:, :2]
    steps = np.stack([track[:-1], track[1:]], axis=1)
    avoiding = run.telemetry("avoiding")[:-1, 0] > 0.5
    ax.add_collection(LineCollection(list(steps[~avoiding]), colors=ROBOT, linewidths=1.8, zorder=4))
    ax.add_collection(LineCollection(list(steps[avoiding]), colors=AVOIDING, linewidths=3.4, zorder=4))
    changes = depth_changes(run)
    if not changes:
        return
    elsewhere = run.telemetry("depth_reference")[:-1, 0] != run.scenario.depth
    ax.add_collection(LineCollection(list(steps[elsewhere]), colors="white", linewidths=1.2, zorder=4.2))
    for change in changes:
        below = np.array(change.place_m) - [0.0, 1.4 * run.vehicle["radius"]]
        _label(ax, below, f"to z {change.to_m:.2f}", INK, "white")


def _draw_hull(ax: Axes, run: Run, k: int) -> None:
    x, y, _, heading = run.record.eta[k]
    radius = run.vehicle["radius"]
    ax.add_patch(Circle((x, y), radius, fill=False, edgecolor=ROBOT, linewidth=1.0, zorder=4.5))
    nose = np.array([[x, y], [x, y]]) + radius * np.array([[0.55], [1.0]]) * [np.cos(heading), np.sin(heading)]
    ax.plot(nose[:, 0], nose[:, 1], color=ROBOT, linewidth=1.6, zorder=4.5)
    if 0 < k < len(run.record.time) - 1:  # start and end have their own marks
        _label(ax, np.array([x, y]), f"{run.record.time[k]:.3g}", ROBOT, "white")


def _draw_beams(ax: Axes, run: Run, k: int) -> None:
    x, y = run.record.eta[k, :2]
    length, width, _ = run.scenario.site
    water = Rectangle((0, 0), length, width, transform=ax.transData)
    for beam in map(beam_patch, beams_at(run, k)):
        ax.add_patch(beam)
        beam.set_clip_path(water)
    ax.add_patch(Circle((x, y), run.vehicle["radius"], fill=False, edgecolor=INSTANT, linewidth=1.8, zorder=4.6))
    for body in run.record.obstacles[k]:
        if body.moving:
            patch = body_outline(body.shape)
            patch.set(facecolor="none", edgecolor=INSTANT, linewidth=1.8, zorder=2.1)
            ax.add_patch(patch)


def _add_legend(ax: Axes, run: Run) -> None:
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=INK, linestyle="--", linewidth=1.1, label="path"),
        Line2D([], [], color=ROBOT, linewidth=1.8, label="trajectory"),
        Line2D([], [], color=INK, marker="s", markerfacecolor="white", linestyle="none", label="start"),
        Line2D([], [], color=GOOD, marker="*", markersize=11, linestyle="none", label="target"),
        Line2D([], [], color=ROBOT, marker="o", markerfacecolor="none", markersize=9, linestyle="none", label="hull"),
    ]
    if np.any(run.telemetry("avoiding") > 0.5):
        handles.insert(2, Line2D([], [], color=AVOIDING, linewidth=3.4, label="avoiding"))
    if any(run.record.obstacles):
        handles.append(Patch(facecolor=OBSTACLE, edgecolor=INK, alpha=0.75, label="obstacle"))
    if depth_changes(run):
        edges = [patheffects.withStroke(linewidth=3.4, foreground=AVOIDING)]
        handles.append(Line2D([], [], color="white", linewidth=1.2, path_effects=edges, label="at another depth"))
    if run.sensing == "sonar":
        instant = run.record.time[_closest(run)]
        handles.append(Patch(facecolor=INSTANT, alpha=0.35, label=f"sonar beams at {instant:g} s"))
    if not run.metrics.reached:
        why = f"stopped: {run.metrics.stopped_because}"
        handles.append(Line2D([], [], color=AVOIDING, marker="X", markersize=9, linestyle="none", label=why))
    legend_below(ax, columns=5, handles=handles)
