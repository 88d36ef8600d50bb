"""Read logs of PX4 (.ulg) with pyulog."""

from __future__ import annotations

import struct
from collections.abc import Collection
from pathlib import Path

import numpy as np

from surctl.errors import InputError
from surctl.marine.vehicle.logs.recording import (
    Recording,
    Stream,
    bare_names,
    matches,
    optional_module,
    recording_of,
    topic_of,
)
from surctl.recorded import shown

__all__ = ["read_ulog"]

_HEADER = 16  # bytes


def read_ulog(path: Path, topics: Collection[str] | None) -> Recording:
    """Read topics by name; further instances of a topic have names such as `sensor_gyro[1]`.

    The time is that of the autopilot (`timestamp`).

    Raises:
        InputError: pyulog is not installed, or the file is not such a log.
    """
    pyulog = optional_module("pyulog", path=path, extra="px4")
    try:
        raw = path.read_bytes()
        with path.open("rb") as file:
            log = pyulog.ULog(file, bare_names(topics))
    except Exception as error:  # pyulog raises errors of struct and of types, and Exception itself
        raise InputError(f"cannot be read as a ULog ({error})", file=shown(path), remedy="give a .ulg file") from None
    streams = {}
    for data in log.data_list:
        if matches(data.name, topics):
            fields = {k: np.asarray(v, dtype=float) for k, v in data.data.items() if k != "timestamp"}
            source = str(data.msg_id) if Stream(data.name, data.multi_id) in streams else ""
            time = np.asarray(data.data["timestamp"], dtype=float) * 1e-6
            streams[Stream(data.name, data.multi_id, source)] = topic_of(time, fields)
    unknown, count = _unknown(raw) if log.file_corruption else (0, 0)
    notes = [f"{count - unknown} of {count} messages could be read: {path.name} does not say what the others are"]
    return recording_of(path, streams, notes if unknown else ())


def _unknown(raw: bytes) -> tuple[int, int]:
    """Return the number of data messages that have no subscription, and of all data messages."""
    at, known, unknown, count = _HEADER, set[bytes](), 0, 0
    while at + 3 <= len(raw):
        size, kind = struct.unpack_from("<Hc", raw, at)
        body = raw[at + 3 : at + 3 + size]
        if kind == b"A":
            known.add(body[1:3])
        elif kind == b"D":
            count += 1
            unknown += body[:2] not in known
        at += 3 + size
    return unknown, count
