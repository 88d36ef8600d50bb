"""Record a session as it goes: every frame as a telemetry log (.tlog), and every control period as MCAP."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from surctl.errors import InputError
from surctl.files import Closeable, opened
from surctl.marine.bridge.bridge import Bridge, Moment
from surctl.marine.simulation import Body
from surctl.marine.simulation.record_file import SceneFile, write_layout
from surctl.marine.world import Disc
from surctl.recorded_write import McapFile

_STAMP = struct.Struct(">Q")
_FLUSH = 1.0  # [s] of messages for Foxglove that a killed process may lose; the telemetry log loses nothing
_POINT = 0.03  # [m] radius with which a point is shown


class FrameLog(Closeable):
    """A telemetry log: each frame after its time, in microseconds of the Unix epoch.

    A frame is handed to the operating system before the next one is taken: the end of the process loses nothing.
    `surctl vehicle from-log` and ground stations read the file.
    """

    def __init__(self, path: Path, *, epoch: float | None = None, new: bool = True) -> None:
        self.path = path
        self.epoch = time.time() if epoch is None else epoch
        self._file = opened(path, new=new, buffering=0)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def frame(self, now: float, data: bytes, *, sent: bool) -> None:
        """Record the frames of a datagram that was sent or received at `now` [s] since the begin of the session."""
        stamp = _STAMP.pack(int((self.epoch + now) * 1e6))
        whole = b"".join(stamp + frame for frame in _frames(data))
        if whole:
            self._file.write(whole)

    def period(self, bridge: Bridge) -> None:
        """Record nothing: the frames hold the control period."""


def _frames(data: bytes) -> Iterator[bytes]:
    # the frames of MAVLink 2 (0xFD, signed or not) and 1 (0xFE), by their lengths; other bytes are no frames
    at = 0
    while at + 3 <= len(data):
        head = data[at]
        length = {0xFD: 12 + 13 * (data[at + 2] & 1), 0xFE: 8}.get(head, 0) + data[at + 1]
        if head in (0xFD, 0xFE) and at + length <= len(data):
            yield data[at : at + length]
            at += length
        else:
            at += 1


class SessionRecord(Closeable):
    """The record of a session in a folder: `NAME.tlog` with every frame, and `NAME.mcap` for Foxglove.

    `epoch` is the time of the begin [s] of the Unix epoch; default: now. With `new`, the files must not exist yet.
    `files` are the paths of the two files.

    Raises:
        ToolMissing: the package mcap is not installed.
        InputError: a file cannot be written, or is there already.
    """

    def __init__(
        self, folder: Path, name: str, bridge: Bridge, *, epoch: float | None = None, new: bool = True
    ) -> None:
        epoch = time.time() if epoch is None else epoch
        self._file = McapFile(folder / f"{name}.mcap", new=new, epoch=epoch)
        try:
            self._frames = FrameLog(folder / f"{name}.tlog", epoch=epoch, new=new)
        except InputError:
            self._file.close()
            raise
        self._scene = SceneFile(self._file, bridge.plan.scenario, bridge.plan.vehicle)
        self._flushed, self._texts = 0.0, 0
        perception = bridge.plan.law.perception is not None
        self._ranges = bridge.plan.law.telemetry_slice("ranges") if perception else None
        write_layout(folder, sonars=self._scene.array.size if perception else 0)
        self.files = self._file.path, self._frames.path

    def close(self) -> None:
        """Complete both files."""
        self._frames.close()
        self._file.close()

    def frame(self, now: float, data: bytes, *, sent: bool) -> None:
        """Record a datagram that was sent or received at `now` [s] since the begin of the session."""
        self._frames.frame(now, data, sent=sent)

    def period(self, bridge: Bridge) -> None:
        """Record the newest control period, and the texts since the last."""
        moment = bridge.moment
        if moment is None:
            return
        for at, text in bridge.texts[self._texts :]:
            self._scene.text(at, text, warning="holding" in text)
        self._texts = len(bridge.texts)
        if moment.eta is not None and moment.nu is not None:
            self._moment(moment, bridge.plan.vehicle["radius"])
        if moment.time >= self._flushed + _FLUSH:
            self._flushed = moment.time
            self._file.flush()

    def _moment(self, moment: Moment, radius: float) -> None:
        assert moment.eta is not None and moment.nu is not None
        rows = [row for row in moment.contacts if row[5] > 0.5]
        bodies = [
            Body(f"contact {k}", Disc(row[:2], max(float(row[2]), _POINT)), row[3:5], moving=bool(row[3:5].any()))
            for k, row in enumerate(rows)
        ]
        gaps = [float(np.hypot(*(row[:2] - moment.eta[:2])) - row[2]) - radius for row in rows]
        values: dict[str, object] = {"phase": moment.phase, "age_s": round(moment.age, 4)}
        if moment.axes is not None:
            axes = moment.axes
            values |= {"ahead": axes.ahead, "right": axes.right, "up": axes.up, "clockwise": axes.clockwise}
        ranges = None
        if self._ranges is not None and moment.telemetry is not None:
            ranges = moment.telemetry[self._ranges]
        self._scene.moment(
            moment.time,
            eta=moment.eta,
            nu=moment.nu,
            tau=None if moment.status is None else moment.tau,
            status=moment.status,
            clearance=min(gaps, default=float("nan")),
            bodies=bodies,
            ranges=ranges,
            values=values,
        )
