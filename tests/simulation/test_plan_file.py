"""Missions of other programs: positions in metres as WGS 84 has them, and a scenario that can be loaded."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from surctl.cli.mission import scenario
from surctl.errors import InputError
from surctl.simulation import load_scenario, mission_scenario, read_mission


def _item(command: int, *params: float | None) -> dict[str, Any]:
    return {"type": "SimpleItem", "command": command, "frame": 3, "params": list(params)}


def _plan(items: list[Any]) -> str:
    return json.dumps({"fileType": "Plan", "mission": {"cruiseSpeed": 15, "items": items}, "version": 1})


SURVEY = {
    "type": "ComplexItem",
    "complexItemType": "survey",
    "TransectStyleComplexItem": {
        "Items": [_item(16, 0, 0, 0, None, 63.0002, 10.0, -3), _item(16, 0, 0, 0, None, 63.0002, 10.0004, -3)]
    },
}
ITEMS = [
    _item(178, 1, 0.4, -1, 0, 0, 0, 0),
    _item(16, 0, 0, 0, None, 63.0, 10.0, -2),
    SURVEY,
    _item(20, 0, 0, 0, 0, 0, 0, 0),
]


def test_a_plan_is_a_scenario(tmp_path: Path) -> None:
    (tmp_path / "survey.plan").write_text(_plan(ITEMS))
    mission = read_mission(tmp_path / "survey.plan")
    # lengths of a degree at 63°: 111,425 m of latitude and 50,670 m of longitude
    expected = [[0.0, 0.0], [0.0, 111425 * 2e-4], [50670 * 4e-4, 111425 * 2e-4]]
    np.testing.assert_allclose(mission.points, expected, atol=0.02)
    assert mission.speed == 0.4 and mission.heights.tolist() == [-2.0, -3.0, -3.0]
    assert mission.notes == ("not used: item 4 (command 20)",)
    text, notes = mission_scenario(mission, "survey", vehicle="sur540-flooded", cruise=0.4, margin=4.0)
    assert notes[1] == "heights from -3 to -2 m: the path keeps the lowest, -3 m"
    (tmp_path / "survey.toml").write_text(text)
    scenario = load_scenario(str(tmp_path / "survey.toml"))
    np.testing.assert_allclose(scenario.path.waypoints, mission.points + 4.0, atol=1e-3)
    assert scenario.depth == -3.0 and scenario.cruise == 0.4
    assert (scenario.path.waypoints < np.array(scenario.site[:2]) - 3.9).all()


def test_a_gpx_track_and_one_that_stands_still(tmp_path: Path) -> None:
    points = "".join(
        f'<trkpt lat="-33.0" lon="{179.9999 + 1e-4 * k - 360 * (k > 1)}"><ele>-1</ele></trkpt>' for k in (0, 0, 1, 2)
    )
    file = tmp_path / "bay.gpx"
    file.write_text(f'<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{points}</trkseg></trk></gpx>')
    mission = read_mission(file)
    np.testing.assert_allclose(mission.points, [[0, 0], [9.34, 0], [18.68, 0]], atol=0.02)  # across 180°
    with pytest.raises(InputError, match="--depth: is not below the surface"):
        mission_scenario(read_mission(_with(file, "<ele>-1", "<ele>1")), "bay", vehicle="sur400", cruise=0.2)
    with pytest.raises(InputError, match="fewer than two waypoints"):
        read_mission(_with(file, 'lon="', 'lon="5" x="'))
    with pytest.raises(InputError, match=r"waypoint 1.*is not a position"):
        read_mission(_with(file, 'lat="-33', 'lat="-133'))
    with pytest.raises(InputError, match="too far apart"):
        read_mission(_with(file, "179.9999", "17.9999"))


def _with(file: Path, old: str, new: str) -> Path:
    changed = file.with_name("changed.gpx")
    changed.write_text(file.read_text().replace(old, new))
    return changed


@pytest.mark.parametrize(
    ("name", "text", "fragment"),
    [
        ("a.plan", "{}", "is not a QGroundControl plan"),
        ("a.plan", "[" * 5, "is not a QGroundControl plan"),
        ("a.plan", _plan([_item(16, 0, 0)]), r"item 1 = .*: cannot be read.*save the plan again"),
        ("a.plan", _plan([]), "fewer than two waypoints"),
        ("a.plan", _plan([ITEMS[1], None]), "item 2 = 'None': cannot be read"),
        ("a.plan", _plan([{**SURVEY, "TransectStyleComplexItem": {"Items": [3]}}]), "item 1.1 = '3': cannot be read"),
        ("a.plan", _plan([_item(22), _item(9999)]), r"item 1 \(command 22\); not used: item 2 \(command 9999\)"),
        ("a.plan", _plan([ITEMS[1]] * 100_001), "100,001 waypoints"),
        ("a.gpx", "<gpx>", "is not XML"),
        ("a.gpx", "<!DOCTYPE x><gpx/>", "document type"),
        ("a.gpx", '<gpx><wpt lat="1"/></gpx>', r"point 1 = \('1', None, None\): is not a position"),
    ],
)
def test_files_that_are_no_mission(name: str, text: str, fragment: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=fragment) as caught:
        read_mission(tmp_path / name)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="no such file"):
        read_mission(tmp_path / "gone.plan")


def test_what_a_plan_leaves_out_is_said(tmp_path: Path) -> None:
    items = [{"type": "ComplexItem", "complexItemType": "survey"}, *ITEMS[1:3], _item(178, 1, -1)]
    for cruise, note in ((-1, "-1"), ("fast", "'fast'"), (None, None), (True, "True"), (float("inf"), "inf")):
        (tmp_path / "a.plan").write_text(json.dumps({"mission": {"cruiseSpeed": cruise, "items": items}}))
        mission = read_mission(tmp_path / "a.plan")
        assert mission.speed is None
        assert mission.notes[:2] == (
            "not used: item 1 (survey without waypoints)",
            "not used: item 4 (speed -1 m/s)",
        )
        assert (mission.notes[2:] == ()) if note is None else (f"cruiseSpeed = {note} " in mission.notes[2])
    (tmp_path / "a.plan").write_text(_plan([*ITEMS, _item(178, 1, 0.3)]))
    assert "item 5 (speed 0.3 m/s; the first one, 0.4 m/s, holds)" in read_mission(tmp_path / "a.plan").notes[1]


@pytest.mark.parametrize(("depth", "status"), [("-2", 0), ("2", 2), ("nan", 2), ("0", 2)])
def test_a_depth_above_the_surface_writes_nothing(tmp_path: Path, depth: str, status: int) -> None:
    (tmp_path / "a.plan").write_text(_plan(ITEMS))
    options = ["from-plan", str(tmp_path / "a.plan"), "--depth", depth, "--out", str(tmp_path / "a.toml")]
    result = CliRunner().invoke(scenario, options)
    assert (result.exit_code == 0, (tmp_path / "a.toml").exists()) == (status == 0, status == 0)
