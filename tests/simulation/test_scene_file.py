"""Runs as MCAP for Foxglove: read with the library mcap, and checked against Foxglove's own definitions."""

from __future__ import annotations

import importlib
import json
from collections import defaultdict
from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import Obstacle, Run, load_scenario, save_record, simulate
from surctl.marine.simulation.record_file import LAYOUT, SceneFile, save_scene
from surctl.marine.vehicle import load_vehicle
from surctl.recorded_write import SCHEMAS, McapFile
from tests.tools import need_module

Messages = dict[str, list[tuple[float, str, dict[str, Any]]]]


@cache
def run() -> Run:
    need_module("mcap")
    box = Obstacle(name="B1", shape="box", centre_m=(2.0, 0.5), size_m=(0.2, 0.2), top_m=-0.5)
    scenario = load_scenario("pool-behind")
    scenario = replace(scenario, obstacles=(*scenario.obstacles, box))
    return simulate(scenario, load_vehicle("sur400"), gains=load_gains("default"), law=build_law("closed_form"))


def messages(data: bytes, *, whole: bool = True) -> Messages:
    """Time, schema and content of every message by topic; a file that was cut is read up to the cut."""
    from mcap.exceptions import EndOfFile
    from mcap.reader import NonSeekingReader, make_reader

    read: Messages = defaultdict(list)
    reader = make_reader(BytesIO(data)) if whole else NonSeekingReader(BytesIO(data))
    try:
        for schema, channel, message in reader.iter_messages(log_time_order=whole):
            assert schema is not None and schema.encoding == "jsonschema" and channel.message_encoding == "json"
            read[channel.topic].append((message.log_time * 1e-9, schema.name, json.loads(message.data)))
    except EndOfFile:
        assert not whole
    return read


def test_it_holds_every_step(tmp_path: Path) -> None:
    record = run().record
    read = messages(save_scene(run(), tmp_path).read_bytes())
    assert [time for time, _, _ in read["/pose"]] == pytest.approx(record.time)
    for topic in ("/tf", "/state", "/thrust", "/status"):
        assert len(read[topic]) == len(record.time), topic
    place = np.array([[m["pose"]["position"][k] for k in "xyz"] for _, _, m in read["/pose"]])
    assert np.abs(place - record.eta[:, :3]).max() < 1e-4
    turns = np.array([[m["pose"]["orientation"][k] for k in "zw"] for _, _, m in read["/pose"]])
    assert np.abs(2 * np.arctan2(*turns.T) - record.eta[:, 3]).max() < 1e-4
    thrust = np.array([[m[k] for k in ("surge_n", "sway_n", "heave_n", "yaw_n_m")] for _, _, m in read["/thrust"]])
    assert np.abs(thrust - record.tau).max() < 1e-4
    assert "reached" in read["/log"][-1][2]["message"] or "collision" in read["/log"][-1][2]["message"]


def test_the_scene_has_what_is_in_the_water(tmp_path: Path) -> None:
    read = messages(save_record(run(), tmp_path, kind="mcap").read_bytes())
    entities = {e["id"]: e for _, _, m in reversed(read["/scene"]) for e in m["entities"]}
    assert {"hull", "site", "OM1", "B1"} <= set(entities)
    (box,) = entities["B1"]["cubes"]
    assert box["size"] == {"x": 0.2, "y": 0.2, "z": 0.5} and box["pose"]["position"]["z"] == pytest.approx(-0.75)
    first = [e for e in read["/scene"][0][2]["entities"] if e["id"] == "OM1"]
    assert first[0]["cylinders"][0]["size"]["x"] == pytest.approx(0.4), "the vehicle's radius"
    gone = [d["id"] for _, _, m in read["/scene"] for d in m["deletions"]]
    bodies = [{b.name for b in step} for step in run().record.obstacles]
    assert ("OM1" in gone) == ("OM1" not in bodies[-1])


def test_an_obstacle_named_hull_is_not_drawn_as_the_hull(tmp_path: Path) -> None:
    need_module("mcap")
    with McapFile(tmp_path / "a.mcap") as file:
        scene = SceneFile(file, run().scenario, run().vehicle)
        bodies = [replace(run().record.obstacles[0][0], name=name) for name in ("hull", 'the "site"', "site")]
        scene.moment(0.0, eta=np.zeros(4), nu=np.zeros(4), tau=None, status=None, bodies=bodies)
        scene.moment(1.0, eta=np.zeros(4), nu=np.zeros(4), tau=None, status=None)
    read = messages((tmp_path / "a.mcap").read_bytes())
    ids = [entity["id"] for entity in read["/scene"][0][2]["entities"]]
    assert ids == ["hull", "site", "obstacle hull", 'the "site"', "obstacle site"]
    assert {gone["id"] for gone in read["/scene"][1][2]["deletions"]} == set(ids[2:])
    assert "/thrust" not in read and read["/status"][0][2]["status"] is None


