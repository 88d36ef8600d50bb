"""The tables of a scenario's sensors: what they become, who fires when, and mistakes in one line."""

from __future__ import annotations

from math import degrees, pi
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.sensing import SonarArray
from surctl.marine.simulation import LIBRARY, load_scenario
from surctl.marine.simulation.safety import safety_claim
from surctl.marine.simulation.sensors import FIRING, firing_plan
from surctl.marine.vehicle import load_vehicle

POOL = (LIBRARY / "pool-behind.toml").read_text(encoding="utf-8")


def _loaded(folder: Path, table: str):
    path = folder / "scenario.toml"
    path.write_text(f"{POOL}\n{table}\n", encoding="utf-8")
    return load_scenario(str(path)).sensors


def test_tables_become_the_equipment(tmp_path: Path) -> None:
    sensors = _loaded(
        tmp_path,
        """
[sonar]
azimuths_deg = [0, 120, 240]
beam_deg = 15
scale = 0.99
bias_m = 0.02
chances = { dropout = 0.1 }
[[sonar.faults]]
sensor = 2
kind = "stuck"
start_s = 4.0
[base_station]
latency_s = 0.2
loss = 0.3
[own_state]
gaps_s = [[3.0, 5.0]]
""",
    )
    array, station, own = sensors.equipment.array, sensors.equipment.station, sensors.equipment.own
    assert array.azimuths == pytest.approx((0, 2 * pi / 3, 4 * pi / 3))
    assert array.order == (0, 1, 2)
    assert (array.beam_angle, array.scale, array.bias) == pytest.approx((pi / 12, 0.99, 0.02))
    assert sensors.chances.dropout == 0.1 and sensors.faults[0].kind == "stuck"
    assert (station.messages.latency, station.messages.loss) == (0.2, 0.3)
    assert own is not None and own.fixes.gaps == ((3.0, 5.0),)
    assert sensors.array_on(0.3).hull_radius == 0.3


def test_without_tables_it_is_the_paper_s_array_and_nothing_fails() -> None:
    sensors = load_scenario("pool-behind").sensors
    assert sensors.equipment.array == SonarArray()
    assert not sensors.faults and not any(sensors.chances.numbers)
    assert sensors.on(0.2) == sensors.equipment


def test_own_state_may_be_the_truth(tmp_path: Path) -> None:
    assert _loaded(tmp_path, "[own_state]\ntruth = true").equipment.own is None


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ("[sonar]\nbeam_deg = 200", "sonar.beam_deg"),
        ("[sonar]\nbeam = 15", "sonar.beam"),
        ("[sonar]\nfiring_period_s = 0.03", "sonar.firing_period_s"),
        ("[sonar]\nfiring_period_s = 0.02", "sonar.firing_period_s"),
        ("[sonar]\nmaximum_m = 40.0", "sonar.maximum_m"),
        ("[sonar]\nnoise_sd_m = nan", "sonar.noise_sd_m"),
        ("[sonar]\nminimum_m = 0.3\nblind_time_s = 0.001", "sonar.blind_time_s"),
        ("[sonar]\nscale = 0.2\ncalibrated_for_m_per_s = 343", "sonar.scale"),
        ('[[sonar.faults]]\nsensor = 7\nkind = "dead"', "sonar.faults.0.sensor"),
        ('[[sonar.faults]]\nsensor = 1\nkind = "deaf"', "sonar.faults.0.kind"),
        ("[sonar.chances]\ndropout = 0.7\nspike = 0.6", "sonar.chances"),
        ("[own_state]\nlatency_s = 0.03", "own_state.latency_s"),
        ("[base_station]\ngaps_s = [[5.0, 3.0]]", "base_station.gaps_s"),
        ("[base_station]\nloss = 2", "base_station.loss"),
        ("[sonar]\nsamples = 0", "sonar.samples"),
        ("[sonar]\nbits = 0\nsamples = 5", "sonar.bits"),
        ("[sonar]\nmaximum_m = 0.1", "sonar.maximum_m"),
        ("[sonar]\nminimum_m = 5", "sonar.minimum_m"),
        ("[sonar]\nnoise_sd_m = -1", "sonar.noise_sd_m"),
        ("[sonar]\nfloor_m = true", "sonar.floor_m"),
        ("[sonar]\npitch_deg = true", "sonar.pitch_deg"),
        ("[sonar]\nbits = true", "sonar.bits"),
        ("[sonar]\nazimuths_deg = [0, true]", "sonar.azimuths_deg.1"),
        ("[reflectors.x]\nincidence_limit_deg = true", "reflectors.x.incidence_limit_deg"),
    ],
)
def test_a_mistake_is_named_as_the_file_has_it(table: str, key: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        _loaded(tmp_path, table)
    assert caught.value.key == key
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize(("count", "period"), [(4, 0.025), (3, 0.025), (2, 0.05), (6, 0.0125), (8, 0.0125)])
def test_everyone_fires_once_a_cycle_in_the_array_s_order(count: int, period: float) -> None:
    order = tuple(int(k) for k in np.random.default_rng(count).permutation(count))
    array = SonarArray(azimuths=tuple(2 * pi * np.arange(count) / count), order=order, firing_period=period)
    plan = firing_plan(array)
    instants = round(array.cycle / FIRING) * 3 if count != 3 else 9
    fired = [sensor for k in range(instants) for sensor in plan.at(k)]
    assert fired == [array.order[k % count] for k in range(len(fired))]
    assert len(fired) == round(instants * FIRING / period)
    assert [plan.at(k) for k in range(plan.period)] == [plan.at(k + plan.period) for k in range(plan.period)]


@pytest.mark.parametrize(
    ("key", "value", "limit"), [("pitch_deg", 40.0, "half"), ("incidence_limit_deg", 120.0, "0 and 90;")]
)
def test_a_wrong_angle_is_stated_in_degrees(tmp_path: Path, key: str, value: float, limit: str) -> None:
    with pytest.raises(InputError, match=rf"{key} = {value}: .*{limit}.* give degrees"):
        _loaded(tmp_path, f"[sonar]\n{key} = {value}\n")


def test_a_floor_above_the_robot_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"goes down to z = -0\.15 m; give the depth .* at least 0\.15 m") as caught:
        _loaded(tmp_path, "[sonar]\nfloor_m = 0.1\n")
    assert caught.value.key == "sonar.floor_m" and str(tmp_path) in str(caught.value)


