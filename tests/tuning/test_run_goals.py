"""Goals on costs of the runs of a system, and linear goals whose run is at a limit."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import pytest

from surctl.errors import InputError
from surctl.system import Cost, System
from surctl.tuning import RunGoal, Settling, judge_loops, operating_loops, tune_system
from surctl.tuning.goals import load_system_goals
from surctl.tuning.outcome import goal_rows
from tests.cli.test_systems import run
from tests.tuning.test_loop_goals import SYSTEM


def test_a_goal_on_a_cost_of_the_runs_is_searched_and_kept() -> None:
    late = Cost(lambda s: ca.fabs(s.x["place"] - s.r["target"]) - 0.05, "last_time", "s")
    own = System(SYSTEM.plant, SYSTEM.controller, costs={"late": late})
    ranges, step = {"k_p": (1.0, 30.0), "k_d": (1.0, 12.0)}, {"reference.target": 1.0}
    quick = RunGoal("quick", "late", "s", 3.0)
    tuned = tune_system(own, 20.0, ranges, cases=step, trials=60, run_goals=[quick], least_disk_margin=0.0)
    (row,) = [row for row in goal_rows(tuned.tuning) if row["name"] == "quick"]
    assert row["tuned"] < row["hand"] and "least late" not in str(tuned.lines())
    (line,) = [line for line in tuned.lines() if line.startswith("quick ")]
    assert f"{row['tuned']:.4g} " in line and "≤ 3" in line
    never = RunGoal("never", "late", "s", 1e-6, kind="hard")
    tuned = tune_system(own, 20.0, ranges, cases=step, trials=30, run_goals=[quick, never], least_disk_margin=0.0)
    assert "never" in tuned.unmet


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("metric = 'lat'", "did you mean 'late'"),
        ("metric = 'late'", "needs one bound"),
        ("metric = 'late'\nat_most = '3 s'\nat_least = '1 s'", "needs one bound"),
        ("metric = 'late'\nat_most = '0 s'", "greater than 0"),
        ("metric = 'late'\nat_most = '3 m'", "at_most"),
        ("metric = 'late'\nat_most = '3 s'\nover = 'mean'", "is not a key of a goal on a cost"),
    ],
)
def test_a_mistake_in_a_goal_on_a_cost_is_one_line(tmp_path: Path, text: str, problem: str) -> None:
    late = Cost(lambda s: s.x["place"], "last_time", "s")
    own = System(SYSTEM.plant, SYSTEM.controller, costs={"late": late})
    file = tmp_path / "g.toml"
    file.write_text(f"kind = 'goals'\nname = 'g'\n[[goals]]\nname = 'quick'\n{text}\n")
    with pytest.raises(InputError, match=problem) as raised:
        load_system_goals(file, own)
    assert "goals.quick" in str(raised.value) and "\n" not in str(raised.value)


def test_a_score_prints_as_one_line() -> None:
    goal = Settling(name="soon", source="target", end="place", at_most=4.0)
    (score,) = judge_loops([goal], operating_loops(SYSTEM, {})).scores
    assert str(score).count("soon (soft)") == 1 and "array" not in str(score) and "\n" not in str(score)


LIMITED = """
import casadi as ca
from dataclasses import replace
from surctl.system import Action, Cost, System
from tests.tuning.test_loop_goals import cart

def build(limit=%s):
    base = cart()
    def law(x, u, p):
        error = u["target"] - u["place"]
        raw = p["k_p"] * error - p["k_d"] * u["speed"]
        return Action(ca.fmin(ca.fmax(raw, -limit), limit), {"sum": x["sum"]})
    late = Cost(lambda s: ca.fabs(s.x["place"] - s.r["target"]) - 0.05, "last_time", "s")
    return System(base.plant, replace(base.controller, law=law), costs={"late": late})
"""
GOAL = "kind = 'goals'\nname = 'g'\n[[goals]]\nname = 'soon'\nat_most = '4 s'\n"
LINEAR, OF_RUN = GOAL + "type = 'settling'\nfrom = 'target'\nto = 'place'\n", GOAL + "metric = 'late'\n"


@pytest.mark.parametrize(("goal", "limit", "said"), [(LINEAR, 0.5, True), (LINEAR, 500.0, False), (OF_RUN, 0.5, False)])
def test_a_linear_goal_whose_run_is_at_a_limit_is_not_representative(
    goal: str, limit: float, said: bool, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(LIMITED % limit)
    (tmp_path / "g.toml").write_text(goal)
    words = (f"{tmp_path / 'mine.py'}:build", "reference.target=2", "--gain", "k_p=1..9", "--gain", "k_d=1..9")
    done = run("tune", *words, "--goals", str(tmp_path / "g.toml"), "--trials", "10", "--seconds", "10",
               "--out", str(tmp_path / "out"))  # fmt: skip
    first, *others = done.stdout.splitlines()
    assert first.startswith(("WORSE than before: ", "no figure of the assessment is worse"))
    lines = [line for line in others if line.startswith("not representative: soon (linear): command force is at its")]
    assert bool(lines) is said
    assert not said or 'metric = "late"' in " ".join(others)
    assert not (tmp_path / "out" / "best-so-far.csv").exists() and (tmp_path / "out" / "gains.csv").exists()
