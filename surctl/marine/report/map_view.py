"""The map of a law with perception at some instants of a run, as values and in plots with the true obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.control.perception import CELLS_A_HULL
from surctl.marine.report.plan_view import body_outline, describe
from surctl.marine.sensing import LocalMap
from surctl.marine.simulation import Run
from surctl.marine.simulation.world import beside
from surctl.report.theme import AVOIDING, GOOD, INK, MUTED, OBSTACLE, ROBOT, dress, head, new_figure

__all__ = ["MapView", "map_view", "plot_map", "plot_maps"]

_COLOURS = {"unknown": "#DADCE0", "free": "#CDE7DD", "marked": AVOIDING}


@dataclass(frozen=True, eq=False, kw_only=True)
class MapView:
    """The map after one control period, with the trajectory and heading of the robot.

    Attributes:
        step: number of the control period.
        time: time [s].
        corner: (2,) position (x, y) of the corner of the map window in {E} [m].
        edge: edge length of a cell [m].
        kinds: (N, N) state of each map cell: 0 unknown, 1 known to be free, 2 marked. Row k holds the k-th cells along
            y.
        track: (k, 2) trajectory up to this period in {E} [m].
        heading: heading ψ [rad].
    """

    step: int
    time: float
    corner: NDArray[np.float64]
    edge: float
    kinds: NDArray[np.int_]
    track: NDArray[np.float64]
    heading: float


def map_view(run: Run, step: int) -> MapView:
    """Return the map of a run after one control period.

    Args:
        run: a run of a law with perception.
        step: index of the control period in the record of the run, from 0 to one less than the last.

    Raises:
        InputError: the law has no perception, or the record has no such control period.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import map_view
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission = replace(load_scenario("pool-behind"), time_limit=3.0)
        >>> run = simulate(mission, load_vehicle("sur400"), gains=load_gains("default"), sensing="sonar")
        >>> view = map_view(run, 40)
        >>> view.time, view.kinds.shape, round(view.edge, 3)
        (2.0, (48, 48), 0.05)
        >>> round(float((view.kinds == 1).sum()) * view.edge**2, 1)  # m^2 of water known to be free
        3.1
    """
    law, record = run.law, run.record
    if law.perception is None:
        raise InputError("has no map", key="law", value=law.name, remedy="use the law guarded with sensing sonar")
    if not 0 <= step < len(record.time) - 1:
        raise InputError("is not in the record", key="step", value=step, remedy=f"give 0 to {len(record.time) - 2}")
    after, known = record.law_state[step + 1], LocalMap(dt=law.dt)
    cells, corner = (after[law.state.slice(f"map_{name}")] for name in ("cells", "corner"))
    values, _, _ = known.view(cells, corner)
    edge = float(record.law_parameters[law.gains.slice("hull")][0]) / CELLS_A_HULL
    kinds = np.where(values > 0, 2, np.where(values < -known.known, 1, 0))
    track, heading = record.eta[: step + 1, :2], float(record.eta[step, 3])
    return MapView(
        step=step,
        time=float(record.time[step]),
        corner=corner * edge,
        edge=edge,
        kinds=kinds,
        track=track,
        heading=heading,
    )


def plot_map(run: Run, view: MapView, ax: Axes | None = None) -> Axes:
    """Plot one map in {E} [m] at equal scale, with cells, true obstacles and walls, path, trajectory and hull.

    Args:
        run: the run that the map belongs to.
        view: the map, from `map_view`.
        ax: axes to draw in.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import map_view, plot_map
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission = replace(load_scenario("pool-behind"), time_limit=3.0)
        >>> run = simulate(mission, load_vehicle("sur400"), gains=load_gains("default"), sensing="sonar")
        >>> ax = plot_map(run, map_view(run, 40))
        >>> ax.get_title("left"), ax.get_xlabel()
        ('2.0 s', 'x in {E} [m]')
    """
    z, radius = float(run.record.eta[view.step, 2]), run.vehicle["radius"]
    title = f"{view.time:.1f} s" + (f", z {z:.2f} m" if run.scenario.depths else "")
    ax = dress(ax or new_figure(6.4, 5.6).add_subplot(), title=title, x="x in {E} [m]", y="y in {E} [m]")
    ax.grid(visible=False)
    side = len(view.kinds)
    x, y = (start + view.edge * np.arange(side + 1) for start in view.corner)
    ax.pcolormesh(x, y, view.kinds, cmap=ListedColormap(list(_COLOURS.values())), vmin=0, vmax=2, zorder=1, alpha=0.75)
    window = Rectangle((x[0], y[0]), x[-1] - x[0], y[-1] - y[0], fill=False, edgecolor=MUTED, linewidth=0.8, zorder=2)
    ax.add_patch(window)
    length, width, _ = run.scenario.site
    ax.add_patch(Rectangle((0, 0), length, width, fill=False, edgecolor=INK, linewidth=1.6, zorder=3))
    for body in run.record.obstacles[view.step]:
        patch = body_outline(body.shape)
        patch.set(facecolor="none", edgecolor=OBSTACLE if body.moving else INK, linewidth=1.6, zorder=3)
        if body.moving:
            patch.set_linestyle("--")
        elif not beside([body], z, radius):
            patch.set_linestyle(":")
        ax.add_patch(patch)
    points = run.scenario.path.waypoints
    ax.plot(points[:, 0], points[:, 1], color=INK, linestyle=":", linewidth=1.0, zorder=2.5)
    ax.plot(view.track[:, 0], view.track[:, 1], color=ROBOT, linewidth=1.6, zorder=4)
    here = view.track[-1]
    ax.add_patch(Circle((here[0], here[1]), radius, fill=False, edgecolor=ROBOT, linewidth=1.6, zorder=4))
    nose = here + radius * np.array([[0.4], [1.0]]) * [np.cos(view.heading), np.sin(view.heading)]
    ax.plot(nose[:, 0], nose[:, 1], color=ROBOT, linewidth=1.8, zorder=4)
    ax.plot(*run.scenario.target, marker="*", color=GOOD, markersize=12, markeredgecolor="white", zorder=4.5)
    rim = 0.04 * max(length, width)
    ax.set_xlim(-rim, length + rim)
    ax.set_ylim(-rim, width + rim)
    ax.set_aspect("equal")
    return ax


def plot_maps(run: Run, views: Sequence[MapView]) -> Axes:
    """Plot several maps of one run, two per row, with one title and one legend; return the axes of the first map.

    Raises:
        InputError: `views` is empty.

    Example:
        >>> from dataclasses import replace
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import map_view, plot_maps
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission = replace(load_scenario("pool-behind"), time_limit=3.0)
        >>> run = simulate(mission, load_vehicle("sur400"), gains=load_gains("default"), sensing="sonar")
        >>> first = plot_maps(run, [map_view(run, 10), map_view(run, 50)])
        >>> [ax.get_title("left") for ax in first.figure.axes]
        ['0.5 s', '2.5 s']
    """
    if not views:
        raise InputError("is empty", key="views", remedy="give at least one map")
    length, width, _ = run.scenario.site
    columns = min(2, len(views))
    rows = -(-len(views) // columns)
    figure = new_figure(5.6 * columns, rows * (5.0 * width / length + 0.9) + 1.0)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, view in zip(axes, views, strict=False):
        plot_map(run, view, ax)
    for ax in axes[len(views) :]:
        ax.set_axis_off()
    handles: list[Patch | Line2D] = [
        Patch(facecolor=colour, edgecolor=INK, alpha=0.75, linewidth=0.6, label=f"map: {name}")
        for name, colour in _COLOURS.items()
    ]
    handles += [
        Patch(facecolor="none", edgecolor=INK, linewidth=1.6, label="true obstacle, wall"),
        Patch(facecolor="none", edgecolor=OBSTACLE, linestyle="--", linewidth=1.6, label="true moving obstacle"),
        Line2D([], [], color=ROBOT, linewidth=1.6, label="trajectory, hull"),
    ]
    if any(not body.heights.whole for body in run.record.obstacles[views[0].step]):
        passed = Patch(facecolor="none", edgecolor=INK, linestyle=":", linewidth=1.6, label="passed above or below")
        handles.append(passed)
    head(figure, describe(run), x=0.01, ha="left")
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=8.5, frameon=False)
    first: Axes = axes[0]
    return first
