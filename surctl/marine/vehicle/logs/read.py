"""Read a recording of any format, by its suffix: ArduPilot, ROS, MCAP, tables, PX4; damage and losses it notes."""

from __future__ import annotations

import json
import os
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from surctl.errors import InputError, check_known
from surctl.marine.vehicle.logs.joining import ClockTable, LogMap, joined, load_log_map
from surctl.marine.vehicle.logs.recording import (
    LogRecording,
    Stream,
    Topic,
    TopicRows,
    bare_names,
    flattened,
    matches,
    optional_module,
    recording_of,
    topic_of,
)
from surctl.marine.vehicle.motion_log import MotionLog
from surctl.recorded import Recorded, read_recorded, read_unnamed, shown
from surctl.units import in_unit

_NO_MOTION = ("FMT", "FMTU", "UNIT", "MULT", "PARM")


_Message = tuple[Stream, float, Any]  # stream, time [s], content


def _ardupilot(path: Path, topics: Collection[str] | None, notes: list[str]) -> Iterator[_Message]:
    """Yield messages by type, such as ATT or RCOU; further instances of a type have names such as XKF1[1].

    In a telemetry log, types that several systems or components sent have names such as ATTITUDE@1.1. The time is that
    of the autopilot (TimeUS) in a dataflash log, and the time of reception in a telemetry log.
    """
    mavutil = optional_module("pymavlink.mavutil", path=path, extra="ardupilot")
    kinds = bare_names(topics)
    bad = 0
    log = mavutil.mavlink_connection(str(path), notimestamps=False)
    while (message := log.recv_match(type=kinds and [*kinds, "BAD_DATA"])) is not None:
        kind = message.get_type()
        bad += kind == "BAD_DATA"
        if kind == "BAD_DATA" or kind in _NO_MOTION:
            continue
        values = message.to_dict()
        values.pop("mavpackettype", None)
        time = values["TimeUS"] * 1e-6 if "TimeUS" in values else float(message._timestamp)
        yield _stream(message, values), time, values
    log.close()
    if bad:
        notes.append(f"{bad} parts of {path.name} are no messages: not used")


def _stream(message: Any, values: dict[str, Any]) -> Stream:
    # messages of MAVLink have the field of the instance and the sender themselves, those of a dataflash log in a format
    logged = getattr(message, "fmt", None)
    instance_field = getattr(message if logged is None else logged, "instance_field", None)
    instance = None if instance_field is None else values[instance_field]
    source = f"{message.get_srcSystem()}.{message.get_srcComponent()}" if logged is None else ""
    return Stream(message.get_type(), instance, source)


def _bag(path: Path, topics: Collection[str] | None, _: list[str]) -> Iterator[_Message]:
    """Yield messages of a bag of ROS 1, or of ROS 2 in a folder with metadata.yaml (a file inside it may be named).

    The time is that of the recorder. Custom messages need their definitions in the bag. A topic that several nodes
    published, or that has several types, has names such as `/odom@/filter`.
    """
    highlevel = optional_module("rosbags.highlevel", path=path, extra="ros")
    typesys = optional_module("rosbags.typesys", path=path, extra="ros")
    bag = path
    if path.suffix.lower() == ".db3":
        bag = path.parent
        if not (bag / "metadata.yaml").is_file():
            remedy = "give the folder of the bag: ros2 bag reindex"
            raise InputError("has no metadata.yaml beside it", file=shown(path), remedy=remedy)
    store = typesys.get_typestore(typesys.Stores.LATEST)
    with highlevel.AnyReader([bag], default_typestore=store) as reader:
        chosen = [c for c in reader.connections if matches(c.topic, topics)]
        types = {(c.topic, c.msgtype) for c in reader.connections}
        several = {name for name in {c.topic for c in chosen} if sum(topic == name for topic, _ in types) > 1}
        for connection, stamp, raw in reader.messages(connections=chosen) if chosen else ():
            node = getattr(connection.ext, "callerid", None) or ""
            source = f"{node}:{connection.msgtype}" if connection.topic in several else node
            message = reader.deserialize(raw, connection.msgtype)
            yield Stream(connection.topic, None, source), stamp * 1e-9, message


def _mcap(path: Path, topics: Collection[str] | None, _: list[str]) -> Iterator[_Message]:
    """Yield messages of an MCAP file in JSON, ROS 1 or ROS 2 (CDR); the time is that of the recorder.

    A topic with several channels has names such as `/odom@3`, with the number of the channel.
    """
    reader_of = optional_module("mcap.reader", path=path, extra="ros").make_reader
    decoders: dict[int, Callable[[bytes], Any]] = {}
    with path.open("rb") as file:
        for schema, channel, message in reader_of(file).iter_messages(log_time_order=False):
            if not matches(channel.topic, topics):
                continue
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(path, schema, channel)
            stream = Stream(channel.topic, None, str(channel.id))
            yield stream, message.log_time * 1e-9, decoders[channel.id](message.data)


