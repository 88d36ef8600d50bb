"""Routes of scenario files: legs, arcs, depths, speeds, kinds of corners and surveys, and every mistake in them."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.guidance import BEND, MAX_WAYPOINTS, PASS, VISIT
from surctl.marine.simulation import Scenario, load_scenario
from surctl.marine.simulation.scenario import scenario_table
from surctl.marine.simulation.toml_text import toml_text

HEAD = """
kind = "scenario"
name = "survey"
title = "A survey"
provenance = "made up"
vehicle = "sur400"
depth_m = -1.0
cruise_m_per_s = 0.2
cap_m_per_s = 0.3
{top}
site = {{ length_m = 60.0, width_m = 60.0, depth_m = 5.0 }}
{tables}
"""
ARC = 'to_m = [10, 16]\nradius_m = 3.0\nturn = "left"'


def text(top: str, *tables: str) -> str:
    return HEAD.format(top=top, tables="\n".join(tables))


def loaded(folder: FilePath, content: str) -> Scenario:
    (folder / "own.toml").write_text(content, encoding="utf-8")
    return load_scenario(str(folder / "own.toml"))


def legs(*bodies: str) -> str:
    return "\n".join(f"[[leg]]\n{body}" for body in bodies)


def test_a_thousand_points_are_a_path_and_its_time_limit_follows_from_its_length(tmp_path: FilePath) -> None:
    points = [[2.0 + 0.05 * k, 2.0 + 3.0 * (k % 2)] for k in range(1000)]
    scenario = loaded(tmp_path, text(f"path_m = {points}"))
    assert scenario.path.waypoints.tolist() == points and scenario.path.fed
    assert scenario.time_limit == pytest.approx(2 * scenario.path.length / 0.2 + 60, abs=1)
    assert scenario.path.slots.tolist() == [*points[:7], points[-1]]


@pytest.mark.parametrize(("turn", "side"), [("left", 1), ("right", -1)])
@pytest.mark.parametrize("large_arc", [False, True])
def test_an_arc_is_within_its_error_and_ends_where_it_says(
    tmp_path: FilePath, turn: str, side: int, large_arc: bool
) -> None:
    body = f'to_m = [14, 12]\nradius_m = 3.0\nturn = "{turn}"\nlarge_arc = {str(large_arc).lower()}'
    scenario = loaded(tmp_path, text("path_m = [[5, 10], [10, 10]]", legs(body, "to_m = [20, 12]")))
    points = scenario.path.waypoints
    arc = points[1:-1]
    chord = np.hypot(4, 2)
    centre = (
        np.array([12, 11]) + side * (-1 if large_arc else 1) * np.sqrt(9 - chord**2 / 4) * np.array([-2, 4]) / chord
    )
    assert np.linalg.norm(arc - centre, axis=1) == pytest.approx(3.0, abs=1e-9)
    middles = (arc[1:] + arc[:-1]) / 2
    assert 0 < 3.0 - np.linalg.norm(middles - centre, axis=1).min() <= 0.001
    d = np.diff(arc, axis=0)
    turns = d[:-1, 0] * d[1:, 1] - d[:-1, 1] * d[1:, 0]
    assert (np.sign(turns) == side).all() and arc[0].tolist() == [10, 10] and arc[-1].tolist() == [14, 12]
    half = np.arcsin(chord / 6)
    length = 3.0 * (2 * np.pi - 2 * half if large_arc else 2 * half)
    assert np.linalg.norm(d, axis=1).sum() == pytest.approx(length, rel=2e-4)
    kinds = scenario.path.kinds
    assert (kinds[2:-2] == BEND).all() and (kinds[[0, 1, -2, -1]] == PASS).all()


def test_speed_depth_and_kind_of_a_leg(tmp_path: FilePath) -> None:
    bodies = ['to_m = [20, 10]\nspeed_m_per_s = 0.1\ndepth_m = -2.0\ncorner = "visit"', "to_m = [20, 20]"]
    scenario = loaded(tmp_path, text("path_m = [[5, 10], [10, 10]]", legs(*bodies)))
    path = scenario.path
    # 1 m down at 0.05 m/s takes 20 s, in which the robot goes 2 m
    assert path.waypoints.tolist() == [[5, 10], [10, 10], [12, 10], [20, 10], [20, 20]]
    assert path.rises.tolist() == [0, 0, -1, -1, -1] and path.speeds.tolist() == [0, 0, 0.1, 0.1, 0]
    assert path.kinds.tolist() == [PASS, PASS, BEND, VISIT, PASS]
    assert scenario.visited.tolist() == [[20, 10]] and scenario.visit == 0.1
    assert scenario.depth_range == (-2.0, -1.0) and scenario.end_depth == -2.0
    assert scenario.duration == pytest.approx(5 / 0.2 + 10 / 0.1 + 10 / 0.2)
    assert scenario.time_limit == 2 * 175 + 10 + 60


def test_straight_legs_alone_are_a_plain_path(tmp_path: FilePath) -> None:
    scenario = loaded(tmp_path, text("path_m = [[5, 10]]", legs("to_m = [10, 10]", "to_m = [10, 20]")))
    plain = loaded(tmp_path, text("path_m = [[5, 10], [10, 10], [10, 20]]"))
    assert not scenario.path.fed and np.array_equal(scenario.path.waypoints, plain.path.waypoints)


SURVEY = '[survey]\nkind = "lawnmower"\ncorner_m = [5, 5]\nlength_m = 40.0\nwidth_m = {width}\nspacing_m = 0.5\n{more}'


def test_a_survey_of_lines(tmp_path: FilePath) -> None:
    square = loaded(tmp_path, text("", SURVEY.format(width=2.0, more='side = "right"\nheading_deg = 90')))
    expected = [[5, 5], [5, 45], [5.5, 45], [5.5, 5], [6, 5], [6, 45], [6.5, 45], [6.5, 5], [7, 5], [7, 45]]
    assert np.allclose(square.path.waypoints, expected, atol=1e-9)
    long = loaded(tmp_path, text("", SURVEY.format(width=49.9, more="")))
    assert len(long.path.waypoints) == 200
    rounded = loaded(tmp_path, text("path_m = [[2, 2]]", SURVEY.format(width=2.0, more='ends = "round"')))
    inside = rounded.path.waypoints[rounded.path.waypoints[:, 0] > 45.01]
    assert inside[:, 0].max() == pytest.approx(45.25, abs=1e-3) and rounded.path.waypoints[0].tolist() == [2, 2]
    assert len(rounded.path.waypoints) > MAX_WAYPOINTS


def test_a_route_is_written_and_read_back(tmp_path: FilePath) -> None:
    tables = legs(ARC, 'to_m = [20, 16]\ndepth_m = -2.0\ncorner = "visit"'), SURVEY.format(width=2.0, more="")
    scenario = loaded(tmp_path, text("path_m = [[5, 10], [10, 10]]\narc_error_m = 0.002", *tables))
    table = scenario_table(scenario)
    again = loaded(tmp_path, toml_text(table))
    for name in ("waypoints", "rises", "speeds", "kinds"):
        assert np.array_equal(getattr(scenario.path, name), getattr(again.path, name))
    assert "radius_m" in table["leg"][0] and "length_m" in table["survey"]


MISTAKES = {
    "zero length": (legs("to_m = [10, 10]"), "leg.0.to_m = [10.0, 10.0]", "the leg has no length"),
    "small radius": (
        legs(ARC.replace("3.0", "2.9")),
        "leg.0.radius_m = 2.9",
        "the ends of the leg are 6 m apart; at least 3",
    ),
    "radius without turn": (legs("to_m = [10, 16]\nradius_m = 3.0"), "leg.0", "an arc needs radius_m and turn"),
    "unknown turn": (legs(ARC.replace("left", "port")), "leg.0.turn", "'left' or 'right'"),
    "unknown corner": (legs('to_m = [20, 10]\ncorner = "skip"'), "leg.0.corner", "'visit' or 'pass'"),
    "above the cap": (
        legs("to_m = [20, 10]\nspeed_m_per_s = 0.4"),
        "leg.0.speed_m_per_s = 0.4",
        "is above cap_m_per_s = 0.3; lower it or raise the cap",
    ),
    "outside the water": (
        legs("to_m = [30, 10]\ndepth_m = -6.0"),
        "leg.0.depth_m = -6.0",
        "a value above -5 and below 0, such as -0.1 for a boat",
    ),
    "too short to dive": (
        legs("to_m = [11, 10]\ndepth_m = -2.0"),
        "leg.0.depth_m = -2.0",
        "that takes 4 m, but the leg is 1 m long; make the leg longer or slower",
    ),
    "outside the site": (legs("to_m = [70, 10]"), "path_m = [70.0, 10.0]", "lies outside the site"),
    "unknown survey": ('[survey]\nkind = "spiral"', "survey.kind", "'lawnmower'"),
    "one line": (SURVEY.format(width=0.4, more=""), "survey", "there is only one line; reduce it"),
    "too many lines": (
        SURVEY.format(width=20.0, more="").replace("= 0.5", "= 1e-6"),
        "survey",
        "spacing_m gives 4e+07 points, more than 100,000; raise it",
    ),
    "infinitely many lines": (
        SURVEY.format(width=1e300, more="").replace("= 0.5", "= 1e-300"),
        "survey",
        "spacing_m gives inf points",
    ),
    "misspelt": (legs("to_m = [20, 10]\nspeed_mps = 0.2"), "leg.0.speed_mps", "did you mean 'speed_m_per_s'?"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_with_file_key_and_remedy(tmp_path: FilePath, mistake: str) -> None:
    tables, key, fragment = MISTAKES[mistake]
    with pytest.raises(InputError) as caught:
        loaded(tmp_path, text("path_m = [[5, 10], [10, 10]]", tables))
    shown = str(caught.value)
    assert shown.startswith(f"{tmp_path / 'own.toml'}: {key}") and fragment in shown and "\n" not in shown


def test_mistakes_above_the_tables(tmp_path: FilePath) -> None:
    near = [[5 + 0.01 * k, 10] for k in range(12)]
    cases = {
        "": "path_m: is missing; give the start",
        "climb_m_per_s = 0.2\npath_m = [[1, 1], [2, 2]]": "climb_m_per_s = 0.2: ",
        f"path_m = {near}": "is 0.01 m from the next point of the path, but at the cap of 0.3 m/s",
    }
    for top, fragment in cases.items():
        with pytest.raises(InputError) as caught:
            loaded(tmp_path, text(top))
        assert fragment in str(caught.value)
    with pytest.raises(InputError, match=r"arc_error_m = 1e-14: gives an arc of 3 m radius .* points; .*; raise it"):
        loaded(tmp_path, text("arc_error_m = 1e-14\npath_m = [[5, 10], [10, 10]]", legs(ARC)))
