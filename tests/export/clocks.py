"""The smallest law with ages: it remembers when a message came, and what the last step was; for the tests of time."""

from __future__ import annotations

from functools import cache

import casadi as ca

from surctl.export import Bundle
from surctl.ir import Layout, Port, Real
from surctl.marine.export import build_bundle
from surctl.system import Action, Controller

LONGEST = 60.0  # [s]


@cache
def clocks(real: Real = "float64") -> tuple[Controller, Bundle]:
    """The law and its bundle. The command is 1 if the message is fresh (at most 0.5 s old)."""
    dt = 0.05

    def law(x: dict[str, ca.SX], u: dict[str, ca.SX], p: dict[str, ca.SX]) -> Action:
        age = ca.if_else(u["message"] > 0.5, 0.0, ca.fmin(x["age"] + dt, LONGEST))
        memory = ca.vertcat(u["reading"], x["memory"][0])
        return Action(age <= 0.5, {"age": age, "memory": memory, "count": x["count"] + 1}, telemetry={"seen": age})

    controller = Controller(
        "clocks",
        dt,
        Layout((Port("message", (1,), "1", "1 if a message came"), Port("reading", (1,), "m", "of a sensor"))),
        Layout((Port("go", (1,), "1", "1 while the message is fresh"),)),
        law,
        Layout(
            (
                Port("age", (1,), "s", "time since the message", LONGEST, gap="age"),
                Port("memory", (2,), "m", "last readings, newest first", -1.0, gap="anew"),
                Port("count", (1,), "1", "number of steps"),
            )
        ),
        telemetry=Layout((Port("seen", (1,), "s", "age"),)),
    )
    return controller, build_bundle(controller, {}, real=real)


DRIVER = """#include "clocks.h"
#include <stdio.h>
/* stdin: triples (sample, message, reading) of doubles; a reading of -9 stands for NaN */
int main(void)
{
    static clocks_state_t state; static clocks_gains_t gains; static clocks_input_t input;
    static clocks_output_t output;
    static double row[3], out[6];
    volatile REAL zero = 0;
    (void)clocks_initialize(&state, &gains);
    while (fread(row, sizeof row[0], 3, stdin) == 3) {
        input.sample = (uint32_t)row[0];
        input.message = (REAL)row[1];
        input.reading = (row[2] == -9.0) ? zero / zero : (REAL)row[2];
        out[0] = clocks_step(&state, &gains, &input, &output);
        out[1] = (double)output.go;
        out[2] = (double)state.x[clocks_at_age];
        out[3] = (double)state.x[clocks_at_memory];
        out[4] = (double)state.x[clocks_at_memory + 1];
        out[5] = (double)state.x[clocks_at_count];
        (void)fwrite(out, sizeof out[0], 6, stdout);
    }
    return 0;
}
"""
