"""Read logs of ArduPilot with pymavlink: dataflash logs (.BIN) and telemetry logs (.tlog)."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

from surctl.errors import InputError
from surctl.marine.vehicle.logs.recording import (
    Recording,
    Rows,
    Stream,
    bare_names,
    flattened,
    optional_module,
    recording_of,
)
from surctl.recorded import shown

__all__ = ["read_ardupilot"]

_NO_MOTION = ("FMT", "FMTU", "UNIT", "MULT", "PARM")


def read_ardupilot(path: Path, topics: Collection[str] | None) -> Recording:
    """Read messages by type, such as ATT or RCOU; further instances of a type have names such as XKF1[1].

    In a telemetry log, types that several systems or components sent have names such as ATTITUDE@1.1. The time is that
    of the autopilot (TimeUS) in a dataflash log, and the time of reception in a telemetry log.

    Raises:
        InputError: pymavlink is not installed, or the file is not such a log.
    """
    mavutil = optional_module("pymavlink.mavutil", path=path, extra="ardupilot")
    rows: dict[Stream, Rows] = {}
    kinds = bare_names(topics)
    bad = 0
    try:
        log = mavutil.mavlink_connection(str(path), notimestamps=False)
        while (message := log.recv_match(type=kinds and [*kinds, "BAD_DATA"])) is not None:
            kind = message.get_type()
            bad += kind == "BAD_DATA"
            if kind == "BAD_DATA" or kind in _NO_MOTION:
                continue
            values = message.to_dict()
            values.pop("mavpackettype", None)
            time = values["TimeUS"] * 1e-6 if "TimeUS" in values else float(message._timestamp)
            rows.setdefault(_stream(message, values), Rows()).append(time, flattened(values))
        log.close()
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(
            f"cannot be read as a log of ArduPilot ({error})", file=shown(path), remedy="give a .BIN or .tlog file"
        ) from None
    notes = [f"{bad} parts of {path.name} are no messages: not used"] if bad else []
    return recording_of(path, {stream: one.topic() for stream, one in rows.items()}, notes)


def _stream(message: Any, values: dict[str, Any]) -> Stream:
    # messages of MAVLink have the field of the instance and the sender themselves, those of a dataflash log in a format
    logged = getattr(message, "fmt", None)
    instance_field = getattr(message if logged is None else logged, "instance_field", None)
    instance = None if instance_field is None else values[instance_field]
    source = f"{message.get_srcSystem()}.{message.get_srcComponent()}" if logged is None else ""
    return Stream(message.get_type(), instance, source)
