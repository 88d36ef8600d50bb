"""Logs of several sources: no messages of two sources are mixed, and what is not used is counted."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from surctl.errors import InputError
from surctl.marine.cli.vehicle import vehicle
from surctl.marine.vehicle.logs.read import read_mapped_log, read_recording
from surctl.marine.vehicle.motion_log import read_motion_log
from tests.vehicle import logs_written as written
from tests.vehicle.test_logs import TLOG

DIVE = written.dive()


def _tlog(path: Path, sent: list[tuple[float, int, int, int, int]]) -> None:
    # (time, system, component, port, value)
    from pymavlink.dialects.v20 import ardupilotmega

    raw = b""
    for t, system, component, port, value in sent:
        link = ardupilotmega.MAVLink(None, srcSystem=system, srcComponent=component)
        message = ardupilotmega.MAVLink_servo_output_raw_message(round(1e6 * t), port, *[value] * 8)
        raw += struct.pack(">Q", round(1e6 * (written.START + t))) + message.pack(link)
    path.write_bytes(raw)


def _ros1(path: Path, sent: list[tuple[float, str, int]]) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    name = "std_msgs/msg/Int32"
    with Writer(path) as bag:
        connections: dict[str, Any] = {}
        for t, node, value in sent:
            if node not in connections:
                connections[node] = bag.add_connection("/cmd", name, typestore=store, callerid=node)
            raw = store.serialize_ros1(store.types[name](data=value), name)
            bag.write(connections[node], round(1e9 * (written.START + t)), raw)


def _mcap(path: Path, sent: list[tuple[float, str, int]]) -> None:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name="n", encoding="jsonschema", data=b"{}")
        channels = {
            source: writer.register_channel("cmd", "json", schema, metadata={"node": source}) for _, source, _ in sent
        }
        for t, source, value in sent:
            stamp = round(1e9 * (written.START + t))
            writer.add_message(channels[source], stamp, json.dumps({"data": value}).encode(), stamp)
        writer.finish()


def _values(fields: Any) -> list[float]:
    return list(fields["servo1_raw" if "servo1_raw" in fields else "data"])


@pytest.mark.parametrize("seed", range(6))
def test_each_system_component_and_port_of_a_telemetry_log_is_its_own_topic(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    sources = [(s, c) for s in (1, 2) for c in (1, 191)]
    chosen = [sources[k] for k in rng.permutation(4)[: rng.integers(1, 4)]]
    ports = sorted(rng.permutation(3)[: rng.integers(1, 4)].tolist())
    streams = [(*source, port) for source in chosen for port in ports]
    picks = [*range(len(streams)), *rng.integers(len(streams), size=60).tolist()]
    sent = [(0.05 * k, *streams[pick], 1000 + 10 * pick + k % 10) for k, pick in enumerate(picks)]
    _tlog(tmp_path / "a.tlog", sent)
    recording = read_recording(tmp_path / "a.tlog")
    for source in chosen:
        for port in ports:
            base = "SERVO_OUTPUT_RAW" + (f"[{port}]" if port != ports[0] else "")
            full = f"{base}@{source[0]}.{source[1]}"
            expected = [float(value) for _, s, c, p, value in sent if (s, c, p) == (*source, port)]
            assert _values(recording.topic(full, key="topic").fields) == expected
            if len(chosen) == 1:
                assert _values(recording.topics[base].fields) == expected
            else:
                with pytest.raises(
                    InputError, match=rf"several sources in \S*a.tlog; name one of: .*{re.escape(full)}"
                ):
                    recording.topic(base, key="thrust.topic")
    assert len(recording.topics) == len(streams)


@pytest.mark.parametrize(("suffix", "write", "topic"), [("bag", _ros1, "/cmd"), ("mcap", _mcap, "cmd")])
def test_publishers_of_one_topic_are_not_mixed(suffix: str, write: Any, topic: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    nodes = ["/pilot", "/filter", *rng.choice(["/pilot", "/filter"], 40).tolist()]
    path = tmp_path / f"a.{suffix}"
    write(path, [(0.1 * k, node, k) for k, node in enumerate(nodes)])
    recording = read_recording(path, [topic])
    with pytest.raises(InputError, match="several sources"):
        recording.topic(topic, key="thrust.topic")
    got = sorted(_values(one.fields) for one in recording.topics.values())
    assert got == sorted([[float(k) for k, other in enumerate(nodes) if other == n] for n in ("/pilot", "/filter")])
    write(tmp_path / f"b.{suffix}", [(0.1 * k, "/pilot", k) for k in range(10)])
    assert list(read_recording(tmp_path / f"b.{suffix}").topics) == [topic]


def test_a_second_port_leaves_the_log_as_it_is_and_is_named(tmp_path: Path) -> None:
    written.write_tlog(tmp_path / "one.tlog", DIVE)
    raw = (tmp_path / "one.tlog").read_bytes()
    _tlog(tmp_path / "other.tlog", [(t, 1, 1, 1, 0) for t in DIVE.command_time + 0.01])
    (tmp_path / "two.tlog").write_bytes(raw + (tmp_path / "other.tlog").read_bytes())
    (tmp_path / "map.toml").write_text(TLOG)
    one, two = (read_mapped_log(tmp_path / f"{k}.tlog", tmp_path / "map.toml") for k in ("one", "two"))
    assert one.motion.tobytes() == two.motion.tobytes() and one.thrust.tobytes() == two.thrust.tobytes()
    assert one.notes == () and two.notes == ("SERVO_OUTPUT_RAW is the first instance; not used: SERVO_OUTPUT_RAW[1]",)
    (tmp_path / "map.toml").write_text(TLOG.replace('"SERVO_OUTPUT_RAW"', '"SERVO_OUTPUT_RAW[1]"'))
    with pytest.raises(InputError, match=r"120 of 120 commands lie outside the table thrust.command, 1100 to 1900 \(0"):
        read_mapped_log(tmp_path / "two.tlog", tmp_path / "map.toml")


@pytest.mark.parametrize("sentinel", [0, 900, 65535, 1901])
def test_a_command_outside_the_table_is_no_thrust(sentinel: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(sentinel)
    rows = [[0.1 * k, 0.01 * k, *rng.integers(1100, 1900, 2)] for k in range(200)]
    without = rng.permutation(200)[:40]
    for k in without:
        rows[k][2 + k % 2] = sentinel
    (tmp_path / "a.csv").write_text("t_s,u,a,b\n" + "".join(f"{t:.1f},{u:.2f},{a},{b}\n" for t, u, a, b in rows))
    (tmp_path / "map.toml").write_text(
        'kind = "log-map"\nlog = { frame = "enu" }\nvelocity = { fields = ["u", ""], frame = "heading" }\n'
        '[thrust]\nfields = ["a", "b"]\ncommand = [1100, 1500, 1900]\nforce_N = [-40, 0, 50]\n'
        "matrix = [[1, 1], [0, 0], [0, 0], [0.1, -0.1]]\n"
    )
    log = read_mapped_log(tmp_path / "a.csv", tmp_path / "map.toml")
    assert set(np.round(10 * log.time).astype(int)) == set(range(200)) - set(without.tolist())
    first = np.interp(rows[np.setdiff1d(range(200), without)[0]][2:], [1100, 1500, 1900], [-40, 0, 50]).sum()
    assert log.thrust[0, 0] == pytest.approx(first)
    assert log.notes == (
        f"40 of 200 commands lie outside the table thrust.command, 1100 to 1900 ({sentinel:g}): the thrust there is "
        "not known",
    )


def _without_subscription(path: Path, topic: int) -> None:
    # removes the record that says what the messages of a topic are
    raw, at = path.read_bytes(), 16
    while at < len(raw):
        size, kind, number = struct.unpack_from("<HcxH", raw, at)
        if (kind, number) == (b"A", topic):
            path.write_bytes(raw[:at] + raw[at + 3 + size :])
            return
        at += 3 + size
    raise AssertionError


def test_messages_that_cannot_be_read_are_counted_and_stdout_has_one_object(tmp_path: Path) -> None:
    path = tmp_path / "dive.ulg"
    written.write_ulog(path, DIVE)
    _without_subscription(path, 1)
    count = len(DIVE.time) + len(DIVE.command_time)
    for options in ([str(path), "--topics", "--json"], [str(path), "--topics"]):
        result = CliRunner().invoke(vehicle, ["from-log", *options])
        note = f"{len(DIVE.time)} of {count} messages could be read: dive.ulg does not say what the others are"
        assert result.exit_code == 0 and note in result.stdout and "no subscription" not in result.stderr
    assert json.loads(CliRunner().invoke(vehicle, ["from-log", str(path), "--topics", "--json"]).stdout)["notes"]


def _records(raw: bytes) -> list[tuple[int, int]]:
    # begin and end of the data messages of a ULog
    at, result = 16, []
    while at < len(raw):
        size, kind = struct.unpack_from("<Hc", raw, at)
        result += [(at, at + 3 + size)] if kind == b"D" else []
        at += 3 + size
    return result


@pytest.mark.parametrize("seed", range(3))
def test_a_ulog_says_what_it_lost(seed: int, tmp_path: Path) -> None:
    path, rng = tmp_path / "dive.ulg", np.random.default_rng(seed)
    written.write_ulog(path, DIVE)
    raw = path.read_bytes()
    records = _records(raw)
    begin, end = records[int(rng.integers(20, len(records) - 20))]
    lost, pause = int(rng.integers(1, 9)), int(rng.integers(1, 900))
    short = struct.pack("<Hc", end - begin - 3 - lost, b"D") + raw[begin + 3 : end - lost]
    dropout = struct.pack("<HcH", 2, b"O", pause)
    damage = {
        "": raw,
        f"1 of {len(records)} messages have a wrong length": raw[:begin] + short + raw[end:],
        f"cut at byte {begin} of {end - lost}": raw[: end - lost],
        f"damaged or cut at byte {begin} of": raw[:begin] + bytes(40) + raw[begin:],
        f"2 dropouts, {2e-3 * pause:g} s in all": raw[:begin] + dropout + raw[begin:end] + dropout + raw[end:],
    }
    for text, data in damage.items():
        path.write_bytes(data)
        for topics in (None, {"wrench", "vehicle_odometry"}):
            notes = read_recording(path, topics).notes
            assert len(notes) == bool(text) and text in "".join(notes), text


@pytest.mark.parametrize("seed", range(4))
def test_rows_of_one_time_are_named_or_counted(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    row = int(rng.integers(1, 90))
    times = 0.1 * np.arange(90)
    times[row] = times[row - 1]
    text = "t_s,u_m_per_s,Fu_N,Fv_N,Fw_N,Fr_N_m\n" + "".join(f"{t:.1f},0.{k:02},1,0,0,0\n" for k, t in enumerate(times))
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError, match=rf"a.csv:{row + 2}: t_s = .* is the time of the previous row too; write the"):
        read_motion_log(tmp_path / "a.csv")
    (tmp_path / "map.toml").write_text(
        'kind = "log-map"\n[log]\nframe = "enu"\n[velocity]\nfields = ["u_m_per_s", ""]\nframe = "heading"\n'
        '[thrust]\nfields = ["Fu_N", "Fv_N", "Fw_N", "Fr_N_m"]\n'
    )
    log = read_mapped_log(tmp_path / "a.csv", tmp_path / "map.toml")
    assert log.notes == ("1 of 90 messages of the table repeat a time: not used",) and len(log.time) == 89
