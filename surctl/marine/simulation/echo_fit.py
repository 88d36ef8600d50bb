"""Findings of `lint` on echoes: surfaces that no sonar hears, weak echoes, surface and floor; detection range.

A smooth face reflects sound like a mirror. It returns an echo only to a sonar that looks at it within a limited angle
of its normal (`incidence_limit` of the sonar array, or of the reflector that the face has). A face is unheard if the
hull fits in no place to which the face returns an echo. Obstacles that the sonars' fan does not meet at the depths of
the path have no findings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import asin, atan2, degrees, floor, hypot, pi, radians, sqrt

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import Finding
from surctl.marine.control.beams import SURE, floor_range
from surctl.marine.sensing import INCIDENCE_LIMIT, Reflector, SonarArray, Surfaces
from surctl.marine.sensing.sonar.returns import level_range
from surctl.marine.sensing.sonar.solids import Solid, SolidBox, SolidDisc, SolidWalls
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.simulation.reflectors import ECHOES
from surctl.marine.simulation.scenario import Scenario, escaped
from surctl.marine.simulation.world import BAND
from surctl.marine.vehicle import Vehicle

_NAMED = 4  # obstacles that a text names; others are counted
_ANGLE = 1e-9  # [rad] rounding of an angle in degrees


def detection_range(scenario: Scenario) -> float:
    """Return the range [m] up to which a law with sonars takes an echo for an obstacle, at the deepest place.

    That is the longest range of the sonars, or the range from which the law takes echoes for those of the floor.
    """
    equipment = scenario.sensors.equipment
    floor = floor_range(equipment, scenario.deepest)
    return equipment.array.maximum if floor is None else max(min(equipment.array.maximum, floor), 0.0)


def _obstacle_reflectors(scenario: Scenario, array: SonarArray) -> tuple[Reflector, ...]:
    """Return the reflector of each obstacle; without an echo model, as the `incidence_limit` of `array` says."""
    surfaces = scenario.surfaces
    return (Reflector(array.incidence_limit),) * len(scenario.obstacles) if surfaces is None else surfaces.obstacles


def unanswered(scenario: Scenario) -> str:
    """Return which obstacles answer less than the law assumes, as text; empty if none does."""
    groups: dict[str, list[str]] = {}
    reflectors = _obstacle_reflectors(scenario, scenario.sensors.equipment.array)
    for obstacle, reflector in zip(scenario.obstacles, reflectors, strict=True):
        limit, curved = reflector.incidence_limit, obstacle.size_m is None
        if reflector.silent(curved=curved):
            how = "silent"
        elif limit == 0 or (curved and reflector.cylinder_range is not None):
            how = "detected with a probability"
        elif limit is not None and limit < INCIDENCE_LIMIT - _ANGLE:
            how = f"silent beyond {degrees(limit):.3g} deg of the normal"
        else:
            continue
        groups.setdefault(how, []).append(escaped(obstacle.name))
    parts = [f"{_listed(names)} {'is' if len(names) == 1 else 'are'} {how}" for how, names in groups.items()]
    return "; ".join(parts)


def _listed(names: list[str]) -> str:
    *first, last = names if len(names) <= _NAMED else [*names[:_NAMED], f"{len(names) - _NAMED} more"]
    return f"{', '.join(first)} and {last}" if first else last


Array = NDArray[np.float64]
Point = tuple[float, float]

_OVERLAP = 1e-5  # [m] by which a hull that fits may overlap an obstacle, for hulls that touch it


def _has_echo(box: Obstacle, normal: Point, *, scenario: Scenario, array: SonarArray, limit: float) -> bool:
    """Return whether the hull fits where a sonar receives an echo of the face of a box with this outward normal.

    The search goes over the point of the face, the angle of incidence, the range, and the direction of the ray in the
    beam; these determine place and heading of the hull. Other still obstacles, at their places at the start, may hide
    the face, and none may overlap the hull. `limit` is the largest angle of incidence [rad] at which the face answers,
    below π/2; 0: it is silent.
    """
    if limit <= 0:
        return False
    low, high = scenario.depth_range
    depths = (low,) if low == high else (low, 0.5 * (low + high), high)
    extent = array.hull_radius + BAND
    return any(
        _Face(box, normal, scenario=scenario, array=array, limit=limit, part=part, z=z).has_place()
        for z in depths
        if box.heights.crosses(z, extent)
        for part in _parts(array)
    )


def _parts(array: SonarArray) -> list[tuple[float, float, float]]:
    # distance of the apex from the centre [m], and ends of the beam from the direction of the apex [rad], of each kind
    parts = {}
    for i, cones in enumerate(array.cones):
        x, y = (array.hull_radius, 0.0) if array.mounts is None else array.mounts[i]
        turned = 0.0 if array.mounts is None else array.azimuths[i] - atan2(y, x)
        for offset, half in cones:
            middle = turned + offset - 2 * pi * round((turned + offset) / (2 * pi))
            part = (hypot(x, y), middle - half, middle + half)
            parts[tuple(round(value, 9) for value in part)] = part
    return list(parts.values())


class _Face:
    # the search at one depth, for one kind of sensor; points of it are rows of four numbers from 0 to 1

    def __init__(
        self,
        box: Obstacle,
        normal: Point,
        *,
        scenario: Scenario,
        array: SonarArray,
        limit: float,
        part: tuple[float, float, float],
        z: float,
    ) -> None:
        assert box.size_m is not None
        self._hull, self._maximum, self._limit, self._part = array.hull_radius, array.maximum, limit, part
        self._site, self._normal = scenario.site[:2], normal
        (nx, ny), (length, width) = normal, box.size_m
        # the face lies a little outside the box
        self._middle = (box.centre_m[0] + nx * (0.5 * length + 1e-6), box.centre_m[1] + ny * (0.5 * width + 1e-6))
        self._along = (abs(ny) * length, abs(nx) * width)
        self._near = [o for o in scenario.obstacles if o.still and o.heights.crosses(z, self._hull + BAND)]
        self._free = _free(self._near, self._site, self._maximum)
        gaps = [max(o.heights.gap(z), 0.0) for o in self._near]
        # horizontal distance that the hull, a sphere, keeps from an obstacle above or below its centre
        self._needed = [sqrt(max(self._hull**2 - gap**2, 0.0)) for gap in gaps]

    def has_place(self) -> bool:
        """Return whether the search finds a place."""
        from scipy.optimize import differential_evolution  # this import takes long

        best = differential_evolution(
            lambda points: self._overlap(points.T), [(0.0, 1.0)] * 4, vectorized=True, updating="deferred", rng=0,
            popsize=16, maxiter=300, tol=0.0, atol=_OVERLAP, init="sobol", polish=False,
            callback=lambda intermediate_result: bool(intermediate_result.fun <= _OVERLAP),
        )  # fmt: skip
        return bool(best.fun <= _OVERLAP)

    def _overlap(self, points: Array) -> Array:
        # [m] by which the hull at each place overlaps obstacles or walls
        along, turn, share, aside = points.T
        (nx, ny), (radius, first, last) = self._normal, self._part
        x, y = (self._middle[k] + (along - 0.5) * self._along[k] for k in (0, 1))
        angle = (2 * turn - 1) * self._limit
        c, s = np.cos(angle), np.sin(angle)
        ux, uy = c * nx - s * ny, s * nx + c * ny
        distance = share**2 * np.array(self._free(np.stack([x, y]), np.stack([ux, uy])))[0]
        radial = np.arctan2(-uy, -ux) - (first + aside * (last - first))
        x, y = x + distance * ux - radius * np.cos(radial), y + distance * uy - radius * np.sin(radial)
        length, width = self._site
        worst = self._hull - np.minimum.reduce([x, length - x, y, width - y])
        for obstacle, needed in zip(self._near, self._needed, strict=True):
            worst = np.maximum(worst, needed - obstacle.distance((x, y)))
        return np.asarray(worst)


def _free(obstacles: Sequence[Obstacle], site: Sequence[float], maximum: float) -> ca.Function:
    # range [m] of rays with apexes (2, n) and unit vectors (2, n) to the first obstacle or wall, at most `maximum`
    apex, ray, free = ca.SX.sym("apex", 2), ca.SX.sym("ray", 2), ca.SX(maximum)
    solids: list[Solid] = [SolidWalls(ca.SX([0.0, site[0], 0.0, site[1]]))]
    for o in obstacles:
        centre = ca.SX(o.centre_m)
        solids.append(SolidDisc(centre, ca.SX(o.rounding)) if o.size_m is None else SolidBox(centre, ca.SX(o.size_m)))
    for solid in solids:
        free = ca.fmin(free, ca.if_else(solid.holds(apex), 0.0, solid.hit(apex, ray, nothing=maximum)[0]))
    return ca.Function("free", [apex, ray], [free])


_SIDES: dict[str, Point] = {"+x": (1.0, 0.0), "-x": (-1.0, 0.0), "+y": (0.0, 1.0), "-y": (0.0, -1.0)}
# obstacles or faces that a finding names
_OBLIQUE = pi / 3  # [rad] with a larger limit, the missions arrive as if all surfaces answered (chosen)


@dataclass(frozen=True)
class _Surface:
    # an obstacle, or a wall if `obstacle` is None; `key` of the scenario file gives it its reflector
    key: str
    reflector: Reflector
    obstacle: Obstacle | None = None

    @property
    def limit(self) -> float | None:
        return self.reflector.incidence_limit

    @property
    def name(self) -> str:
        return "" if self.obstacle is None else escaped(self.obstacle.name)

    @property
    def box(self) -> bool:
        return self.obstacle is not None and self.obstacle.size_m is not None

    @property
    def silent(self) -> bool:
        # whether no part of the obstacle ever answers
        return self.reflector.silent(curved=not self.box)


def echo_findings(scenario: Scenario, vehicle: Vehicle, array: SonarArray) -> list[Finding]:
    """Return the findings about surfaces that do not answer every firing, and about echoes of surface and floor."""
    on_hull, surfaces = replace(array, hull_radius=vehicle["radius"]), scenario.surfaces
    met = _met(scenario, on_hull)
    listed = [*_oblique(scenario, met, _walls(scenario, array)), *_silent(met), *_unheard(scenario, vehicle, on_hull)]
    listed += _corners(scenario, vehicle, on_hull, met)
    if surfaces is None:
        return listed
    return [*listed, *_level(scenario, array, surfaces), *_weak(vehicle, met)]


def level_findings(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Return the findings about echoes of water surface and floor, which hide what is farther away."""
    surfaces = scenario.surfaces
    return [] if surfaces is None else [*_level(scenario, scenario.sensors.on(vehicle["radius"]).array, surfaces)]


