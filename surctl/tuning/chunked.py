"""Evaluate a sweep in chunks: processes, Dask, resume, progress; its file `sweep.nc`; journal of a search for gains."""

from __future__ import annotations

import hashlib
import logging
import os
import re
import signal
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, field
from itertools import count
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, SurctlError, writing
from surctl.files import write_file
from surctl.store import RESUME, ChunkStore, one_at_a_time

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
        alone_s: remaining work, as processor time [s], that the calling process does alone. Each other process needs
            seconds to load its libraries, which is longer than most small sweeps take. The work is estimated from the
            faster of the last two chunks, because the first one often builds what the others use again.

    Raises:
        InputError: `workers` is less than 1.
        SurctlError: a worker died.
    """

    workers: int = 1
    alone_s: float = 8.0

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise InputError("must be at least 1", key="workers", value=self.workers, remedy="write 1")

    def map_chunks(self, function: Evaluator, chunks: Iterable[Chunk]) -> Results:
        """Evaluate all chunks; yield the pair (index, result) of every chunk, as in `Executor`."""
        chunks = deque(chunks)
        before, pace = 0.0, 0.0
        while chunks and (self.workers == 1 or len(chunks) == 1 or pace * len(chunks) < self.alone_s):
            index, points = chunks.popleft()
            began = time.process_time()
            result = function(index, points)
            now = time.process_time() - began
            before, pace = now, min(before, now)
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
            problem = f"no scheduler replies ({type(error).__name__})"
            remedy = "start one with `dask scheduler` and give its address, such as tcp://127.0.0.1:8786"
            raise InputError(problem, key="--dask", value=self.address, remedy=remedy) from None
        try:
            client.wait_for_workers(1, timeout=_CONNECT_TIMEOUT)
        except TimeoutError:
            client.close()
            remedy = f"start one with `dask worker {self.address}`"
            raise InputError("the scheduler has no worker", key="--dask", value=self.address, remedy=remedy) from None
        return client


Floats = NDArray[np.float64]
Progress = Callable[[str], None]
Columns = Callable[[int, int], Floats]
"""Function (index of the stage, index of the column) → values (rows of the stage,), read from the stored chunks."""

TABLE = "sweep.nc"
"""Name of the file of a finished sweep."""
_FROM_TABLE = ("sweep.csv", "sweep-*.png", "sensitivity-*.png", "locus-*.png")  # that a command wrote beside it
_RENAMED = re.compile(r"sweep-([0-9a-f]{12}|unreadable\d*)\b")
_MOST_CHUNKS = 64  # chunks of a small sweep, so that an interruption loses little and every worker has work


@dataclass(frozen=True, eq=False)
class SweepStage:
    """Rows that a sweep evaluates in chunks.

    Attributes:
        names: names of the parameters.
        rows: (n, parameters) values.
        size: rows in a chunk.
        width: number of columns of results.
        name: what is computed, for the progress.
        unit: what is counted in the rate of the progress.
        each: how many of these belong to a row.
        counted: what the rows are, for the progress.
    """

    names: tuple[str, ...]
    rows: Floats = field(repr=False)
    size: int
    width: int
    name: str = "sweep"
    unit: str = "runs"
    each: int = 1
    counted: str = "points"


def chunk_size(count: int, *, most: int) -> int:
    """Return the number of rows in a chunk, for `count` rows in all and at most `most` rows in a chunk.

    It does not depend on the executor, so that any executor can resume a sweep.
    """
    return max(1, min(most, -(-count // _MOST_CHUNKS)))


@contextmanager
def evaluated_chunks(
    function: Evaluator,
    stages: Sequence[SweepStage],
    *,
    out: Path,
    request: str,
    executor: Executor,
    progress: Progress,
) -> Iterator[Columns]:
    """Evaluate all rows of all stages, and yield a function that returns columns of the results.

    Chunks are numbered through all stages. Chunks that an interrupted process left for the same request are not
    evaluated again. When all are finished, a `TABLE` of another request is renamed. After the `with` statement, all
    stored chunks are deleted, unless it raised an error.

    Args:
        function: evaluator of a chunk.
        stages: the rows; those of the last stage are the points of the sweep.
        out: folder of the sweep.
        request: digest of everything that the results depend on.
        executor: executor of the chunks.
        progress: function that receives one line of text at each step of the work.

    Raises:
        InputError: the folder cannot be written, or the disk is full. Finished chunks remain.
    """
    chunks: list[list[Chunk]] = []
    for stage in stages:
        first = sum(map(len, chunks))
        starts = enumerate(range(0, len(stage.rows), stage.size))
        chunks.append([(first + k, stage.rows[at : at + stage.size]) for k, at in starts])
    shapes = {i: (len(points), s.width) for s, part in zip(stages, chunks, strict=True) for i, points in part}
    store = ChunkStore(out / "sweep.chunks" / request[:16], request)

    def column(stage: int, k: int) -> Floats:
        return np.concatenate([store.column(i, shapes[i], k) for i, _ in chunks[stage]])

    with store.open():
        todo = [(i, points) for part in chunks for i, points in part if not store.has(i, shapes[i])]
        pace = _Pace(stages, chunks, todo, progress)
        run_chunks(function, todo, store=store, executor=executor, finished=pace.finished)
        try:
            with one_at_a_time(out):  # another request may end in this folder at the same time
                _set_aside(out / TABLE, progress)
                yield column
        except InputError as error:
            problem, remedy = f"{error.problem}; finished chunks are kept", f"{error.remedy}; the same command resumes"
            again = InputError(problem, file=error.file, key=error.key, value=error.value, remedy=remedy)
            again.exit_status = error.exit_status
            raise again from None
    store.remove()


def run_chunks(
    function: Evaluator,
    chunks: Sequence[Chunk],
    *,
    store: ChunkStore,
    executor: Executor,
    finished: Callable[[int], None] = lambda _: None,
) -> None:
    """Evaluate chunks, and store each result as soon as it is available.

    Args:
        function: the evaluator of a chunk.
        chunks: chunks that the store does not contain yet.
        store: open store of finished chunks.
        executor: executor of the chunks.
        finished: function that receives the index of each chunk once the chunk is stored.

    Raises:
        InputError: a chunk cannot be written.
    """
    with closing(executor.map_chunks(function, chunks)) as results:  # after an error here the workers stop too
        for index, table in results:
            store.write(index, table)
            finished(index)


def finished_table(out: Path, request: str, *, progress: Progress) -> Path | None:
    """Return the file in the folder that holds the finished sweep of a request; None if there is none."""
    for path in (out / TABLE, out / f"sweep-{request[:12]}.nc"):
        if path.exists() and _request_of(path) == request:
            progress(f"sweep: {path} has all points")
            return path
    return None


def _set_aside(target: Path, progress: Progress) -> None:
    """Rename the file of another request, and what was written from it."""
    if not target.exists():
        return
    request = _request_of(target)
    names = (f"sweep-unreadable{number or ''}.nc" for number in count())
    free = next(name for name in names if not target.with_name(name).exists())
    other = target.with_name(free if request is None else f"sweep-{request[:12]}.nc")
    with writing(target, **RESUME):
        for path in (path for pattern in _FROM_TABLE for path in sorted(target.parent.glob(pattern))):
            if not _RENAMED.match(path.name):
                rest = path.name.removeprefix("sweep") if path.name.startswith("sweep") else f"-{path.name}"
                path.replace(path.with_name(other.stem + rest))
        target.replace(other)
    progress(f"{target} contained the table of another request; it is now {other}")


def _request_of(path: Path) -> str | None:
    """Return the request digest stored in a finished sweep file; None if the file is damaged or is no sweep file."""
    import netCDF4

    try:
        with netCDF4.Dataset(path) as file:
            for variable in file.variables.values():
                _ = variable[:]  # reading verifies the stored checksums
            return str(file.getncattr("request"))
    except (OSError, RuntimeError, AttributeError):
        return None


class _Pace:
    """Lines about the progress of a sweep, at most two a second."""

    def __init__(
        self, stages: Sequence[SweepStage], chunks: Sequence[Sequence[Chunk]], todo: Sequence[Chunk], progress: Progress
    ) -> None:
        self.progress, self.stages = progress, stages
        self.stage_of = {index: k for k, part in enumerate(chunks) for index, _ in part}
        self.left = {index: len(points) for index, points in todo}
        waiting = [sum(self.left.get(i, 0) for i, _ in part) for part in chunks]
        self.before = [len(stage.rows) - left for stage, left in zip(stages, waiting, strict=True)]
        self.done = list(self.before)
        self.last = time.monotonic()
        self.start = [self.last] * len(stages)
        self.progress(f"{stages[-1].name} {self.done[-1]}/{len(stages[-1].rows)} {stages[-1].counted}")

    def finished(self, index: int) -> None:
        k, now = self.stage_of[index], time.monotonic()
        self.done[k] += self.left.pop(index)
        self.start[k + 1 :] = [now] * len(self.start[k + 1 :])
        if not self.left or now - self.last >= 0.5:
            self.last = now
            self.progress(self._line(k, now))

    def _line(self, k: int, now: float) -> str:
        stage, whole = self.stages[k], len(self.stages[k].rows)
        rate = (self.done[k] - self.before[k]) / max(now - self.start[k], 1e-9)
        left = round((whole - self.done[k]) / rate)
        eta = f"{left // 3600}:{left // 60 % 60:02d}:{left % 60:02d}"
        return f"{stage.name} {self.done[k]}/{whole} {stage.counted}, {rate * stage.each:.3g} {stage.unit}/s, ETA {eta}"


# The batches of a search for gains, in the same stores


_SEARCHES = "tune.chunks"


class Journal:
    """The finished batches of searches in a folder; only one process at a time can hold it.

    Args:
        folder: output folder of a tuning; None keeps the batches in memory.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self._memory: dict[str, dict[int, Floats]] = {}

    @contextmanager
    def held(self) -> Iterator[None]:
        """Lock the folder inside the `with` statement; InputError if it cannot be written, or is in use."""
        with nullcontext() if self.folder is None else ChunkStore(self.folder / _SEARCHES, "").open():
            yield

    def batches(self, request: str, *, width: int) -> Batches:
        """Return the batches of the search with a request (a text), which have rows of `width` numbers."""
        store = None
        if self.folder is not None:
            digest = hashlib.sha256(request.encode()).hexdigest()
            store = ChunkStore(self.folder / _SEARCHES / digest[:16], digest)
            store.folder.mkdir(parents=True, exist_ok=True)
        return Batches(width, store, self._memory.setdefault(request, {}))

    def note_best(self, name: str, text: str) -> None:
        """Write the best gains so far as text to a file in the folder; InputError if it cannot be written."""
        if self.folder is not None:
            write_file(self.folder / name, text)


