"""A scenario written as a file is the same scenario."""

import tomllib
from dataclasses import replace
from math import pi, radians, ulp

import pytest

from surctl.marine.sensing import BaseStation, Delivery, Equipment, Fault, FaultChances, OwnState, SonarArray
from surctl.marine.simulation import LIBRARY, Sensors, load_scenario
from surctl.marine.simulation.scenario import scenario_from_table, scenario_table
from surctl.marine.simulation.toml_text import toml_text

LATE = Delivery(period=0.2, latency=0.15, loss=0.1, gaps=((1.0, 2.5),))
SENSORS = {
    "as the file has them": None,
    "a wide beam": Sensors(Equipment(array=SonarArray(beam_angle=radians(33.3), minimum=0.15))),
    "everything else": Sensors(
        Equipment(
            array=SonarArray(
                azimuths=tuple(radians(a) for a in (0.1, 123.4, -77.7)),
                order=(2, 0, 1),
                mounts=((0.3, 0.0), (-0.2, 0.3), (0.1, -0.4)),
                hull_radius=0.0,
                incidence_limit=radians(22.5),
                blind_time=3e-4,
                calibrated_for=1500.0,
                maximum=4.0,
                firing_period=0.0125,
                bits=10,
                samples=3,
                noise_sd=0.02,
                bias=-0.001,
                temperature=7.0,
            ),
            station=BaseStation(position_sd=0.02, velocity_sd=0.03, messages=LATE),
            own=OwnState(yaw_sd=0.02, rate_sd=0.001, fixes=LATE),
            floor=1.5,
            search_limit=45.0,
        ),
        (Fault(sensor=1, kind="delay", delay_s=0.25), Fault(sensor=0, kind="stuck", start_s=1.0, duration_s=2.0)),
        FaultChances(dropout=0.05, spike=0.01),
    ),
    "the truth": Sensors(Equipment(own=None)),
}


@pytest.mark.parametrize("sensors", SENSORS)
@pytest.mark.parametrize("name", sorted(path.stem for path in LIBRARY.glob("*.toml")))
def test_it_reads_back_the_same(name, sensors):
    scenario = load_scenario(name)
    scenario = replace(scenario, sensors=SENSORS[sensors] or scenario.sensors)
    table = tomllib.loads(toml_text(scenario_table(scenario)))
    assert repr(scenario_from_table(table, source=scenario.source)) == repr(scenario)


def test_an_angle_of_a_file_comes_back_to_the_bit_and_any_other_to_the_next_number():
    for k in range(1, 2000, 9):
        angle = k * 0.0893 * pi / 180.0
        for given, apart in ((angle, 0.0), (k * 0.0015 / 1.0000001, 2.0)):
            sonar = Sensors(Equipment(array=SonarArray(beam_angle=given)))
            table = scenario_table(replace(load_scenario("tank-static"), sensors=sonar))
            assert abs(table["sonar"]["beam_deg"] * pi / 180.0 - given) <= apart * ulp(given)


def test_heights_and_depths_are_kept():
    scenario = load_scenario("tank-static")
    ends = ({"top_m": -1.0}, {"bottom_m": -2.0}, {"bottom_m": -2.0, "top_m": -1.0}, {})
    obstacles = tuple(o.model_copy(update=end) for o, end in zip(scenario.obstacles, ends, strict=True))
    other = replace(scenario, obstacles=obstacles, depths=(-1.0, 0.0))
    again = scenario_from_table(tomllib.loads(toml_text(scenario_table(other))), source="")
    assert (again.obstacles, again.depths) == (other.obstacles, (-1.0, 0.0))
    assert "depths_m" not in scenario_table(scenario)


def test_many_sensors_and_whole_centimetres_are_written_and_read() -> None:
    table = scenario_table(load_scenario("tank-static"))
    table["sonar"] = {"azimuths_deg": [15.0 * k for k in range(24)], "cycle_limit_s": 0.6, "step_m": 0.01}
    scenario = scenario_from_table(table, source="many.toml")
    array = scenario.sensors.equipment.array
    assert array.size == 24 and array.cycle == pytest.approx(0.6) and array.top_code == 450
    again = scenario_from_table(scenario_table(scenario), source="many.toml")
    assert again.sensors.equipment.array == array
