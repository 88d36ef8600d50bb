"""Read bags of ROS 1 (.bag) and ROS 2 (a folder, .db3, .mcap) with rosbags, and other MCAP files with mcap."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path
from typing import Any

from surctl.errors import InputError
from surctl.marine.vehicle.logs.recording import (
    Recording,
    Rows,
    Stream,
    flattened,
    matches,
    optional_module,
    recording_of,
)
from surctl.recorded import shown

__all__ = ["read_bag", "read_mcap"]


def read_bag(path: Path, topics: Collection[str] | None) -> Recording:
    """Read a bag of ROS 1, or of ROS 2 in a folder with metadata.yaml (a file inside it may be named).

    The time is that of the recorder. Custom messages need their definitions in the bag. A topic that several nodes
    published, or that has several types, has names such as `/odom@/filter`.

    Raises:
        InputError: rosbags is not installed, or the bag cannot be read.
    """
    highlevel = optional_module("rosbags.highlevel", path=path, extra="ros")
    typesys = optional_module("rosbags.typesys", path=path, extra="ros")
    bag = path
    if path.suffix.lower() == ".db3":
        bag = path.parent
        if not (bag / "metadata.yaml").is_file():
            raise InputError(
                "has no metadata.yaml beside it",
                file=shown(path),
                remedy="give the folder of the bag: ros2 bag reindex",
            )
    rows: dict[Stream, Rows] = {}
    store = typesys.get_typestore(typesys.Stores.LATEST)
    try:
        with highlevel.AnyReader([bag], default_typestore=store) as reader:
            chosen = [c for c in reader.connections if matches(c.topic, topics)]
            types = {(c.topic, c.msgtype) for c in reader.connections}
            several = {name for name in {c.topic for c in chosen} if sum(topic == name for topic, _ in types) > 1}
            for connection, stamp, raw in reader.messages(connections=chosen) if chosen else ():
                message = reader.deserialize(raw, connection.msgtype)
                node = getattr(connection.ext, "callerid", None) or ""
                source = f"{node}:{connection.msgtype}" if connection.topic in several else node
                rows.setdefault(Stream(connection.topic, None, source), Rows()).append(stamp * 1e-9, flattened(message))
    except Exception as error:  # rosbags passes on errors of its own and of every library that it reads with
        raise InputError(
            f"cannot be read as a bag ({_line(error)})", file=shown(path), remedy="check it with: ros2 bag info"
        ) from None
    return recording_of(path, {stream: one.topic() for stream, one in rows.items()})


def read_mcap(path: Path, topics: Collection[str] | None) -> Recording:
    """Read an MCAP file with messages in JSON, ROS 1 or ROS 2 (CDR); the time is that of the recorder.

    A topic with several channels has names such as `/odom@3`, with the number of the channel.

    Raises:
        InputError: a package is not installed, the file cannot be read, or its messages have another encoding.
    """
    reader_of = optional_module("mcap.reader", path=path, extra="ros").make_reader
    rows: dict[Stream, Rows] = {}
    decoders: dict[int, Callable[[bytes], Any]] = {}
    try:
        with path.open("rb") as file:
            for schema, channel, message in reader_of(file).iter_messages(log_time_order=False):
                if not matches(channel.topic, topics):
                    continue
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(path, schema, channel)
                decoded = decoders[channel.id](message.data)
                stream = Stream(channel.topic, None, str(channel.id))
                rows.setdefault(stream, Rows()).append(message.log_time * 1e-9, flattened(decoded))
    except InputError:
        raise
    except Exception as error:  # mcap raises errors of its decompressors too
        raise InputError(
            f"cannot be read as an MCAP file ({_line(error)})", file=shown(path), remedy="check it with: mcap doctor"
        ) from None
    return recording_of(path, {stream: one.topic() for stream, one in rows.items()})


def _decoder(path: Path, schema: Any, channel: Any) -> Callable[[bytes], Any]:
    encoding = channel.message_encoding
    if encoding == "json":
        return json.loads
    if encoding not in ("cdr", "ros1") or schema is None:
        raise InputError(
            f"has the encoding {encoding!r}",
            file=shown(path),
            key=channel.topic,
            remedy="give messages in JSON, ROS 1 or ROS 2 (CDR)",
        )
    typesys = optional_module("rosbags.typesys", path=path, extra="ros")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    store.register(typesys.get_types_from_msg(schema.data.decode(), schema.name))
    name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
    if encoding == "cdr":
        return lambda raw: store.deserialize_cdr(raw, name)
    return lambda raw: store.deserialize_ros1(raw, name)


def _line(error: Exception) -> str:
    with suppress(ValueError, UnicodeError):
        return " ".join(str(error).split())[:200] or type(error).__name__
    return type(error).__name__
