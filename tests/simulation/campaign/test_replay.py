"""Runs as files: flown again they come to the same, and nonsense is told in one line."""

import re
from dataclasses import replace
from math import inf

import pytest

from surctl.errors import InputError
from surctl.marine.simulation import Case, load_scenario
from surctl.marine.simulation.campaign.campaign import Replay, load_replay, run_campaign
from surctl.marine.simulation.campaign.worlds import SampledRun
from surctl.marine.vehicle import load_vehicle
from tests.simulation.campaign.test_draws import GAINS, plan


@pytest.mark.parametrize(
    "drawn",
    [
        plan("tank-speed-015", law="paper", mode="nsb", avoidance="printed", seconds=5.0),
    ],  # by sonar: study 40
    ids=["paper"],
)
def test_a_worst_run_flown_again_equals_its_row(drawn, tmp_path):
    gains = GAINS.with_values({"k_v": 1.7})
    drawn = replace(drawn, case=replace(drawn.case, gains=gains))
    flown = run_campaign(drawn, runs=4)
    for kept, k in zip(flown.worst(2), flown.table.worst(2), strict=True):
        file = tmp_path / "run.toml"
        file.write_text(kept.to_toml())
        read = load_replay(file)
        assert read.to_toml() == kept.to_toml()
        row, run = flown.table.row(k), read.run.simulate()
        assert run.metrics.stopped_because == row["stopped_because"] and run.seed == row["seed"]
        for name in ("time_s", "min_clearance_m", "deviation_m", "length_m", "effort_n", "max_deviation_m"):
            assert getattr(run.metrics, name) == pytest.approx(row[name], rel=1e-9, abs=1e-9)
        assert read.difference(run) <= 1e-9
        assert run.gains.values == gains.values and run.law.mode == drawn.case.mode


def test_the_file_of_a_run_has_the_thrusters_of_its_vehicle(tmp_path):
    vehicle = load_vehicle("lauv")
    case = Case(load_scenario("tank-static"), vehicle, GAINS, model=vehicle.with_values({"m11": 20.0}))
    file = tmp_path / "run.toml"
    file.write_text(Replay(SampledRun(case, 0), "time limit", {}, "thrusters").to_toml())
    read = load_replay(file).run.case
    assert vehicle.actuators is not None and read.vehicle.actuators == vehicle.actuators
    assert read.vehicle.digest() == vehicle.digest() and read.model.digest() == case.model.digest()


@pytest.fixture(scope="module")
def text():
    return run_campaign(plan("tank-moving", law="closed_form", seconds=3.0), runs=3).worst(1)[0].to_toml()


def test_another_run_is_told_apart(text, tmp_path):
    (tmp_path / "a.toml").write_text(text)
    kept = load_replay(tmp_path / "a.toml")
    run = kept.run.simulate()
    assert kept.difference(run) <= 1e-9
    assert replace(kept, stopped_because="standstill").difference(run) == inf
    off = kept.figures | {"length_m": kept.figures["length_m"] + 1e-6}
    assert replace(kept, figures=off).difference(run) == pytest.approx(1e-6, rel=1e-3)
    fewer = {name: value for name, value in kept.figures.items() if name != "length_m"}
    assert replace(kept, figures=fewer).difference(run) == inf
    heavier = replace(kept.run, draw=kept.run.draw | {"m11": 60.0})
    assert kept.difference(heavier.simulate()) > 1e-6


@pytest.mark.parametrize(
    ("pattern", "put", "words"),
    [
        (r'kind = "run"', 'kind = "scenario"', "kind = 'scenario'"),
        (r"seed = \d+", "seed = -1", "seed = -1"),
        (r"seed = \d+", 'seed = "one"', "seed = 'one'"),
        (r'law = "closed_form"', 'law = "closed_from"', "law = 'closed_from'"),
        (r'sensing = "truth"', 'sensing = "touch"', "sensing = 'touch'"),
        (r'priority_mode = "nsb"', "priority_mode = 3", "priority_mode = 3"),
        (r"m11 = [\d.]+", "m11 = 1e9", "lies outside its own range"),
        (r"m11 = [\d.]+", "m11 = nan", "draw.m11 = nan"),
        (r"m11 = [\d.]+", "m111 = 60.0", "draw.m111: no such vehicle parameter"),
        (r"length_m = [\d.]+\n", "width = 3.0\n", "figures.width: no such metric"),
        (r"k_v = [\d.]+", "k_v = -1.0", "gains.k_v = -1.0"),
        (r"k_v = [\d.]+\n", "", "gains.values.k_v: is missing"),
        (r"k_v = [\d.]+\n", "k_v = 1.0\nk_w = 1.0\n", "gains.k_w: no such gain"),
        (r"cruise_m_per_s = [\d.]+", "cruise_m_per_s = 9.0", "is above cap_m_per_s"),
        (r"radius_m = [\d.]+", "radius_m = -0.3", "radius_m = -0.3"),
        (r"\[vehicle.hull.radius\]\nvalue = [\d.]+", "[vehicle.hull.radius]\nvalue = 0.0", "hull.radius = 0.0"),
        (r"\[scenario\]", "[scenery]", "scenery: unknown key"),
        (r"\[scenario.sonar\]", '[scenario.sonar]\nechoes = "loud"', "scenario.sonar.echoes = 'loud'"),
        (r"(?s).*", "kind = 'run'", "is missing"),
        (r"(?s).*", "]", "not valid TOML"),
    ],
)
def test_nonsense_is_told_in_one_line(text, pattern, put, words, tmp_path):
    file = tmp_path / "altered.toml"
    altered = re.sub(pattern, lambda _: put, text, count=1)
    assert altered != text
    file.write_text(altered)
    with pytest.raises(InputError, match=re.escape(words)) as told:
        load_replay(file)
    assert str(told.value).startswith(str(file)) and "\n" not in str(told.value)


def test_a_start_inside_an_obstacle_is_told_when_it_is_flown(text, tmp_path):
    file = tmp_path / "altered.toml"
    file.write_text(
        re.sub(r"size_m = \[.*\]", "size_m = [0.3, 9.0]", text.replace("[8.0, 1.2]", "[0.6, 2.5]"), count=1)
    )
    with pytest.raises(InputError, match="inside obstacle"):
        load_replay(file).run.simulate()
