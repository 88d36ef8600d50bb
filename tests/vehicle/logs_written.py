"""Writers of small logs in the formats of other programs, from one simulated dive."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
START = 1_700_000_000.0  # s, the recorder's clock
CURVE = ((1100.0, 1475.0, 1525.0, 1900.0), (-40.0, 0.0, 0.0, 50.0))  # PWM, N
MATRIX = ((0.7, 0.7, -0.7, -0.7, 0, 0), (0.7, -0.7, 0.7, -0.7, 0, 0), (0, 0, 0, 0, 1, 1), (0.2, -0.2, -0.2, 0.2, 0, 0))


@dataclass(frozen=True)
class Dive:
    """A motion in NED/FRD with roll and pitch, sampled at 20 Hz; commands of six thrusters at 10 Hz, 3 ms later."""

    time: Array
    position: Array
    angles: Array  # roll, pitch, yaw
    body: Array  # velocity u, v, w in the body frame
    heading: Array  # velocity in the heading frame
    rate: Array
    command_time: Array
    pwm: Array
    force: Array  # (n, 4) at the command times

    @property
    def world(self) -> Array:
        c, s = np.cos(self.angles[:, 2]), np.sin(self.angles[:, 2])
        u, v, w = self.heading.T
        return np.column_stack([c * u - s * v, s * u + c * v, w])

    @property
    def quaternion(self) -> Array:
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_euler("ZYX", self.angles[:, ::-1]).as_quat())


def dive() -> Dive:
    t = np.arange(0.0, 12.0, 0.05)
    yaw, roll, pitch = 0.5 * t + 2.9, 0.2 * np.sin(t), 0.1 * np.cos(0.7 * t)
    heading = np.column_stack([0.5 + 0.1 * np.sin(t), 0.1 * np.cos(t), 0.05 * np.sin(0.5 * t)])
    from scipy.spatial.transform import Rotation

    tilt = Rotation.from_euler("YX", np.column_stack([pitch, roll]))
    body = tilt.inv().apply(heading)
    c, s = np.cos(yaw), np.sin(yaw)
    world = np.column_stack(
        [c * heading[:, 0] - s * heading[:, 1], s * heading[:, 0] + c * heading[:, 1], heading[:, 2]]
    )
    position = np.vstack([np.zeros(3), np.cumsum(0.05 * (world[1:] + world[:-1]) / 2, axis=0)])
    at = np.arange(0.003, 12.0, 0.1)
    rng = np.random.default_rng(5)
    pwm = np.repeat(rng.integers(1100, 1900, (len(at) // 6 + 1, 6)), 6, axis=0)[: len(at)].astype(float)
    force = np.interp(pwm, *CURVE) @ np.array(MATRIX).T
    rate = np.full(len(t), 0.5)
    return Dive(t, position, np.column_stack([roll, pitch, yaw]), body, heading, rate, at, pwm, force)


def write_bin(path: Path, d: Dive) -> None:
    """A dataflash log: ATT and XKF1 (two cores) from the motion, RCOU from the commands."""
    kinds = {
        "FMT": (0x80, "BBnNZ", "Type,Length,Name,Format,Columns"),
        "ATT": (1, "Qfff", "TimeUS,Roll,Pitch,Yaw"),
        "XKF1": (2, "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
        "RCOU": (3, "QHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6"),
        "FMTU": (4, "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
    }
    codes = {"B": "B", "Q": "Q", "f": "f", "H": "H", "n": "4s", "N": "16s", "Z": "64s"}

    def packed(kind: str, *values: Any) -> bytes:
        number, form, _ = kinds[kind]
        held = [v.encode() if isinstance(v, str) else v for v in values]
        return struct.pack("<BBB" + "".join(codes[c] for c in form), 0xA3, 0x95, number, *held)

    raw = b""
    for kind, (number, form, columns) in kinds.items():
        length = 3 + struct.calcsize("<" + "".join(codes[c] for c in form))
        raw += packed("FMT", number, length, kind, form, columns)
    raw += packed("FMTU", 0, 2, "s#------", "F-------")  # the core C is an instance
    for k, t in enumerate(d.time):
        stamp, degrees = round(1e6 * (t + 5)), np.degrees(d.angles[k])
        raw += packed("ATT", stamp, degrees[0], degrees[1], degrees[2] % 360.0)
        raw += packed("XKF1", stamp, 0, *d.world[k], *d.position[k])
        raw += packed("XKF1", stamp, 1, 9, 9, 9, 9, 9, 9)
    for k, t in enumerate(d.command_time):
        raw += packed("RCOU", round(1e6 * (t + 5)), *d.pwm[k].astype(int).tolist())
    path.write_bytes(raw)


def write_tlog(path: Path, d: Dive) -> None:
    """A telemetry log of MAVLink messages, each after its time of reception."""
    from pymavlink.dialects.v20 import ardupilotmega

    link = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=1)
    messages: list[tuple[float, Any]] = []
    for k, t in enumerate(d.time):
        since = round(1e3 * t)
        roll, pitch, yaw = d.angles[k]
        turned = (yaw + np.pi) % (2 * np.pi) - np.pi
        messages.append((t, ardupilotmega.MAVLink_attitude_message(since, roll, pitch, turned, 0.0, 0.0, 0.0)))
        messages.append((t, ardupilotmega.MAVLink_local_position_ned_message(since, *d.position[k], *d.world[k])))
    for t, pwm in zip(d.command_time, d.pwm.astype(int), strict=True):
        message = ardupilotmega.MAVLink_servo_output_raw_message(round(1e6 * t), 0, *pwm.tolist(), 0, 0)
        messages.append((t, message))
    raw = b""
    for t, message in sorted(messages, key=lambda pair: pair[0]):
        raw += struct.pack(">Q", round(1e6 * (START + t))) + message.pack(link)
    path.write_bytes(raw)


def write_ulog(path: Path, d: Dive) -> None:
    """A log of PX4: vehicle_odometry with the quaternion w, x, y, z and velocity in NED, and a wrench."""

    def message(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    raw = bytes([0x55, 0x4C, 0x6F, 0x67, 0x01, 0x12, 0x35, 1]) + struct.pack("<Q", 0)
    raw += message("B", bytes(40))
    raw += message("F", b"vehicle_odometry:uint64_t timestamp;float[3] position;float[4] q;float[3] velocity;float r;")
    raw += message("F", b"wrench:uint64_t timestamp;float[4] f;")
    raw += message("A", struct.pack("<BH", 0, 0) + b"vehicle_odometry") + message(
        "A", struct.pack("<BH", 0, 1) + b"wrench"
    )
    for k, t in enumerate(d.time):
        x, y, z, w = d.quaternion[k]
        numbers = [*d.position[k], w, x, y, z, *d.world[k], d.rate[k]]
        raw += message("D", struct.pack("<HQ11f", 0, round(1e6 * t), *numbers))
    for t, force in zip(d.command_time, d.force, strict=True):
        raw += message("D", struct.pack("<HQ4f", 1, round(1e6 * t), *force))
    path.write_bytes(raw)


def _messages(d: Dive, store: Any) -> list[tuple[str, str, float, Any]]:
    # odometry with twist in the body frame, and the wrench as six numbers of an array
    types = store.types
    stamp, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    extra = {"seq": 0} if "seq" in header.__dataclass_fields__ else {}
    vector, point, quaternion = (types[f"geometry_msgs/msg/{k}"] for k in ("Vector3", "Point", "Quaternion"))
    nothing = np.zeros(36)
    result: list[tuple[str, str, float, Any]] = []
    for k, t in enumerate(d.time):
        seconds = 100.0 + t  # the robot's own clock
        own = header(stamp=stamp(sec=int(seconds), nanosec=round(1e9 * (seconds % 1))), frame_id="map", **extra)
        pose = types["geometry_msgs/msg/Pose"](
            position=point(*d.position[k].tolist()), orientation=quaternion(*d.quaternion[k].tolist())
        )
        twist = types["geometry_msgs/msg/Twist"](
            linear=vector(*d.body[k].tolist()), angular=vector(0.0, 0.0, float(d.rate[k]))
        )
        odometry = types["nav_msgs/msg/Odometry"](
            header=own,
            child_frame_id="base_link",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=nothing),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=nothing),
        )
        result.append(("/odom", "nav_msgs/msg/Odometry", t, odometry))
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    for t, force in zip(d.command_time, d.force, strict=True):
        array = types["std_msgs/msg/Float64MultiArray"](layout=layout, data=force)
        result.append(("/wrench", "std_msgs/msg/Float64MultiArray", t, array))
    return sorted(result, key=lambda entry: entry[2])


def write_bag(path: Path, d: Dive, *, kind: str) -> None:
    """A bag of ROS 1 (`ros1`), or of ROS 2 with the storage `sqlite3` or `mcap`."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    if kind == "ros1":
        bag: Any = Writer1(path)
    else:
        bag = Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3)
    with bag:
        connections: dict[str, Any] = {}
        for topic, typename, t, message in _messages(d, store):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, typename, typestore=store)
            raw = (store.serialize_ros1 if kind == "ros1" else store.serialize_cdr)(message, typename)
            bag.write(connections[topic], round(1e9 * (START + t)), raw)


def write_mcap(path: Path, d: Dive) -> None:
    """An MCAP file with messages in JSON."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name="state", encoding="jsonschema", data=b"{}")
        channels = {
            t: writer.register_channel(topic=t, message_encoding="json", schema_id=schema) for t in ("state", "f")
        }
        for k, t in enumerate(d.time):
            state = {"p": d.position[k].tolist(), "q": d.quaternion[k].tolist(), "v": d.world[k].tolist(), "r": 0.5}
            _add(writer, channels["state"], t, state)
        for t, force in zip(d.command_time, d.force, strict=True):
            _add(writer, channels["f"], t, {"f": force.tolist()})
        writer.finish()


def _add(writer: Any, channel: int, t: float, message: Mapping[str, Any]) -> None:
    stamp = round(1e9 * (START + t))
    writer.add_message(channel_id=channel, log_time=stamp, publish_time=stamp, data=json.dumps(message).encode())
