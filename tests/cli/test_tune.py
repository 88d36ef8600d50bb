import json

import pytest

from surctl.cli.output import same_command
from surctl.marine.cli.robot_options import at_hand
from surctl.marine.cli.tune import TunedMissions, mission_plan
from surctl.marine.simulation import load_scenario
from tests.cli.process import LIBRARY, surctl, surctl_here
from tests.tools import need_compiler

STUDY = """
kind = "study"
name = "small"
vehicle = "sur400"
law = "closed_form"
runs = [{ scenario = "pool-behind" }]

[[goals]]
name = "keep clear"
metric = "min_clearance_m"
at_least = { value = %s, unit = "m" }
kind = "hard"

[[goals]]
name = "arrive soon"
metric = "time_s"
at_most = { value = 12.0, unit = "s" }
"""

SMALL = ("--gain", "k_v=0.8..3", "--trials", 4, "--seeds", 1, "--rounds", 1, "--monte-carlo", 2, "--json")


def test_a_hard_goal_that_cannot_be_judged_is_refused_and_a_soft_one_warned_of(tmp_path):
    goal = (
        '\n[[goals]]\nname = "robust"\nmetric = "least_damping"\nat_least = { value = 0.5, unit = "1" }\nkind = "%s"\n'
    )
    text = (STUDY % "0.01").replace('vehicle = "sur400"', 'vehicle = "sur400"\nguidance = "ilos"')
    for kind, level, status in (("hard", "error", 1), ("soft", "warning", 0)):
        (tmp_path / "study.toml").write_text(text + goal % kind)
        lint = surctl("lint", "study.toml", cwd=tmp_path)
        assert lint.status == status and f"{level}: goals.robust: is not judged, because surctl has no" in lint.out
    (tmp_path / "study.toml").write_text(text + goal % "hard")
    done = surctl("tune", "study.toml", "--out", "out", cwd=tmp_path)
    assert done.status == 2 and "study.toml: goals.robust: is hard, but " in done.err and 'type = "margins"' in done.err


def test_tune_writes_gains_with_provenance_and_all_else(tmp_path):
    need_compiler()
    (tmp_path / "small.toml").write_text(STUDY % "0.01")
    done = surctl("tune", "small.toml", *SMALL, "--out", "out", cwd=tmp_path)
    assert done.status == 0, done.err
    assert set(done.json) >= {"best", "front", "goals", "rounds", "counterexamples", "conflict"}
    assert "ETA" in done.err and "fresh runs" in done.err
    assert 0.8 <= done.json["best"]["gains"]["k_v"] <= 3
    # the file holds the result; what to type next belongs to the screen
    kept = {key: value for key, value in done.json.items() if key != "next"}
    assert json.loads((tmp_path / "out" / "tuning.json").read_text()) == kept
    assert all("--gains out/gains.toml" in command for command in done.json["next"])
    assert any(command.startswith("surctl verify --scenario ") for command in done.json["next"]), done.json["next"]
    lint = surctl("lint", "out/gains.toml", cwd=tmp_path)
    assert lint.status == 0
    assert "fresh runs" in (tmp_path / "out" / "gains.toml").read_text()
    assert {p.name for p in (tmp_path / "out").glob("*.png")} >= {"tuning-goals.png", "tuning-front.png"}


def test_a_hard_goal_that_cannot_be_met_ends_with_1_and_is_named(tmp_path):
    need_compiler()
    (tmp_path / "small.toml").write_text(STUDY % "5.0")
    done = surctl("tune", "small.toml", *SMALL, cwd=tmp_path)
    assert done.status == 1, done.err
    assert done.json["conflict"] == ["keep clear"]
    assert not done.json["accepted"] and done.json["unmet"] == ["keep clear"]
    head = (tmp_path / "surctl-out" / "gains.toml").read_text().splitlines()[0]
    assert head == "# HARD GOALS NOT MET (keep clear): best gains found, but do not use them"
    # the log has no score, the miss has its run, and the next command shows this run
    search = done.err.partition("searching for the demands")[0]  # with the least margins as goals
    assert "best score" not in search and "fewest violated: 1 of 3 (keep clear)" in search
    (miss,) = done.json["misses"]
    assert (miss["case"], miss["seed"], miss["limit"]) == ("pool-behind/sur400/truth", 0, 5.0)
    assert 0 < miss["figure"] < 5 and miss["ending"].startswith("reached at")
    assert done.json["next"] == [
        "surctl simulate pool-behind --vehicle sur400 --gains surctl-out/gains.toml "
        "--law closed_form --guidance los --sensing truth --seed 0 --explain"
    ]


