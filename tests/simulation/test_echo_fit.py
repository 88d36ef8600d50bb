"""Findings about smooth surfaces that answer near their normal only."""

from __future__ import annotations

from dataclasses import replace

import pytest

from surctl.simulation import findings, load_scenario
from surctl.simulation.echo_fit import silent_faces
from surctl.vehicle import load_vehicle

BASE = load_scenario("tank-static")
VEHICLE = load_vehicle(BASE.vehicle)


def test_only_surfaces_that_answer_near_their_normal_are_reported() -> None:
    assert not [f for f in findings(BASE, VEHICLE) if f.key == "sonar.incidence_limit_deg"]
    smooth = replace(BASE, sensors=BASE.sensors.hearing("webots"))
    found = [f for f in findings(smooth, VEHICLE) if f.key == "sonar.incidence_limit_deg"]
    assert [f.level for f in found] == ["warning", "warning", "warning"]
    assert "within 22.5° of their normal" in found[0].text
    # these boxes end 0.4 m from a side wall of the tank, which is less than the hull's diameter of 0.54 m
    assert "hears OS1 -y, OS2 +y, OS3 -y: " in found[1].text


@pytest.mark.parametrize(("gap", "heard"), [(0.53, False), (0.56, True)])
def test_a_face_is_heard_as_soon_as_the_hull_fits_before_it(gap: float, heard: bool) -> None:
    box = BASE.obstacles[0]
    assert box.size_m is not None
    moved = box.model_copy(update={"centre_m": (box.centre_m[0], gap + box.size_m[1] / 2)})
    scenario = replace(BASE, obstacles=(moved,), sensors=BASE.sensors.hearing("webots"))
    faces = silent_faces(scenario, VEHICLE["radius"], scenario.sensors.equipment.array)
    assert (not faces) is heard and faces in ([], ["OS1 -y"])


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
