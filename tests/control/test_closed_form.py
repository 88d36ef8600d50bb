"""The smallest law: it flies round one obstacle, and its projection is the numeric one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import build_law, load_gains
from surctl.marine.control.paper import DAMPING
from surctl.marine.export import closed_form
from surctl.marine.simulation import law_numbers, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.priority import nsb

GAINS = load_gains("default")


@pytest.mark.parametrize("name", ["pool-ahead", "pool-behind"])
def test_it_gets_past_one_obstacle(name: str) -> None:
    mission = load_scenario(name)
    run = simulate(
        mission, load_vehicle(mission.vehicle), gains=GAINS, law=build_law("closed_form"), sensing="truth", seed=1
    )
    assert run.metrics.stopped_because == "reached" and run.metrics.min_clearance_m > 0.0


def test_the_closed_form_is_the_numeric_projection() -> None:
    mission, law = load_scenario("pool-ahead"), build_law("closed_form")
    p = law_numbers(mission, load_gains("default"), load_vehicle(mission.vehicle))
    at = law.telemetry_slice("nu_reference")
    cap = p[law.gains.slice("cap")][0]
    rng, met = np.random.default_rng(2), 0
    for _ in range(60):
        x, u = law.initial_state(), law.inputs.pack()
        u[:4] = [*rng.uniform(0.3, 2.5, 2), -0.15, rng.uniform(-3, 3)]
        u[8:] = [*(u[:2] + rng.uniform(-0.8, 0.8, 2)), 0.05, *rng.uniform(-0.1, 0.1, 2), 1.0]
        x[0] = rng.uniform(0.0, 2.5)
        problem = law.problem(x, u, p)
        met += bool(problem.levels[0].J.any())
        v = nsb(problem)
        v[:2] *= min(1.0, cap / max(float(np.hypot(*v[:2])), 1e-9))
        np.testing.assert_allclose(law.step(x, u, p).telemetry[at][:2], v[:2], rtol=0, atol=10 * DAMPING**2)
    assert met > 5


def test_what_it_cannot_do_is_named() -> None:
    for options, word in (({"sonar": True}, "sensing"), ({"mode": "projected"}, "priority-mode")):
        with pytest.raises(InputError, match="law closed_form supports only") as caught:
            build_law("closed_form", **options)  # type: ignore[arg-type]
        assert word in str(caught.value)
    with pytest.raises(InputError, match="without perception"):
        closed_form(replace(build_law("closed_form"), perception=object()), constants=np.zeros(3))  # type: ignore[arg-type]
    assert closed_form(build_law("closed_form")) is build_law("closed_form")
