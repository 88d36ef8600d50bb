"""Time in the exported step: refused, missed and jumping samples age everything, and a new count is recognised."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from surctl.export import Records, build_controller, write_bundle
from surctl.export.precision import replayed
from surctl.export.process import compile_controller
from surctl.export.supplement import RESTART, aged, longest_gap
from surctl.ir import Real
from surctl.ir.cache import compile_program
from surctl.marine.control import build_law
from surctl.marine.simulation import load_scenario
from tests.export.clocks import DRIVER, LONGEST, clocks
from tests.export.standin import Vector
from tests.tools import need_compiler

RESTARTED, STALE, NONFINITE = 16384, -4, -2
NAN = -9.0


def program(folder: Path, real: Real = "float64") -> Path:
    need_compiler()
    _, bundle = clocks(real)
    write_bundle(bundle, folder / "b")
    main = folder / "main.c"
    main.write_text(DRIVER.replace("REAL", "double" if real == "float64" else "float"))
    return compile_program(
        [main, *compile_controller(bundle, folder / "b")], folder / "main", flags=["-I", str(folder / "b")]
    )


def drive(at: Path, rows: list[tuple[float, float, float]]) -> Vector:
    """Rows of (sample, message, reading) → (status, go, age, memory, memory, count)."""
    done = subprocess.run([str(at)], input=np.array(rows, dtype=float).tobytes(), capture_output=True, check=True)
    return np.frombuffer(done.stdout).reshape(len(rows), 6)


@pytest.fixture(scope="module")
def clock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return program(tmp_path_factory.mktemp("clock"))


def test_refused_steps_age_everything_at_the_next_accepted_one(clock: Path) -> None:
    out = drive(clock, [(1, 1, 2.0), *[(2 + k, 0, NAN) for k in range(200)], (202, 0, 3.0), (203, 0, 4.0)])
    assert (out[1:201, 0] == NONFINITE).all() and not out[1:201, 1].any() and (out[1:201, 2] == 0.0).all()
    assert out[-2, 0] >= 0 and out[-2, 2] == pytest.approx(201 * 0.05, abs=1e-9)  # fresh would be 0.05 s
    assert out[-2, 1] == 0.0 and list(out[-2, 3:5]) == [3.0, -1.0]  # the reading before is not 0.05 s old
    assert out[-1, 2] == pytest.approx(202 * 0.05, abs=1e-9) and list(out[-1, 3:5]) == [4.0, 3.0]


def test_a_jump_of_the_counter_by_200_ages_by_200_periods(clock: Path) -> None:
    out = drive(clock, [(7, 1, 2.0), (207, 0, 3.0)])
    assert out[1, 2] == pytest.approx(200 * 0.05, abs=1e-9) and out[1, 1] == 0.0
    wrapped = drive(clock, [(2**32 - 2, 1, 2.0), (8, 0, 3.0)])
    assert wrapped[1, 2] == pytest.approx(10 * 0.05, abs=1e-9)


def test_calls_with_the_same_sample_count_as_periods(clock: Path) -> None:
    out = drive(clock, [(7, 1, 2.0), *[(7, 0, 2.0)] * 100, (8, 0, 3.0)])
    assert (out[1:-1, 0] == STALE).all() and out[-1, 2] == pytest.approx(101 * 0.05, abs=1e-9)


def test_a_board_that_stands_still_and_a_program_that_misses_steps_add_up(clock: Path) -> None:
    out = drive(clock, [(7, 1, 2.0), *[(7, 0, 2.0)] * 100, (58, 0, 3.0)])  # 50 periods later the board counts again
    assert out[-1, 2] == pytest.approx(151 * 0.05, abs=1e-9)


def test_a_short_gap_keeps_the_memory(clock: Path) -> None:
    for gap in (1, longest_gap(0.05), longest_gap(0.05) + 1):
        out = drive(clock, [(7, 1, 2.0), (7 + gap, 0, 3.0)])
        assert out[1, 4] == (2.0 if gap <= longest_gap(0.05) else -1.0) and out[1, 5] == 2.0
        assert out[1, 2] == pytest.approx(gap * 0.05, abs=1e-12)


@pytest.mark.parametrize("first", [0, 37])
def test_a_counter_that_starts_again_is_recognised_and_nothing_is_fresh(clock: Path, first: int) -> None:
    out = drive(clock, [(5000, 1, 2.0), *[(first + k, 0, 3.0) for k in range(RESTART + 3)]])
    assert (out[1 : RESTART + 1, 0] == STALE).all() and not out[1 : RESTART + 1, 1].any()
    assert int(out[RESTART + 1, 0]) == RESTARTED and out[RESTART + 1, 2] == LONGEST and out[RESTART + 1, 1] == 0.0
    assert list(out[RESTART + 2 :, 0]) == [0.0, 0.0] and (out[RESTART + 1 :, 2] == LONGEST).all()


def test_old_samples_that_do_not_rise_stay_refused(clock: Path) -> None:
    shuffled = [(100 + 3 * (-1) ** k, 0, 3.0) for k in range(100)]
    late = [(sample, 0, 3.0) for start in range(400, 480, 8) for sample in (start, start - 3)]
    for rows in (shuffled, late):
        assert (drive(clock, [(5000, 1, 2.0), *rows])[1:, 0] == STALE).all()


@pytest.mark.parametrize("real", ["float64", "float32"])
def test_python_ages_as_the_c_does(tmp_path: Path, real: Real) -> None:
    need_compiler()
    law, bundle = clocks(real)
    controller = build_controller(law, bundle, tmp_path / "b")
    U = np.array([[1.0, 2.0], [0.0, 3.0], *[[0.0, np.nan]] * 9, [0.0, 4.0], [0.0, np.nan], [0.0, 5.0], [1.0, 6.0]])
    load = np.arange(len(U)) == 0
    records = Records(np.tile(law.initial_state(), (len(U), 1)), U, np.zeros((len(U), 0)))
    c = controller.run(records, load=load)
    states = np.vstack([records.X[:1], c.state[:-1]])
    python = replayed(controller.law, Records(states, U, records.P), load)
    assert np.array_equal(c.status, python.status) and np.array_equal(c.state, python.state)
    assert np.array_equal(c.tau, python.tau) and c.state[11, 0] > 0.5


def test_the_law_with_sonars_says_what_ages_and_what_ends() -> None:
    equipment = load_scenario("tank-static").sensors.on(0.27)
    law = build_law(sonar=True, equipment=equipment)
    ages = {port.name for port in law.state if port.gap == "age"}
    assert ages == {"own_age", "mover_age", "sonar_since", "sonar_age", "silent", "face_age"}
    kept = {port.name for port in law.state if port.gap == "keep"}
    assert {"map_cells", "map_corner", "progress", "launched", "sonar_distrust", "stalled"} <= kept
    assert not {name for name in kept if name.startswith("own_")}
    start = law.initial_state()
    x = aged(
        law,
        np.where([port.gap == "age" for port in law.state for _ in range(port.size)], 0.1, start),
        201,
        real="float64",
    )
    for name in ages:
        assert (x[law.state.slice(name)] >= np.minimum(10.1, start[law.state.slice(name)]) - 1e-9).all(), name
