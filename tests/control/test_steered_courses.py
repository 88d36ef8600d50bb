"""The steered law predicts candidates in the order of their least cost, within a fixed number of steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.marine.control import DEGRADED, LAWS, Law, load_gains, steered
from surctl.marine.control.build import build_law_of
from surctl.marine.control.ports import law_parameters
from surctl.marine.guidance import Path
from tests.craft import CRUISE, craft

SITE = (0.0, 60.0, 0.0, 60.0)
EXACT = (1 + len(steered.COURSES) * len(steered.SPEEDS)) * steered.STEPS  # the last choice, then all candidates


def rebuilt() -> Law:
    return build_law_of(replace(LAWS["steered"], decide=steered.steered_law))


def numbers(**changed: float) -> NDArray[np.float64]:
    gains, path = (
        load_gains("default", own=LAWS["steered"].gains).with_values(changed),
        Path(np.array([[10.0, 30.0], [50.0, 30.0]])),
    )
    return law_parameters(gains, craft("otter"), path=path, depth=0.0, cruise=CRUISE["otter"], cap=1.0, walls=SITE)


@pytest.mark.parametrize(("budget", "stops"), [(1, True), (steered.STEPS, False)])
def test_a_course_counts_as_clear_only_as_far_as_it_was_predicted(
    monkeypatch: pytest.MonkeyPatch, budget: int, *, stops: bool
) -> None:
    monkeypatch.setattr(steered, "BUDGET", budget)
    # a stopping distance of several steps
    law, p = rebuilt(), numbers(brake=0.1)
    x = law.initial_state()
    x[law.state.slice("progress")] = 15.0
    u = law.inputs.pack({"eta": [12.0, 30.0, 0.0, 0.0], "nu": [0.77, 0.0, 0.0, 0.0], "contacts": np.zeros((8, 6))})
    assert bool(law.step(x, u, p).status & DEGRADED) == stops
