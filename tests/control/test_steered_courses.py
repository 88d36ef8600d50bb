"""The steered law predicts candidates in the order of their least cost, within a fixed number of steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.control import DEGRADED, LAWS, Law, build_law_of, courses, law_parameters, load_gains, steered
from surctl.guidance import Path
from tests.craft import CRUISE, craft

SITE = (0.0, 60.0, 0.0, 60.0)
EXACT = (1 + len(courses.COURSES) * len(courses.SPEEDS)) * courses.STEPS  # the last choice, then all candidates


def rebuilt() -> Law:
    return build_law_of(replace(LAWS["steered"], decide=steered.steered_law))


def numbers(**changed: float) -> NDArray[np.float64]:
    gains, path = (
        load_gains("default", own=LAWS["steered"].gains).with_values(changed),
        Path(np.array([[10.0, 30.0], [50.0, 30.0]])),
    )
    return law_parameters(gains, craft("otter"), path=path, depth=0.0, cruise=CRUISE["otter"], cap=1.0, walls=SITE)


def test_the_choice_is_that_of_a_search_through_all_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    law, ordered = rebuilt(), courses._ordered
    assert law.block.operations < 40_000
    # no candidate ends the search but the last, and there are steps for all of them

    def unending(side: int) -> Iterator[tuple[float, ...]]:
        return ((*row[:5], -1.0 if row[5] < 1e3 else row[5]) for row in ordered(side))

    monkeypatch.setattr(courses, "_ordered", unending)
    monkeypatch.setattr(courses, "BUDGET", EXACT)
    whole, p = rebuilt(), numbers()
    assert law.block.digest() != whole.block.digest()
    rng, turned = np.random.default_rng(3), 0
    for _ in range(16):
        x = law.initial_state()
        x[law.state.slice("progress")] = 15.0
        x[law.state.slice("side")] = rng.choice([-1.0, 0.0, 1.0])
        contacts = np.zeros((8, 6))
        count = int(rng.integers(0, 4))
        contacts[:count, :2] = np.array([20.0, 30.0]) + rng.normal(scale=[8.0, 4.0], size=(count, 2))
        contacts[:count, 2:] = np.column_stack(
            [rng.uniform(0, 2, count), rng.normal(0, 0.2, (count, 2)), np.ones(count)]
        )
        eta = [12.0, 30.0 + rng.normal(), 0.0, rng.normal(scale=0.5)]
        u = law.inputs.pack({"eta": eta, "nu": [0.7, 0.0, 0.0, rng.normal(scale=0.05)], "contacts": contacts})
        one, other = law.step(x, u, p), whole.step(x, u, p)
        assert one.tau == pytest.approx(other.tau, abs=1e-9) and one.status == other.status
        assert one.x_next == pytest.approx(other.x_next, abs=1e-9)
        turned += bool(one.telemetry[law.telemetry_slice("avoiding")][0])
    assert turned > 3


@pytest.mark.parametrize(("budget", "stops"), [(1, True), (courses.STEPS, False)])
def test_a_course_counts_as_clear_only_as_far_as_it_was_predicted(
    monkeypatch: pytest.MonkeyPatch, budget: int, *, stops: bool
) -> None:
    monkeypatch.setattr(courses, "BUDGET", budget)
    # a stopping distance of several steps
    law, p = rebuilt(), numbers(brake=0.1)
    x = law.initial_state()
    x[law.state.slice("progress")] = 15.0
    u = law.inputs.pack({"eta": [12.0, 30.0, 0.0, 0.0], "nu": [0.77, 0.0, 0.0, 0.0], "contacts": np.zeros((8, 6))})
    assert bool(law.step(x, u, p).status & DEGRADED) == stops
