"""Findings about smooth surfaces that answer near their normal only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import cos, pi, radians
from typing import Any

import numpy as np
import pytest

from surctl.files import read_toml
from surctl.marine.sensing import SonarArray
from surctl.marine.simulation import Finding, findings
from surctl.marine.simulation.echo_fit import echo_findings, unheard_faces
from surctl.marine.simulation.scenario import LIBRARY, Scenario, scenario_from_table
from surctl.marine.vehicle import load_vehicle

LEVEL = {"pitch_deg": 0.0, "floor_m": 0.0}  # level sonars, and no floor that the law knows


def _base() -> Scenario:
    table = read_toml(LIBRARY / "tank-static.toml") | {"sonar": LEVEL}
    return scenario_from_table(table, source="level.toml")


BASE = _base()
VEHICLE = load_vehicle(BASE.vehicle)
BESIDE_WALLS = ["OS1 -y", "OS2 +y", "OS3 -y"]


def _echoes(change: Callable[[dict[str, Any]], object], *, of: str = "tank-static") -> list[Finding]:
    """Findings about echoes of a built-in scenario after a change of its file."""
    table = read_toml(LIBRARY / f"{of}.toml")
    table.setdefault("sonar", dict(LEVEL))
    change(table)
    scenario = scenario_from_table(table, source="changed.toml")
    return echo_findings(scenario, load_vehicle(scenario.vehicle), scenario.sensors.equipment.array)


def test_only_surfaces_that_answer_near_their_normal_are_reported() -> None:
    assert not [f for f in findings(BASE, VEHICLE) if f.key.startswith("sonar.")]
    smooth = replace(BASE, sensors=BASE.sensors.hearing("webots"))
    found = [f for f in findings(smooth, VEHICLE) if f.key == "sonar.echoes"]
    assert [f.level for f in found] == ["warning", "warning", "warning"]
    assert "within 22.5° of their normal" in found[0].text
    # these boxes end 0.4 m from a side wall of the tank, less than 0.405 m, see the next test
    assert "hears OS1 -y, OS2 +y, OS3 -y: " in found[1].text


def silent_faces(scenario: Scenario, hull: float, array: SonarArray) -> list[str]:
    return [f"{box.name} {side}" for box, side in unheard_faces(scenario, replace(array, hull_radius=hull))]


@pytest.mark.parametrize("limit", [5.0, 22.5, 30.0])
def test_a_face_is_heard_as_soon_as_a_sonar_beside_it_can_look_under_it(limit: float) -> None:
    # The hull touches wall and corner, and the edge of a beam (37.5°) meets the face at the limit. The apex is then at
    # R + R cos(limit + 37.5°) from the wall, so a wider gap is heard, though the hull fits before the face only from 2R
    box, hull = BASE.obstacles[0], VEHICLE["radius"]
    assert box.size_m is not None
    least = hull + hull * cos(radians(limit + 37.5))
    for gap, expected in ((least - 0.002, ["OS1 -y"]), (least + 0.002, [])):
        moved = box.model_copy(update={"centre_m": (box.centre_m[0], gap + box.size_m[1] / 2)})
        array = replace(BASE.sensors.equipment.array, incidence_limit=radians(limit))
        assert silent_faces(replace(BASE, obstacles=(moved,)), hull, array) == expected, (limit, gap)


@pytest.mark.parametrize(("limit", "unheard"), [(22.5, BESIDE_WALLS), (30.0, []), (45.0, []), (70.0, [])])
def test_no_face_is_reported_for_which_a_random_search_finds_a_place(limit: float, unheard: list[str]) -> None:
    array = replace(BASE.sensors.equipment.array, incidence_limit=radians(limit))
    assert silent_faces(BASE, VEHICLE["radius"], array) == unheard
    found = [name for name in BESIDE_WALLS if _random_place(name, radians(limit))]
    assert not set(found) & set(unheard) and (limit < 45.0 or found == BESIDE_WALLS)


def _random_place(face: str, limit: float) -> bool:
    """Whether a random place and heading of the hull hears a face of a box that ends 0.4 m from a side wall."""
    (name, side), hull, rng, n = face.split(), VEHICLE["radius"], np.random.default_rng(0), 400_000
    box = next(o for o in BASE.obstacles if o.name == name)
    assert box.size_m is not None
    up = 1.0 if side == "+y" else -1.0
    middle = np.array([box.centre_m[0], box.centre_m[1] + up * box.size_m[1] / 2])
    wall = 5.0 if up > 0 else 0.0
    centre = np.stack([middle[0] + rng.uniform(-0.6, 0.6, n), wall - up * rng.uniform(hull, hull + 0.1, n)], axis=1)
    beyond = np.abs(centre - box.centre_m) - np.array(box.size_m) / 2
    centre = centre[np.hypot(*np.maximum(beyond, 0.0).T) >= hull]  # the other boxes are farther away
    turn = rng.uniform(-pi, pi, len(centre))
    apex = centre + hull * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    point = np.stack([middle[0] + rng.uniform(-0.5, 0.5, len(centre)) * box.size_m[0], 0 * turn + middle[1]], axis=1)
    x, y = (point - apex).T
    incidence = np.arctan2(np.abs(x), -up * y)  # above 90° behind the face
    aside = np.abs((np.arctan2(y, x) - turn + pi) % (2 * pi) - pi)
    return bool(np.any((incidence <= limit) & (aside <= radians(37.5))))


def test_where_a_sonar_is_mounted_decides_which_faces_it_hears() -> None:
    # at the end of an arm of 0.35 m that looks along the hull's side, a sonar looks under the box
    limited = replace(BASE.sensors.equipment.array, incidence_limit=pi / 8)
    arms = SonarArray(
        azimuths=(pi / 2,), mounts=((0.35, 0.0),), hull_radius=0.27, order=(0,), incidence_limit=pi / 8, cycle_limit=1.0
    )
    assert silent_faces(BASE, VEHICLE["radius"], limited) == BESIDE_WALLS
    assert silent_faces(BASE, VEHICLE["radius"], arms) == []


def test_obstacles_that_never_answer_are_named() -> None:
    def silent(table: dict[str, Any]) -> None:
        table["obstacles"][0]["reflector"] = "silent"

    (found,) = _echoes(silent, of="pool-static")
    assert (found.level, found.key) == ("warning", "reflector")
    assert found.text == "no sonar ever receives an echo of Obstacle1: the robot does not avoid it"

    def mute(table: dict[str, Any]) -> None:
        table["reflectors"] = {"mute": {"cylinder_range_m": 0.0}}
        table["obstacles"][0]["reflector"] = table["obstacles"][1]["reflector"] = "mute"

    (found,) = _echoes(mute, of="pool-static")
    assert found.text == "no sonar ever receives an echo of Obstacle1, Obstacle2: the robot does not avoid them"

    (found,) = _echoes(silent, of="pool-behind")
    assert found.text == "no sonar ever receives an echo of OM1: the robot knows of it only by the base station"

    (found,) = _echoes(silent)  # a box: not its four faces one by one, and no angle of 0°
    assert found.text == "no sonar ever receives an echo of OS1: the robot does not avoid it"


def test_obstacles_above_or_below_the_fan_of_the_sonars_have_no_findings() -> None:
    def sunk(table: dict[str, Any]) -> None:
        table["sonar"]["echoes"] = "webots"
        table["obstacles"][0]["top_m"], table["obstacles"][3]["top_m"] = -2.0, -3.0
        table["obstacles"][1]["reflector"] = "silent"

    faces, corners = [f.text for f in _echoes(sunk) if "hears" in f.text]
    assert "hears OS3 -y: " in faces and "a corner of OS3 along" in corners
    silent = [f.text for f in _echoes(sunk) if "ever receives" in f.text]
    assert silent == ["no sonar ever receives an echo of OS2: the robot does not avoid it"]


def test_a_corner_heard_too_late_to_stop_is_reported_until_the_robot_is_slow_or_its_edges_answer() -> None:
    def reported(echoes: str, **changed: object) -> list[str]:
        scenario = replace(BASE, sensors=BASE.sensors.hearing(echoes), **changed)  # type: ignore[arg-type]
        return [f.text for f in findings(scenario, VEHICLE) if "bisector" in f.text]

    (webots,), (specular,) = reported("webots"), reported("specular")
    assert "hears it 0.16 m away at best, and needs 0.46 m to stop from 0.22 m/s" in webots
    assert "corner of OS1, OS2, OS3, OS4 along its bisector touches it before any sonar can hear it" in specular
    assert not [*reported("ideal"), *reported("diffuse"), *reported("webots", cap=0.12, cruise=0.1)]
    edged = tuple(o.model_copy(update={"reflector": "specular-edges"}) for o in BASE.obstacles)
    assert not reported("specular", obstacles=edged)


@pytest.mark.parametrize("limit", [None, 45.0, 70.0])
def test_corners_that_are_heard_as_far_as_any_surface_are_not_reported(limit: float | None) -> None:
    def fast(table: dict[str, Any]) -> None:
        table["cap_m_per_s"], table["sonar"]["maximum_m"] = 0.9, 2.0
        table["sonar"] |= {} if limit is None else {"incidence_limit_deg": limit}

    assert not [f for f in _echoes(fast) if "corner" in f.text]


def _level(*, depth: float = 1.0, site: dict[str, str] | None = None, **sonar: object) -> dict[str, str]:
    def change(table: dict[str, Any]) -> None:
        table["site"] |= {"depth_m": depth, **(site or {})}
        table["sonar"] |= sonar

    return {f.key: f.text for f in _echoes(change) if f.key in ("site.surface", "site.floor")}


def test_a_floor_that_the_law_knows_is_not_reported_and_the_remedies_do_not_exclude_each_other() -> None:
    tilted: dict[str, Any] = {"echoes": "diffuse", "pitch_deg": -18.0}
    (floor,) = _level(**tilted).values()
    assert "hide obstacles; sonar.floor_m = 1 makes it known to the law: at" in floor and "hears it at 1.03 m" in floor
    assert not _level(**tilted, floor_m=1.0)
    assert _level(**tilted, floor_m=1.5)  # the law expects the echo later

    both = _level(echoes="diffuse")
    remedy = "sonar.pitch_deg below -17.5 makes it silent; then give sonar.floor_m = 1, because the floor answers: at"
    assert remedy in both["site.surface"]
    assert "hide obstacles; sonar.floor_m = 1 makes it known to the law: at" in both["site.floor"]
    silent = _level(site={"floor": "diffuse"})
    remedy = "sonar.floor_m = 1 makes it known to the law, and sonar.pitch_deg above 17.5 makes it silent: at"
    assert remedy in silent["site.floor"]


def test_the_pitch_that_is_offered_silences_a_surface_that_answers_at_any_angle() -> None:
    ideal: dict[str, Any] = {"depth": 5.0, "site": {"surface": "ideal"}}
    assert _level(**ideal)["site.surface"].startswith(
        "echoes of the water surface hide obstacles; sonar.pitch_deg below -35.6 makes it silent: "
    )
    assert _level(**ideal, pitch_deg=-35.5) and not _level(**ideal, pitch_deg=-35.7)


def test_findings_have_the_key_of_the_file_that_causes_them() -> None:
    def keys(change: Callable[[dict[str, Any]], object]) -> set[str]:
        return {f.key for f in _echoes(change)}

    assert keys(lambda table: table["sonar"].update(echoes="webots")) == {"sonar.echoes"}
    assert keys(lambda table: table["sonar"].update(incidence_limit_deg=20.0)) == {"sonar.incidence_limit_deg"}
    assert keys(lambda table: table["obstacles"][0].update(reflector="webots")) == {"reflector"}
    assert keys(lambda table: table["site"].update(walls={"x0": "silent"})) == {"site.walls"}


def test_walls_that_do_not_answer_near_their_normal_are_reported() -> None:
    def walls(kind: str) -> list[Finding]:
        return _echoes(lambda table: table["site"].update(walls=kind))

    assert not walls("specular")  # within 5° of their normal
    (found,) = walls("silent")
    assert "the walls never answer" in found.text and "within 3°" in found.text


def test_mixed_reflectors_are_told_apart_and_a_name_does_not_split_a_line() -> None:
    def mixed(table: dict[str, Any]) -> None:
        first, second, *_ = table["obstacles"]
        first["reflector"], second["reflector"] = "webots", "specular"
        table["reflectors"] = {"edges": {"incidence_limit_deg": 0.0, "edge_range_m": 0.5}}
        table["obstacles"][2]["reflector"] = "edges"
        first["name"] = "OS\n1"

    found = [f.text for f in _echoes(mixed)]
    assert found[0].startswith("some surfaces answer only within 5° or 22.5° (by their reflectors) of their normal: ")
    assert "hears OS\\n1 -y, OS2 +y: these faces answer only within 5° or 22.5°" in found[1]
    assert "hears OS3 +x, OS3 -x, OS3 +y, OS3 -y: these faces are silent" in found[2]
    assert "edges of OS3 0.5 m" in found[-1] and not [text for text in found if "\n" in text or " 0°" in text]
