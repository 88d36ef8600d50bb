"""Many runs of a compiled simulation step in parallel, with lanes and threads; when a run ends; its C text."""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir.c99_wide import emit_wide
from surctl.ir.cache import shared_library
from surctl.ir.native import loaded
from surctl.ir.routine import Block

PRELUDE = r"""#include <math.h>
#include <string.h>

/* number of runs side by side, unless defined by the caller */
#ifndef LANES
#if defined(__GNUC__) && defined(__AVX512DQ__)
#define LANES 8
#elif defined(__GNUC__) && defined(__AVX__)
#define LANES 4
#elif defined(__GNUC__) && (defined(__ARM_NEON) || defined(__VSX__))
#define LANES 2
#else
#define LANES 1
#endif
#endif

/* number of runs in one vector */
#if defined(__GNUC__) && defined(__AVX512DQ__) && LANES % 8 == 0
#define WIDTH 8
#elif defined(__GNUC__) && defined(__AVX__) && LANES % 4 == 0
#define WIDTH 4
#elif defined(__GNUC__) && (defined(__SSE2__) || defined(__ARM_NEON) || defined(__VSX__)) && LANES % 2 == 0
#define WIDTH 2
#else
#define WIDTH 1
#endif

#if WIDTH > 2
#include <immintrin.h>
#endif

#if defined(__GNUC__)
#define APART __attribute__((noinline))
#else
#define APART
#endif

#if WIDTH == 8

typedef __m512d vec;
typedef __mmask8 truth;
#define SET(x) _mm512_set1_pd(x)
#define TRUTH(a) _mm512_cmp_pd_mask(a, _mm512_setzero_pd(), _CMP_NEQ_UQ)
#define NUMBER(m) _mm512_maskz_mov_pd(m, _mm512_set1_pd(1.0))
#define LT(a, b) _mm512_cmp_pd_mask(a, b, _CMP_LT_OQ)
#define LE(a, b) _mm512_cmp_pd_mask(a, b, _CMP_LE_OQ)
#define EQ(a, b) _mm512_cmp_pd_mask(a, b, _CMP_EQ_OQ)
#define NE(a, b) _mm512_cmp_pd_mask(a, b, _CMP_NEQ_UQ)
#define AND(a, b) _kand_mask8(a, b)
#define OR(a, b) _kor_mask8(a, b)
#define NOT(a) _knot_mask8(a)
#define SELECT(m, a, b) _mm512_mask_blend_pd(m, b, a)
#define ONLY_IF(m, a) _mm512_maskz_mov_pd(m, a)
#define FABS(a) _mm512_abs_pd(a)
/* the second operand if both are equal or one is a NaN */
#define FMIN(a, b) _mm512_min_pd(b, a)
#define FMAX(a, b) _mm512_max_pd(b, a)
#define ROOT(v) v = _mm512_sqrt_pd(v)
#define ROUND_DOWN(v) v = _mm512_floor_pd(v)
#define FUSED(v, b, c) v = _mm512_fmadd_pd(v, b, c)
#define BITS(m) ((unsigned)(m))

#elif WIDTH == 4

typedef __m256d vec;
typedef __m256d truth;
#define SET(x) _mm256_set1_pd(x)
#define TRUTH(a) _mm256_cmp_pd(a, _mm256_setzero_pd(), _CMP_NEQ_UQ)
#define NUMBER(m) _mm256_and_pd(m, _mm256_set1_pd(1.0))
#define LT(a, b) _mm256_cmp_pd(a, b, _CMP_LT_OQ)
#define LE(a, b) _mm256_cmp_pd(a, b, _CMP_LE_OQ)
#define EQ(a, b) _mm256_cmp_pd(a, b, _CMP_EQ_OQ)
#define NE(a, b) _mm256_cmp_pd(a, b, _CMP_NEQ_UQ)
#define AND(a, b) _mm256_and_pd(a, b)
#define OR(a, b) _mm256_or_pd(a, b)
#define NOT(a) _mm256_xor_pd(a, _mm256_castsi256_pd(_mm256_set1_epi64x(-1LL)))
#define SELECT(m, a, b) _mm256_blendv_pd(b, a, m)
#define ONLY_IF(m, a) _mm256_and_pd(m, a)
#define FABS(a) _mm256_andnot_pd(_mm256_set1_pd(-0.0), a)
#define FMIN(a, b) _mm256_min_pd(b, a)
#define FMAX(a, b) _mm256_max_pd(b, a)
#define ROOT(v) v = _mm256_sqrt_pd(v)
#define ROUND_DOWN(v) v = _mm256_floor_pd(v)
#if defined(__FMA__)
#define FUSED(v, b, c) v = _mm256_fmadd_pd(v, b, c)
#endif
#define BITS(m) ((unsigned)_mm256_movemask_pd(m))

#elif WIDTH == 2

typedef double vec __attribute__((vector_size(8 * WIDTH)));
typedef long long truth __attribute__((vector_size(8 * WIDTH)));
#define SET(x) ((x) - (vec){0.0})
#define TRUTH(a) ((truth)((a) != (vec){0.0}))
#define NUMBER(m) ((vec)((m) & (truth)SET(1.0)))
#define LT(a, b) ((truth)((a) < (b)))
#define LE(a, b) ((truth)((a) <= (b)))
#define EQ(a, b) ((truth)((a) == (b)))
#define NE(a, b) ((truth)((a) != (b)))
#define AND(a, b) ((a) & (b))
#define OR(a, b) ((a) | (b))
#define NOT(a) (~(a))
#define SELECT(m, a, b) ((vec)(((m) & (truth)(a)) | (~(m) & (truth)(b))))
#define ONLY_IF(m, a) ((vec)((m) & (truth)(a)))
#define FABS(a) ((vec)((truth)(a) & 0x7fffffffffffffffLL))
#define BITS(m) ((unsigned)(((m)[0] & 1LL) | ((m)[1] & 2LL)))
#define FMIN(a, b) SELECT(LT(b, a), b, a)
#define FMAX(a, b) SELECT(LT(a, b), b, a)
#define ROOT(v) LIBRARY(sqrt, v)
#define ROUND_DOWN(v) LIBRARY(floor, v)

#if defined(__FMA__)
#include <immintrin.h>
#define FUSED(v, b, c) v = (vec)_mm_fmadd_pd((__m128d)(v), (__m128d)(b), (__m128d)(c))
#endif

#else

typedef double vec;
typedef int truth;
#define SET(x) (x)
#define TRUTH(a) ((a) != 0.0)
#define NUMBER(m) ((m) ? 1.0 : 0.0)
#define LT(a, b) ((a) < (b))
#define LE(a, b) ((a) <= (b))
#define EQ(a, b) ((a) == (b))
#define NE(a, b) ((a) != (b))
#define AND(a, b) ((a) & (b))
#define OR(a, b) ((a) | (b))
#define NOT(a) (!(a))
#define SELECT(m, a, b) ((m) ? (a) : (b))
#define ONLY_IF(m, a) ((m) ? (a) : 0.0)
#define FABS(a) fabs(a)
#define BITS(m) ((unsigned)(m))
#define FMIN(a, b) (((b) < (a)) ? (b) : (a))
#define FMAX(a, b) (((a) < (b)) ? (b) : (a))
#define ROOT(v) LIBRARY(sqrt, v)
#define ROUND_DOWN(v) LIBRARY(floor, v)

#endif

#define ADD(a, b) ((a) + (b))
#define SUB(a, b) ((a) - (b))
#define MUL(a, b) ((a) * (b))
#define DIV(a, b) ((a) / (b))
#define NEG(a) (-(a))
#define INV(a) (SET(1.0) / (a))
#define SQ(a) ((a) * (a))
#define TWICE(a) ((a) + (a))

#define EACH_LANE for (int lane = 0; lane < LANES; lane += WIDTH)
#if WIDTH == 1
#define LOAD(from, at) (from)[(at) * LANES + lane]
#define STORE(to, at, v) (to)[(at) * LANES + lane] = (v)
#define LIBRARY(f, v) v = f(v)
#define LIBRARY_2(f, v, w) v = f(v, w)
#define FUSED(v, b, c) v = fma(v, b, c)
#else
typedef double loose __attribute__((vector_size(8 * WIDTH), aligned(8), may_alias));
#define LOAD(from, at) ((vec) * (const loose *)((from) + (at) * LANES + lane))
#define STORE(to, at, v) (*(loose *)((to) + (at) * LANES + lane) = (loose)(v))
#define LIBRARY(f, v) for (int k = 0; k < WIDTH; ++k) { v[k] = f(v[k]); }
#define LIBRARY_2(f, v, w) { const vec other = w; for (int k = 0; k < WIDTH; ++k) { v[k] = f(v[k], other[k]); } }
#if !defined(FUSED)
#define FUSED(v, b, c) \
    { const vec by = b, to = c; for (int k = 0; k < WIDTH; ++k) { v[k] = fma(v[k], by[k], to[k]); } }
#endif
#endif

/* helper functions; clang would warn about an unused static function */
#define HELPER static inline __attribute__((unused))

#define ALL_LANES ((1U << LANES) - 1U)

/* the lanes whose flag is 0, as bits */
HELPER unsigned running(const double *flag)
{
    unsigned run = 0U;
    EACH_LANE { run |= BITS(EQ(LOAD(flag, 0), SET(0.0))) << lane; }
    return run;
}

/* the piece with this index: rounded down, limited to the pieces that exist, 0 for a NaN */
HELPER int piece(double index, double last)
{
    return (int)((index >= 1.0) ? ((index < last) ? index : last) : 0.0);
}

HELPER void copy(double *to, const double *from, int size)
{
    memmove(to, from, (size_t)size * LANES * sizeof *to);
}

HELPER void fill(double *to, double value)
{
    for (int lane = 0; lane < LANES; ++lane) { to[lane] = value; }
}

/* new numbers for the lanes whose flag is 0 */
HELPER void keep(double *to, const double *fresh, const double *flag, int size)
{
    EACH_LANE {
        const truth run = EQ(LOAD(flag, 0), SET(0.0));
        for (int k = 0; k < size; ++k) {
            STORE(to, k, SELECT(run, LOAD(fresh, k), LOAD(to, k)));
        }
    }
}
"""
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
            parameters: parameters of each run (runs, m).
            steps: largest number of steps.
            threads: number of threads; the final states do not depend on this number.

        Returns:
            The final states (runs, n).

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


