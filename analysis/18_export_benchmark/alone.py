"""A single routine on the emulated Cortex-M4F: its outputs, and the instructions of each call."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.export import TARGETS
from surctl.ir import Block, Call, Gather, Loop, Program, Routine, Step, lower
from surctl.ir.c99 import C_TYPE, Real
from surctl.ir.c99_routine import emit_block
from surctl.ir.cache import compile_program

__all__ = ["at_bounds", "counted", "counted_c"]

_NAME = "alone"
_MAIN = """
#include <stdio.h>
static REAL record[RECORD], answer[ANSWER];
void stepped(void);
__attribute__((noinline)) void step(void) { one(record, answer); }
int main(int argc, char **argv)
{
    (void)argc; (void)argv;
    while (fread(record, sizeof(REAL), RECORD, stdin) == RECORD) {
        step();
        stepped();
        fwrite(answer, sizeof(REAL), ANSWER, stdout);
    }
    return 0;
}
"""


def counted(
    routine: Block,
    arrays: tuple[NDArray[np.float64], ...],
    *,
    target: str = "cortex-m4f",
    level: str = "-O2",
    real: Real = "float32",
) -> tuple[list[NDArray[np.float64]], NDArray[np.int64]]:
    """Return outputs (N, size) each and instructions (N,) in the number type, for inputs (N, size) each."""
    sizes, made = [size for _, size in routine.inputs], [size for _, size in routine.outputs]
    starts, ends = (np.cumsum([0, *part[:-1]]) for part in (sizes, made))
    given = ", ".join([*(f"record + {at}" for at in starts), *(f"answer + {at}" for at in ends)])
    text = f"""#include <math.h>
#include <stddef.h>
#include <string.h>
{emit_block(routine, symbol="law", real=real)}
static void one(const {C_TYPE[real]} *record, {C_TYPE[real]} *answer) {{ law({given}); }}
"""
    rows, counts = counted_c(text, np.hstack(arrays), sum(made), target=target, level=level, real=real)
    return np.split(rows, ends[1:], axis=1), counts


def at_bounds(routine: Routine) -> Routine:
    """The same with one more input, `never` (1,): with 0 there, which no compiler knows, every loop runs to its bound.

    What it answers is of no use: the flags that end loops are lost.
    """
    product = ca.SX.sym("flag"), ca.SX.sym("never")
    held = lower(ca.Function("held", list(product), [product[0] * product[1]]))
    steps: list[Step] = []
    for at, step in enumerate(routine.steps):
        if isinstance(step, Gather) or (isinstance(step.block, Program) and isinstance(step, Call)):
            steps.append(step)
        elif isinstance(step, Call):
            steps.append(replace(step, block=at_bounds(step.block), args=(*step.args, "never")))
        else:
            steps += _loop_at_bounds(step, held, f"held_{at}")
    return replace(routine, inputs=(*routine.inputs, ("never", 1)), steps=tuple(steps))


def _loop_at_bounds(loop: Loop, held: Program, name: str) -> list[Step]:
    body: Block = loop.block if isinstance(loop.block, Program) else at_bounds(loop.block)
    extra = () if isinstance(body, Program) else ("never",)
    if loop.until is None:
        return [replace(loop, block=body, fixed=(*loop.fixed, *extra))]
    inputs = body.inputs if extra else (*body.inputs, ("never", 1))
    given, made = tuple(key for key, _ in body.inputs), [f"made_{k}" for k, _ in enumerate(body.outputs)]
    inner = (
        Call(body, given, tuple(made)),
        Call(held, (made[loop.until], "never"), ("flag_made",)),
    )
    made[loop.until] = "flag_made"
    carried = [name if k == loop.until else key for k, key in enumerate(loop.carried)]
    return [
        Call(held, (loop.carried[loop.until], "never"), (name,)),
        replace(
            loop,
            block=Routine(f"{body.name}_on", inputs, inner, tuple(made)),
            carried=tuple(carried),
            fixed=(*loop.fixed, "never"),
        ),
    ]


def counted_c(
    text: str,
    records: NDArray[np.float64],
    width: int,
    *,
    sources: Sequence[Path] = (),
    flags: Sequence[str] = (),
    target: str = "cortex-m4f",
    level: str = "-O2",
    real: Real = "float32",
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(answers (N, width), instructions (N,)) of `static void one(const float *record, float *answer)`, or double.

    Args:
        text: C with that function. sources, flags: what is compiled with it, and how.
        records: (N, size). width: numbers of an answer.
    """
    built, templates = TARGETS[target], files("surctl.export").joinpath("templates")
    words = tuple(level if flag == "-O2" else flag for flag in built.flags)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name in ("target_start.c", "target.ld"):
            folder.joinpath(name).write_text(templates.joinpath(f"{name}.j2").read_text().replace("{{ name }}", _NAME))
        main = folder / "main.c"
        main.write_text(f"{text}\n{_MAIN}")
        sizes = (f"-DRECORD={records.shape[1]}", f"-DANSWER={width}", f"-DREAL={C_TYPE[real]}")
        bare = ("--specs=rdimon.specs", "-nostartfiles", f"-T{folder / 'target.ld'}", "-w")
        program = compile_program(
            [folder / "target_start.c", main, *sources],
            folder / "program",
            flags=(*words, *sizes, *flags, *bare),
            compiler=built.compiler,
        )
        counter = Path(str(templates / "count_steps.c"))
        plugin = compile_program([counter], folder / "count.so", flags=("-shared", "-fPIC", "-Wno-pedantic"))
        listed = subprocess.run(["arm-none-eabi-nm", str(program)], capture_output=True, text=True, check=True).stdout
        at = {words[2]: words[0] for words in map(str.split, listed.splitlines()) if len(words) == 3}
        option = f"{plugin},from=0x{at['step']},to=0x{at['stepped']},out={folder / 'counts'}"
        command = [*built.board(str(program)), "-plugin", option]
        sent = records.astype(real).tobytes()
        raw = subprocess.run(command, input=sent, capture_output=True, check=True).stdout
        counts = np.array([int(line) for line in (folder / "counts").read_text().split()])
    return np.frombuffer(raw, dtype=real).reshape(len(counts), width), counts
