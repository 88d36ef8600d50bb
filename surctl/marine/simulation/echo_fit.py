"""Findings about reflectors: what no sonar can hear, weak echoes, and echoes of surface and floor.

A smooth face reflects sound like a mirror. It returns an echo only to a sonar that looks at it within a limited angle
of its normal (`incidence_limit` of the sonar array, or of the reflector that the face has). A face is unheard if the
hull fits in no place to which the face returns an echo. Obstacles that the sonars' fan does not meet at the depths of
the path have no findings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import asin, degrees, floor, pi, radians

from surctl.marine.control.beams import floor_range
from surctl.marine.sensing import Reflector, SonarArray, Surfaces, level_range
from surctl.marine.simulation.column import BAND
from surctl.marine.simulation.detection import obstacle_reflectors
from surctl.marine.simulation.face_echo import has_echo
from surctl.marine.simulation.finding import Finding, escaped
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.simulation.reflectors import ECHOES
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.vehicle import Vehicle

__all__ = ["echo_findings", "silent_faces"]

Point = tuple[float, float]

_SIDES: dict[str, Point] = {"+x": (1.0, 0.0), "-x": (-1.0, 0.0), "+y": (0.0, 1.0), "-y": (0.0, -1.0)}
_NAMED = 4  # obstacles or faces that a finding names
_CLEARED = {
    "diffuse": "silence is free water: a smooth face that a beam meets obliquely is cleared from the map",
    "smooth-walls": "only walls may be silent: a smooth obstacle that a beam meets obliquely is cleared from the map",
    "smooth": "a mark of a smooth obstacle lasts 9 s, and a face that never answered is not in the map",
    "specular": "a face that never answered is not in the map",
}
_OBLIQUE = pi / 3  # [rad] with a larger limit, the missions arrive as if all surfaces answered (chosen)
_SURE = radians(3.0)  # [rad] within which known walls answer, as all laws assume but those for diffuse surfaces


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


def silent_faces(scenario: Scenario, hull: float, array: SonarArray) -> list[str]:
    """Return the faces of still boxes, as NAME with the side (`OS1 -y`), that answer at no place where the hull fits.

    Boxes that the sonars' fan does not meet at the depths of the path are left out.

    Args:
        scenario: the mission; obstacles are taken at their places at the start, without drift.
        hull: hull radius [m].
        array: the sonars; their `incidence_limit` is the largest angle [rad] from a face's normal at which it answers,
            unless the scenario gives its surfaces reflectors.
    """
    return [f"{box.name} {side}" for box, side in _unheard_faces(scenario, replace(array, hull_radius=hull))]


def _unheard_faces(scenario: Scenario, array: SonarArray) -> Iterator[tuple[_Surface, str]]:
    for surface in _met(scenario, array):
        box, limit = surface.obstacle, surface.limit
        if box is None or not surface.box or limit is None:
            continue
        for side, normal in _SIDES.items():
            if not has_echo(box, normal, scenario=scenario, array=array, limit=limit):
                yield surface, side


def _met(scenario: Scenario, array: SonarArray) -> list[_Surface]:
    # the obstacles that the sonars' fan meets at some depth of the path
    low, high = scenario.depth_range
    model, extent = _model_key(scenario), array.hull_radius + BAND + 0.5 * (high - low)
    return [
        _Surface(model if obstacle.reflector is None else "reflector", reflector, obstacle)
        for obstacle, reflector in zip(scenario.obstacles, obstacle_reflectors(scenario, array), strict=True)
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
    assumed = scenario.sensors.equipment.surface_model
    listed = [s for s in met if s.limit is not None and 0 < s.limit < _OBLIQUE and not s.silent]
    smooth = [s for s in walls if s.limit is not None and s.limit < _OBLIQUE]
    if listed:
        listed += [wall for wall in smooth if wall.limit]
        which = "surfaces" if len(listed) == len(met) + len(walls) else "some surfaces"
        text = (
            f"{which} answer only within {_angle(listed)} of their normal; with surface_model = {assumed!r}, "
            f"{_CLEARED[assumed]}; simulate many seeds before a launch"
        )
        yield Finding("warning", _key(listed), text)
        smooth = [wall for wall in smooth if not wall.limit]
    if assumed != "diffuse":  # such a law knows that walls may be silent, but not near their normal
        smooth = [wall for wall in smooth if wall.limit is not None and wall.limit < _SURE]
    if smooth:
        turned = [wall for wall in smooth if wall.limit]
        parts = [f"answer only within {_angle(turned)} of their normal"] if turned else []
        parts += ["never answer"] if len(turned) < len(smooth) else []
        which = "the walls" if len(smooth) == len(walls) else "some walls"
        text = f"{which} {' or '.join(parts)}, but with surface_model = {assumed!r} the law "
        if assumed == "diffuse":
            text += "takes a reading from beyond a known wall for a fault of the sonar; "
            text += 'surface_model = "smooth-walls" is for such walls'
        else:
            text += f"takes a reading from beyond a wall that a beam meets within {degrees(_SURE):.3g}° for a fault"
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
    faces = [(box, side) for box, side in _unheard_faces(scenario, array) if not box.silent]
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
        at = distance(side, array.pitch)
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
            f"every sonar hears the {what} at {at:.2f} m at the depth of {depth:g} m and takes it for an "
            f"obstacle: what is farther away is not heard; {remedy}"
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