def _decoder(path: Path, schema: Any, channel: Any) -> Callable[[bytes], Any]:
    encoding = channel.message_encoding
    if encoding == "json":
        return json.loads
    if encoding not in ("cdr", "ros1") or schema is None:
        remedy = "give messages in JSON, ROS 1 or ROS 2 (CDR)"
        raise InputError(f"has the encoding {encoding!r}", file=shown(path), key=channel.topic, remedy=remedy)
    typesys = optional_module("rosbags.typesys", path=path, extra="ros")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(typesys.get_types_from_msg(schema.data.decode(), schema.name))
    name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
    if encoding == "cdr":
        return lambda raw: store.deserialize_cdr(raw, name)
    return lambda raw: store.deserialize_ros1(raw, name)


def _read_table(path: Path, clock: ClockTable, *, map_name: str = "") -> LogRecording:
    """Read the numeric columns of a table as the fields of one topic with an empty name.

    Args:
        path: a file .csv, .mat or .nc; if the clock has `columns`, a text file of numbers without a header.
        map_name: file that names the time, for errors; default: the table.
    """
    time, names = clock.time, clock.columns
    table = read_recorded(path) if names is None else read_unnamed(path, names, skip=clock.skip_lines)
    check_known(time, table.columns, f"is not a column of {table.name}", key="log.time", file=map_name or table.name)
    seconds = table.numbers(time) * in_unit(1.0, clock.time_unit, "s")
    fields = {name: column for name in table.columns if name != time and (column := _numbers(table, name)) is not None}
    known = np.isfinite(seconds)
    if np.count_nonzero(known) == 1:
        raise InputError("has only one row with a time", file=table.name, key=time, remedy="give a longer log")
    if not known.any():
        problem = f"has no timestamps in {table.name}"
        remedy = "name the column of the time"
        raise InputError(problem, file=map_name or table.name, key="log.time", value=time, remedy=remedy)
    return LogRecording(table.name, {"": topic_of(seconds[known], {k: v[known] for k, v in fields.items()})})


def _numbers(table: Recorded, name: str) -> np.ndarray[tuple[int], np.dtype[np.float64]] | None:
    # texts, such as the state of a mission, are no field
    try:
        return table.numbers(name)
    except InputError:
        return None


_HEADER = 16  # bytes
_LONGEST = 10_000  # bytes of a message; a longer one is damage, as in pyulog


def _ulog(path: Path, topics: Collection[str] | None, notes: list[str]) -> dict[Stream, Topic]:
    """Return topics by name; further instances of a topic have names such as `sensor_gyro[1]`.

    The time is that of the autopilot (`timestamp`).
    """
    pyulog = optional_module("pyulog", path=path, extra="px4")
    raw = path.read_bytes()
    with path.open("rb") as file:
        log = pyulog.ULog(file, bare_names(topics))
    streams: dict[Stream, Topic] = {}
    for data in log.data_list:
        if matches(data.name, topics):
            fields = {k: np.asarray(v, dtype=float) for k, v in data.data.items() if k != "timestamp"}
            source = str(data.msg_id) if Stream(data.name, data.multi_id) in streams else ""
            time = np.asarray(data.data["timestamp"], dtype=float) * 1e-6
            streams[Stream(data.name, data.multi_id, source)] = topic_of(time, fields)
    notes += _ulog_notes(path.name, raw, log, whole=topics is None)
    return streams


def _ulog_notes(name: str, raw: bytes, log: Any, *, whole: bool) -> list[str]:
    """Return what a ULog lacks: messages without subscription or of a wrong length, lost ones, and damage.

    `whole`: all topics were read.
    """
    at, known, dropouts = _HEADER, set[bytes](), list[int]()
    messages, read = Counter[bytes](), {data.msg_id: len(data.data["timestamp"]) for data in log.data_list}
    while at + 3 <= len(raw):
        size, kind = struct.unpack_from("<Hc", raw, at)
        body = raw[at + 3 : at + 3 + size]
        if not (0 < size <= _LONGEST and kind.isalpha()) or len(body) < size:
            break
        if kind == b"A":
            known.add(body[1:3])
        elif kind == b"D":
            messages[body[:2]] += 1
        elif kind == b"O":
            dropouts.append(int.from_bytes(body[:2], "little"))
        at += 3 + size
    count, unknown, wrong = messages.total(), 0, 0
    for key, number in messages.items():
        code = int.from_bytes(key, "little")
        if key not in known:
            unknown += number
        elif whole or code in read:
            wrong += number - read.get(code, 0)
    notes = [f"{count - unknown} of {count} messages could be read: {name} does not say what the others are"]
    notes = notes if unknown else []
    if at != len(raw):
        notes.append(f"{name} is damaged or cut at byte {at} of {len(raw)}: messages after it may be missing")
    elif wrong > 0:
        notes.append(f"{wrong} of {count} messages have a wrong length: not used")
    elif log.file_corruption and not unknown:
        notes.append(f"{name} is damaged: messages may be missing")
    if dropouts:
        notes.append(f"{len(dropouts)} dropouts, {1e-3 * sum(dropouts):g} s in all: the autopilot lost messages")
    return notes


