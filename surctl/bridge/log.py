"""Record a session as it goes: every frame of both directions as a telemetry log (.tlog), without a buffer."""

from __future__ import annotations

import struct
import time
from pathlib import Path
from types import TracebackType

from surctl.bridge.bridge import Bridge
from surctl.errors import InputError

__all__ = ["FrameLog"]

_STAMP = struct.Struct(">Q")


class FrameLog:
    """A telemetry log: each frame after its time, in microseconds of the Unix epoch.

    A frame is handed to the operating system before the next one is taken: the end of the process loses nothing.
    `surctl vehicle from-log` and ground stations read the file.

    Attributes:
        path: the file.

    Example:
        >>> from pathlib import Path
        >>> from surctl.bridge import FrameLog, Wire
        >>> with FrameLog(Path("session.tlog"), epoch=0.0) as log:
        ...     log.frame(1.5, Wire().heartbeat(), sent=True)
        >>> int.from_bytes(Path("session.tlog").read_bytes()[:8], "big")  # µs
        1500000
    """

    def __init__(self, path: Path, *, epoch: float | None = None) -> None:
        self.path = path
        self.epoch = time.time() if epoch is None else epoch
        try:
            self._file = path.open("xb", buffering=0)
        except FileExistsError:
            raise InputError(
                "is already there: a session never overwrites another", file=path, remedy="name another folder"
            ) from None
        except OSError as error:
            raise InputError(f"cannot be written ({error.strerror})", file=path, remedy="name another folder") from None

    def __enter__(self) -> FrameLog:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def frame(self, now: float, data: bytes, *, sent: bool) -> None:
        """Record a datagram that was sent or received at `now` [s] since the begin of the session."""
        self._file.write(_STAMP.pack(int((self.epoch + now) * 1e6)) + data)

    def period(self, bridge: Bridge) -> None:
        """Record nothing: the frames hold the control period."""
