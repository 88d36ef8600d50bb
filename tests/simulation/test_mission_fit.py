"""What lint says of arcs, changes of depth, speeds of legs and close corners, and who cannot follow a long mission."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from surctl.cli.app import app
from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.guidance import Path
from surctl.marine.simulation import Obstacle, findings, load_scenario, simulate
from surctl.marine.simulation.explanation import stop_reason
from surctl.marine.simulation.motion import planned_radius
from surctl.marine.simulation.scenario import scenario_table
from surctl.marine.simulation.toml_text import toml_text
from surctl.marine.vehicle import Vehicle
from tests.craft import CRUISE, craft, mission
from tests.simulation.test_missions import GAINS, VEHICLE, loops, written

ARC = {"to_m": [9, 9], "radius_m": 1.0, "turn": "left"}


def weak(**values: float) -> Vehicle:
    parameters = dict(VEHICLE.parameters)
    for name, value in values.items():
        parameters[name] = replace(parameters[name], value=value, range=None)
    return replace(VEHICLE, parameters=parameters)


@pytest.mark.parametrize(
    ("leg", "more", "vehicle", "level", "text"),
    [
        (ARC, {}, VEHICLE, None, ""),
        (ARC, {}, weak(Fv_max=0.5), "error", "of radius 1 m at 0.2 m/s needs 2.00 N towards its centre, but the sway"),
        (ARC, {}, weak(Fr_max=0.02), "warning", "turns at 0.2 rad/s, but sur400 sustains"),
        ({"to_m": [15, 7], "depth_m": -1.5}, {"climb_m_per_s": 0.1}, weak(Fw_max=0.1), "error", "at 0.1 m/s needs"),
        ({"to_m": [9.5, 7]}, {"path_m": [[2, 2], [2, 7], [9, 2]]}, VEHICLE, None, ""),
        ({"to_m": [9, 7.5]}, {}, VEHICLE, "info", "1 of 2 stretches between corners are shorter than the look-ahead"),
        ({"to_m": [15, 7], "speed_m_per_s": 0.25}, {}, weak(Fu_max=1.0), "error", "at this leg's speed of 0.25 m/s"),
    ],
    ids=["fits", "sway", "yaw", "heave", "long legs", "short leg", "speed"],
)
def test_what_lint_says(
    leg: dict[str, Any], more: dict[str, Any], vehicle: Vehicle, level: str | None, text: str
) -> None:
    scenario = written(more.pop("path_m", [[7, 7], [9, 7]]), leg, **more)
    keys = ("leg.radius_m", "climb_m_per_s", "path_m", "cruise_m_per_s", "leg.0.speed_m_per_s")
    found = [f for f in findings(scenario, vehicle) if f.key in keys]
    if level is None:
        assert not found
    else:
        assert [f.level for f in found if text in f.text] == [level], [f.text for f in found]


def test_the_planned_turning_radius_decides_about_the_arcs_and_corners_of_a_steered_craft() -> None:
    otter, radius = craft("otter"), planned_radius(craft("otter"), GAINS, CRUISE["otter"])[0]
    for share, warned in ((1.2, 0), (0.8, 1)):
        arc = {"to_m": [30, 20 + 2 * share * radius], "radius_m": share * radius, "turn": "left"}
        scenario = mission([[10.0, 20.0], [30.0, 20.0]], "otter", size=(60, 60), time=200, leg=[arc])
        found = [f for f in findings(scenario, otter) if f.key in ("leg.radius_m", "path_m")]
        assert [(f.level, f.key) for f in found] == [("warning", "leg.radius_m")] * warned
        assert all(
            f"planned turning radius at 0.77 m/s is {radius:.2g} m (gain sideslip = 0.2 rad)" in f.text for f in found
        )
    zigzag = [[10.0 + 0.5 * k, 10.0 + 0.5 * ((k + 1) // 2 % 2)] for k in range(40)]
    zigzag[20][1] += 0.1  # sharpens the corner before it
    found = [f for f in findings(mission(zigzag, "otter", size=(60, 60), time=200), otter) if "corner" in f.text]
    assert [f.text.count("(the worst; ") for f in found if f.level == "warning"] == [1]
    assert "corner (19.5, 10) turns by 56°" in next(f.text for f in found if f.level == "warning")


def test_a_speed_beyond_the_thrust_names_its_leg() -> None:
    arc, climb = ARC, {"to_m": [4, 9], "depth_m": -1.2}
    fast = {"to_m": [4, 15], "speed_m_per_s": 0.25}
    scenario = written([[7, 7], [9, 7]], arc, climb, fast, {"to_m": [9, 15], "speed_m_per_s": 0.21})
    assert [f.key for f in findings(scenario, weak(Fu_max=2.0)) if "moves at" in f.text] == ["leg.2.speed_m_per_s"]


def test_depths_of_the_path_count_where_obstacles_end() -> None:
    low = {"name": "sill", "shape": "box", "centre_m": [15, 7], "size_m": [1.0, 1.0], "top_m": -1.6}
    above = written([[7, 7], [9, 7]], {"to_m": [15, 7]}, obstacles=[low])
    inside = written([[7, 7], [9, 7]], {"to_m": [15, 7], "depth_m": -1.7}, obstacles=[low])
    assert not [f for f in findings(above, VEHICLE) if "sill" in f.text]
    assert next(f.level for f in findings(inside, VEHICLE) if "sill" in f.text) == "error"


def test_only_corners_to_visit_must_be_free() -> None:
    post = {"name": "post", "shape": "cylinder", "centre_m": [9, 7], "radius_m": 0.2}
    for corner, errors in (("pass", 0), ("visit", 1)):
        legs = {"to_m": [9, 7], "corner": corner}, {"to_m": [9, 12]}
        scenario = written([[2, 7]], *legs, obstacles=[post])
        assert len([f for f in findings(scenario, VEHICLE) if "corner (9, 7)" in f.text]) == errors


def test_a_dead_end_says_how_much_of_the_whole_path_was_reached() -> None:
    wall = Obstacle(name="wall", shape="box", centre_m=(6.5, 2.5), size_m=(0.3, 5.0))
    points = np.stack([np.linspace(1.0, 9.0, 40), np.full(40, 2.5)], axis=1)
    scenario = replace(load_scenario("tank-static"), path=Path(points), obstacles=(wall,), time_limit=120.0, cruise=0.2)
    run = simulate(scenario, VEHICLE, gains=load_gains("default").with_values({"patience": 5.0}))
    assert run.metrics.stopped_because == "dead end" and "of the 8.0 m path" in stop_reason(run)
    reached = float(stop_reason(run).split("reached ")[1].split(" m")[0])
    assert reached == pytest.approx(run.record.eta[:, 0].max() - 1.0, abs=0.2)


def test_who_cannot_feed_a_law_says_so(tmp_path: Any) -> None:
    scenario = replace(load_scenario("tank-static"), path=Path(loops(20, 0.1)), obstacles=())
    file = tmp_path / "long.toml"
    file.write_text(toml_text(scenario_table(scenario)), encoding="utf-8")
    common = [str(file), "--law", "closed_form", "--sensing", "truth"]
    export = ["export", "--scenario", *common, "--out", str(tmp_path)]
    for words, fragment in (
        ([*export, "--constant-gains"], "path_m: has more than 8 points"),
        (["simulate", *common, "--controller", "qemu:cortex-m4f"], "cannot receive a path of more than 8 points"),
    ):
        done = CliRunner().invoke(app, words)
        assert isinstance(done.exception, InputError | SystemExit), words
        assert fragment in str(done.exception) + done.output, words