def compile_batch(
    step: Block, *, lanes: int | None = None, flags: Sequence[str] = (), folder: Path | None = None
) -> Batch:
    """Compile a simulation step for many runs, or load the compiled step from the cache.

    Args:
        step: program or routine with the inputs state (n,) and parameters (m,), and with the next state (n,) as output;
            entry 0 of the state is the flag that ends a run.
        lanes: number of runs that one thread processes in parallel: 1, 2, 4 or 8; None selects the vector width of this
            machine. The final states do not depend on this number, unless the step uses libm functions such as sin (see
            `without_libm`).
        flags: additional compiler flags; flags that change numerical results are refused.
        folder: cache folder (`surctl.ir.cache.cache_folder()` if None).

    Raises:
        InputError: the step has other inputs or outputs, `lanes` is invalid, or a flag changes results.
        ToolMissing: there is no compiler, or no folder from which a library can be loaded.
        SurctlError: the compiler reports an error.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import compile_batch, lower
        >>> x, p = ca.SX.sym("x", 2), ca.SX.sym("p")  # stopped, speed; drag
        >>> speed = x[1] - 0.05 * p * x[1]
        >>> batch = compile_batch(lower(ca.Function("coast", [x, p], [ca.vertcat(speed < 0.1, speed)])))
        >>> batch.run([[0.0, 1.0], [0.0, 1.0]], [[0.5], [2.0]], steps=60).round(4).tolist()
        [[0.0, 0.2189], [1.0, 0.0985]]
    """
    if lanes not in (None, 1, 2, 4, 8):
        raise InputError("is not a lane count", key="lanes", value=lanes, remedy="use 1, 2, 4 or 8")
    width = () if lanes is None else (f"-DLANES={lanes}",)
    return compile_batch_source(batch_source(step), flags=(*width, *flags), folder=folder)


