"""Plan view of the certified tube of a mission."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from surctl.marine.verification.mission import tube_radii
from surctl.report.theme import GOOD, INK, dress, legend_below, new_axes

_TUBE = "#BFDCF0"


def plot_mission(document: Mapping[str, Any]) -> Axes:
    """Plot the path of a mission certificate and the discs around the target that contain the robot, x and y in m.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import plot_mission
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.mission import mission_claim, prove_mission
        >>> from surctl.marine.verification.region import region_statement
        >>> scenario, region = load_scenario("tank-speed-015"), region_statement("region-turning-20-scale")
        >>> vehicle, gains, speeds = load_vehicle("sur540-flooded"), load_gains("default"), dict(cruise=0.15, cap=0.22)
        >>> claim = mission_claim(scenario, vehicle, gains, region, at_rest=False, **speeds)
        >>> ax = plot_mission(prove_mission(claim, attempts=8).certificate())
        >>> ax.get_title("left")
        'mission-tank-speed-015: certified tube'
    """
    legs, motion = tube_radii(document, 161), document["claim"]["motion"]
    places = np.concatenate(legs)
    rim = 1.1 * float(places[:, 2].max())
    low, high = places[:, :2].min(axis=0) - rim, places[:, :2].max(axis=0) + rim
    width, height = high - low
    ax = new_axes(9.0, float(np.clip(7.6 * height / width + 1.5, 2.3, 7.6)))
    dress(ax, title=f"{document['claim']['name']}: certified tube", x="x in {E} [m]", y="y in {E} [m]")
    discs = [Circle((x, y), radius) for x, y, radius in places]  # opaque, so that their union has one colour
    ax.add_collection(PatchCollection(discs, facecolor=_TUBE, edgecolor="none", zorder=1.1))
    path = np.array(document["claim"]["path_m"])
    ax.plot(path[:, 0], path[:, 1], color=INK, linestyle="--", linewidth=1.1, zorder=3)
    ax.plot(*path[0], marker="s", color=INK, markersize=6, markerfacecolor="white", zorder=4, linestyle="none")
    ax.add_patch(Circle(path[-1], motion["goal_m"], fill=False, edgecolor=GOOD, linewidth=1.6, zorder=4))
    ax.set_aspect("equal")
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=INK, linestyle="--", linewidth=1.1, label="path"),
        Line2D([], [], color=INK, marker="s", markerfacecolor="white", linestyle="none", label="start"),
        Patch(facecolor=_TUBE, label=f"tube: robot within {max(motion['tube_m']):.3g} m of the path"),
        Line2D([], [], color=GOOD, label=f"robot within {motion['goal_m']:.3g} m when the target reaches the end"),
    ]
    legend_below(ax, columns=2, handles=handles)
    return ax
