"""A study of a vehicle that fits no built-in scenario: missions scaled to it, and without sonars."""

from __future__ import annotations

from pathlib import Path

import pytest

from surctl.errors import InputError
from surctl.marine.control import build_law
from surctl.marine.study import load_plan
from surctl.marine.study.conduct import with_perception


@pytest.mark.parametrize("name", ["girona500", "lauv", "sur540-light"])
def test_a_library_vehicle_has_a_study(name: str) -> None:
    plan = load_plan(vehicle=name)
    assert plan.deciding and plan.axes and plan.vehicle.name == name
    if plan.vehicle["Fv_max"] == 0:
        assert plan.law == "steered" and "turning the hull" in plan.unheard
        assert [leg.misfit for leg in plan.legs] == [None] * 3
        assert with_perception(plan, plan.legs[0]).actuators == plan.vehicle.actuators


def test_a_study_file_of_a_craft_without_sway_force_simulates_no_sonars_either(tmp_path: Path) -> None:
    """A study file has no key that would switch the sonars off."""
    load_plan(vehicle="otter").written(tmp_path)
    mission = next(tmp_path.glob("*.toml")).name
    file = tmp_path / "tide.toml"
    file.write_text(f'kind = "study"\nname = "tide"\nvehicle = "otter"\n[[runs]]\nscenario = "{mission}"\n')
    plan = load_plan(str(file))
    assert plan.law == "steered" and "turning the hull" in plan.unheard
    assert with_perception(plan, plan.deciding[0]).actuators == plan.vehicle.actuators


def test_sonar_for_a_craft_without_sway_force_is_refused_with_the_reason() -> None:
    with pytest.raises(InputError, match="supports only truth, because the sonar map is scanned by turning the hull"):
        build_law("steered", sonar=True)
    with pytest.raises(InputError, match="has its own vehicle"):
        load_plan("default", vehicle="otter")
