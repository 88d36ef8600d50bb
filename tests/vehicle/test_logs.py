"""Logs of other programs: what is read is the motion that was written, in surctl's frame, with one time for all."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.vehicle import FRAME_TEXT
from surctl.marine.vehicle.logs.joining import roll_pitch_heading
from surctl.marine.vehicle.logs.read import read_mapped_log, read_recording, topic_lines
from surctl.marine.vehicle.logs.recording import TopicRows, step_back
from surctl.marine.vehicle.motion_log import heading_frame, read_motion_log, swap_body, swap_pose
from surctl.recorded import read_recorded
from tests.vehicle import logs_written as written

DIVE = written.dive()
THRUSTERS = f"""
command = {list(written.CURVE[0])}
force_N = {list(written.CURVE[1])}
matrix = {[list(row) for row in written.MATRIX]}
"""
ODOMETRY = """
kind = "log-map"
[log]
frame = "ned"
[position]
topic = "/odom"
fields = ["pose.pose.position.x", "pose.pose.position.y", "pose.pose.position.z"]
[attitude]
topic = "/odom"
fields = ["pose.pose.orientation.x", "pose.pose.orientation.y", "pose.pose.orientation.z", "pose.pose.orientation.w"]
[velocity]
topic = "/odom"
fields = ["twist.twist.linear.x", "twist.twist.linear.y", "twist.twist.linear.z"]
frame = "body"
[rates]
topic = "/odom"
fields = ["twist.twist.angular.z"]
[thrust]
topic = "/wrench"
fields = ["data[0]", "data[1]", "data[2]", "data[3]"]
"""
BIN = f"""
kind = "log-map"
[log]
frame = "ned"
[position]
topic = "XKF1"
fields = ["PN", "PE", "PD"]
[attitude]
topic = "ATT"
fields = ["Roll", "Pitch", "Yaw"]
unit = "deg"
[velocity]
topic = "XKF1"
fields = ["VN", "VE", "VD"]
frame = "world"
[thrust]
topic = "RCOU"
fields = ["C1", "C2", "C3", "C4", "C5", "C6"]
{THRUSTERS}
"""
TLOG = f"""
kind = "log-map"
[log]
frame = "ned"
[position]
topic = "LOCAL_POSITION_NED"
fields = ["x", "y", "z"]
[attitude]
topic = "ATTITUDE"
fields = ["roll", "pitch", "yaw"]
[velocity]
topic = "LOCAL_POSITION_NED"
fields = ["vx", "vy", "vz"]
frame = "world"
[thrust]
topic = "SERVO_OUTPUT_RAW"
fields = ["servo1_raw", "servo2_raw", "servo3_raw", "servo4_raw", "servo5_raw", "servo6_raw"]
{THRUSTERS}
"""
ULOG = """
kind = "log-map"
[log]
frame = "ned"
[position]
topic = "vehicle_odometry"
fields = ["position[0]", "position[1]", "position[2]"]
[attitude]
topic = "vehicle_odometry"
fields = ["q[1]", "q[2]", "q[3]", "q[0]"]
[velocity]
topic = "vehicle_odometry"
fields = ["velocity[0]", "velocity[1]", "velocity[2]"]
frame = "world"
[rates]
topic = "vehicle_odometry"
fields = ["r"]
[thrust]
topic = "wrench"
fields = ["f[0]", "f[1]", "f[2]", "f[3]"]
"""
JSON = """
kind = "log-map"
[log]
frame = "ned"
[position]
topic = "state"
fields = ["p[0]", "p[1]", "p[2]"]
[attitude]
topic = "state"
fields = ["q[0]", "q[1]", "q[2]", "q[3]"]
[velocity]
topic = "state"
fields = ["v[0]", "v[1]", "v[2]"]
frame = "world"
[rates]
topic = "state"
fields = ["r"]
[thrust]
topic = "f"
fields = ["f[0]", "f[1]", "f[2]", "f[3]"]
"""
FORMATS: dict[str, tuple[str, str, Callable[[Path], None]]] = {
    "bin": ("dive.BIN", BIN, lambda path: written.write_bin(path, DIVE)),
    "tlog": ("dive.tlog", TLOG, lambda path: written.write_tlog(path, DIVE)),
    "ulog": ("dive.ulg", ULOG, lambda path: written.write_ulog(path, DIVE)),
    "ros1": ("dive.bag", ODOMETRY, lambda path: written.write_bag(path, DIVE, kind="ros1")),
    "ros2-db3": ("dive", ODOMETRY, lambda path: written.write_bag(path, DIVE, kind="sqlite3")),
    "ros2-mcap": ("dive", ODOMETRY, lambda path: written.write_bag(path, DIVE, kind="mcap")),
    "mcap-json": ("dive.mcap", JSON, lambda path: written.write_mcap(path, DIVE)),
}


@pytest.mark.parametrize("kind", FORMATS)
def test_what_is_read_is_what_was_written(kind: str, tmp_path: Path) -> None:
    name, text, write = FORMATS[kind]
    write(tmp_path / name)
    (tmp_path / "map.toml").write_text(text)
    log = read_mapped_log(tmp_path / name, tmp_path / "map.toml")
    at = np.searchsorted(DIVE.time, DIVE.command_time[0])  # the first time at which both topics are known
    count = len(log.time)
    assert count >= len(DIVE.time) - 3
    np.testing.assert_allclose(np.diff(log.time), 0.05, atol=1e-5)
    rows = slice(at, at + count)
    pose = swap_pose(np.column_stack([DIVE.position, DIVE.angles[:, 2]]))[rows]
    np.testing.assert_allclose(log.motion[:, :3], pose[:, :3], atol=1e-5)
    turns = (log.motion[:, 3] - pose[:, 3]) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns[0]), atol=1e-5)
    velocity = swap_body(np.column_stack([DIVE.heading, DIVE.rate]))[rows]
    np.testing.assert_allclose(log.motion[:, 4:7], velocity[:, :3], atol=1e-5)
    if kind in ("bin", "tlog"):  # no yaw rate in the map
        assert np.isnan(log.motion[:, 7]).all()
    else:
        np.testing.assert_allclose(log.motion[:, 7], velocity[:, 3], atol=1e-6)
    place = np.searchsorted(DIVE.command_time, DIVE.time[rows] + 1e-9, side="right") - 1
    np.testing.assert_allclose(log.thrust, swap_body(DIVE.force)[place], atol=1e-5)


def test_a_ros2_mcap_alone_is_read(tmp_path: Path) -> None:
    written.write_bag(tmp_path / "dive", DIVE, kind="mcap")
    (file,) = (tmp_path / "dive").glob("*.mcap")
    (tmp_path / "map.toml").write_text(ODOMETRY)
    one = read_mapped_log(file, tmp_path / "map.toml")
    other = read_mapped_log(tmp_path / "dive", tmp_path / "map.toml")
    assert one.motion.tobytes() == other.motion.tobytes()


def test_clocks_without_common_time_are_told_and_a_shift_joins_them(tmp_path: Path) -> None:
    written.write_bag(tmp_path / "dive.bag", DIVE, kind="ros1")
    file = tmp_path / "map.toml"
    own = ODOMETRY.replace('frame = "ned"', 'frame = "ned"\nstamp = { "/odom" = "header.stamp" }', 1)
    file.write_text(own)
    with pytest.raises(InputError, match=r"thrust \(/wrench\): has no time in common with .*log.shift_s"):
        read_mapped_log(tmp_path / "dive.bag", file)
    file.write_text(
        own.replace('"header.stamp" }', f'"header.stamp" }}\nshift_s = {{ "/odom" = {written.START - 100} }}')
    )
    joined = read_mapped_log(tmp_path / "dive.bag", file)
    file.write_text(ODOMETRY)
    np.testing.assert_allclose(joined.thrust, read_mapped_log(tmp_path / "dive.bag", file).thrust)


def test_a_common_period_and_a_gap(tmp_path: Path) -> None:
    rows = [(t, 0.5 * t, k) for k, t in enumerate(np.arange(0.0, 20.0, 0.1)) if not 8.0 < t < 12.0]
    text = "stamp,speed,force,mode\n" + "".join(f"{round(1e9 * t)},{v},{k},AUTO\n" for t, v, k in rows)
    (tmp_path / "log.csv").write_text(text)
    file = tmp_path / "map.toml"
    file.write_text(
        'kind = "log-map"\nlog = { frame = "enu", time = "stamp", time_unit = "ns", period_s = 0.25 }\n'
        'velocity = { fields = ["speed", "speed"], unit = "km/h", frame = "heading" }\n'
        'thrust = { fields = ["force", "", "", ""], unit = "kgf" }\n'
    )
    log = read_mapped_log(tmp_path / "log.csv", file)
    np.testing.assert_allclose(np.unique(np.round(np.diff(log.time), 6)), [0.25, 3.0])  # no command counts in the gap
    np.testing.assert_allclose(log.motion[4, 4:6], 0.5 / 3.6)
    assert np.isnan(log.motion[:, [0, 1, 2, 3, 6, 7]]).all()
    assert log.thrust[1].tolist() == [pytest.approx(2 * 9.80665), 0.0, 0.0, 0.0]


def test_angles_are_those_of_scipy() -> None:
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(1)
    turned = Rotation.from_quat(rng.normal(size=(200, 4)))
    angles = roll_pitch_heading(3.0 * turned.as_quat())
    np.testing.assert_allclose(angles, turned.as_euler("ZYX")[:, ::-1], atol=1e-9)
    body = rng.normal(size=(200, 3))
    level = Rotation.from_euler("z", -angles[:, 2:]) * turned
    np.testing.assert_allclose(heading_frame(body, roll=angles[:, 0], pitch=angles[:, 1]), level.apply(body), atol=1e-9)


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        (("/odom", "/odomm"), r"map.toml: .*topic = '/odomm': is not a topic of .*did you mean '/odom'"),
        (("data[3]", "data[4]"), r"thrust.fields = 'data\[4\]': is not a numeric field of topic /wrench"),
        (('frame = "ned"', 'frame = "nde"'), "map.toml: log.frame = 'nde'"),
        (('frame = "body"', 'frame = "bodi"'), "velocity.frame = 'bodi'"),
        (('fields = ["twist.twist.angular.z"]', 'fields = ["twist.twist.angular.z"]\nunit = "kg"'), "rates.unit"),
        (("[thrust]", "[thrust]\nmatrix = [[1], [0], [0], [0]]"), "matrix needs 4 numbers"),
        (("[thrust]", "[thrust]\ncommand = [1, 2]\nforce_N = [1, 2]"), "no matrix"),
        (("[rates]", "[rate]"), "rate: unknown key"),
        (("[log]", '[log]\nstamp = { "/odom" = "twist" }'), "stamp./odom = 'twist': is not a time"),
        (("[log]", '[log]\nshift_s = { "/odo" = 1.0 }'), "'/odo': is not a topic of this map"),
    ],
)
def test_a_map_that_cannot_be_used(change: tuple[str, str], fragment: str, tmp_path: Path, bag: Path) -> None:
    (tmp_path / "map.toml").write_text(ODOMETRY.replace(*change))
    with pytest.raises(InputError, match=fragment) as caught:
        read_mapped_log(bag, tmp_path / "map.toml")
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "dive.bag"
    written.write_bag(path, DIVE, kind="ros1")
    return path


def test_topics_are_listed(bag: Path) -> None:
    lines = topic_lines(read_recording(bag))
    assert lines[0].startswith("/odom: 240 messages, 20 Hz: header.") and "pose.pose.position.x" in lines[0]
    assert lines[1].startswith("/wrench: 120 messages, 10 Hz: ") and lines[1].endswith("data[3]")


@pytest.mark.parametrize(
    ("suffix", "module", "extra"),
    [
        (".BIN", "pymavlink.mavutil", "ardupilot"),
        (".bag", "rosbags.highlevel", "ros"),
        (".mcap", "mcap.reader", "ros"),
        (".ulg", "pyulog", "px4"),
    ],
)
def test_a_package_that_is_missing_and_a_file_that_is_none(
    suffix: str,
    module: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / f"log{suffix}"
    path.write_bytes(b"no log" * 20)
    with pytest.raises(InputError) as wrong:
        read_recording(path)
    assert capfd.readouterr() == ("", ""), "readers print nothing beside the error"
    assert "\n" not in str(wrong.value) and path.name in str(wrong.value)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"needs the package .*pip install 'surctl\[{extra}\]'"):
        read_recording(path)


def test_columns_in_other_units(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    stamp = 1_700_000_000_000_000_000
    rows = "".join(f"{stamp + 100_000_000 * k},{10 * k},{k},1,0,0,0\n" for k in range(60))
    file.write_text("t_ns,psi_deg,u_cm_per_s,Fu_kgf,Fv_N,Fw_N,Fr_N_m\n" + rows)
    log = read_motion_log(file)
    np.testing.assert_allclose(log.time, 0.1 * np.arange(60), atol=1e-9)
    np.testing.assert_allclose(log.motion[-1, [3, 4]], [np.radians(590), 0.59])
    assert log.thrust[0, 0] == pytest.approx(9.80665)
    file.write_text(file.read_text().replace("Fu_kgf", "Fu_lb"))
    with pytest.raises(InputError, match="column 'Fu_N' is missing"):
        read_motion_log(file)


def test_matlab_7_3_is_read(tmp_path: Path) -> None:
    import h5py

    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name in ("t_s", "x_m", "Fu_N", "Fv_N", "Fw_N", "Fr_N_m"):
            file[name] = np.arange(60.0)[None, :]
        file["frame"] = np.array([[ord(c)] for c in FRAME_TEXT["ned"]], dtype=np.uint16)
        file["frame"].attrs["MATLAB_class"] = np.bytes_("char")
        file["pulse"] = np.full((1, 60), 65535, dtype=np.uint16)
        cells = file.create_dataset("cells", (2, 1), dtype=h5py.ref_dtype)
        cells[0, 0] = file["t_s"].ref
    raw = bytearray(path.read_bytes())
    raw[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path.write_bytes(raw)
    log = read_motion_log(path)
    assert log.motion[5, 1] == 5.0 and log.time[-1] == 59.0  # north is y
    assert read_recorded(path).numbers("pulse").tolist() == [65535.0] * 60


def test_a_missing_whole_number_of_a_netcdf_file_is_no_number(tmp_path: Path) -> None:
    import netCDF4

    with netCDF4.Dataset(tmp_path / "log.nc", "w") as file:
        file.createDimension("row", 3)
        file.createVariable("t_s", "f8", ("row",))[:] = np.arange(3.0)
        file.createVariable("count", "i4", ("row",))[:2] = [4, 5]
    np.testing.assert_array_equal(read_recorded(tmp_path / "log.nc").numbers("count"), [4.0, 5.0, np.nan])


def test_a_table_without_a_header_or_time_says_where_to_name_them(tmp_path: Path) -> None:
    table, named = tmp_path / "run.txt", tmp_path / "map.toml"
    table.write_text("0.0 1.0 2.0\n0.1 1.0 2.0\n")
    with pytest.raises(InputError, match=r"run.txt:1: has no header.*--map with columns"):
        read_motion_log(table)
    table.write_text("seconds,r,Fr\n0.0,1.0,2.0\n0.1,1.0,2.0\n")
    text = 'kind = "log-map"\n[log]\nframe = "enu"\n[rates]\nfields = ["r"]\n[thrust]\nfields = ["", "", "", "Fr"]\n'
    named.write_text(text)
    with pytest.raises(InputError, match=r"^\S*map.toml: log.time = 't_s': is not a column of \S*run.txt"):
        read_mapped_log(table, named)


def _moving(rows: int = 60) -> list[list[float]]:
    return [[0.5 * k, 0.1 * k, 1.0, 0.0, 0.0, 0.0] for k in range(rows)]


@pytest.mark.parametrize(
    ("rows", "fragment"),
    [
        ([*_moving(), *_moving()], r"clock that runs back: 0.000 s comes after 29.500 s; sort the rows by time"),
        (_moving()[::-1], r"velocity \(table\): has a clock that runs back: .*; sort"),
        (_moving(1), r"run.csv: t_s: has only one row with a time; give a longer log"),
        ([[t, u, *4 * [math.nan]] for t, u, *_ in _moving()], r"run.csv: thrust \(table\): has no command at any of"),
        ([[math.nan, *row[1:]] for row in _moving()], r"map.toml: log.time = 't_s': has no timestamps in \S*run.csv"),
    ],
)
def test_rows_that_are_no_log(rows: list[list[float]], fragment: str, tmp_path: Path) -> None:
    lines = ["t_s,u_m_per_s,Fu_N,Fv_N,Fw_N,Fr_N_m", *(",".join(map(str, row)) for row in rows)]
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "map.toml").write_text(
        'kind = "log-map"\n[log]\nframe = "enu"\n[velocity]\nfields = ["u_m_per_s", ""]\nframe = "heading"\n'
        '[thrust]\nfields = ["Fu_N", "Fv_N", "Fw_N", "Fr_N_m"]\n'
    )
    with pytest.raises(InputError, match=fragment) as caught:
        read_mapped_log(tmp_path / "run.csv", tmp_path / "map.toml")
    assert "\n" not in str(caught.value)


def test_a_frame_that_is_unknown_is_named_with_its_file(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("# frame=nwu\nt_s,Fu_N,Fv_N,Fw_N,Fr_N_m\n0,1,0,0,0\n")
    with pytest.raises(InputError, match=r"run.csv: --frame = 'nwu': is not known; give enu .* or ned"):
        read_motion_log(tmp_path / "run.csv", frame="nwu")
    with pytest.raises(InputError, match=r"run.csv: frame = 'nwu': is not known; give enu .* or ned"):
        read_motion_log(tmp_path / "run.csv")


def test_messages_that_are_a_little_late_are_sorted_and_a_clock_that_starts_anew_is_not() -> None:
    assert step_back(np.array([0.0, 2.0, 1.5, 3.0])) is None
    rows = TopicRows([0.0, 2.0, 1.5, 3.0], [{"a": float(k)} for k in range(4)])
    assert rows.topic().time.tolist() == [0.0, 1.5, 2.0, 3.0] and rows.topic().back is None
    assert TopicRows([5.0, 6.0, 0.0], [{"a": 0.0}] * 3).topic().back == (6.0, 0.0)
