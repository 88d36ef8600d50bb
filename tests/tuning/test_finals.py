"""Goals on figures of the assessment that the search does not compute: checked at its end, on its best gain sets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pytest

from surctl.assessment import Assessment, Figure, Part, assess
from surctl.errors import InputError
from surctl.marine.assessment import Mission
from surctl.marine.control import load_gains
from surctl.marine.simulation import METRICS, load_scenario
from surctl.marine.tuning import Goal, load_goals
from surctl.marine.tuning.goals import ASSESSED, PART_OF, goals_from_tables, with_floor
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import LINEAR_METRICS
from surctl.tuning import Tuned, Tuning, tune
from surctl.tuning.goals import GoalTable
from surctl.tuning.outcome import check_finals
from tests.tuning.synthetic import CLEAR, NEAR, THRIFT, install, request

WIDE = Goal("region", "region_m", "m", 0.2, "at least", "hard")


@dataclass(frozen=True)
class Claimed:
    """A subject whose certified region is a function of its gains."""

    gains: Mapping[str, float]
    size: Callable[[Mapping[str, float]], float]
    name: str = "claimed"

    def parts(self) -> Mapping[str, Callable[[], Part]]:
        figure = Figure("region_m", self.size(self.gains), "m", "proved", "high")
        disk = Figure("disk_margin", self.gains["k_v"], "1", "margin", "high", 0.3)
        return {"loop": lambda: Part((disk,), ()), "region": lambda: Part((figure,), ())}


def check(
    tuning: Tuning, goals: Sequence[Goal], subject: Callable[[Mapping[str, float]], Claimed], **more: Any
) -> Tuned:
    def assessed(gains: Mapping[str, float], parts: Any, computed: Any) -> Assessment:
        return assess(subject(gains), parts=parts, computed=computed)

    return check_finals(tuning, goals, assessed, **more)


@pytest.fixture(scope="module")
def tuning() -> Tuning:
    with pytest.MonkeyPatch.context() as patch:
        install(patch)
        return tune(request((CLEAR, NEAR, THRIFT)), trials=64, rounds=1, runs=20)


@pytest.fixture(autouse=True)
def _cheap(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)


def test_each_figure_is_one_of_the_assessment() -> None:
    mission = Mission(
        load_vehicle("sur400"), load_gains("default"), 0.15, 0.22, scenarios=(load_scenario("pool-behind"),),
        sensing="truth",
    )  # fmt: skip
    known = assess(mission, parts=["loop", "no contact", "runs"]).figures
    for name, part in PART_OF.items():
        spec = {**METRICS, **LINEAR_METRICS, **ASSESSED}[name]
        if part != "region":
            assert (known[name].unit, known[name].better) == (spec.unit, spec.better), name
    assert set(ASSESSED) <= set(PART_OF) and not set(ASSESSED) & {*METRICS, *LINEAR_METRICS}


def test_the_tuned_gains_stay_if_they_meet_the_goal(tuning: Tuning) -> None:
    same, found = check(tuning, [WIDE], lambda gains: Claimed(gains, lambda g: 0.25))
    assert same is tuning and found.unmet == () and found.checked == 1
    assert any("region (hard): region_m ≥ 0.2 m: 0.25 → 0.25" in line for line in found.lines())


def test_no_part_of_the_tuned_gains_is_computed_twice(tuning: Tuning) -> None:
    computed = list[Mapping[str, float]]()

    class Counted(Claimed):
        def parts(self) -> Mapping[str, Callable[[], Part]]:
            known = super().parts()
            return {**known, "region": lambda: computed.append(self.gains) or known["region"]()}

    _, found = check(tuning, [WIDE], lambda gains: Counted(gains, lambda g: 0.25))
    assert computed == [tuning.result.gains, tuning.request.begun]
    assert found.comparison.after.omitted == ()


def test_the_next_best_set_that_meets_the_goal_is_taken(tuning: Tuning) -> None:
    best = tuning.result.gains["k_v"]
    other, found = check(tuning, [WIDE], lambda gains: Claimed(gains, lambda g: 0.1 + 0.2 * (g["k_v"] != best)))
    assert found.unmet == () and found.checked > 1 and other.accepted
    assert other.result.gains != tuning.result.gains and other.result.gains in tuning.result.others
    assert other.tuned.gains(0) == other.result.gains and other.result.verified is not None
    assert other.result.verified.seeds == tuning.result.verified.seeds
    assert found.comparison.after.figures["region_m"].value == pytest.approx(0.3)


def test_a_goal_that_no_set_meets_is_named_with_the_best_value(tuning: Tuning) -> None:
    nearest, found = check(tuning, [WIDE], lambda gains: Claimed(gains, lambda g: 0.02 * g["k_v"]))
    assert found.unmet == ("region",) and found.checked == tuning.request.checked + 1
    assert nearest.accepted and found.comparison.after.figures["region_m"].value == found.best["region"]
    (line,) = [line for line in found.lines() if "MISSED" in line]
    assert f"best of the checked sets: {found.best['region']:.4g}" in line
    assert found.to_dict()["goals"][0]["met"] is False
    assert any("best gain sets of the search and the start gains" in line for line in found.lines())


def test_the_start_gains_stay_where_every_other_set_misses_more_goals(tuning: Tuning) -> None:
    start = tuning.request.base["k_v"]
    goals = [WIDE, replace(WIDE, name="margin", metric="disk_margin", unit="1", limit=0.3)]

    class Broken(Claimed):
        def parts(self) -> Mapping[str, Callable[[], Part]]:
            disk = Figure("disk_margin", float(self.gains["k_v"] == start), "1", "margin", "high", 0.3)
            return {**super().parts(), "loop": lambda: Part((disk,), ())}

    same, found = check(tuning, goals, lambda gains: Broken(gains, lambda g: 0.1))
    assert same.result.gains["k_v"] == start and found.unmet == ("region",)
    assert found.lines()[-1] == found.refused
    assert (
        found.refused
        == "start gains kept: the best set of the search misses region_m ≥ 0.2 (0.1), disk_margin ≥ 0.3 (0)"
    )
    _, found = check(tuning, goals[1:], lambda gains: Broken(gains, lambda g: 0.1))
    assert found.refused.startswith(
        "start gains kept: add a goal of type margins; the best set of the search misses disk_"
    )
    assert found.comparison.worse == []


def test_a_set_that_the_verifying_runs_refute_is_not_taken(tuning: Tuning, monkeypatch: pytest.MonkeyPatch) -> None:
    best = tuning.result.gains["k_v"]
    module = check_finals.__globals__
    real = module["monte_carlo"]

    def refuting(figures, goals, runs, gains):
        return real(figures, [replace(goal, limit=9.0) if goal == CLEAR else goal for goal in goals], runs, gains)

    monkeypatch.setitem(module, "monte_carlo", refuting)
    same, found = check(tuning, [WIDE], lambda gains: Claimed(gains, lambda g: 0.1 + 0.2 * (g["k_v"] != best)))
    assert same is tuning and found.unmet == ("region",)


def test_a_default_goal_without_a_figure_is_left_out_and_a_stated_one_is_missed(tuning: Tuning) -> None:
    none = replace(WIDE, name="none", metric="contact_margin_m")
    stated = check(tuning, [none], lambda gains: Claimed(gains, lambda g: 0.3))[1]
    assert stated.unmet == ("none",)
    left = check(tuning, [none], lambda gains: Claimed(gains, lambda g: 0.3), default=[none])[1]
    assert left.undetermined == (none,) and left.unmet == ()


def test_the_least_margins_are_goals_unless_others_bound_them() -> None:
    built_in = {goal.metric: goal for goal in load_goals() if goal.kind == "hard"}
    added = with_floor([NEAR])[1:]
    assert added == (built_in["delay_margin_s"], built_in["disk_margin"])
    assert all(goal.plants == "nominal" for goal in added)  # the disk margin is that of the worst corner
    own = Goal("disk margin", "time_s", "s", 9.0)
    assert [goal.name for goal in with_floor([own])][1:] == ["delay margin", "least disk margin"]


@pytest.mark.parametrize(
    ("more", "problem"),
    [({"cases": ("pool-behind",)}, "leave out cases"), ({"over": "mean"}, "leave out cases")],
)
def test_a_figure_of_the_assessment_has_no_cases(more: dict[str, object], problem: str) -> None:
    table = {"name": "a", "metric": "region_m", "at_least": {"value": 0.2, "unit": "m"}}
    assert goals_from_tables([GoalTable.model_validate(table)], file="g.toml")[0].final
    with pytest.raises(InputError, match=problem):
        goals_from_tables([GoalTable.model_validate(table | more)], file="g.toml")
