"""A small process that sends neutral commands if the bridge's process ends without a word, even by a kill signal.

The bridge passes it the socket, and on its standard input the newest address and neutral frames. The end of the input
without a farewell means that the bridge is gone. The file imports the standard library alone: it runs as a
program, so it stays a file of its own.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

_TIMES, _PERIOD = 20, 0.05  # how often and every how many seconds the neutral frames are sent
_FAREWELL = b"farewell\n"


class Guardian:
    """The guardian of a socket; where the system cannot pass a socket on, there is none."""

    def __init__(self, wire: socket.socket) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._known: bytes = b""
        if os.name == "posix":
            with suppress(OSError):
                command = [sys.executable, "-S", "-E", str(Path(__file__)), str(wire.fileno())]
                self._process = subprocess.Popen(
                    command, stdin=subprocess.PIPE, pass_fds=(wire.fileno(),), start_new_session=True
                )

    def tell(self, peer: tuple[str, int] | None, frames: list[bytes]) -> None:
        """Say where to send which frames if the bridge ends; no frames: nothing would have to be sent."""
        line = json.dumps([list(peer) if peer else None, [frame.hex() for frame in frames]]).encode() + b"\n"
        if self._process is None or self._process.stdin is None or line == self._known:
            return
        with suppress(OSError):
            self._process.stdin.write(line)
            self._process.stdin.flush()
            self._known = line

    def end(self, *, farewell: bool) -> None:
        """End the guardian: without a command after a farewell, else by the neutral commands."""
        if self._process is None or self._process.stdin is None:
            return
        with suppress(OSError):
            if farewell:
                self._process.stdin.write(_FAREWELL)
            self._process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(2.0)


def _guard(number: int) -> None:
    peer: tuple[str, int] | None = None
    frames: list[bytes] = []
    for line in sys.stdin.buffer:
        if line == _FAREWELL:
            return
        with suppress(ValueError, TypeError):
            place, texts = json.loads(line)
            peer = (str(place[0]), int(place[1])) if place else None
            frames = [bytes.fromhex(text) for text in texts]
    if peer is None or not frames:
        return
    with socket.socket(fileno=number) as wire:
        for _ in range(_TIMES):
            for frame in frames:
                with suppress(OSError):
                    wire.sendto(frame, peer)
            time.sleep(_PERIOD)


if __name__ == "__main__":
    _guard(int(sys.argv[1]))
