"""loop.c around the smallest law: nothing starts or returns without the operator, and time is counted once."""

from __future__ import annotations

import subprocess
from collections.abc import Callable

import numpy as np
import pytest

from surctl.export import Records, write_bundle
from surctl.export.precision import replayed
from surctl.export.process import compile_controller
from surctl.ir.cache import compile_program
from tests.export.clocks import LONGEST, clocks
from tests.export.standin import Vector
from tests.tools import need_compiler

MAIN = """#include "loop.h"
#include <stdio.h>
/* stdin: rows of doubles (periods, measured, armed, message, reading); a reading of -9 stands for NaN */
int main(void)
{
    static clocks_loop_t loop;
    static double row[5], out[9];
    volatile double zero = 0;
    if (clocks_loop_start(&loop) != 0) { return 1; }
    while (fread(row, sizeof row[0], 5, stdin) == 5) {
        loop.input.message = row[3];
        loop.input.reading = (row[4] == -9.0) ? zero / zero : row[4];
        out[0] = clocks_loop_step(&loop, (uint32_t)row[0], row[1] > 0.5, row[2] > 0.5);
        out[1] = loop.mode;
        out[2] = loop.status;
        out[3] = loop.state.x[clocks_at_age];
        out[4] = loop.input.sample;
        out[5] = loop.output.go;
        for (int k = 0; k < 3; ++k) { out[6 + k] = loop.state.x[clocks_at_memory + k]; }
        (void)fwrite(out, sizeof out[0], 9, stdout);
        clocks_loop_end(&loop);
    }
    return 0;
}
"""
Row = tuple[float, float, float, float, float]
Loop = Callable[[list[Row]], Vector]
READY, RUNNING, HOLDING, SAFE = range(4)
STALE = -4


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Loop:
    """Rows (periods, measured, armed, message, reading) → rows (T, 9).

    A row out: applied, state of the program, status, age, sample, command, the rest of the law's state.
    """
    need_compiler()
    folder = tmp_path_factory.mktemp("loop")
    _, bundle = clocks()
    write_bundle(bundle, folder / "b")
    (folder / "main.c").write_text(MAIN)
    code = [folder / "main.c", folder / "b/loop.c"]
    program = compile_program(
        [*code, *compile_controller(bundle, folder / "b")], folder / "main", flags=["-I", str(folder / "b")]
    )

    def steps(rows: list[Row]) -> Vector:
        done = subprocess.run([program], input=np.array(rows, float).tobytes(), capture_output=True, check=True)
        return np.frombuffer(done.stdout).reshape(len(rows), 9)

    return steps


def row(periods: int = 1, *, measured: int = 1, armed: int = 1, message: int = 0, reading: float = 2.0) -> Row:
    return periods, measured, armed, message, reading


def test_a_switch_that_is_on_at_the_start_arms_nothing(loop: Loop) -> None:
    out = loop([row()] * 60)
    assert not out[:, 0].any() and (out[:, 1] == SAFE).all() and (out[:, 2] == 0).all()
    out = loop([*[row()] * 30, row(armed=0), *[row()] * 21])
    assert list(out[[29, 30, 49, 50], 1]) == [SAFE, READY, READY, RUNNING] and not out[:50, 0].any()


FLYING = [row(armed=0), *[row()] * 21]


@pytest.mark.parametrize("halt", [19, 20, 21, 100, 600, 10**9])
def test_a_halt_of_a_second_ends_in_safe(loop: Loop, halt: int) -> None:
    """The program stood still while RUNNING: `halt` periods pass until the next step, which is accepted."""
    out = loop([*FLYING, row(halt), *[row()] * 40, row(armed=0), *[row()] * 20])
    assert out[21, 0] == 1 and (out[22:, 2] == 0).all()
    assert out[22, 1] == (RUNNING if halt <= 20 else SAFE)  # the last of the periods has an accepted step
    assert (out[22:62, 0] == (halt <= 20)).all() and out[-1, 1] == RUNNING


def test_refused_steps_and_missed_periods_count_together(loop: Loop) -> None:
    for bad, missed, end in ((10, 10, RUNNING), (10, 11, SAFE), (1, 19, RUNNING), (1, 20, SAFE)):
        out = loop([*FLYING, *[row(reading=-9.0)] * bad, row(missed), row()])
        assert (out[22:-2, 1] == HOLDING).all() and (out[-2:, 1] == end).all(), (bad, missed)
    assert loop([*FLYING, row(30, reading=-9.0)])[-1, 1] == SAFE


def test_a_halt_while_armed_counts_as_no_accepted_second(loop: Loop) -> None:
    out = loop([row(armed=0), *[row()] * 10, row(600), *[row()] * 19])
    assert (out[:-1, 1] == READY).all() and out[-1, 1] == RUNNING


def test_periods_without_a_sample_age_once(loop: Loop) -> None:
    for n in (1, 2, 10, 200):
        out = loop([row(armed=0, message=1), *[row(armed=0, measured=0)] * n, row(armed=0)])
        assert (out[1:-1, 2] == STALE).all() and not out[1:-1, 5].any()
        assert out[-1, 4] - out[0, 4] == n + 1 and out[-1, 3] == pytest.approx((n + 1) * 0.05, abs=1e-9)
    assert loop([row(measured=0)])[0, 2] == STALE  # also before the first sample


def test_ages_are_exact_through_any_outage_and_python_replays_them(loop: Loop) -> None:
    rng = np.random.default_rng(0)
    rows: list[Row] = []
    while len(rows) < 3000:
        kind, length = rng.integers(0, 4), int(rng.integers(1, 30))
        for _ in range(
            length
        ):  # ordinary steps, no samples, readings that are no number, missed periods; and all mixed
            periods = 1 if kind < 3 else int(rng.integers(1, 40))
            measured = rng.random() < (0.0 if kind == 1 else 0.9)
            bad = rng.random() < (0.9 if kind == 2 else 0.1)
            rows.append(
                row(
                    periods,
                    measured=int(measured),
                    armed=0,
                    message=int(rng.random() < 0.1),
                    reading=-9.0 if bad else 3.0,
                )
            )
    out, sent = loop(rows), np.array(rows)
    now, accepted = np.cumsum(sent[:, 0]), out[:, 2] >= 0
    arrived = np.maximum.accumulate(np.where(accepted & (sent[:, 3] > 0.5), now, -(10**9)))
    assert 500 < accepted.sum() < 2500
    assert np.abs(out[:, 3] - np.minimum((now - arrived) * 0.05, LONGEST))[accepted].max() < 1e-9

    law, _ = clocks()
    tried = sent[:, 1] > 0.5
    U = sent[tried][:, 3:]
    U[U == -9.0] = np.nan
    state = out[tried][:, [3, 6, 7, 8]]
    records = Records(np.vstack([law.initial_state(), state[:-1]]), U, np.zeros((len(U), 0)))
    again = replayed(law, records, np.arange(len(U)) == 0, counts=out[tried, 4].astype(np.int64))
    assert np.array_equal(again.status, out[tried, 2]) and np.array_equal(again.state, state)
    assert np.array_equal(again.tau[:, 0], out[tried, 5])
