"""Many runs of a compiled simulation step in parallel, with lanes and threads; when a run ends; its C text."""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir.c99_wide import emit_wide
from surctl.ir.cache import shared_library
from surctl.ir.native import loaded
from surctl.ir.routine import Block

PRELUDE = files("surctl.ir").joinpath("wide.h").read_text(encoding="utf-8")
"""C text that must precede the text of `emit_wide`. The macro LANES may be defined before it, as a power of 2."""


Array: TypeAlias = NDArray[np.float64]

_WIDEST = 8
_TURN = 0.05  # s; approximate length of one call into C; interrupts are handled between calls


class Batch:
    """A compiled simulation step for any number of runs; it computes the next state from state and parameters.

    Attributes:
        sizes: number of entries of a run's state and of its parameters.
        lanes: number of runs that one thread processes at a time.
    """

    def __init__(self, library: bytes) -> None:
        self._library = loaded(library)
        for name in ("lanes", "work", "state", "parameters"):
            getattr(self._library, f"surctl_{name}").restype = ctypes.c_long
        self.sizes = int(self._library.surctl_state()), int(self._library.surctl_parameters())
        self._library.surctl_go.restype = ctypes.c_long
        self._library.surctl_go.argtypes = [ctypes.c_void_p] * 5 + [ctypes.c_long] * 2
        self.lanes = int(self._library.surctl_lanes())

    def run(self, state: Array, parameters: Array, *, steps: int, threads: int = 1) -> Array:
        """Return the final states; a run ends after the first step that sets its flag, or after `steps` steps.

        Args:
            state: (runs, n); entry 0 of a run's state is the flag of this run, 0 while the run continues. If the flag
                is not 0 at the start, no step is computed.

        Raises:
            InputError: an array has another shape, `steps` is negative, or `threads` is below 1.
        """
        n, m = self.sizes
        arrays = [np.ascontiguousarray(x, dtype=np.float64) for x in (state, parameters)]
        runs = arrays[0].shape[0] if arrays[0].ndim else 0
        for name, array, size in (("state", arrays[0], n), ("parameters", arrays[1], m)):
            if array.shape != (runs, size):
                raise InputError(f"has shape {array.shape}, expected ({runs}, {size})", key=name)
        for name, count, least in (("steps", steps, 0), ("threads", threads, 1)):
            if count < least:
                raise InputError(f"must be at least {least}", key=name, value=count)
        out = np.empty_like(arrays[0])
        threads = max(1, min(threads, -(-runs // self.lanes)))
        job = _Job(self._library, arrays[0], arrays[1], out, steps, _blocks(runs, threads, self.lanes))
        if threads == 1:
            job.work()
        else:
            job.share(threads)
        return out


def _blocks(runs: int, threads: int, lanes: int) -> Iterator[tuple[int, int]]:
    """Yield groups of consecutive runs as pairs (index of the first run, index after the last run)."""
    size = runs if threads == 1 else max(lanes, min(1024, runs // (16 * threads)))
    for first in range(0, runs, max(1, size)):
        yield first, min(runs, first + size)


class _Job:
    """One call of `Batch.run`, shared by the threads that work on it."""

    def __init__(
        self, library: Any, state: Array, parameters: Array, out: Array, steps: int, blocks: Iterator[tuple[int, int]]
    ) -> None:
        self.library, self.arrays, self.steps, self.blocks = library, (state, parameters, out), steps, blocks
        self.lock, self.stop = threading.Lock(), threading.Event()

    def share(self, threads: int) -> None:
        # all threads stop when a thread fails or the user interrupts
        with ThreadPoolExecutor(threads) as pool:
            try:
                for done in [pool.submit(self.work) for _ in range(threads)]:
                    done.result()
            finally:
                self.stop.set()

    def work(self) -> None:
        # between short calls into C, `stop` is tested
        lanes = int(self.library.surctl_lanes())
        # next run, end, whether more may follow, active runs, then for each lane its run and its remaining steps
        book = np.zeros(4 + 2 * lanes, dtype=np.dtype(ctypes.c_long))
        book[4 : 4 + lanes] = -1
        memory = _aligned(int(self.library.surctl_work()))
        addresses = [x.ctypes.data for x in (*self.arrays, memory, book)]
        chunk = 1
        book[2] = 1
        while not self.stop.is_set():
            if book[2] and book[0] == book[1]:
                self._take(book)
            begin = time.perf_counter()
            used = int(self.library.surctl_go(*addresses, self.steps, chunk))
            if not book[2] and not book[3]:
                return
            if used == chunk:
                spent = time.perf_counter() - begin
                chunk = int(min(2 * chunk, max(1, chunk * _TURN / max(spent, 1e-9))))

    def _take(self, book: NDArray[Any]) -> None:
        with self.lock:
            block = next(self.blocks, None)
        if block is None:
            book[2] = 0
        else:
            book[:2] = block


def _aligned(size: int) -> Array:
    # the address must be a multiple of the vector length
    memory = np.zeros(size + _WIDEST)
    skip = (-memory.ctypes.data // memory.itemsize) % _WIDEST
    return memory[skip : skip + size]


def compile_batch(step: Block, *, lanes: int | None = None, flags: Sequence[str] = ()) -> Batch:
    """Compile a simulation step for many runs, or load the compiled step from the cache.

    Args:
        step: program or routine with the inputs state (n,) and parameters (m,), and with the next state (n,) as output;
            entry 0 of the state is the flag that ends a run.
        lanes: number of runs that one thread processes in parallel: 1, 2, 4 or 8; None selects the vector width of this
            machine. The final states do not depend on this number, unless the step uses libm functions such as sin (see
            `without_libm`).
        flags: additional compiler flags; flags that change numerical results are refused.

    Raises:
        InputError: the step has other inputs or outputs, `lanes` is invalid, or a flag changes results.
        ToolMissing: there is no compiler, or no folder from which a library can be loaded.
        SurctlError: the compiler reports an error.
    """
    if lanes not in (None, 1, 2, 4, 8):
        raise InputError("is not a lane count", key="lanes", value=lanes, remedy="use 1, 2, 4 or 8")
    width = () if lanes is None else (f"-DLANES={lanes}",)
    return compile_batch_source(batch_source(step), flags=(*width, *flags))


def compile_batch_source(source: str, *, flags: Sequence[str] = ()) -> Batch:
    """Compile the C text of `batch_source`, or load the compiled step from the cache; see `compile_batch`."""
    return Batch(shared_library(source, flags=flags, wide=True))


def batch_source(step: Block) -> str:
    """Return the C text of a simulation step for many runs, which `compile_batch_source` compiles."""
    sizes = [size for _, size in step.inputs]
    output_sizes = [size for _, size in step.outputs]
    if len(sizes) != 2 or output_sizes != sizes[:1] or sizes[0] < 1:
        problem = f"has inputs of the sizes {sizes} and outputs of the sizes {output_sizes}"
        raise InputError(problem, key=step.name, remedy="(state, parameters) in, state out")
    wide = emit_wide(step, symbol="surctl_step")
    n, m = sizes
    driver = files("surctl.ir").joinpath("batch.c").read_text(encoding="utf-8")
    return f"{PRELUDE}\n{wide.text}\n#define STATE {n}\n#define PARAMETERS {m}\n#define WORK {wide.work}\n\n{driver}"
