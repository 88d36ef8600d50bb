"""The hand-written scalar C loop (`hand/loop.c`), compiled for this machine."""

from __future__ import annotations

import ctypes
import shlex
import subprocess
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scene import LUCK, OWN_METRICS, Array, with_corners

from surctl.errors import SurctlError
from surctl.ir.cache import find_compiler

__all__ = ["FLAGS", "HandLoop"]

SOURCE = Path(__file__).parents[1] / "hand" / "loop.c"
FLAGS = {
    "-O2": ("-O2", "-march=native"),
    "-O3": ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math"),
    "-Ofast": ("-O3", "-march=native", "-ffast-math", "-fno-finite-math-only"),
}
_GAINS = 17


class HandLoop:
    """`run` simulates many runs of a scene; fused multiply-adds are allowed, as by default in the compiler."""

    def __init__(self, folder: Path, flags: Sequence[str]) -> None:
        """Compile into `folder`; raise SurctlError if the compiler fails."""
        library = folder / f"loop{abs(hash(tuple(flags)))}.so"
        command = [*shlex.split(find_compiler()), "-std=c99", *flags, "-shared", "-fPIC", "-o", str(library)]
        done = subprocess.run([*command, str(SOURCE), "-lm"], capture_output=True, text=True, check=False)
        if done.returncode:
            raise SurctlError(f"the hand-written loop does not compile: {done.stderr.strip().splitlines()[0]}")
        self._library: Any = ctypes.CDLL(str(library))
        self._library.batch.restype = ctypes.c_double
        self._library.batch.argtypes = [ctypes.c_void_p, ctypes.c_long, *[ctypes.c_void_p] * 4]

    def run(self, scene: Array, gains: Array, luck: Array, seeds: NDArray[np.uint64], *, threads: int = 1) -> Array:
        """Return metrics (runs, len(METRICS)) for gains (runs, 17) and random numbers (runs, LUCK)."""
        runs = len(seeds)
        if scene.size * 8 != self._library.sizes(0) or gains.shape != (runs, _GAINS) or luck.shape != (runs, LUCK):
            raise ValueError("the layout is not that of hand/loop.c")
        out = np.empty((runs, OWN_METRICS))
        parts = np.linspace(0, runs, 8 * threads + 1 if threads > 1 else 2).astype(int)

        def part(first: int, last: int) -> float:
            data = [table[first:last].ctypes.data for table in (gains, luck, seeds, out)]
            return float(self._library.batch(scene.ctypes.data, last - first, *data))

        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(part, parts[:-1], parts[1:]))
        return with_corners(out)
