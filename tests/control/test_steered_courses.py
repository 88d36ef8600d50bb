"""The steered law predicts only candidates that can still be the best one; its choice is that of all candidates."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.control import LAWS, build_law_of, law_parameters, load_gains, steered
from surctl.guidance import Path
from tests.craft import CRUISE, craft

SITE = (0.0, 60.0, 0.0, 60.0)


def test_a_candidate_that_is_not_predicted_would_not_be_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    law, predict = build_law_of(LAWS["steered"]), steered._first_hit

    def every(*arguments: Any, skip: ca.SX, **others: Any) -> tuple[ca.SX, ca.SX]:
        return predict(*arguments, skip=ca.SX(0), **others)

    monkeypatch.setattr(steered, "_first_hit", every)
    whole = build_law_of(replace(LAWS["steered"], decide=steered.steered_law))
    assert law.block.digest() != whole.block.digest()
    gains = load_gains("default", own=LAWS["steered"].gains)
    p = law_parameters(
        gains, craft("otter"), path=Path(np.array([[10.0, 30.0], [50.0, 30.0]])), depth=0.0, cruise=CRUISE["otter"],
        cap=1.0, walls=SITE,
    )  # fmt: skip
    rng, turned = np.random.default_rng(3), 0
    for _ in range(40):
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
    assert turned > 10
