"""Finished chunks of runs on disk for a resume: damaged chunks, full disk, lock against a second process."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, writing
from surctl.files import write_file

__all__ = ["RESUME", "ChunkStore"]

_MAGIC = "surctl-chunk-1"

RESUME: Mapping[str, str] = {
    "more": "; finished chunks are kept",
    "remedy": "free disk space or name another folder with --out; the same command resumes",
}
"""What `cannot_write` says about a file beside the chunks."""


@dataclass(frozen=True)
class ChunkStore:
    """A folder with one file per chunk of runs.

    A file holds one line of text (file signature, request, index, number of rows, number of columns, SHA-256), then the
    columns one after another as little-endian doubles. A file gets its final name only when it is complete and on the
    disk.

    Attributes:
        folder: folder that holds the files of the chunks.
        request: digest of everything that the results depend on; chunks with another request are ignored.
    """

    folder: Path
    request: str

    @contextmanager
    def open(self) -> Iterator[None]:
        """Create and lock the folder, and remove incomplete files that an interrupted process left.

        Raises:
            InputError: the folder cannot be written, or another process has locked it.
        """
        with writing(self.folder, **RESUME):
            self.folder.mkdir(parents=True, exist_ok=True)
            lock = (self.folder / "lock").open("w")
        with lock:
            _hold(lock, self.folder)
            for left in self.folder.glob("*.tmp"):
                with suppress(OSError):
                    left.unlink()
            yield

    def has(self, index: int, shape: tuple[int, int]) -> bool:
        """Return whether the store has an undamaged chunk of the present request with the given shape."""
        try:
            raw = self._path(index).read_bytes()
        except OSError:
            return False
        line, _, payload = raw.partition(b"\n")
        return len(payload) == 8 * shape[0] * shape[1] and line == self._line(index, shape, payload)

    def write(self, index: int, table: NDArray[np.float64]) -> None:
        """Write one finished chunk, an array (rows, columns).

        Raises:
            InputError: the disk is full, or the folder cannot be written; chunks that were written before remain.
        """
        payload = np.ascontiguousarray(table.T, dtype="<f8").tobytes()
        line = self._line(index, (table.shape[0], table.shape[1]), payload)
        write_file(self._path(index), line + b"\n" + payload, **RESUME)
        _sync(self.folder)

    def column(self, index: int, shape: tuple[int, int], column: int) -> NDArray[np.float64]:
        """Return one column (rows,) of a chunk; the chunk must exist, see `has`."""
        rows, columns = shape
        path = self._path(index)
        start = path.stat().st_size - 8 * rows * columns
        return np.fromfile(path, dtype="<f8", count=rows, offset=start + 8 * rows * column)

    def remove(self) -> None:
        """Delete all chunks of the store, and the parent folder if it is then empty."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):
            self.folder.parent.rmdir()

    def _path(self, index: int) -> Path:
        return self.folder / f"{index:07d}.chunk"

    def _line(self, index: int, shape: tuple[int, int], payload: bytes) -> bytes:
        head = f"{_MAGIC} {self.request} {index} {shape[0]} {shape[1]}"
        return f"{head} {hashlib.sha256(head.encode() + payload).hexdigest()}".encode()


def _hold(lock: IO[str], folder: Path) -> None:
    # the system releases the lock when the process ends, even if the process crashes
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise InputError(
            "another process with this request is running", file=folder, remedy="wait for it, or name another --out"
        ) from None


@contextmanager
def one_at_a_time(folder: Path) -> Iterator[None]:
    """Wait until no other process is inside this `with` statement for the same folder, where the system has locks."""
    handle = None
    if sys.platform != "win32":
        import fcntl

        with suppress(OSError):  # some file systems have no locks
            handle = os.open(folder, os.O_RDONLY)
            fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


def _sync(folder: Path) -> None:
    # some operating systems cannot sync a folder
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
