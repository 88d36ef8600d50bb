"""Sensors and their faults from the command line: what is read, what is flown, and what a mistake is told in."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.cli.sensor_options import SensorOptions, parse_chances, parse_fault
from surctl.marine.sensing import Equipment, Fault, FaultChances, OwnState, SonarArray
from surctl.marine.simulation import load_scenario
from surctl.marine.simulation.scenario import LIBRARY
from surctl.marine.simulation.sensors import Sensors
from tests.cli.process import surctl, surctl_here

SONAR = ["simulate", "pool-behind", "--sensing", "sonar"]

FAULTS = {
    "dead:1": Fault(sensor=1, kind="dead"),
    "stuck:0:5": Fault(sensor=0, kind="stuck", start_s=5.0),
    "second_echo:2:0.5:3": Fault(sensor=2, kind="second_echo", start_s=0.5, duration_s=3.0),
    "delay=0.4:3": Fault(sensor=3, kind="delay", delay_s=0.4),
    "delay=0.1:0:1:2": Fault(sensor=0, kind="delay", delay_s=0.1, start_s=1.0, duration_s=2.0),
}


@pytest.mark.parametrize("text", FAULTS)
def test_a_fault_is_read(text: str) -> None:
    assert parse_fault(text) == FAULTS[text]


def test_chances_are_read() -> None:
    assert parse_chances(["dropout=0.1", "spike=5e-2"]) == FaultChances(dropout=0.1, spike=0.05)
    assert parse_chances(["dropout=0.9", "spike=0.1"]).numbers[:1] == (0.9,)


@settings(max_examples=20)
@given(st.text(max_size=20), st.sampled_from(["", "dead:", "stuck:0:", "delay=", "delay=0.4:0:", "dropout="]))
def test_no_text_ends_otherwise_than_read_or_refused(text: str, head: str) -> None:
    for parse in (parse_fault, lambda t: parse_chances([t])):
        try:
            parse(head + text)
        except InputError as error:
            assert error.remedy and str(error).startswith("--") and "\n" not in str(error)


def test_what_is_given_replaces_and_the_rest_stays() -> None:
    own, array = OwnState(yaw_sd=0.02), SonarArray(bits=10)
    sensors = Sensors(
        Equipment(array=array, own=own), faults=(FAULTS["dead:1"],), chances=FaultChances(zero=0.1, spike=0.1)
    )
    scenario = replace(load_scenario("pool-behind"), sensors=sensors)
    assert SensorOptions().over(scenario) == scenario
    told = SensorOptions(faults=["stuck:0:5", "delay=0.4:3"]).over(scenario).sensors
    assert told == replace(sensors, faults=(FAULTS["stuck:0:5"], FAULTS["delay=0.4:3"]))
    struck = SensorOptions(chances=["dropout=0.2"]).over(scenario).sensors
    assert struck == replace(sensors, chances=FaultChances(dropout=0.2))


def test_a_sensor_is_looked_for_in_the_scenario_s_own_array() -> None:
    two = SonarArray(azimuths=(0.0, 1.0), order=(0, 1))
    scenario = replace(load_scenario("pool-behind"), sensors=Sensors(Equipment(array=two)))
    assert SensorOptions(faults=["dead:1"]).over(scenario).sensors.faults == (FAULTS["dead:1"],)
    with pytest.raises(InputError, match=r"--fault = 'dead:2'.*0 to 1"):
        SensorOptions(faults=["dead:2"]).over(scenario)
    one = replace(scenario, sensors=Sensors(Equipment(array=SonarArray(azimuths=(0.0,), order=(0,)))))
    for options in (SensorOptions(faults=["crosstalk:0"]), SensorOptions(chances=["crosstalk=0.1"])):
        with pytest.raises(InputError, match="at least two sensors"):
            options.over(one)


MISTAKES = {
    "unknown kind": (["--fault", "ded:0"], ["--fault", "'ded:0'", "'dead'"]),
    "no sensor": (["--fault", "dead"], ["--fault", "names no sensor", "KIND:SENSOR"]),
    "a sensor that is not there": (["--fault", "dead:4"], ["--fault", "'dead:4'", "0 to 3"]),
    "a sensor below 0": (["--fault", "dead:-1"], ["--fault", "'-1'", "from 0"]),
    "a sensor that is no number": (["--fault", "dead:1_0"], ["--fault", "'1_0'", "whole number"]),
    "a start that is no number": (["--fault", "stuck:0:soon"], ["--fault", "start", "'soon'"]),
    "a start before the run": (["--fault", "stuck:0:-1"], ["--fault", "start", "at least 0"]),
    "no duration": (["--fault", "stuck:0:1:0"], ["--fault", "duration", "greater than 0"]),
    "endless duration": (["--fault", "stuck:0:1:inf"], ["--fault", "duration", "'inf'"]),
    "too many parts": (["--fault", "stuck:0:1:2:3"], ["--fault", "too many", "KIND:SENSOR"]),
    "a delay of what": (["--fault", "delay:0"], ["--fault", "delay=SECONDS"]),
    "too long a delay": (["--fault", "delay=0.9:0"], ["--fault", "delay", "0.8"]),
    "a number for what takes none": (["--fault", "stuck=1:0"], ["--fault", "stuck:SENSOR"]),
    "a death that ends": (["--fault", "dead:0:1:2"], ["--fault", "dropout"]),
    "unknown chance": (["--chance", "drop=0.1"], ["--chance", "'drop=0.1'", "'dropout'"]),
    "what does not strike": (["--chance", "dead=0.1"], ["--chance", "--fault dead"]),
    "no chance": (["--chance", "dropout"], ["--chance", "dropout=P"]),
    "more than certain": (["--chance", "dropout=2"], ["--chance", "0 to 1"]),
    "chance of nan": (["--chance", "dropout=nan"], ["--chance", "0 to 1"]),
    "chance of a word": (["--chance", "dropout=often"], ["--chance", "'dropout=often'", "0 to 1"]),
    "chances above 1": (["--chance", "dropout=0.6", "--chance", "spike=0.6"], ["--chance", "1.2"]),
    "a chance twice": (["--chance", "spike=0.1", "--chance", "spike=0.2"], ["--chance", "twice"]),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_one_line(tmp_path, case) -> None:
    words, expected = MISTAKES[case]
    done = surctl_here(*SONAR, *words, cwd=tmp_path)
    assert done.status == 2, done
    for word in expected:
        assert word in done.complaint
    assert done.out == ""


@pytest.mark.parametrize(
    "words",
    [["--fault", "dead:0"], ["--chance", "dropout=0.1"]],
    ids=lambda words: words[0],
)
def test_with_true_positions_they_are_refused(tmp_path, words) -> None:
    done = surctl_here("simulate", "pool-behind", *words, cwd=tmp_path)
    assert done.status == 2
    assert words[0] in done.complaint and "no effect" in done.complaint and "--sensing sonar" in done.complaint


def test_a_fault_is_flown_and_a_halt_is_told(tmp_path) -> None:
    words = ["simulate", "pool-static", "--sensing", "sonar"]
    words += [word for i in range(4) for word in ("--fault", f"dead:{i}:2")]
    said = surctl(*words, cwd=tmp_path)
    assert said.status == 1
    assert "standstill at " in said.out and "standstill: all sonars are judged faulty (0, 1, 2, 3)" in said.out


def test_options_change_what_is_flown(tmp_path) -> None:
    """All at once that the smallest law with sonars takes: what each of them replaces is told above."""
    text = (LIBRARY / "pool-behind.toml").read_text()
    (tmp_path / "short.toml").write_text(text.replace("time_limit_s = 60.0", "time_limit_s = 6.0"))
    options = ("--chance", "dropout=0.2", "--fault", "delay=0.4:0")
    plain, changed = (
        surctl("simulate", "short.toml", "--law", "paper", *SONAR[2:], *more, "--json", cwd=tmp_path).json["runs"][0]
        for more in ((), options)
    )
    assert plain["length_m"] != changed["length_m"]
    assert changed["sensors"]["chances"] == {"dropout": 0.2}
    assert changed["sensors"]["faults"] == [{"sensor": 0, "kind": "delay", "start_s": 0.0, "delay_s": 0.4}]


def test_true_positions_are_flown_by_a_law_without_sonars(tmp_path) -> None:
    done = surctl("simulate", "pool-behind", "--json", cwd=tmp_path)
    assert done.status == 0 and "sensors" not in done.json["runs"][0]


def test_the_echo_model_has_a_name_on_the_command_line_and_in_the_file(tmp_path):
    scenario = load_scenario("pool-static")
    smooth = SensorOptions(echoes="webots").over(scenario).sensors.equipment.array
    assert smooth.incidence_limit == pytest.approx(pi / 8)
    assert SensorOptions(echoes="ideal").over(replace(scenario, sensors=scenario.sensors.hearing("webots"))) == scenario
    text = (LIBRARY / "pool-static.toml").read_text() + '\n[sonar]\nechoes = "webots"\n'
    file = tmp_path / "smooth.toml"
    file.write_text(text)
    assert load_scenario(str(file)).sensors.equipment.array == smooth
    file.write_text(text + "incidence_limit_deg = 30\n")
    with pytest.raises(InputError, match="sets the same quantity as incidence_limit_deg") as error:
        load_scenario(str(file))
    assert error.value.key == "sonar.echoes"
    for wrong, sensing, problem in (("webot", "sonar", "is not known"), ("webots", "truth", "has no effect")):
        with pytest.raises(InputError, match=problem) as error:
            SensorOptions(echoes=wrong).check(sensing=sensing)
        assert error.value.key == "--echoes"