def test_by_default_the_law_knows_the_floor_of_the_site_and_hears_no_rough_water_surface(tmp_path: Path) -> None:
    for line, floor, elevation in (
        ("", 1.0, -18.0),
        ("floor_m = 0", None, -18.0),
        ("beam_deg = 30", 1.0, 0.0),
        ("beam_deg = 50\npitch_deg = 4", 1.0, 4.0),
    ):
        equipment = _loaded(tmp_path, f"[sonar]\n{line}\n").equipment
        assert equipment.floor == floor and degrees(equipment.array.elevation) == pytest.approx(elevation)


@pytest.mark.parametrize(
    ("mounts", "message"),
    [
        ("[[0.1, 0], [0, 0.27], [-0.27, 0], [0, -0.27]]", r"mounts_m = \(0.1, 0.0\): sensor 0 lies inside the hull"),
        ("[[0.27, 0], [0, 0.27], [0.27, 0], [0, -0.27]]", r"mounts_m = \(0.27, 0.0\): sensor 2 .* of 180 degrees"),
    ],
)
def test_mounts_that_a_hull_cannot_have_are_named_with_their_file(tmp_path: Path, mounts: str, message: str) -> None:
    sensors = _loaded(tmp_path, f"[sonar]\nmounts_m = {mounts}")
    with pytest.raises(InputError, match=rf"scenario\.toml: sonar\.{message}"):
        sensors.on(0.27)
    with pytest.raises(InputError, match=rf"scenario\.toml: sonar\.{message}"):
        sensors.array_on(0.27)
    mission = load_scenario(str(tmp_path / "scenario.toml"))
    boat = load_vehicle("sur540-flooded").with_values({"radius": 0.27})
    with pytest.raises(InputError, match=rf"scenario\.toml: sonar\.{message}"):
        safety_claim(mission, boat, load_gains("default"), detection=4.5)


@pytest.mark.parametrize("line", ["mounts_m = [[0.3, 0.0]]", "incidence_limit_deg = 95"])
def test_a_remedy_is_toml(tmp_path: Path, line: str) -> None:
    with pytest.raises(InputError, match="or leave the key out") as caught:
        _loaded(tmp_path, f"[sonar]\n{line}")
    assert "None" not in str(caught.value)
