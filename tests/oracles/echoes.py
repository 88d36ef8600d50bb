"""Echoes of a sonar in plain Python and NumPy: ranges, samples and faults of one firing.

If the incidence angle at a surface exceeds a limit, the surface reflects the sound away from the sonar, but still hides
the shapes behind it. So `nearest_echo` cannot treat the shapes one by one. Instead, the function examines a few
directions, one of which contains the nearest echo. On each face, range and incidence both increase with the distance
from the foot point, the point of the face nearest to the apex. So the nearest reflecting point of a face is its foot
point if the foot point is visible; otherwise it lies where the visible part of the face ends: at a corner of the face,
on an edge ray of the cone, or at the shadow of another shape's rim. `rays.outlook` lists the directions to these
points, and `nearest_echo` evaluates the first hit in each direction.

The directions to corners and rims are turned by 1e-9 rad past the corner or rim, which changes a range r by less than
1e-9·r·tan(limit). Shapes may touch each other. If two shapes overlap, the directions do not include the intersection of
their surfaces; if the smallest range is exactly at this intersection, the result is the next larger range.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import cos, floor, hypot, inf, isfinite, pi, sin, tan

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.sensing import Fault, FaultChances, Reflector, SonarArray, Surfaces
from surctl.marine.sensing.sonar.faults import _SLACK, LONGEST_DELAY, FaultKind, _delay_firings, _fault_end
from surctl.marine.sensing.sonar.returns import (
    _CONSTANTS,
    _LEVEL,
    _P,
    _ROUNDS,
    ECHO_KEY,
    detection_odds,
    level_range,
    rim,
)
from surctl.marine.world import Box, Disc, Shape, Vector2, Wall
from tests.oracles.rays import hit, nearest_in_cone, outlook

_TOUCHES = 1e-9  # [m] a shape that is nearer than a point by less than this does not hide it
_IN_CONE = 1e-12  # tolerance of `nearest_in_cone`


def nearest_echo(
    shapes: Iterable[Shape], apex: Vector2, axis: float, *, half_angle: float, incidence_limit: float | None = None
) -> float:
    """Return the distance [m] from `apex` to the nearest reflecting point in the cone |bearing − axis| ≤ half_angle.

    Args:
        shapes: all shapes of the scene.
        apex: (2,) [m] in {E}, position of the sonar.
        axis: bearing of the cone's axis [rad], counter-clockwise from x of {E}.
        half_angle: half the opening angle [rad], 0 ≤ half_angle < π/2.
        incidence_limit: largest angle [rad], in (0, π/2), between a surface's outward normal and the direction to the
            apex at which the surface reflects; None: every surface reflects.

    Returns:
        The distance [m]; inf if there is no echo, 0 if the apex lies inside a shape.

    Raises:
        InputError: an angle is out of range, or apex or axis is not finite.
    """
    if incidence_limit is None:
        return min((nearest_in_cone(shape, apex, axis, half_angle=half_angle) for shape in shapes), default=inf)
    _check(half_angle, incidence_limit)
    scene = list(shapes)
    return nearest_facing(scene, [cos(incidence_limit)] * len(scene), apex, axis, half_angle=half_angle)


def nearest_facing(
    shapes: Sequence[Shape], faced: Sequence[float], apex: Vector2, axis: float, *, half_angle: float
) -> float:
    """Return the distance [m] as `nearest_echo` does, for shapes that answer up to different angles of incidence.

    Args:
        shapes: all shapes of the scene.
        faced: for each shape, the least cosine of incidence at which it reflects; above 1: it only hides other shapes.
        apex: (2,) [m] in {E}, position of the sonar.
        axis: bearing of the cone's axis [rad].
        half_angle: half the opening angle [rad], 0 ≤ half_angle < π/2.
    """
    x, y = float(apex[0]), float(apex[1])
    if not isfinite(x + y + axis):
        raise InputError("apex and axis must be finite", key="apex, axis", value=(x, y, axis))
    if any(shape.foot(x, y)[0] <= 0.0 for shape in shapes):
        return 0.0
    c, s, least = cos(axis), sin(axis), cos(half_angle) - _IN_CONE
    looks = [(cos(axis + turn), sin(axis + turn)) for turn in (half_angle, -half_angle)]
    looks += [e for shape in shapes for e in outlook(shape, x, y) if e[0] * c + e[1] * s >= least]
    nearest = inf
    for ex, ey in looks:
        hits = ((*hit(shape, x, y, ex=ex, ey=ey), limit) for shape, limit in zip(shapes, faced, strict=True))
        distance, cosine, limit = min(hits, key=lambda hit: hit[:2], default=(inf, 0.0, 0.0))
        if cosine >= limit:
            nearest = min(nearest, distance)
    return nearest


def in_view(shapes: Iterable[Shape], apex: Vector2, point: Vector2) -> tuple[float, float, float]:
    """Return the distance [m] from `apex` to `point`, inf if one of the shapes hides it, and the unit vector to it."""
    x, y = float(apex[0]), float(apex[1])
    dx, dy = point[0] - x, point[1] - y
    distance = hypot(dx, dy)
    ex, ey = (dx / distance, dy / distance) if distance > 0.0 else (1.0, 0.0)
    hidden = any(hit(shape, x, y, ex=ex, ey=ey)[0] < distance - _TOUCHES for shape in shapes)
    return inf if hidden else distance, ex, ey


def box_edges(box: Box, apex: Vector2) -> list[tuple[float, float] | None]:
    """Return the four vertical edges (x, y) [m] of a box, with None for an edge that the box hides from the apex."""
    px, py = box.local(float(apex[0]), float(apex[1]))
    (hx, hy), (c, s), (cx, cy) = (0.5 * box.size[0], 0.5 * box.size[1]), (cos(box.angle), sin(box.angle)), box.center
    edges: list[tuple[float, float] | None] = []
    for along, across in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        shown = along * px > hx or across * py > hy
        qx, qy = along * hx, across * hy
        edges.append((cx + c * qx - s * qy, cy + s * qx + c * qy) if shown else None)
    return edges


def _check(half_angle: float, incidence_limit: float) -> None:
    if not 0.0 <= half_angle < pi / 2:
        raise InputError("must lie in [0, pi/2)", key="half_angle", value=half_angle, remedy="give radians")
    if not 0.0 < incidence_limit < pi / 2:
        raise InputError(
            "must lie between 0 and pi/2", key="incidence_limit", value=incidence_limit, remedy="give radians, or None"
        )


def true_range(array: SonarArray, sensor: int, *, position: Vector2, heading: float, shapes: Iterable[Shape]) -> float:
    """Return the distance [m] from a sensor's apex to the nearest reflecting point in its cones; inf if none exists.

    Args:
        array: the sonar array.
        sensor: index of the sensor.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: all reflecting shapes of the scene, at their present positions.

    Raises:
        InputError: if the sensor does not exist, or the position or heading is not finite.
    """
    x, y, axis = array.apex(sensor, position=position, heading=heading)
    if not isfinite(x + y):
        raise InputError("position and heading must be finite", key="position", value=(x, y, heading))
    scene, limit = list(shapes), array.incidence_limit
    return min(
        nearest_echo(scene, (x, y), axis + offset, half_angle=half, incidence_limit=limit)
        for offset, half in array.cones[sensor]
    )


def fire(
    array: SonarArray,
    sensor: int,
    *,
    position: Vector2,
    heading: float,
    shapes: Iterable[Shape],
    noise: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the raw samples (samples,) [m] of one firing in a scene of shapes.

    Args:
        array: the sonar array.
        sensor: index of the sensor.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: all reflecting shapes of the scene, at their present positions.
        noise: (samples,) standard normal numbers.

    Raises:
        InputError: if `true_range` raises InputError, or `noise` does not have the shape (samples,).
    """
    return firing_samples(
        array, true_range(array, sensor, position=position, heading=heading, shapes=shapes), noise=noise
    )


