"""Read logs of PX4 (.ulg) with pyulog."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from surctl.errors import InputError
from surctl.recorded import shown
from surctl.vehicle.logs.recording import Recording, Topic, optional_module, step_back

__all__ = ["read_ulog"]


def read_ulog(path: Path, topics: Collection[str] | None) -> Recording:
    """Read topics by name; further instances of a topic have names such as `sensor_gyro[1]`.

    The time is that of the autopilot (`timestamp`).

    Raises:
        InputError: pyulog is not installed, or the file is not such a log.
    """
    pyulog = optional_module("pyulog", path=path, extra="px4")
    names = None if topics is None else sorted({topic.partition("[")[0] for topic in topics})
    try:
        with path.open("rb") as file:
            log = pyulog.ULog(file, names)
    except Exception as error:  # pyulog raises errors of struct and of types, and Exception itself
        raise InputError(f"cannot be read as a ULog ({error})", file=shown(path), remedy="give a .ulg file") from None
    held = {}
    for data in log.data_list:
        time = np.asarray(data.data["timestamp"], dtype=float) * 1e-6
        order = np.argsort(time, kind="stable")
        order = order[np.append(np.diff(time[order]) > 0, True)]
        fields = {k: np.asarray(v, dtype=float)[order] for k, v in data.data.items() if k != "timestamp"}
        name = data.name if data.multi_id == 0 else f"{data.name}[{data.multi_id}]"
        held[name] = Topic(time[order], fields, step_back(time))
    return Recording(shown(path), held)