def unheard_faces(scenario: Scenario, array: SonarArray) -> Iterator[tuple[_Surface, str]]:
    """Yield each box with a side from which no sonar receives an echo, and the name of that side."""
    for surface in _met(scenario, array):
        box, limit = surface.obstacle, surface.limit
        if box is None or not surface.box or limit is None:
            continue
        for side, normal in _SIDES.items():
            if not _has_echo(box, normal, scenario=scenario, array=array, limit=limit):
                yield surface, side


def _met(scenario: Scenario, array: SonarArray) -> list[_Surface]:
    # the obstacles that the sonars' fan meets at some depth of the path
    low, high = scenario.depth_range
    model, extent = _model_key(scenario), array.hull_radius + BAND + 0.5 * (high - low)
    return [
        _Surface(model if obstacle.reflector is None else "reflector", reflector, obstacle)
        for obstacle, reflector in zip(scenario.obstacles, _obstacle_reflectors(scenario, array), strict=True)
        if obstacle.heights.crosses(low + 0.5 * (high - low), extent)
    ]


def _walls(scenario: Scenario, array: SonarArray) -> list[_Surface]:
    surfaces, model = scenario.surfaces, _model_key(scenario)
    reflectors = (Reflector(array.incidence_limit),) * 4 if surfaces is None else surfaces.walls
    names = scenario.reflectors.walls
    return [_Surface("site.walls" if n else model, r) for n, r in zip(names, reflectors, strict=True)]