def firing_samples(array: SonarArray, distance: float, *, noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the raw samples (samples,) [m] of a firing whose echo comes from `distance`, in order of time.

    Each sample is scale · distance + bias + noise, limited to [lowest, maximum] and rounded to the nearest conversion
    step (for example, the minimum of 0.2 m gives the nearest code, 0.194 m). Without an echo within the maximum, every
    sample is the maximum.

    Args:
        array: the sonar array.
        distance: true range [m]; inf if there is no echo.
        noise: (samples,) standard normal numbers.

    Raises:
        InputError: if `noise` does not have the shape (samples,).
    """
    if np.shape(noise) != (array.samples,):
        raise InputError(f"has shape {np.shape(noise)}", key="noise", remedy=f"give ({array.samples},)")
    if distance > array.maximum:
        return np.full(array.samples, array.maximum)
    reading = np.clip(array.scale * distance + array.bias + array.noise_sd * noise, array.lowest, array.maximum)
    top = array.top_code
    codes: NDArray[np.float64] = np.floor(reading * top / array.maximum + 0.5)
    return codes * array.maximum / top


def certain_range(
    array: SonarArray,
    sensor: int,
    *,
    place: Sequence[float],
    heading: float,
    shapes: Sequence[tuple[Shape, Reflector]],
    surfaces: Surfaces,
) -> float:
    """Return the distance [m] to the nearest return that is detected with certainty; inf if there is none.

    Args:
        array: the sonar array.
        sensor: index of the sensor.
        place: (3,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: upright shapes of the scene, walls included, with their reflectors.
        surfaces: reflectors of water surface and floor, and the depth of the water.

    Raises:
        InputError: if the sensor does not exist, or the place or heading is not finite.
    """
    x, y, axis = array.apex(sensor, position=place, heading=heading)
    if not abs(x + y + axis) < inf:
        raise InputError("position and heading must be finite", key="place", value=(*place, heading))
    scene = [shape for shape, _ in shapes]
    faced = [reflector.faced(curved=isinstance(shape, Disc)) for shape, reflector in shapes]
    nearest = min(
        nearest_facing(scene, faced, (x, y), axis + offset, half_angle=half) for offset, half in array.cones[sensor]
    )
    levels = [(1, surfaces.surface, -place[2]), (-1, surfaces.floor, surfaces.depth + place[2])]
    levels = [level for level in levels if level_range(array, level[1], side=level[0], gap=1.0) is not None]
    if not levels:
        return nearest
    ahead = (cos(axis), sin(axis))
    for ex, ey in [ahead, *(ray for shape in scene for ray in outlook(shape, x, y))]:
        cosine = ex * ahead[0] + ey * ahead[1]
        free = min((hit(shape, x, y, ex=ex, ey=ey)[0] for shape in scene), default=inf)
        for side, reflector, gap in levels:
            rise, level = rim(array, cosine, side=side)
            if rise >= max(reflector.faced(curved=False), _LEVEL) and free * rise > max(gap, 0.0) * level:
                nearest = min(nearest, max(gap, 0.0) / rise)
    return nearest


def weak_range(
    array: SonarArray,
    sensor: int,
    *,
    position: Vector2,
    heading: float,
    bodies: Sequence[tuple[int, Shape, Reflector]],
    corners: Sequence[Vector2],
    uniform: Callable[[int], float],
) -> float:
    """Return the distance [m] to the nearest detected edge, cylinder or corner of the site; inf if there is none.

    Args:
        array: the sonar array.
        sensor: index of the sensor.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        bodies: the obstacles of the scene: number of their first echo (`echo_number`), shape, and reflector.
        corners: corners of the site that answer (with certainty), from `corner_points`.
        uniform: function that returns the random number in (0, 1) of an echo, by its number: that of the obstacle's
            first echo, plus the number of the edge.
    """
    x, y, axis = array.apex(sensor, position=position, heading=heading)
    ahead, tangent, nearest = (cos(axis), sin(axis)), tan(array.half_angle), inf
    cones = [(cos(axis + o), sin(axis + o), cos(half) - _IN_CONE) for o, half in array.cones[sensor]]
    shapes = [shape for _, shape, _ in bodies]

    def holds(ex: float, ey: float) -> bool:
        return any(ex * c + ey * s >= least for c, s, least in cones)

    for point in corners:
        distance, ex, ey = in_view(shapes, (x, y), point)
        if holds(ex, ey):
            nearest = min(nearest, distance)
    for number, shape, reflector in bodies:
        others = [other for other in shapes if other is not shape]
        if isinstance(shape, Box) and reflector.edge_range > 0:
            points, half_range, radius = box_edges(shape, (x, y)), reflector.edge_range, None
        elif isinstance(shape, Disc) and reflector.cylinder_range:
            _, px, py = shape.foot(x, y)
            points, half_range, radius = [(px, py)], reflector.cylinder_range, shape.radius
        else:
            continue
        for k, place in enumerate(points):
            if place is None:
                continue
            distance, ex, ey = in_view(others, (x, y), place)
            if not holds(ex, ey) or distance >= nearest:
                continue
            cosine = ex * ahead[0] + ey * ahead[1]
            odds = detection_odds(distance, cosine, half_range=half_range, tangent=tangent, radius=radius)
            if uniform(number + k) * odds < 1.0:
                nearest = distance
    return nearest


def corner_points(walls: Sequence[Wall], surfaces: Surfaces) -> list[tuple[float, float]]:
    """Return the corners (x, y) [m] of the site that answer from any direction; see `Surfaces.corners`."""
    return [(walls[i].point[0], walls[j].point[1]) for i, j in surfaces.corners]


def firing_block(key: NDArray[np.float64], instant: int, sensor: int) -> int:
    """Return the state of a firing, from which `echo_uniform` makes the numbers of its echoes.

    Args:
        key: (`ECHO_KEY`,) key of the run.
        instant: number of the firing instant, 0 to 6e7.
        sensor: index of the sensor that fires.
    """
    return _mixed(_mixed(instant, key, 0) + sensor, key, 1)


def echo_uniform(key: NDArray[np.float64], block: int, echo: int) -> float:
    """Return the uniform random number in (0, 1) of one echo of a firing.

    Args:
        key: (`ECHO_KEY`,) key of the run.
        block: state of the firing, from `firing_block`.
        echo: number of the echo, 0 to 2^22.
    """
    return (_mixed(block + echo, key, 2) + 0.5) / _P


def _mixed(x: int, key: NDArray[np.float64], counter: int) -> int:
    for k in range(counter * _ROUNDS, (counter + 1) * _ROUNDS):
        x = pow(x + int(key[k % ECHO_KEY]) + _CONSTANTS[k], 3, _P)
    return x


@dataclass(frozen=True, eq=False)
class FaultState:
    """The samples of earlier firings; under some faults, these samples arrive again.

    Attributes:
        last: (n, samples) samples that arrived last from each sensor [m]; the maximum until samples arrive.
        history: (n, `LONGEST_DELAY`, samples) fault-free samples of each sensor's last firings, newest first [m].
    """

    last: NDArray[np.float64]
    history: NDArray[np.float64]


def fault_state(array: SonarArray) -> FaultState:
    """Return the fault state before the first firing."""
    n, samples = array.size, array.samples
    return FaultState(np.full((n, samples), array.maximum), np.full((n, LONGEST_DELAY, samples), array.maximum))


def faulty(
    array: SonarArray,
    state: FaultState,
    sensor: int,
    *,
    time: float,
    distance: float,
    noise: NDArray[np.float64],
    faults: Sequence[Fault] = (),
    chances: FaultChances | None = None,
    uniforms: Sequence[float] | NDArray[np.float64] = (0.5, 0.5),
) -> tuple[NDArray[np.float64] | None, FaultState]:
    """Return the samples (samples,) [m] that arrive from a firing, or None if none arrive, and the next fault state.

    If no fault acts on the firing, the samples are those of `firing_samples` for `distance`. The function assumes that
    every sensor fires once per cycle.

    Args:
        array: the sonar array.
        state: fault state, from `fault_state` or from the result for the previous firing.
        sensor: index of the sensor that fires.
        time: time of the firing [s].
        distance: range to the nearest reflecting point [m], from `true_range`.
        noise: (samples,) standard normal numbers.
        faults: scheduled faults, checked by `check_faults`; if several faults are active at a firing, the first fault
            in the sequence acts.
        chances: probabilities of random faults, which may occur if no scheduled fault is active.
        uniforms: two numbers in (0, 1); the first selects the random fault, the second gives the value of a spike.

    Raises:
        InputError: if `noise` does not have the shape (samples,).
    """
    own = firing_samples(array, distance, noise=noise)
    active = next((f for f in faults if f.sensor == sensor and _acts(array, f, time)), None)
    kind = active.kind if active else strikes(chances, uniforms[0]) if chances else None
    samples: NDArray[np.float64] | None = own
    if kind in ("dropout", "dead"):
        samples = None
    elif kind == "stuck":
        samples = state.last[sensor]
    elif kind == "zero":
        samples = np.zeros(array.samples)
    elif kind == "maximum":
        samples = np.full(array.samples, array.maximum)
    elif kind == "spike":
        samples = np.full(array.samples, _spike(array, uniforms[1]))
    elif kind == "second_echo":
        samples = firing_samples(array, 2.0 * distance, noise=noise)
    elif kind == "crosstalk":
        samples = state.last[array.order[array.order.index(sensor) - 1]]
    elif kind == "delay" and active is not None:
        m = _delay_firings(array, active)
        began = time - m * array.cycle >= active.start_s - _SLACK
        samples = state.history[sensor, m - 1] if began else None
    last, history = state.last.copy(), state.history.copy()
    history[sensor] = np.vstack((own, history[sensor, :-1]))
    if samples is not None:
        last[sensor] = samples
    return samples, FaultState(last, history)


def strikes(chances: FaultChances, uniform: float) -> FaultKind | None:
    """Return the kind of random fault that a uniform random number in (0, 1) selects; None if no fault occurs."""
    passed = 0.0
    for kind, chance in zip(chances.kinds(), chances.numbers, strict=True):
        passed += chance
        if uniform < passed:
            return kind
    return None


def _acts(array: SonarArray, fault: Fault, time: float) -> bool:
    return fault.start_s - _SLACK <= time < _fault_end(array, fault) - _SLACK


def _spike(array: SonarArray, uniform: float) -> float:
    # from the lowest reading to the maximum, rounded to a conversion step
    value, top = array.lowest + uniform * (array.maximum - array.lowest), array.top_code
    return floor(value * top / array.maximum + 0.5) * array.maximum / top
