"""Findings of `lint` on clearance: start, target, gaps on the way, moving obstacles, hull at the water surface.

A search on a grid finds the gap: the widest path is the path whose smallest clearance is largest. It lies in the
spanning tree of the links with the largest clearances (Hu 1961, "The maximum capacity route problem"). The width of the
gap is then computed exactly from the two bodies on both sides of the gap. Obstacles may drift sinusoidally; the search
adds the drift amplitude of an obstacle to its size, so that the clearance is available at every instant of the drift.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import floor

import numpy as np
from numpy.typing import NDArray

from surctl.errors import Finding
from surctl.marine.control import Gains
from surctl.marine.control.dead_end import SLACK
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.world import BAND
from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.geometry import floating_depth, missing_buoyancy

_CELLS = 250  # grid cells along the site's diagonal; a cell is 45 mm in the tank and 14 mm in the pool

_Field = NDArray[np.float64]
_Cell = tuple[int, int]


@dataclass(frozen=True)
class Gap:
    """A gap between two bodies (obstacles or walls).

    Attributes:
        between: names of the two bodies.
        place: point (x, y) [m] in the earth frame {E} where the path crosses the gap, to within a grid cell.
        width: distance [m] between the two bodies when each obstacle is at the centre of its drift; zero or
            negative if the bodies touch or overlap.
        drift: amount [m] by which the drift of the obstacles may narrow the gap; walls do not drift.
    """

    between: tuple[str, str]
    place: tuple[float, float]
    width: float
    drift: float

    @property
    def always(self) -> float:
        """Width of the gap at the worst drift [m]."""
        return self.width - self.drift


def tightest_gap(scenario: Scenario, clearance: float, *, depth: float | None = None) -> Gap | None:
    """Return the tightest gap on the widest path from start to target; None if every gap on this path is wide enough.

    Args:
        scenario: the mission with its site and obstacles; moving obstacles are ignored.
        clearance: half the required width [m]. If the start or the target has less clearance than this, the search
            moves it along the grid to a point with enough clearance, or to a local maximum of the clearance.
        depth: z [m] of the path; default: the depth of the scenario. Obstacles that are more than `clearance` above or
            below this depth are ignored.
    """
    length, width, _ = scenario.site
    step = float(np.hypot(length, width)) / _CELLS
    xs, ys = (np.linspace(0, edge, max(2, round(edge / step)) + 1) for edge in (length, width))
    x, y = np.meshgrid(xs, ys, indexing="ij")
    z = scenario.depth if depth is None else depth
    beside = [o for o in scenario.obstacles if o.still and o.heights.crosses(z, clearance)]
    bodies = {**_walls(length, width), **{f"{o.name!r}": o for o in beside}}
    clear, second = np.partition([_always(body, (x, y)) for body in bodies.values()], 1, axis=0)[:2]
    start, target = (_uphill(clear, _cell(point, xs, ys), clearance) for point in (scenario.start, scenario.target))
    tightest = min(_widest_path(clear, start, target), key=lambda cell: (clear[cell], second[cell]))
    if clear[tightest] >= clearance + step:
        return None
    place = (float(xs[tightest[0]]), float(ys[tightest[1]]))
    one, other = _pair(bodies, place, step)
    a, b = bodies[one], bodies[other]
    return Gap((one, other), place, a.apart(b), a.drift_m + b.drift_m)


def _walls(length: float, width: float) -> dict[str, Obstacle]:
    # boxes that are much thicker than the site is long
    far = length + width
    across, along = (2 * far, 8 * far), (8 * far, 2 * far)
    places = {
        "the wall x = 0": ((-far, 0.0), across),
        f"the wall x = {length:g}": ((length + far, 0.0), across),
        "the wall y = 0": ((0.0, -far), along),
        f"the wall y = {width:g}": ((0.0, width + far), along),
    }
    return {name: Obstacle(name=name, shape="box", centre_m=at, size_m=size) for name, (at, size) in places.items()}


def _always(body: Obstacle, point: Sequence[_Field]) -> _Field:
    # distance [m] at the worst drift
    distance: _Field = body.distance(point) - body.drift_m
    return distance


def _pair(bodies: Mapping[str, Obstacle], place: tuple[float, float], step: float) -> tuple[str, str]:
    """Return the name of the body nearest to a point, and of the nearest one on the opposite side of the point."""
    slope = step / 16
    away = []
    for name, body in bodies.items():
        here, right, up = _always(body, (np.array(place) + np.array([[0, 0], [slope, 0], [0, slope]])).T)
        away.append((float(here), float(right - here), float(up - here), name))
    away.sort(key=lambda row: row[0])
    first = away[0]
    facing = [row for row in away[1:] if row[1] * first[1] + row[2] * first[2] < 0]
    return first[3], (facing or away[1:])[0][3]


def _cell(point: _Field, xs: _Field, ys: _Field) -> _Cell:
    return int(np.argmin(np.abs(xs - point[0]))), int(np.argmin(np.abs(ys - point[1])))


def _uphill(clear: _Field, cell: _Cell, clearance: float) -> _Cell:
    while clear[cell] < clearance:
        near = [(cell[0] + a, cell[1] + b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
        inside = [(i, j) for i, j in near if 0 <= i < clear.shape[0] and 0 <= j < clear.shape[1]]
        best = max(inside, key=clear.__getitem__)
        if clear[best] <= clear[cell]:
            break
        cell = best
    return cell


def _widest_path(clear: _Field, start: _Cell, target: _Cell) -> list[_Cell]:
    # from target to start; the smallest clearance on the path is as large as possible
    from scipy.sparse import coo_array  # these imports take long
    from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

    cells, flat = np.arange(clear.size).reshape(clear.shape), clear.ravel()
    one = [cells[:-1], cells[:, :-1], cells[:-1, :-1], cells[1:, :-1]]  # each cell has eight neighbours
    other = [cells[1:], cells[:, 1:], cells[1:, 1:], cells[:-1, 1:]]
    pairs = np.array([np.concatenate([part.ravel() for part in parts]) for parts in (one, other)])
    length = 1 + flat.max() - flat[pairs].min(axis=0)  # a link of length 0 would be none
    tree = minimum_spanning_tree(coo_array((length, pairs), shape=(clear.size, clear.size)))
    _, came = breadth_first_order(tree, cells[start], directed=False)
    path = [int(cells[target])]
    while path[-1] != cells[start]:
        path.append(int(came[path[-1]]))
    return [divmod(k, clear.shape[1]) for k in path]


_CLEARANCE = 0.02  # [m] two standard deviations of the base station's position: the law cannot keep less than that


def clearance_findings(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    """Return all findings about clearance: at start and target, in gaps, in the launch area, at the surface."""
    return [
        *end_findings(scenario, vehicle),
        *_drifting_together(scenario),
        *_gap(scenario, vehicle, gains),
        *_launch(scenario, vehicle),
        *_surface(scenario, vehicle),
    ]


def _met(scenario: Scenario, vehicle: Vehicle) -> list[Obstacle]:
    # a hull at a depth of the path can touch the obstacle, or passes it vertically within `_CLEARANCE`
    low, high = scenario.depth_range
    extent = vehicle["radius"] + _CLEARANCE + (high - low) / 2
    middle = scenario.depth if low == high else (low + high) / 2
    return [o for o in scenario.obstacles if o.heights.crosses(middle, extent)]


def end_findings(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Return the findings at the start and the target only, without the slow search for gaps on the way."""
    results = list(_at_walls(scenario, vehicle, _ends(scenario)))
    for obstacle in _met(scenario, vehicle):
        results += _at_still(obstacle, scenario, vehicle) if obstacle.still else _at_moving(obstacle, scenario, vehicle)
    return results