def test_scenarios_that_the_hull_does_not_fit_are_left_out_by_either_way(tmp_path):
    text = (LIBRARY / "marine" / "vehicle" / "library" / "sur540-flooded.toml").read_text()
    (tmp_path / "own.toml").write_text(text.replace("sur540-flooded", "own"))
    goals = (
        'kind = "goals"\nname = "g"\n[[goals]]\nname = "soon"\nmetric = "time_s"\nat_most = "50 s"\ncases = ["%s"]\n'
    )
    (tmp_path / "goals.toml").write_text(goals % "pool-ahead")
    for words in (("own.toml",), ("--vehicle", "own.toml")):
        done = surctl("tune", *words, "--goals", "goals.toml", cwd=tmp_path)
        assert done.status == 2
        said = [line for line in done.err.splitlines() if "is left out" in line]
        assert [line.split()[0] for line in said[:2]] == ["pool-ahead", "pool-behind"]
        assert all("inside a wall" in line for line in said)
        assert "goals.toml: goals.soon.cases = 'pool-ahead': is left out: the 0.27 m hull of own" in done.complaint


def test_a_mission_at_a_speed_of_the_study_is_a_file_for_the_commands_after_it(tmp_path):
    text = (STUDY % "0.01").replace('"pool-behind"', '"pool-behind", cruise_m_per_s = 0.1')
    (tmp_path / "small.toml").write_text(text)
    out = tmp_path / "out"
    own = TunedMissions(None, 1, (), None, None, None, None, trust=False)
    plan = mission_plan(str(tmp_path / "small.toml"), own, out)
    [leg] = plan.legs
    words = at_hand(leg.scenario, leg.vehicle, "default")
    assert words[1] == str(out / "missions" / "pool-behind-0.1.toml")
    assert load_scenario(words[1]).cruise == 0.1


def test_the_command_to_repeat_replaces_the_options_that_it_changes(monkeypatch):
    typed = "surctl tune --trials 32 a.toml --rounds=1 --vehicle x --seeds 1"
    monkeypatch.setattr("sys.argv", typed.split())
    assert same_command() == typed
    assert same_command(trials=64, rounds=3) == "surctl tune a.toml --vehicle x --seeds 1 --trials 64 --rounds 3"


def test_speeds_above_the_cap_are_told_with_the_file_before_anything_is_flown(tmp_path):
    goal = '[[goals]]\nname = "robust"\nmetric = "disk_margin"\nat_least = "0.6"\ncruise_m_per_s = [0.1, 0.9]\n'
    (tmp_path / "small.toml").write_text(STUDY % "0.01" + goal)
    done = surctl_here("tune", "small.toml", *SMALL, cwd=tmp_path)
    assert done.status == 2 and not (tmp_path / "surctl-out").exists()
    assert "small.toml: goals.robust.cruise_m_per_s = 0.9: is above the cap" in done.complaint
    (tmp_path / "small.toml").write_text(STUDY % "0.01")
    done = surctl_here("tune", "small.toml", *SMALL, "--cruise", "0.1", cwd=tmp_path)
    assert done.status == 2 and "--cruise" in done.complaint and "no goal is about the linear loop" in done.complaint


MISTAKES = {
    "an unknown gain": (("--gain", "k_w"), "did you mean"),
    "no range": (("--gain", "k_v=1"), "NAME=LOW..HIGH"),
    "a range from above": (("--gain", "k_v=3..1"), "not a range"),
    "not a number": (("--gain", "k_v=nan..1"), "not a range"),
    "the same gain twice": (("--gain", "k_v", "--gain", "k_v"), "twice"),
    "goals that are not there": (("--goals", "none.toml"), "no such file"),
    "another kind of file": (("--goals", "small.toml"), "kind"),
    "an unknown guidance": (("--guidance", "ilo"), "'ilos'"),
    "a scenario without the page": (("--scenario", "pool-ahead"), '[[runs]] with scenario = "pool-ahead"'),
    "no trials": (("--trials", "0"), "--trials"),
    "a study without one": (("none.toml",), "no such file"),
}


@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(tmp_path, what):
    (tmp_path / "small.toml").write_text(STUDY % "0.01")
    words, told = MISTAKES[what]
    done = surctl_here("tune", *words, cwd=tmp_path)
    assert done.status == 2 and told in done.complaint
