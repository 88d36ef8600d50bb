"""Compiled programs and routines that Python can call; without a compiler a slower function, and a warning."""

from __future__ import annotations

import ctypes
import itertools
import tempfile
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, SurctlError, ToolMissing
from surctl.ir.c99 import C_TYPE, Real
from surctl.ir.c99_routine import emit_block
from surctl.ir.cache import quick_flags, shared_library, source_digest
from surctl.ir.folding import shortened
from surctl.ir.replay import checked, replay
from surctl.ir.routine import Block

Array: TypeAlias = NDArray[Any]  # of the block's dtype

_SYMBOL = "surctl_block"


class SlowerEngine(UserWarning):
    """Warning that there is no C compiler, so that a computation takes about 100 times as long."""


def warn_slower(missing: ToolMissing) -> None:
    """Warn, once for each reason, that a computation starts without compiled code."""
    # one place for all callers: Python shows a warning again only for another place
    warnings.warn(f"{missing}; until then, simulations take up to 100 times as long", SlowerEngine, stacklevel=1)


class Workspace:
    """Input and output buffers for a compiled function: write to `inputs`, call `run`, then read `outputs`.

    A workspace must not be shared between threads; `Native.workspace` creates as many workspaces as needed.

    Attributes:
        inputs, outputs: arrays of the inputs and of the outputs, in the order of the compiled function; all are views
            of one buffer.
        run: the compiled function, which has no arguments and returns None.
    """

    def __init__(self, native: Native) -> None:
        sizes = [size for _, size in (*native.block.inputs, *native.block.outputs)]
        self._memory = np.zeros(max(1, sum(sizes)), dtype=native.dtype)
        ends = np.cumsum([0, *sizes])
        views = [self._memory[a:b] for a, b in itertools.pairwise(ends)]
        split = len(native.block.inputs)
        self.inputs: tuple[Array, ...] = tuple(views[:split])
        self.outputs: tuple[Array, ...] = tuple(views[split:])
        self.run: Callable[[], None] = native.bound(self._memory)


class Native:
    """A program or routine compiled by the system's C compiler.

    Attributes:
        block: the program or routine that was compiled. If it has no `libm` operations, its outputs have the same bytes
            as those of `replay`.
        dtype: type of every array, np.float64 or np.float32.
    """

    def __init__(self, block: Block, library: bytes, *, real: Real = "float64") -> None:
        self.block, self.dtype = block, np.dtype(real)
        self._inputs, self._outputs = block.inputs, block.outputs  # a routine would compute these at every access
        self._library = loaded(library)
        self._library.surctl_run.restype = None
        self._library.surctl_run_many.restype = None
        count = len(block.inputs) + len(block.outputs)
        self._library.surctl_run_many.argtypes = [ctypes.c_long, *[ctypes.c_void_p] * count]

    def workspace(self) -> Workspace:
        """Return a new workspace for the compiled function."""
        return Workspace(self)

    def bound(self, memory: Array) -> Callable[[], None]:
        """Return a function that reads and writes the flat buffer `memory` (all inputs, then all outputs)."""
        if memory.dtype != self.dtype or not memory.flags.c_contiguous:
            raise InputError(f"is not a contiguous {self.dtype} buffer", key=self.block.name)
        function: Any = self._library.surctl_run
        # without `argtypes`, a pointer that exists already is passed in half the time; it keeps the buffer alive
        return partial(function, ctypes.byref(ctypes.c_char.from_buffer(memory.data)))

    def __call__(self, *inputs: ArrayLike) -> list[Array]:
        """Evaluate the compiled function; inputs (n,) or (batch, n) give outputs of shape (m,) or (batch, m)."""
        arrays = checked(self.block.name, self._inputs, inputs, self.dtype)
        batch = np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
        full = [np.ascontiguousarray(np.broadcast_to(a, (*batch, a.shape[-1]))) for a in arrays]
        out = [np.empty((*batch, size), dtype=self.dtype) for _, size in self._outputs]
        count = int(np.prod(batch, dtype=np.int64))
        self._library.surctl_run_many(count, *(a.ctypes.data for a in (*full, *out)))
        return out


def loaded(library: bytes) -> ctypes.CDLL:
    """Load a shared library from its bytes; the temporary file for this is deleted."""
    try:
        with tempfile.TemporaryDirectory(prefix="surctl-") as folder:
            path = Path(folder) / "block.so"
            path.write_bytes(library)
            return ctypes.CDLL(str(path))
    except OSError as error:  # the folder may be full, or mounted noexec
        problem = f"compiled code cannot be loaded from there ({error})"
        remedy = "set it to a folder from which programs may run"
        raise ToolMissing(problem, key="TMPDIR", value=tempfile.gettempdir(), remedy=remedy) from None


def compile_block(block: Block, *, flags: Sequence[str] = (), real: Real = "float64") -> Native:
    """Compile a program or routine, or load the compiled library from the cache.

    Args:
        flags: additional compiler flags; flags that change numerical results are refused.
        real: "float32" computes in float and rounds the inputs to float.

    Raises:
        ToolMissing: there is no compiler, or no folder from which a library can be loaded; use `replay` instead.
        InputError: a flag changes numerical results.
        SurctlError: the compiler reports an error.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import compile_block, lower
        >>> v = ca.SX.sym("v", 2)
        >>> speed = compile_block(lower(ca.Function("speed", [v], [ca.norm_2(v)])))
        >>> speed([[0.3, 0.4], [0.0, 0.2]])[0].tolist()  # one run in each row
        [[0.5], [0.2]]
    """
    write = partial(_source, block, real)
    return Native(block, shared_library(write, flags=flags, identity=_identity(block, real)), real=real)


def _identity(block: Block, real: Real) -> str:
    """Return a text that identifies the C text of a block without writing it; empty if there is none."""
    try:
        return f"{source_digest('surctl.ir')} {block.digest()} {real}"
    except SurctlError:  # the source code is missing or changed since the import
        return ""


def runnable(block: Block, *, quick: bool = False) -> Callable[..., list[Array]]:
    """Return the compiled program or routine, with `quick_flags` if `quick`.

    Without a compiler, return a slower function with equal results, and warn (`SlowerEngine`).
    """
    try:
        return compile_block(block, flags=quick_flags() if quick else ())
    except ToolMissing as missing:
        warn_slower(missing)
        return lambda *inputs: [np.asarray(y, dtype=np.float64) for y in replay(block, *inputs)]


def _source(block: Block, real: Real) -> str:
    kind = C_TYPE[real]
    sizes = [size for _, size in (*block.inputs, *block.outputs)]
    split = len(block.inputs)
    ends = [sum(sizes[:k]) for k in range(len(sizes))]
    one = ", ".join(f"memory + {end}" for end in ends)
    kinds = [f"const {kind} *"] * split + [f"{kind} *"] * (len(sizes) - split)
    head = ", ".join(["long count", *(f"{kind}x{k}" for k, kind in enumerate(kinds))])
    many = ", ".join(f"x{k} + {size} * i" for k, size in enumerate(sizes))
    return f"""#include <math.h>

{emit_block(shortened(block), symbol=_SYMBOL, real=real, vectors=True)}
void surctl_run({kind} *memory);
void surctl_run({kind} *memory)
{{
    {_SYMBOL}({one});
}}

void surctl_run_many({head});
void surctl_run_many({head})
{{
    for (long i = 0; i < count; ++i) {{
        {_SYMBOL}({many});
    }}
}}
"""
