"""Read logs of ArduPilot with pymavlink: dataflash logs (.BIN) and telemetry logs (.tlog)."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

from surctl.errors import InputError
from surctl.recorded import shown
from surctl.vehicle.logs.recording import Recording, Rows, flattened, optional_module, recording_of

__all__ = ["read_ardupilot"]


@contextmanager
def _quiet() -> Iterator[None]:
    # the indexer of pymavlink is in C and prints a line for each byte that begins no message, past `sys.stderr`
    with redirect_stderr(StringIO()):
        try:
            saved = os.dup(2)
        except OSError:  # the process has no standard error
            yield
            return
        try:
            with Path(os.devnull).open("w") as sink:
                os.dup2(sink.fileno(), 2)
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)


def read_ardupilot(path: Path, topics: Collection[str] | None) -> Recording:
    """Read messages by type, such as ATT or RCOU; further instances of a type have names such as XKF1[1].

    The time is that of the autopilot (TimeUS) in a dataflash log, and the time of reception in a telemetry log.

    Raises:
        InputError: pymavlink is not installed, or the file is not such a log.
    """
    mavutil = optional_module("pymavlink.mavutil", path=path, extra="ardupilot")
    rows: dict[str, Rows] = {}
    first: dict[str, float] = {}
    kinds = None if topics is None else sorted({topic.partition("[")[0] for topic in topics})
    try:
        with redirect_stdout(StringIO()), _quiet():  # pymavlink prints its remarks
            log = mavutil.mavlink_connection(str(path), notimestamps=False)
            while (message := log.recv_match(type=kinds)) is not None:
                kind = message.get_type()
                if kind in ("BAD_DATA", "FMT", "FMTU", "UNIT", "MULT", "PARM"):
                    continue
                values = message.to_dict()
                values.pop("mavpackettype", None)
                time = values["TimeUS"] * 1e-6 if "TimeUS" in values else float(message._timestamp)
                instance_field = getattr(getattr(message, "fmt", None), "instance_field", None)
                name = kind
                if instance_field is not None:
                    number = values[instance_field]
                    if number != first.setdefault(kind, number):
                        name = f"{kind}[{number}]"
                rows.setdefault(name, Rows()).append(time, flattened(values))
            log.close()
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise InputError(
            f"cannot be read as a log of ArduPilot ({error})", file=shown(path), remedy="give a .BIN or .tlog file"
        ) from None
    return recording_of(path, rows)
