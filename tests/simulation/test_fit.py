"""What a scenario's sonars cannot do, found before it is flown."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.sensing import Equipment, SonarArray
from surctl.marine.simulation import LIBRARY, findings, load_scenario, simulate
from surctl.marine.simulation.sensors import Sensors
from surctl.marine.vehicle import load_vehicle
from tests.cli.process import surctl

TANK, POOL = load_scenario("tank-static"), load_scenario("pool-static")


def _found(scenario: Any = TANK, vehicle: str = "sur540-flooded", *, spin: float | None = None, **array: Any) -> Any:
    sensors = Sensors(Equipment(array=SonarArray(**{"pitch": 0.0} | array)))
    gains = None if spin is None else load_gains("default").with_values({"spin": spin})
    every = findings(replace(scenario, sensors=sensors), load_vehicle(vehicle), gains=gains)
    return [(f.level, f.key) for f in every if f.key.startswith("sonar")]


@pytest.mark.parametrize("name", sorted(path.stem for path in LIBRARY.glob("*.toml")))
def test_nothing_is_found_in_the_built_in_scenarios(name: str) -> None:
    scenario = load_scenario(name)
    assert not [f for f in findings(scenario, load_vehicle(scenario.vehicle)) if f.key.startswith("sonar")]


def test_a_beam_narrower_than_the_turn_between_two_firings() -> None:
    # 0.218 rad/s · 0.1 s = 1.25°, and 0.6 of a narrow beam clears
    assert _found(beam_angle=2.0 * pi / 180) == [("error", "sonar.beam_deg")]
    assert _found(beam_angle=2.2 * pi / 180) == []
    assert _found(POOL, "sur400", beam_angle=4.2 * pi / 180) == [("error", "sonar.beam_deg")]  # it turns at 0.45 rad/s
    assert _found(POOL, "sur400", beam_angle=4.4 * pi / 180) == []
    assert _found(POOL, "sur400", beam_angle=4.2 * pi / 180, spin=0.4) == []


def test_an_array_whose_gap_is_shown_too_late() -> None:
    one = {"azimuths": (0.0,), "order": (0,)}
    # of a turn 2π − 75° are 41.5 s at 0.12 rad/s, and 45.3 s at 0.11; 42 s are remembered
    assert _found(spin=0.12, **one) == []
    assert _found(spin=0.11, **one) == [("error", "sonar.azimuths_deg")]
    two = {"azimuths": (0.0, pi / 4), "order": (0, 1)}
    assert _found(spin=0.09, **two) == [("error", "sonar.azimuths_deg")]
    assert _found(spin=0.09, azimuths=(0.0, pi), order=(0, 1)) == []
    assert _found(spin=0.09, azimuths=(3 * pi, 0.0), order=(0, 1)) == []  # the same, a turn further
    assert _found(POOL, "sur400", spin=0.11, **one) == [("error", "sonar.azimuths_deg")]
    assert _found(POOL, "sur400", **one) == []


def test_without_a_turn_every_direction_must_be_in_a_beam() -> None:
    assert _found(spin=0.0) == [("error", "sonar.azimuths_deg")]
    assert _found(spin=0.0, beam_angle=91 * pi / 180) == []


def test_a_range_shorter_than_the_way_to_stop() -> None:
    # 0.7 of the least thrust over the greatest mass: 0.0368 m/s²; (0.2 m/s)²/2a + 0.2 m/s · 0.5 s = 0.643 m
    assert _found(maximum=0.64) == [("error", "sonar.maximum_m")]
    assert _found(maximum=0.65) == []
    assert _found(POOL, "sur400", maximum=0.25) == []


def _file(tmp_path: Path, mounts: str) -> Path:
    text = (LIBRARY / "pool-static.toml").read_text(encoding="utf-8")
    text = text.replace("[0.25, 0.25]", "[0.5, 0.8]")  # where the larger hull fits too
    path = tmp_path / "own.toml"
    path.write_text(f"{text}\n[sonar]\nmounts_m = {mounts}\n", encoding="utf-8")
    return path


def test_a_mount_is_judged_by_the_vehicle_that_flies(tmp_path: Path) -> None:
    path = _file(tmp_path, "[[0.2, 0.0], [0.0, 0.2], [-0.2, 0.0], [0.0, -0.2]]")
    fine = surctl("lint", str(path), "--json", cwd=tmp_path)
    assert not [f for f in fine.json["findings"] if f["key"].startswith("sonar")]
    done = surctl("lint", str(path), "--vehicle", "sur540-flooded", "--json", cwd=tmp_path)
    assert done.status == 1
    (found,) = (f for f in done.json["findings"] if f["key"].startswith("sonar"))
    assert found["level"] == "error" and found["key"] == "sonar.mounts_m"
    assert "sur540-flooded" in found["text"] and "inside the hull of radius 0.27 m" in found["text"]
    with pytest.raises(InputError, match=r"sonar\.mounts_m.*inside the hull"):
        simulate(load_scenario(str(path)), load_vehicle("sur540-flooded"), gains=load_gains("default"), sensing="sonar")


def test_a_beam_that_the_hull_cuts_in_two_is_found(tmp_path: Path) -> None:
    path = _file(tmp_path, "[[-0.9, 0.0], [0.0, 0.2], [-0.2, 0.0], [0.0, -0.2]]")
    done = surctl("lint", str(path), cwd=tmp_path)
    assert done.status == 1
    assert "error: sonar.mounts_m: the hull of sur400 splits the beam of sensor 0" in done.out


def test_a_fault_of_a_sensor_that_is_not_there_is_refused(tmp_path: Path) -> None:
    path = _file(tmp_path, "[[0.2, 0.0], [0.0, 0.2], [-0.2, 0.0], [0.0, -0.2]]")
    with path.open("a", encoding="utf-8") as file:
        file.write('faults = [{ sensor = 4, kind = "dead" }]\n')
    done = surctl("lint", str(path), cwd=tmp_path)
    assert done.status == 2 and "no such sensor" in done.complaint and "0 to 3" in done.complaint


def test_a_cap_that_the_thrust_does_not_hold_is_told_by_axis() -> None:
    boat = load_vehicle("sur400").with_values({"Fu_max": 40.0, "Fv_max": 8.3})
    # X v + X2 v² = F: 1.131 m/s ahead and 0.498 m/s sideways
    fast = replace(POOL, cap=1.3)
    [told] = [f for f in findings(fast, boat) if f.key == "cap_m_per_s"]
    assert told.level == "warning" and "1.13 m/s in surge and 0.498 m/s in sway" in told.text
    assert not [f for f in findings(replace(POOL, cap=0.49), boat) if f.key == "cap_m_per_s"]


@pytest.mark.parametrize("seed", range(6))
def test_a_warning_about_the_cap_names_one_that_satisfies_it(seed: int) -> None:
    most, cruise = np.random.default_rng(seed).uniform([0.3, 0.05], [9.0, 0.4])
    boat, fast = load_vehicle("sur400").with_values({"Fv_max": most}), replace(POOL, cruise=cruise, cap=2.0)
    [told] = [f for f in findings(fast, boat) if f.key == "cap_m_per_s"]
    if told.level == "info":  # not even the cruise speed is held sideways
        assert [f for f in findings(replace(fast, cap=cruise), boat) if f.key == "cap_m_per_s"]
        return
    cap = float(told.text.rsplit("write at most ", 1)[1])
    assert told.level == "warning" and cap > cruise - 1e-3
    assert not [f for f in findings(replace(fast, cap=cap), boat) if f.key == "cap_m_per_s"]


def test_the_way_to_stop_is_that_of_surge_and_the_law_s_caution_is_told_apart() -> None:
    boat = load_vehicle("sur400").with_values({"Fu_max": 50.0, "Fv_max": 0.05})  # as a boat without sway thrust
    [told] = [f for f in findings(TANK, boat) if f.key == "sonar.maximum_m"]
    brake, reaction = (load_gains("default")[name] for name in ("brake", "reaction"))
    ahead, weak = (TANK.cruise**2 / (2 * brake * f / 50.0) + TANK.cruise * reaction for f in (50.0, 0.05))
    assert f"stops within {ahead:.2f} m by surge thrust" in told.text and ahead < 1 < 4.5 < weak
    assert f"weaker of surge and sway, 0.05 N, and needs {weak:.2f} m" in told.text