@dataclass
class Batches:
    """The batches of one search, in the order of their evaluation: rows of a set of numbers and its results.

    Attributes:
        width: numbers in a row.
        store: the stored batches; None without a folder.
        memory: tables of the request in this process, by the index of the batch.
        tables: the tables (rows, width) so far.
    """

    width: int
    store: ChunkStore | None
    memory: dict[int, Floats]
    tables: list[Floats] = field(default_factory=list)

    def known(self, count: int, after: int = 0) -> Floats | None:
        """Return the stored table of the next batch, with `count` rows, or of one `after` it; None if there is none."""
        index, shape = len(self.tables) + after, (count, self.width)
        if self.store is None:
            return self.memory.get(index)
        if not self.store.has(index, shape):
            return None
        return np.column_stack([self.store.column(index, shape, k) for k in range(self.width)])

    def add(self, table: Floats, *, restored: bool = False) -> None:
        """Add the table of the next batch, and store it unless it is `restored`; InputError if the disk is full."""
        if not restored and self.store is not None:
            self.store.write(len(self.tables), table)
        elif not restored:
            self.memory[len(self.tables)] = table
        self.tables.append(table)

    def evaluated(self, sets: Floats, evaluate: Callable[[Floats], Floats]) -> Floats:
        """Return the rows (n, width) of the next batch of sets (n, d): the stored ones, or those of `evaluate`."""
        table = self.known(len(sets))
        restored = table is not None and np.array_equal(table[:, : sets.shape[1]], sets)
        if table is None or not restored:
            table = np.column_stack([sets, evaluate(sets)])
        self.add(table, restored=restored)
        return table