def test_foxglove_s_definitions_read_every_message(tmp_path: Path) -> None:
    need_module("foxglove_schemas_protobuf")
    from google.protobuf import json_format

    def native(value: Any) -> Any:  # JSON of Protobuf has texts for times
        if isinstance(value, dict):
            if set(value) == {"sec", "nsec"}:
                return None
            return {k: n for k, v in value.items() if (n := native(v)) is not None}
        return [native(v) for v in value] if isinstance(value, list) else value

    scene = run()
    data = BytesIO()
    path = tmp_path / "all.mcap"
    with McapFile(path) as file:
        log = SceneFile(file, scene.scenario, scene.vehicle)
        log.text(0.0, "begins", warning=True)
        log.moment(
            0.0, eta=scene.record.eta[0], nu=np.zeros(4), tau=np.zeros(4), status=1, tilt=(0.1, -0.2),
            bodies=scene.record.obstacles[0], ranges=np.array([1.0, 4.5, 0.3, 2.0]),
        )  # fmt: skip
    data.write(path.read_bytes())
    kinds = set()
    for rows in messages(data.getvalue()).values():
        for _, name, message in rows:
            package, _, kind = name.partition(".")
            if package == "foxglove":
                module = importlib.import_module(f"foxglove_schemas_protobuf.{kind}_pb2")
                json_format.ParseDict(native(message), getattr(module, kind)())  # refuses unknown fields
                kinds.add(name)
    assert kinds == {name for name in SCHEMAS if name.startswith("foxglove.")}


def test_sonars_are_arcs_and_no_echo_is_empty(tmp_path: Path) -> None:
    need_module("mcap")
    with McapFile(tmp_path / "a.mcap") as file:
        scene = SceneFile(file, run().scenario, run().vehicle)
        scene.moment(
            1.0, eta=np.zeros(4), nu=np.zeros(4), tau=np.zeros(4), status=0, ranges=np.array([1.0, 4.5, 4.5, 4.5])
        )
    read = messages((tmp_path / "a.mcap").read_bytes())
    front, left = read["/sonar/0"][0][2], read["/sonar/1"][0][2]
    assert set(front["ranges"]) == {1.0} and left["ranges"] == []
    assert front["pose"]["position"]["x"] == pytest.approx(0.2) and front["start_angle"] == -front["end_angle"]


def test_equal_runs_give_equal_bytes_and_an_hour_is_small(tmp_path: Path) -> None:
    (tmp_path / "again").mkdir()
    one, other = save_scene(run(), tmp_path), save_scene(run(), tmp_path / "again")
    assert one.read_bytes() == other.read_bytes()
    assert one.stat().st_size / run().record.time[-1] * 3600 < 100e6
    assert not list(tmp_path.glob("*.part*"))


def test_a_killed_process_loses_only_the_last_second(tmp_path: Path) -> None:
    need_module("mcap")
    file = McapFile(tmp_path / "a.mcap")
    scene = SceneFile(file, run().scenario, run().vehicle)
    for k in range(100):
        scene.moment(0.05 * k, eta=np.zeros(4), nu=np.zeros(4), tau=np.zeros(4), status=0)
        if k == 79:
            file.flush()
    cut = (tmp_path / "a.mcap").read_bytes()
    file.close()
    assert len(messages(cut, whole=False)["/pose"]) == 80


def test_numbers_that_are_none_become_null_and_mistakes_are_one_line(tmp_path: Path) -> None:
    need_module("mcap")
    with McapFile(tmp_path / "a.mcap") as file:
        scene = SceneFile(file, run().scenario, run().vehicle)
        scene.moment(0.0, eta=np.full(4, np.nan), nu=np.zeros(4), tau=np.zeros(4), status=0)
    assert messages((tmp_path / "a.mcap").read_bytes())["/state"][0][2]["x_m"] is None
    with pytest.raises(InputError, match="exists already"):
        McapFile(tmp_path / "a.mcap", new=True)
    with pytest.raises(InputError, match="use enu for mcap"):
        save_record(run(), tmp_path, kind="mcap", frame="ned")


def test_the_layout_shows_what_the_file_has(tmp_path: Path) -> None:
    read = messages(save_scene(run(), tmp_path).read_bytes())
    layout = json.loads((tmp_path / LAYOUT).read_text())
    panels = layout["configById"]
    assert set(panels["3D!scene"]["topics"]) <= set(read)
    for name, panel in panels.items():
        for path in panel.get("paths", []):
            topic, _, field = path["value"].partition(".")
            assert field in read[topic][0][2], (name, path)

    def leaves(part: Any) -> set[str]:
        return {part} if isinstance(part, str) else leaves(part["first"]) | leaves(part["second"])

    assert leaves(layout["layout"]) == set(panels)
