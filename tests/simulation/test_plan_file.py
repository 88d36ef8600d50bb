"""Missions of other programs: positions in metres as WGS 84 has them, and a scenario that can be loaded."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from surctl.errors import InputError
from surctl.marine.cli.mission import scenario
from surctl.marine.simulation import load_scenario
from surctl.marine.simulation.plan_file import mission_scenario, read_mission


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
    with pytest.raises(InputError, match="is not a file"):  # a device may never end
        read_mission(Path("/dev/null"))


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
    assert status == 0 or "Invalid value for '--depth'" in result.output  # not a key of the file to be written


HOME = (63.0, 10.0, 71.5)  # a lake above the sea
EAST, NORTH = 50672.9, 111461.7  # m per degree there, by the series of the ellipsoid


def _written(point: tuple[float, float, float], frame: int) -> list[float]:
    # east, north and height above the surface, as a waypoint in a frame
    x, y, z = point
    if frame in (1, 4):
        return [y, x, -z] if frame == 1 else [x, y, z]
    return [HOME[0] + y / NORTH, HOME[1] + x / EAST, z + (HOME[2] if frame in (0, 5) else 0.0)]


def _file(path: Path, items: list[Any], *, home: Any = HOME, **more: Any) -> Path:
    path.write_text(json.dumps({"mission": {"items": items, "plannedHomePosition": home}, **more}))
    return path


@pytest.mark.parametrize("seed", range(8))
def test_waypoints_of_any_frame_are_the_same_mission(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-200, 200, (5, 2)), rng.uniform(-9, -1, 5)])
    frames = [3, *rng.choice([0, 1, 3, 4, 5, 6], 4).tolist()]
    items = [
        {"type": "SimpleItem", "command": 16, "frame": f, "params": [0, 0, 0, None, *_written(tuple(p), f)]}
        for p, f in zip(points.tolist(), frames, strict=True)
    ]
    mission = read_mission(_file(tmp_path / "a.plan", items))
    np.testing.assert_allclose(mission.points, points[:, :2] - points[0, :2], atol=0.02)
    np.testing.assert_allclose(mission.heights, points[:, 2], atol=1e-9)
    assert mission.notes == ()
    without = _file(tmp_path / "b.plan", items, home=None)
    if {1, 4} & set(frames):
        with pytest.raises(InputError, match=r"item \d = 'frame [14]': is in metres from a home position.*; save the"):
            read_mission(without)
    else:
        assert np.isnan(read_mission(without).heights).tolist() == [f in (0, 5) for f in frames]


@pytest.mark.parametrize(
    ("command", "params", "text"),
    [
        (16, (30, 0, 0, None), "hold 30 s"),
        (16, (0, 2, 7, None), "pass at 7 m"),
        (16, (0, 2, 0, -90), "yaw -90°"),
        (17, (0, 0, 12, None), "radius 12 m"),
        (17, (0, 0, 0, None), "loiter without end"),
        (18, (3, 0, 0, None), "3 turns"),
        (18, (0, 0, -4, None), "radius -4 m"),
        (19, (60, 0, 0, None), "hold 60 s"),
        (82, (5, 0, 0, None), "hold 5 s"),
    ],
)
@pytest.mark.parametrize("frame", [3, 10, 11])
def test_what_a_path_has_not_is_said_of_its_item(
    command: int, params: tuple[Any, ...], text: str, frame: int, tmp_path: Path
) -> None:
    first, last = (_item(16, 0, 0, 0, None, 63.0, 10.0 + 1e-3 * k, -2) for k in (0, 2))
    middle = {**_item(command, *params, 63.0, 10.001, -2), "frame": frame}
    mission = read_mission(_file(tmp_path / "a.plan", [first, middle, last]))
    assert f"not used: item 2 ({text})" in mission.notes
    assert ("not used: item 2 (height -2 m above the terrain)" in mission.notes) == (frame != 3)
    assert np.isnan(mission.heights).tolist() == [False, frame != 3, False]


@pytest.mark.parametrize("frame", [2, 7, 8, 9, 12, 20, 21, 99])
def test_a_frame_without_meaning_for_a_mission_is_refused(frame: int, tmp_path: Path) -> None:
    items = [ITEMS[1], {**ITEMS[1], "frame": frame}]
    with pytest.raises(InputError, match=rf"item 2 = 'frame {frame}': is no frame of a waypoint; give latitude"):
        read_mission(_file(tmp_path / "a.plan", items))


def test_speeds_and_stops_of_a_plan_are_said(tmp_path: Path) -> None:
    items = [ITEMS[1], _item(178, 2, 3.0, -1), _item(178, 1, 0.5, -1), {**SURVEY, "autoContinue": False}]
    items[0] = {**items[0], "autoContinue": False}
    mission = read_mission(_file(tmp_path / "a.plan", items))
    assert mission.speed == 0.5 and mission.notes == (
        "not used: item 1 (waits for the operator)",
        "not used: item 2 (command 178)",  # a speed of climbing
        "item 3 (speed 0.5 m/s, on the way) holds from the first waypoint",
    )


@pytest.mark.parametrize("seed", range(4))
def test_exclusion_circles_are_obstacles_and_all_other_fences_are_said(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    centres, radii = np.column_stack([[20, 50, 80], rng.uniform(-20, 20, 3)]), rng.uniform(1, 9, 3)
    points = [_written((x, 0.0, -2.0), 3) for x in (0.0, 100.0)]
    circles: list[dict[str, Any]] = [
        {"circle": {"center": _written((x, y, 0), 3)[:2], "radius": r}, "inclusion": False}
        for (x, y), r in zip(centres.tolist(), radii.tolist(), strict=True)
    ]
    other = [{**circles[0], "inclusion": True}, {**circles[0], "inclusion": False}]
    polygons = [{"polygon": [[63, 10], [63, 10.1], [63.1, 10]], "inclusion": bool(k)} for k in (0, 1)]
    fence = {"circles": [*circles, *other], "polygons": polygons}
    items = [_item(16, 0, 0, 0, None, *point) for point in points]
    mission = read_mission(_file(tmp_path / "a.plan", items, geoFence=fence))
    text, notes = mission_scenario(mission, "a", vehicle="sur400", cruise=0.2, margin=25.0)
    (tmp_path / "a.toml").write_text(text)
    scenario = load_scenario(str(tmp_path / "a.toml"))
    start = scenario.path.waypoints[0]
    np.testing.assert_allclose([np.array(o.centre_m) - start for o in scenario.obstacles], centres, atol=0.03)
    np.testing.assert_allclose([float(o.radius_m or 0) for o in scenario.obstacles], radii)
    assert notes == (
        f"not used: inclusion circle 4, of radius {radii[0]:g} m",
        "not used: exclusion polygon 1, with 3 corners",
        "not used: inclusion polygon 2, with 3 corners",
        f"not used: exclusion circle 4, of radius {radii[0]:g} m (it overlaps an earlier one)",
        "3 exclusion circles are cylinders in the water, so sonars see them too",
    )
    mission = read_mission(_file(tmp_path / "a.plan", [items[0], items[1]], geoFence={"circles": [circles[0]] * 2}))
    _, notes = mission_scenario(mission, "a", vehicle="sur400", cruise=0.2, margin=25.0)
    assert sum("overlaps" in note for note in notes) == 1
    circles[0]["circle"]["center"] = points[0][:2]
    with pytest.raises(InputError, match=r"exclusion circle 1, of radius .*: the path begins or ends inside it"):
        mission_scenario(
            read_mission(_file(tmp_path / "a.plan", items, geoFence=fence)), "a", vehicle="sur400", cruise=0.2
        )
    with pytest.raises(InputError, match="geoFence: cannot be read"):
        read_mission(_file(tmp_path / "a.plan", items, geoFence={"circles": [3]}))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "iso-8859-1", "windows-1252", "utf-16", "utf-16-le"])
def test_a_gpx_file_of_any_encoding_is_read_and_its_document_type_is_refused(encoding: str, tmp_path: Path) -> None:
    declared = encoding.replace("-sig", "").replace("-le", "")
    points = "".join(f'<rtept lat="63" lon="{lon}"><name>Bøye</name></rtept>' for lon in (10.0, 10.001))
    head = f'<?xml version="1.0" encoding="{declared}"?>'
    mark = "\ufeff" if encoding == "utf-16-le" else ""
    path = tmp_path / "a.gpx"
    path.write_bytes((mark + head + f"<gpx><rte>{points}</rte></gpx>").encode(encoding))
    assert len(read_mission(path).points) == 2
    bomb = '<!DOCTYPE a [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><gpx><wpt lat="&b;"/></gpx>'
    path.write_bytes((mark + head + bomb).encode(encoding))
    with pytest.raises(InputError, match=r"a.gpx: declares a document type; remove the DOCTYPE"):
        read_mission(path)


def test_an_encoding_that_is_not_known_is_one_line(tmp_path: Path) -> None:
    for name in ("klingon", "shift_jis", "utf-16"):  # the bytes are not UTF-16
        (tmp_path / "a.gpx").write_bytes(f'<?xml version="1.0" encoding="{name}"?><gpx/>'.encode())
        with pytest.raises(InputError, match=r"a.gpx: is not XML") as caught:
            read_mission(tmp_path / "a.gpx")
        assert "\n" not in str(caught.value)