class _Format(NamedTuple):
    """A format: what it is, the remedy for a damaged file, and what reads it message by message, or whole topics."""

    what: str
    remedy: str
    read: Callable[[Path, Collection[str] | None, list[str]], Iterator[_Message] | dict[Stream, Topic]]


_ARDUPILOT = _Format("a log of ArduPilot", "give a .BIN or .tlog file", _ardupilot)
_BAG = _Format("a bag", "check it with: ros2 bag info", _bag)

FORMATS: dict[str, _Format] = {
    ".bin": _ARDUPILOT,
    ".tlog": _ARDUPILOT,
    ".bag": _BAG,
    ".db3": _BAG,
    ".mcap": _Format("an MCAP file", "check it with: mcap doctor", _mcap),
    ".ulg": _Format("a ULog", "give a .ulg file", _ulog),
}
"""Formats by the suffix of the file; a folder is a bag of ROS 2, any other file a table."""


def _recording(form: _Format, path: Path, topics: Collection[str] | None) -> LogRecording:
    rows, notes = dict[Stream, TopicRows](), list[str]()
    try:
        content = form.read(path, topics, notes)
        for stream, time, message in () if isinstance(content, dict) else content:
            rows.setdefault(stream, TopicRows()).append(time, flattened(message))
    except InputError:
        raise
    except Exception as error:  # the libraries pass on errors of their own and of every library that they read with
        cause = type(error).__name__
        with suppress(ValueError, UnicodeError):
            cause = " ".join(str(error).split())[:200] or cause
        raise InputError(f"cannot be read as {form.what} ({cause})", file=shown(path), remedy=form.remedy) from None
    read = content if isinstance(content, dict) else {stream: one.topic() for stream, one in rows.items()}
    return recording_of(path, read, notes)


@contextmanager
def _quiet() -> Iterator[StringIO]:
    """Catch what a reader prints; its C code, which prints past `sys.stderr`, prints nothing."""
    printed = StringIO()
    with ExitStack() as stack:
        stack.enter_context(redirect_stdout(printed))
        stack.enter_context(redirect_stderr(printed))
        sink = stack.enter_context(Path(os.devnull).open("w"))
        for number in (1, 2):
            with suppress(OSError):  # the process has no such stream
                saved = os.dup(number)
                stack.callback(os.close, saved)
                stack.callback(os.dup2, saved, number)
                os.dup2(sink.fileno(), number)
        yield printed


def read_recording(
    path: Path, topics: Collection[str] | None = None, *, log_map: LogMap | None = None, map_name: str = ""
) -> LogRecording:
    """Read these topics (default: all) of a file or, for ROS 2, a folder; the format follows from the suffix.

    `log_map` names the time of a table, by default the column t_s; `map_name` is the name of its file, for errors.
    """
    if not path.exists():
        raise InputError("no such file", file=shown(path), remedy="check the path")
    form = _BAG if path.is_dir() else FORMATS.get(path.suffix.lower())
    if form is not None:
        with _quiet() as printed:
            recording = _recording(form, path, topics)
        if remarks := [line.strip() for line in printed.getvalue().splitlines() if line.strip()]:
            note = f"the reader of {path.name} gave {len(remarks)} warnings; the first: {shown(remarks[0])[:200]}"
            recording = replace(recording, notes=(*recording.notes, note))
        if topics is None and not recording.topics:
            raise InputError("has no messages with numbers", file=shown(path), remedy="check the file")
        return recording
    return _read_table(path, ClockTable(frame="enu") if log_map is None else log_map.log, map_name=map_name)


def read_mapped_log(path: Path, map_path: Path) -> MotionLog:
    """Read a log of motion and thrust from a recording of any format with a map.

    Topics with other times are interpolated to common times; headings follow from quaternions, velocities in the
    heading frame from velocities in the body or world frame, and thrust from the commands of thrusters.
    """
    log_map = load_log_map(map_path)
    topics = {part.topic for _, part in log_map.sources()}
    recording = read_recording(path, topics, log_map=log_map, map_name=shown(map_path))
    if not topics <= recording.topics.keys() | recording.also.keys():
        recording = read_recording(path, log_map=log_map)  # for a message that names all topics
    return joined(recording, log_map, map_name=shown(map_path))


def topic_lines(recording: LogRecording) -> list[str]:
    """Return one line per topic: name, number of messages, rate, and the names of its fields."""
    lines = []
    for name, topic in sorted(recording.topics.items()):
        span = float(topic.time[-1] - topic.time[0])
        rate = f"{(len(topic.time) - 1) / span:.3g} Hz" if span > 0 else "one time"
        lines.append(f"{name or '(table)'}: {len(topic.time)} messages, {rate}: {', '.join(topic.fields)}")
    return lines
