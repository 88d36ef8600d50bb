"""A routine alone on the emulated Cortex-M4F: what it answers, and how many instructions each call takes."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surctl.export import TARGETS
from surctl.ir import Routine, compile_program, emit_block

__all__ = ["counted", "counted_c"]

_NAME = "alone"
_MAIN = """
#include <stdio.h>
static float record[RECORD], answer[ANSWER];
void stepped(void);
__attribute__((noinline)) void step(void) { one(record, answer); }
int main(int argc, char **argv)
{
    (void)argc; (void)argv;
    while (fread(record, sizeof(float), RECORD, stdin) == RECORD) {
        step();
        stepped();
        fwrite(answer, sizeof(float), ANSWER, stdout);
    }
    return 0;
}
"""


def counted(
    routine: Routine, arrays: tuple[NDArray[np.float64], ...], *, target: str = "cortex-m4f", level: str = "-O2"
) -> tuple[list[NDArray[np.float32]], NDArray[np.int64]]:
    """(outputs (N, size) each, instructions (N,)) in float32, for inputs (N, size) each."""
    sizes, made = [size for _, size in routine.inputs], [size for _, size in routine.outputs]
    starts, ends = (np.cumsum([0, *part[:-1]]) for part in (sizes, made))
    given = ", ".join([*(f"record + {at}" for at in starts), *(f"answer + {at}" for at in ends)])
    text = f"""#include <math.h>
#include <stddef.h>
#include <string.h>
{emit_block(routine, symbol="law", real="float32", folded=True)}
static void one(const float *record, float *answer) {{ law({given}); }}
"""
    rows, counts = counted_c(text, np.hstack(arrays), sum(made), target=target, level=level)
    return np.split(rows, ends[1:], axis=1), counts


def counted_c(
    text: str,
    records: NDArray[np.float64],
    width: int,
    *,
    sources: Sequence[Path] = (),
    flags: Sequence[str] = (),
    target: str = "cortex-m4f",
    level: str = "-O2",
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """(answers (N, width), instructions (N,)) of `static void one(const float *record, float *answer)`.

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
        sizes = (f"-DRECORD={records.shape[1]}", f"-DANSWER={width}")
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
        sent = records.astype(np.float32).tobytes()
        raw = subprocess.run(command, input=sent, capture_output=True, check=True).stdout
        counts = np.array([int(line) for line in (folder / "counts").read_text().split()])
    return np.frombuffer(raw, dtype=np.float32).reshape(len(counts), width), counts