def start_findings(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Return the findings about walls at the start only."""
    return list(_at_walls(scenario, vehicle, _ends(scenario)[:1]))


def _ends(scenario: Scenario) -> list[tuple[str, NDArray[np.float64], float]]:
    # name, position, and the distance [m] at which the point counts as reached
    visited = [(f"corner ({c[0]:g}, {c[1]:g})", c, scenario.arrival_radius) for c in scenario.visited]
    return [("start", scenario.start, 0.0), *visited, ("target", scenario.target, 0.0)]


def _launch(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    # the law takes the launch area as free before its first echoes
    start = (float(scenario.start[0]), float(scenario.start[1]))
    for obstacle in _met(scenario, vehicle):
        own = vehicle["radius"] if not obstacle.still and obstacle.radius_m is None else 0.0
        clearance = obstacle.distance(start) - own - vehicle["radius"] - obstacle.drift_m
        if clearance <= 0 and obstacle.still:
            continue  # `_at_still` reports this obstacle
        if scenario.launch > 0 and clearance < scenario.launch:
            hull = f"the hull of {vehicle.name} at the start"
            text = f"obstacle {obstacle.name!r} may come within {clearance:.3f} m of {hull}"
            yield Finding("error", "launch_m", f"{text}, but launch_m declares {scenario.launch:g} m free")


def _at_walls(
    scenario: Scenario, vehicle: Vehicle, ends: list[tuple[str, NDArray[np.float64], float]]
) -> Iterator[Finding]:
    for name, point, near in ends:
        clearance = min(wall.nearest(point)[0] for wall in scenario.walls) - vehicle["radius"] + near
        if clearance < _CLEARANCE:
            where = f"{-clearance:.3f} m inside a wall" if clearance < 0 else f"only {clearance:.3f} m from a wall"
            text = f"the {vehicle['radius']:g} m hull of {vehicle.name} is {where} at the {name}"
            yield Finding("error", "path_m", text, clearance)


def _at_still(obstacle: Obstacle, scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    for name, point, near in _ends(scenario):
        clearance = obstacle.distance((float(point[0]), float(point[1]))) - vehicle["radius"] + near
        if clearance - obstacle.drift_m > 0:
            continue
        if clearance <= 0:
            what = f"obstacle {obstacle.name!r} for the hull of {vehicle.name}"
            text = f"the {name} lies {-clearance:.3f} m too close to {what}"
        else:
            text = (
                f"at the {name} the hull of {vehicle.name} is {clearance:.3f} m from obstacle {obstacle.name!r}, which "
                f"drifts by up to {obstacle.drift_m:g} m: they may touch"
            )
        yield Finding("error", f"obstacles.{obstacle.name}", text, clearance)


def _at_moving(obstacle: Obstacle, scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    key = f"obstacles.{obstacle.name}"
    contact_distance = vehicle["radius"] + (obstacle.radius_m or vehicle["radius"])
    centre, end = np.array(obstacle.centre_m), np.array(obstacle.to_m)
    clearance = float(np.linalg.norm(scenario.target - end)) - contact_distance
    if clearance > 0:
        return []
    speed = float(obstacle.speed_m_per_s or 0.0)
    when = float(np.linalg.norm(end - centre)) / speed
    if obstacle.removed:
        text = (
            f"the obstacle ends on the target and is removed at {when:.1f} s; at cruise speed the robot is there at "
            f"{scenario.duration:.1f} s, but cannot arrive while the obstacle is near"
        )
        return [Finding("warning", f"{key}.to_m", text)]
    near = f"{-clearance:.3f} m too close to the target for the hull of {vehicle.name}"
    text = f"from {when:.1f} s on the obstacle stays {near}"
    return [Finding("error", f"{key}.to_m", text)]


def _drifting_together(scenario: Scenario) -> Iterator[Finding]:
    still = [o for o in scenario.obstacles if o.still]
    for k, one in enumerate(still):
        for other in still[k + 1 :]:
            clearance, drift = one.apart(other), one.drift_m + other.drift_m
            if drift > 0 and clearance < drift and one.heights.shares(other.heights):
                pair = f"obstacles {one.name!r} and {other.name!r}"
                text = f"{pair} are {clearance:.3f} m apart and may drift into each other"
                yield Finding("warning", f"obstacles.{other.name}.drift_m", text)


def _gap(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    """Report the tightest gap on the widest passage to the target if the gap is too narrow for hull and path error.

    If a passage at another depth is wide enough, the finding is not an error but a warning that names this depth.
    """
    error = scenario.paper.position_error_m or _CLEARANCE
    hull = 2 * vehicle["radius"]
    gap = tightest_gap(scenario, hull / 2 + error)
    if gap is None or gap.always >= hull + 2 * error:
        return []
    drifts = f", {max(gap.always, 0.0):.3f} m at the worst drift" if gap.drift else ""
    text = (
        f"the widest passage to the target leads between {gap.between[0]} and {gap.between[1]} near "
        f"({gap.place[0]:.2f}, {gap.place[1]:.2f}): {max(gap.width, 0.0):.3f} m wide{drifts}; the hull of "
        f"{vehicle.name} needs {hull:.3f} m, or {hull + 2 * error:.3f} m with an error of {error:g} m on either side"
    )
    if gap.always >= hull:
        return [Finding("warning", "obstacles" if scenario.obstacles else "site", text)]
    lost = "no passage is guaranteed" if gap.width >= hull else "no passage is wide enough"
    if scenario.depths is None:
        return [Finding("error", "obstacles" if scenario.obstacles else "site", f"{lost}: {text}")]
    tried = layers(scenario, vehicle, gains)
    open_depths = [z for z in tried if _passes(scenario, hull / 2 + max(error, BAND), z, hull=hull)]
    if open_depths:
        summary = f"the target can be reached only at another depth, first at z = {open_depths[0]:.2f} m"
        return [Finding("warning", "depths_m", f"{summary}; at the path's depth {lost}: {text}")]
    listed = ", ".join(f"{z:.2f}" for z in tried) or "none fits"
    summary = f"no passage is wide enough, neither at the path's depth nor at another depth (z in m: {listed})"
    return [Finding("error", "depths_m", f"{summary}: {text}")]


def _passes(scenario: Scenario, clearance: float, z: float, *, hull: float) -> bool:
    gap = tightest_gap(scenario, clearance, depth=z)
    return gap is None or gap.always >= hull


def layers(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[float]:
    """Return the depths z [m] that the law tries in addition to the path's depth, see `control.dead_end`.

    Depths above the path come first, and the depth nearest to the path comes first among them. The list of depths is
    empty if the mission has no `depths`. The function does not consider obstacles that the echo sounders may detect on
    the way to another depth.
    """
    if scenario.depths is None:
        return []
    lowest, highest = scenario.depths
    keep, pitch = vehicle["radius"] + gains["margin"], 2 * vehicle["radius"] + gains["margin"]
    above, below = (
        max(0, floor((height + SLACK) / pitch))
        for height in (highest - keep - scenario.depth, scenario.depth - keep - lowest)
    )
    return [scenario.depth + k * pitch for k in (*range(1, above + 1), *range(-1, -below - 1, -1))]


def _surface(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    out = vehicle["radius"] + scenario.depth_range[1]
    if out <= 0 or vehicle["Fw_max"] == 0:  # a craft without heave force keeps its depth by its weight
        return
    radius, heave = vehicle["radius"], float(vehicle.thrust_range[1, 2])
    missing = missing_buoyancy(radius, scenario.depth_range[1])
    text = f"at this depth, the top of the hull is {out:.2f} m above the water surface; the model has no buoyancy"
    if missing > heave:
        sunk = floating_depth(radius, heave) if heave > 0 else -radius
        text += (
            f"; a flooded hull needs {missing:.3g} N upwards at this depth, and the heave thrust gives {heave:g} N: "
            f"unless ballast makes the hull float, the hull sinks to z = {sunk:.3f} m; use {-radius:g} m or less"
        )
    yield Finding("warning", "depth_m", text)
