"""A law with ages, its C, and the program that steps it by given sample numbers."""

from __future__ import annotations

import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.export import Bundle, write_bundle
from surctl.export.process import compile_controller
from surctl.ir import Layout, Port
from surctl.ir.cache import compile_program
from surctl.marine.export import build_bundle
from surctl.system import Action, Controller

DT, LONGEST, REFUSED = 0.05, 60.0, -9.0
MAIN = """#include "clock.h"
#include <stdio.h>
int main(void)
{
    static clock_state_t state; static clock_gains_t gains; static clock_input_t input; static clock_output_t output;
    static double row[2], out[3];
    volatile double zero = 0.0;
    (void)clock_initialize(&state, &gains);
    while (fread(row, sizeof row[0], 2, stdin) == 2) {
        input.sample = (uint32_t)row[0];
        input.message = (row[1] == -9.0) ? zero / zero : row[1];
        out[0] = clock_step(&state, &gains, &input, &output);
        out[1] = state.x[clock_at_age];
        out[2] = state.x[clock_at_last];
        (void)fwrite(out, sizeof out[0], 3, stdout);
    }
    return 0;
}
""".replace("clock", "clock_law")


def clock_bundle() -> Bundle:
    """Return the bundle of a law that states the age of the last message and remembers the last step."""

    def law(x: dict[str, ca.SX], u: dict[str, ca.SX], p: dict[str, ca.SX]) -> Action:
        age = ca.if_else(u["message"] > 0.5, 0.0, ca.fmin(x["age"] + DT, LONGEST))
        return Action(age <= 0.5, {"age": age, "last": x["last"] + 1})

    controller = Controller(
        "clock_law",
        DT,
        Layout((Port("message", (1,), "1", "1 if a message came"),)),
        Layout((Port("go", (1,), "1", "1 while the message is fresh"),)),
        law,
        Layout(
            (
                Port("age", (1,), "s", "time since the message", LONGEST, gap="age"),
                Port("last", (1,), "1", "steps since the memory began", 0.0, gap="anew"),
            )
        ),
    )
    return build_bundle(controller, {})


def run_clock(bundle: Bundle, folder: Path, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compile the bundle and step it: rows (T, 2) of sample number and message → (T, 3) of status, age, memory."""
    write_bundle(bundle, folder / "b")
    (folder / "main.c").write_text(MAIN)
    code = compile_controller(bundle, folder / "b")
    program = compile_program([folder / "main.c", *code], folder / "main", flags=["-I", str(folder / "b")])
    done = subprocess.run([str(program)], input=rows.tobytes(), capture_output=True, check=True)
    return np.frombuffer(done.stdout).reshape(len(rows), 3)
