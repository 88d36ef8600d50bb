"""Tuning of any system: the best gains of a dense grid are found, bounds are kept, and what cannot be kept is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.assessment import ClosedLoop, assess
from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.system import Controller, Cost, Plant, System, linearise, simulate_system
from surctl.testing import cart_system
from surctl.tuning import SensitivityBound, Tuned, tune_system
from surctl.tuning.outcome import goal_rows
from surctl.tuning.systems import assess_cases
from surctl.verification import system_disk_margin
from tests.tools import need_compiler
from tests.tuning.test_system_sweep import build as noisy_cart

PLACE, SPEED = Port("place", (1,), "m", "of the cart", 1.0), Port("speed", (1,), "m/s", "of the cart")
FORCE = Port("force", (1,), "N", "on the cart")
RANGES = {"k[0]": (0.2, 20.0), "k[1]": (0.2, 20.0)}


def cart(**bounds: float) -> System:
    plant = Plant(
        "cart",
        Layout((PLACE, SPEED)),
        Layout((FORCE,)),
        lambda x, f, d, p: {"place": x["speed"], "speed": f["force"] / p["mass"]},
        parameters=Layout((Port("mass", (1,), "kg", "of the cart", 2.0),)),
    )
    law = Controller(
        "hold",
        0.05,
        Layout((PLACE, SPEED)),
        Layout((FORCE,)),
        lambda x, u, p: -p["k"][0] * u["place"] - p["k"][1] * u["speed"],
        gains=Layout((Port("k", (2,), "N/m, N s/m", "of place and speed", 1.0),)),
    )
    costs = {
        "late": Cost(lambda s: ca.fabs(s.x["place"]) - 0.05, "last_time", "s", "settled"),
        "peak": Cost(lambda s: ca.fabs(s.f["force"]), "max", "N", "largest force"),
        "square": Cost(lambda s: s.x["place"] ** 2 + 0.02 * s.f["force"] ** 2, "integral", "m^2 s", "cost"),
    }
    costs = {name: replace(cost, at_most=bounds.get(name)) for name, cost in costs.items()}
    return System(plant, law, costs=costs, stops={"away": lambda s: ca.fabs(s.x["place"]) > 3})


def costs_of(tuned: Tuned) -> dict[str, float]:
    return tuned.tuning.request.costs(tuned.gains)  # type: ignore[attr-defined]


def test_it_finds_the_best_point_of_a_dense_grid() -> None:
    need_compiler()
    system, cases = cart(), {"start.place": [1.0, -0.5, 0.2]}
    tuned = tune_system(system, 8.0, RANGES, cases=cases, objective="square", trials=600, seed=1)
    axis = np.geomspace(0.2, 20, 60)
    first, second = (part.ravel() for part in np.meshgrid(axis, axis))
    means = np.mean(
        [
            simulate_system(system, 8.0, {"k[0]": first, "k[1]": second, "start.place": at})["square"]
            for at in (1.0, -0.5, 0.2)
        ],
        axis=0,
    )
    costs, before = costs_of(tuned), tuned.tuning.request.costs(tuned.tuning.request.begun)
    assert costs["square"] <= means.min() * 1.0001
    assert before["square"] > costs["square"]
    linear = linearise(system, tuned.gains)
    places = (("force",), ("place", "speed"))
    assert tuned.figures["disk_margin"].value == min(
        system_disk_margin(linear, *signals).guaranteed for signals in places
    )
    assert tuned.unmet == ()


def test_bounds_and_the_margin_are_kept_or_named() -> None:
    need_compiler()
    free = tune_system(cart(), 8.0, RANGES, trials=300)
    bounded = tune_system(cart(peak=1.0), 8.0, RANGES, trials=300)
    assert costs_of(free)["peak"] > 1.0 >= costs_of(bounded)["peak"]
    assert costs_of(bounded)["late"] > costs_of(free)["late"]
    assert bounded.unmet == ()
    assert tune_system(cart(peak=0.01), 8.0, RANGES, trials=60).unmet == ("peak",)
    wide = tune_system(cart(), 8.0, RANGES, trials=300, least_disk_margin=0.65)
    assert wide.unmet == () and wide.figures["disk_margin"].value >= 0.65
    assert tune_system(cart(), 8.0, RANGES, trials=60, least_disk_margin=1.99).unmet == ("disk margin",)


def test_the_delay_margin_is_kept_and_the_own_gains_are_a_candidate() -> None:
    need_compiler()
    hard = cart_system(costs={"pull": Cost(lambda s: s.f["force"], "min", "m/s^2")})  # least with the largest gain
    tuned = tune_system(hard, 0.5, {"k": (1.0, 18.0)}, trials=20)
    assert tuned.unmet == () and [goal.name for goal in tuned.finals.goals] == ["disk margin", "delay margin"]
    assert tune_system(hard, 0.5, {"k": (12.0, 13.0)}, trials=5).unmet == ("delay margin",)
    off = Cost(lambda s: (s.f["force"] + 4 * s.x["speed"]) ** 2, "integral", "m^2/s^3")
    own = tune_system(cart_system(4.0, costs={"off": off}), 1.0, {"k": (1.0, 18.0)}, trials=5)
    assert own.gains == {"k": 4.0}


def test_an_interrupted_search_resumes_to_the_same_gains(tmp_path: Path) -> None:
    need_compiler()
    goals = (SensitivityBound(name="peak", at="force", at_most=2.0),)
    asked: dict[str, Any] = {"trials": 60, "goals": goals, "cases": {"start.place": [1.0, -0.5]}}
    whole = tune_system(cart(), 8.0, RANGES, **asked)

    def stop(line: str) -> None:
        if line.startswith("trial 30/"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tune_system(cart(), 8.0, RANGES, **asked, out=tmp_path, progress=stop)
    system, lines, resumed = cart(), list[str](), "30 trials of the same request are resumed"
    for change in ({"seed": 1}, {"cases": {"start.place": [1.0, -0.6]}}, {"objective": "square"}, {"goals": ()}):
        tune_system(system, 8.0, RANGES, **asked | {"trials": 30} | change, out=tmp_path, progress=lines.append)
    tune_system(cart(peak=9.0), 8.0, RANGES, **asked | {"trials": 30}, out=tmp_path, progress=lines.append)
    assert resumed not in lines
    again = tune_system(cart(), 8.0, RANGES, **asked, out=tmp_path, progress=lines.append)
    assert resumed in lines and again.gains == whole.gains and again.lines() == whole.lines()


def test_random_runs_refute_gains_and_the_next_round_keeps_the_bound_in_them() -> None:
    need_compiler()
    system = replace(cart(late=6.0), ranges={"plant.mass": (0.3, 9.0)})
    (tuning, _) = tune_system(system, 8.0, RANGES, objective="square", trials=30, rounds=3, runs=40)
    hit = tuning.rounds[0].training[0]
    assert hit.goal == "late" and 0.3 <= hit.plant["plant.mass"] <= 9.0
    assert len(tuning.request.conditions) > tuning.requested and not tuning.result.refuted
    assert tune_system(cart(), 8.0, RANGES, trials=30, runs=40).tuning.result.verified is None  # nothing is random


def test_a_run_that_ends_early_is_no_cheap_run() -> None:
    need_compiler()
    gains = np.linspace(-300.0, 5.0, 200)
    runs = simulate_system(cart(), 20.0, {"k[0]": gains})
    assert runs.stopped[np.argmin(runs["late"])] == "away"  # such a gain leaves the rail at once
    tuned = tune_system(cart(), 20.0, {"k[0]": (-300.0, 5.0)}, trials=60)
    assert tuned.gains["k[0]"] > 0
    assert np.isfinite(costs_of(tuned)["late"])


@pytest.mark.parametrize(
    ("ranges", "options", "problem"),
    [
        ({}, {}, "nothing is tuned"),
        ({"k[0]": (2.0, 1.0)}, {}, r"k\[0\] = \(2\.0, 1\.0\): is not a range"),
        ({"k[0]": (1.0, float("nan"))}, {}, "is not a range"),
        ({"plant.mass": (1.0, 2.0)}, {}, r"plant\.mass: is not a gain"),
        ({"k[0]": (1.0, 2.0)}, {"cases": {"k[0]": 3.0}}, r"^k\[0\]: is both a tuned gain and a value of the cases"),
        ({"k": (1.0, 2.0)}, {}, r"^k: has 2 entries; name one: k\[0\], k\[1\]$"),
        ({"q": (1.0, 2.0)}, {}, "q: no such number of the system"),
        ({"k[0]": (1.0, 2.0)}, {"objective": "lat"}, "no such cost; did you mean 'late'"),
    ],
)
def test_mistakes_are_named(ranges: dict[str, tuple[float, float]], options: dict[str, Any], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        tune_system(cart(), 2.0, ranges, trials=20, **options)


def test_bounds_hold_in_every_case_and_all_cases_are_assessed() -> None:
    need_compiler()
    system, cases = cart(peak=1.0), {"start.place": [0.1, 1.0], "plant.mass": [0.5, 4.0]}
    tuned = tune_system(system, 8.0, {"k[0]": (0.5, 3.0)}, cases=cases, objective="square", trials=40, seed=1)
    # |force| is k[0] at the start of the second case; the mean over the cases would allow 1.8
    assert tuned.gains["k[0]"] == pytest.approx(1.0, abs=0.05) and not tuned.unmet
    (peak,) = [row for row in goal_rows(tuned.tuning) if row["name"] == "peak"]
    assert peak["tuned"] <= 1.0 and peak["tuned"] > 1.5 * costs_of(tuned)["peak"]
    beyond = assess_cases(system, cases, {"k[0]": 1.5}, seconds=8.0)
    apart = [
        assess(ClosedLoop(system, {"k[0]": 1.5, **{name: values[k] for name, values in cases.items()}}, seconds=8.0))
        for k in range(2)
    ]
    for name, figure in beyond.figures.items():
        values = [one.figures[name].value for one in apart]
        worst = (min if figure.better == "high" else max)(values)
        assert figure.value == worst, name
    assert [one.accepted() for one in apart] == [True, False] and not beyond.accepted()
    assert "case 2 (start.place = 1, plant.mass = 4): peak = 1.5 N, at most 1 N" in beyond.failures
    assert "plant.mass = 0.5" in beyond.figures["delay_margin_s"].where
    vectors = assess_cases(system, {"k": [[0.5, 1.0], [2.0, 1.0]], "start.place": [1.0, 1.0]}, {}, seconds=1.0)
    assert "case 2 (start.place = 1): peak = 2 N, at most 1 N" in vectors.failures


def test_each_case_is_assessed_with_its_own_noise() -> None:
    loop, seeds = noisy_cart(), [0.0, 5.0]
    both = assess_cases(loop, {"seed": seeds}, {"k": 1.0}, seconds=1.0)
    apart = [assess(ClosedLoop(loop, {"k": 1.0, "seed": seed}, seconds=1.0)).figures for seed in seeds]
    found = [one["cost.final"].value for one in apart]
    assert found[0] < found[1] and both.figures["cost.final"].value == max(found)
    assert both.figures["disk_margin"].value == apart[0]["disk_margin"].value