def _model_key(scenario: Scenario) -> str:
    return "sonar.echoes" if scenario.sensors.echo_model in ECHOES else "sonar.incidence_limit_deg"


def _key(surfaces: Sequence[_Surface]) -> str:
    # the key of the echo model if it concerns some of the surfaces
    return min((s.key for s in surfaces), key=lambda key: (not key.startswith("sonar."), key == "site.walls"))


def _angle(surfaces: Sequence[_Surface]) -> str:
    limits = sorted({surface.limit for surface in surfaces if surface.limit is not None})
    text = " or ".join(f"{degrees(limit):.3g}°" for limit in limits)
    return text if len(limits) < 2 else f"{text} (by their reflectors)"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")


def _oblique(scenario: Scenario, met: Sequence[_Surface], walls: Sequence[_Surface]) -> Iterator[Finding]:
    # surfaces that answer near their normal only; `_silent` names the silent obstacles
    listed = [s for s in met if s.limit is not None and 0 < s.limit < _OBLIQUE and not s.silent]
    if listed:
        listed += [wall for wall in walls if wall.limit is not None and 0 < wall.limit < _OBLIQUE]
        which = "surfaces" if len(listed) == len(met) + len(walls) else "some surfaces"
        text = (
            f"{which} answer only within {_angle(listed)} of their normal: a mark of such an obstacle lasts 9 s, and a "
            "face that never answered is not in the map; simulate many seeds before a launch"
        )
        yield Finding("warning", _key(listed), text)
    # the law knows that walls may be silent, but not near their normal
    smooth = [wall for wall in walls if wall.limit is not None and wall.limit < SURE]
    if smooth:
        turned = [wall for wall in smooth if wall.limit]
        parts = [f"answer only within {_angle(turned)} of their normal"] if turned else []
        parts += ["never answer"] if len(turned) < len(smooth) else []
        which = "the walls" if len(smooth) == len(walls) else "some walls"
        text = (
            f"{which} {' or '.join(parts)}, but the law takes a reading from beyond a wall that a beam meets within "
            f"{degrees(SURE):.3g}° of its normal for a fault of the sonar"
        )
        yield Finding("warning", _key(smooth), text)