def compile_batch_source(source: str, *, flags: Sequence[str] = (), folder: Path | None = None) -> Batch:
    """Compile the C text of `batch_source`, or load the compiled step from the cache; see `compile_batch`.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import batch_source, compile_batch_source, lower
        >>> x, p = ca.SX.sym("x", 2), ca.SX.sym("p")  # stopped, speed; drag
        >>> text = batch_source(lower(ca.Function("coast", [x, p], [ca.vertcat(x[1] < 0.1, x[1] - 0.05 * p * x[1])])))
        >>> compile_batch_source(text).run([[0.0, 1.0]], [[2.0]], steps=1).tolist()
        [[0.0, 0.9]]
    """
    return Batch(shared_library(source, flags=flags, folder=folder, wide=True))


def batch_source(step: Block) -> str:
    """Return the C text of a simulation step for many runs, which `compile_batch_source` compiles.

    Args:
        step: as in `compile_batch`.

    Raises:
        InputError: the step has other inputs or outputs.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import batch_source, lower
        >>> x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
        >>> text = batch_source(lower(ca.Function("coast", [x, p], [ca.vertcat(x[1] < 0.1, x[1] - p)])))
        >>> [line for line in text.splitlines() if line.startswith(("#define STATE", "#define PARAMETERS"))]
        ['#define STATE 2', '#define PARAMETERS 1']
    """
    sizes = [size for _, size in step.inputs]
    output_sizes = [size for _, size in step.outputs]
    if len(sizes) != 2 or output_sizes != sizes[:1] or sizes[0] < 1:
        problem = f"has inputs of the sizes {sizes} and outputs of the sizes {output_sizes}"
        raise InputError(problem, key=step.name, remedy="(state, parameters) in, state out")
    wide = emit_wide(step, symbol="surctl_step")
    n, m = sizes
    return f"{PRELUDE}\n{wide.text}\n#define STATE {n}\n#define PARAMETERS {m}\n#define WORK {wide.work}\n{_DRIVER}"


