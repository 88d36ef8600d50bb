"""Studies whose quick form takes too long for the suite, which runs them on made-up results, or runs their like."""

from __future__ import annotations

import pytest

from tests.test_analysis import ANALYSIS, examine_example, run, table
from tests.tools import need_compiler


@pytest.mark.parametrize("example", ["cybership2", "bluerov2_attitude", "quadrotor_altitude"])
def test_an_example_of_a_ship_an_rov_or_a_quadrotor(example: str) -> None:
    examine_example(example)


@pytest.mark.parametrize("law", ["wall", "station"])
def test_a_law_of_ones_own_goes_through_the_chain_by_python(law: str) -> None:
    need_compiler()
    done = run(ANALYSIS / "27_own_law" / f"{law}.py", "--quick")
    assert done.returncode == 0 and "\nclaim, " in done.stdout, done.stdout + done.stderr


def test_by_sonar_the_way_through_the_pool_is_longer_and_takes_longer() -> None:
    need_compiler()
    done = run(ANALYSIS / "17_pool_static_limits" / "run.py", "--quick")
    assert done.returncode == 0, done.stdout + done.stderr
    rows = {row[0]: [float(cell) for cell in row[1:]] for row in table(done.stdout)[1:] if len(row) == 8}
    truth, sonar = rows["true positions"], rows["nothing: by sonar"]
    assert truth[0] == 4 and sonar[4] > 1.5 * truth[4] and sonar[5] > truth[5]


def test_a_run_with_the_echo_model_of_smooth_walls() -> None:
    done = run(ANALYSIS / "33_echoes" / "run.py", "--quick")
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [row for row in table(done.stdout) if len(row) == 9][1:]
    assert [row[:2] for row in rows] == [["`pool-behind`", "specular"]] and sum(map(int, rows[0][2:6])) == 2


def test_the_cruise_is_proved_far_enough_beside_the_path() -> None:
    done = run(ANALYSIS / "16_cruise_regions" / "run.py", "--quick")
    row = next(row for row in table(done.stdout) if row[0] == "`region-cruise-20`")
    assert done.returncode == 0 and float(row[2].split()[0]) >= 0.34 and int(row[10].split()[0]) < 10_000, done.stderr