def _silent(met: Sequence[_Surface]) -> Iterator[Finding]:
    silent = [s for s in met if s.obstacle is not None and s.silent]
    still = [s for s in silent if s.obstacle is not None and s.obstacle.still]
    moving = [s for s in silent if s not in still]
    if still:
        text = f"no sonar ever receives an echo of {_some([s.name for s in still])}: the robot does not avoid "
        yield Finding("warning", _key(still), text + ("it" if len(still) == 1 else "them"))
    if moving:
        names, pronoun = _some([s.name for s in moving]), "it" if len(moving) == 1 else "them"
        text = f"no sonar ever receives an echo of {names}: the robot knows of {pronoun} only by the base station"
        yield Finding("warning", _key(moving), text)


def _unheard(scenario: Scenario, vehicle: Vehicle, array: SonarArray) -> Iterator[Finding]:
    faces = [(box, side) for box, side in unheard_faces(scenario, array) if not box.silent]
    for mute in (False, True):
        chosen = [(box, side) for box, side in faces if (box.limit == 0) is mute]
        if chosen:
            boxes = [box for box, _ in chosen]
            why = "are silent" if mute else f"answer only within {_angle(boxes)} of their normal"
            text = (
                f"no place where the hull of {vehicle.name} fits hears "
                f"{_some([f'{box.name} {side}' for box, side in chosen])}: these faces {why}"
            )
            yield Finding("warning", _key(boxes), text)