_DRIVER = r"""
long surctl_lanes(void);
long surctl_lanes(void) { return LANES; }

long surctl_state(void);
long surctl_state(void) { return STATE; }

long surctl_parameters(void);
long surctl_parameters(void) { return PARAMETERS; }

/* size of the memory that one thread needs, in numbers */
long surctl_work(void);
long surctl_work(void) { return (long)LANES * (STATE + PARAMETERS + WORK); }

/* load the next unfinished run into this lane; a run that needs no step is copied to the output */
static void refill(const double *state, const double *parameters, double *out, double *memory, long *book, int lane,
    long steps)
{
    long *const run = book + 4 + lane;
    *run = -1;
    while (*run < 0 && book[0] < book[1]) {
        const long next = book[0]++;
        const double *const from = state + next * STATE;
        if (from[0] != 0.0 || steps == 0) {
            for (int k = 0; k < STATE; ++k) { out[next * STATE + k] = from[k]; }
            continue;
        }
        for (int k = 0; k < STATE; ++k) { memory[k * LANES + lane] = from[k]; }
        double *const own = memory + STATE * LANES;
        for (int k = 0; k < PARAMETERS; ++k) { own[k * LANES + lane] = parameters[next * PARAMETERS + k]; }
        *run = next;
        run[LANES] = steps;
    }
}

/* a lane without a run repeats the computation of an active lane */
static void shadow(double *memory, const long *book)
{
    int busy = 0;
    while (busy < LANES && book[4 + busy] < 0) { ++busy; }
    for (int lane = 0; lane < LANES && busy < LANES; ++lane) {
        if (book[4 + lane] >= 0) { continue; }
        for (int k = 0; k < STATE + PARAMETERS; ++k) { memory[k * LANES + lane] = memory[k * LANES + busy]; }
    }
}

/* at most `chunk` steps, fewer if a lane is free and no run is left; returns the number of steps */
long surctl_go(const double *state, const double *parameters, double *out, double *memory, long *book, long steps,
    long chunk);
long surctl_go(const double *state, const double *parameters, double *out, double *memory, long *book, long steps,
    long chunk)
{
    double *const own = memory + STATE * LANES;
    double *const work = own + PARAMETERS * LANES;
    long done = 0;
    for (;;) {
        long left = chunk - done, busy = 0, idle = 0;
        for (int lane = 0; lane < LANES; ++lane) {
            if (book[4 + lane] < 0) {
                refill(state, parameters, out, memory, book, lane, steps);
                ++idle;
            }
            if (book[4 + lane] >= 0) {
                ++busy;
                left = (book[4 + LANES + lane] < left) ? book[4 + LANES + lane] : left;
            }
        }
        book[3] = busy;
        if (busy == 0 || done == chunk || (busy < LANES && book[2] != 0)) { return done; }
        if (idle > 0 && busy < LANES) { shadow(memory, book); }
        long count = 0;
        do {
            surctl_step(memory, own, memory, work);
            ++count;
        } while (count < left && running(memory) == ALL_LANES);
        done += count;
        for (int lane = 0; lane < LANES; ++lane) {
            const long run = book[4 + lane];
            if (run < 0) { continue; }
            book[4 + LANES + lane] -= count;
            if (memory[lane] == 0.0 && book[4 + LANES + lane] > 0) { continue; }
            for (int k = 0; k < STATE; ++k) { out[run * STATE + k] = memory[k * LANES + lane]; }
            book[4 + lane] = -1;
        }
    }
}
"""
