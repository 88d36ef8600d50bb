"""Executors evaluate the points of a sweep in chunks: in this process, in local processes, or on a Dask cluster."""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import CancelledError, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, SurctlError

__all__ = ["Chunk", "DaskExecutor", "Evaluator", "Executor", "LocalExecutor"]

Chunk = tuple[int, NDArray[np.float64]]
"""Index of a chunk, and the points (rows, axes) of the chunk."""

Evaluator = Callable[[int, NDArray[np.float64]], NDArray[np.float64]]
"""Function (index of the chunk, points (rows, axes)) → (rows, columns); pickled by name for other processes."""

Results = Generator[tuple[int, NDArray[np.float64]], None, None]

_CONNECT_TIMEOUT = 8.0  # [s] until a connection attempt fails
_RETRIES = 2


class Executor(Protocol):
    """Interface of an executor; results must depend neither on the executor nor on the order of the chunks."""

    def map_chunks(self, function: Evaluator, chunks: Iterable[Chunk]) -> Results:
        """Evaluate all chunks; yield the pair (index, result) of every chunk, in any order."""


@dataclass(frozen=True)
class LocalExecutor:
    """Executor on this machine: one worker runs in the calling process, several workers run in spawned processes.

    Attributes:
        workers: number of processes that evaluate chunks.
        alone_s: work [s] that the calling process does before it starts other processes. Each of them needs seconds of
            processor time to load its libraries, which is longer than most small sweeps take.

    Raises:
        InputError: `workers` is less than 1.
        SurctlError: a worker died.
    """

    workers: int = 1
    alone_s: float = 2.0

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise InputError("must be at least 1", key="workers", value=self.workers, remedy="write 1")

    def map_chunks(self, function: Evaluator, chunks: Iterable[Chunk]) -> Results:
        """Evaluate all chunks; yield the pair (index, result) of every chunk, as in `Executor`."""
        chunks = deque(chunks)
        worked = 0.0
        while chunks and (self.workers == 1 or len(chunks) == 1 or worked < self.alone_s):
            index, points = chunks.popleft()
            began = time.perf_counter()
            result = function(index, points)
            worked += time.perf_counter() - began
            yield index, result
        if not chunks:
            return
        with ProcessPoolExecutor(
            min(self.workers, len(chunks)),
            mp_context=get_context("spawn"),  # a forked child would inherit the locks of numerical libraries
            initializer=_begin,
        ) as pool:
            jobs = {pool.submit(function, index, points): index for index, points in chunks}
            try:
                for job in as_completed(jobs):
                    yield jobs.pop(job), job.result()
            except BrokenProcessPool:
                raise SurctlError(
                    "a worker process died (out of memory?); finished chunks are stored; repeat the command to resume"
                ) from None
            finally:
                for job in jobs:
                    job.cancel()


def _begin() -> None:
    # ignores Ctrl-C in a worker process, prints a warning as one line, and ends with the parent process
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    warnings.formatwarning = lambda message, *_, **__: f"surctl: {message}\n"


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


@dataclass(frozen=True)
class DaskExecutor:
    """Executor on the workers of a Dask scheduler; every worker needs surctl, and compiles the simulated loops itself.

    The scheduler gives the chunks of a lost worker to another worker. A failed chunk is tried again, at most twice.

    Raises:
        InputError: dask.distributed is not installed, no scheduler replies at the address, or the scheduler has no
            worker.
        SurctlError: the cluster was lost while chunks were running.
    """

    address: str

    def map_chunks(self, function: Evaluator, chunks: Iterable[Chunk]) -> Results:
        """Evaluate all chunks; yield the pair (index, result) of every chunk, as in `Executor`."""
        chunks = list(chunks)
        if not chunks:
            return
        try:
            import distributed
        except ImportError:
            raise InputError(
                "dask.distributed is not installed", key="--dask", remedy="pip install 'surctl[cluster]'"
            ) from None
        logger = logging.getLogger("distributed")
        level = logger.level
        logger.setLevel(logging.CRITICAL)  # a lost worker is reported below in one line, or not at all
        client = None
        try:
            client = self._connect(distributed)
            jobs = {client.submit(function, *chunk, pure=False, retries=_RETRIES): chunk[0] for chunk in chunks}
            for job in distributed.as_completed(list(jobs), loop=client.loop):
                yield jobs.pop(job), job.result()
        except (distributed.KilledWorker, CancelledError, OSError) as error:
            raise SurctlError(
                f"the cluster at {self.address} was lost ({type(error).__name__}); finished chunks are stored; "
                "repeat the command to resume"
            ) from None
        finally:
            if client is not None:
                client.close()
            logger.setLevel(level)

    def _connect(self, distributed: Any) -> Any:
        try:
            client = distributed.Client(self.address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, TimeoutError, ValueError, ImportError) as error:
            raise InputError(
                f"no scheduler replies ({type(error).__name__})",
                key="--dask",
                value=self.address,
                remedy="start one with `dask scheduler` and give its address, such as tcp://127.0.0.1:8786",
            ) from None
        try:
            client.wait_for_workers(1, timeout=_CONNECT_TIMEOUT)
        except TimeoutError:
            client.close()
            raise InputError(
                "the scheduler has no worker",
                key="--dask",
                value=self.address,
                remedy=f"start one with `dask worker {self.address}`",
            ) from None
        return client