def _corners(scenario: Scenario, vehicle: Vehicle, array: SonarArray, met: Sequence[_Surface]) -> Iterator[Finding]:
    # corners of boxes that are heard nearer than the distance in which the hull stops at full thrust
    slowing = min(vehicle["Fu_max"], vehicle["Fv_max"]) / max(vehicle["m11"], vehicle["m22"])
    stopping = scenario.cap**2 / (2 * slowing)
    late: dict[float, list[_Surface]] = {}
    for surface in met:
        if surface.box and surface.reflector.edge_range == 0 and surface.limit != 0:
            at = array.corner_range(surface.limit)
            if at < min(stopping, array.maximum):  # from 45° on, a corner is heard as far as any surface
                late.setdefault(at, []).append(surface)
    for at, boxes in late.items():
        when = f"hears it {at:.2f} m away at best" if at > 0 else "touches it before any sonar can hear it"
        text = (
            f"a hull that comes to a corner of {', '.join(box.name for box in boxes)} along its bisector {when}, and "
            f"needs {stopping:.2f} m to stop from {scenario.cap:g} m/s; only paths along the normals of the faces, "
            "slower motion or wider beams help"
        )
        yield Finding("warning", _key(boxes), text)


def _level(scenario: Scenario, array: SonarArray, surfaces: Surfaces) -> Iterator[Finding]:
    # echoes of water surface and floor, which the law takes for obstacles
    depth, known = scenario.depth, scenario.sensors.equipment.floor
    from_floor = floor_range(scenario.sensors.equipment, depth)
    gaps = {1: -depth, -1: surfaces.depth + depth}

    def distance(side: int, pitch: float) -> float | None:
        reflector, tilted = surfaces.surface if side == 1 else surfaces.floor, replace(array, pitch=pitch)
        at = level_range(tilted, reflector, side=side, gap=gaps[side])
        return None if at is None or at > array.maximum else at

    for side, name, what in ((1, "surface", "water surface"), (-1, "floor", "floor")):
        at = distance(side, array.elevation)
        if at is None or (side == -1 and from_floor is not None and from_floor <= at):
            continue
        pitch = _silencing(array, surfaces.surface if side == 1 else surfaces.floor, side=side, gap=gaps[side])
        remedy = f"sonar.pitch_deg {'below' if side == 1 else 'above'} {pitch:.3g} makes it silent"
        tilted = radians(pitch) - side * 1e-3
        within = abs(tilted) < 0.5 * array.beam_angle
        if not within:
            remedy = "a narrower beam makes it silent"
        if side == -1:
            known_text = f"sonar.floor_m = {surfaces.depth:g} makes it known to the law"
            excluded = within and distance(1, tilted) is not None
            remedy = known_text if excluded or not within else f"{known_text}, and {remedy}"
        elif within and known is None and distance(-1, tilted) is not None:
            remedy += f"; then give sonar.floor_m = {surfaces.depth:g}, because the floor answers"
        text = (
            f"echoes of the {what} hide obstacles; {remedy}: at the depth of {depth:g} m, every sonar hears it at "
            f"{at:.2f} m and takes it for an obstacle, and does not hear what is farther away"
        )
        yield Finding("warning", f"site.{name}", text)


def _silencing(array: SonarArray, reflector: Reflector, *, side: int, gap: float) -> float:
    # pitch [deg], rounded to the safe side, beyond which the steepest direction of a beam is too flat for an echo
    flat = asin(min(gap / array.maximum, 1.0))
    if reflector.incidence_limit is not None:
        flat = max(flat, 0.5 * pi - reflector.incidence_limit)
    return side * floor(10 * degrees(flat - 0.5 * array.beam_angle) + 1e-6) / 10


def _weak(vehicle: Vehicle, met: Sequence[_Surface]) -> Iterator[Finding]:
    # cylinders that answer weakly, and boxes whose edges do
    ranges: dict[str, _Surface] = {}
    for surface in met:
        reflector, obstacle = surface.reflector, surface.obstacle
        if obstacle is None or surface.silent:
            continue
        if not surface.box and reflector.cylinder_range is not None:
            radius = obstacle.radius_m or vehicle["radius"]
            ranges[f"{surface.name} {reflector.cylinder_range * (radius / 0.1) ** (1 / 3):.2g} m"] = surface
        elif surface.box and reflector.edge_range > 0:
            ranges[f"edges of {surface.name} {reflector.edge_range:.2g} m"] = surface
    if ranges:
        text = f"ahead of a sonar, half of the firings detect at these ranges: {_some(list(ranges))}"
        yield Finding("info", _key(list(ranges.values())), text)
