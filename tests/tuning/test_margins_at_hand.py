"""Linear figures of a sweep are those of the law that flies, or none."""

import numpy as np
import pytest

from surctl.marine.control import load_gains
from surctl.marine.simulation import load_scenario
from surctl.marine.tuning import MissionSweep, build_cases
from surctl.marine.tuning.sweep import LINEAR_COLUMNS, judged

GAINS = load_gains("default")


@pytest.mark.parametrize(("kind", "has"), [({}, True), ({"guidance": "ilos"}, False), ({"law": "calm"}, False)])
def test_a_law_without_a_linear_loop_has_no_margins_and_never_another_law_s(kind: dict[str, str], has: bool) -> None:
    cases = build_cases([load_scenario("pool-behind")], gains=GAINS, **kind)
    evaluation = MissionSweep(cases)
    table = evaluation.evaluate(0, 0, {"k_v": np.array([1.5, 2.0])})
    assert evaluation.has_margins is has and table.shape == (2, len(LINEAR_COLUMNS))
    assert np.isnan(table).all() == (not has)


def test_margins_that_are_not_judged_do_not_decide_what_is_feasible() -> None:
    flown = {name: np.ones(2) for name in ("reached_worst", "min_clearance_m_worst", "strayed", "time_ratio")}
    assert judged(flown)["feasible"].tolist() == [1.0, 1.0]
    nothing = {"delay_margin_s": np.full(2, np.nan), "disk_margin": np.full(2, np.nan)}  # no straight cruise at all
    assert judged(flown | nothing)["feasible"].tolist() == [0.0, 0.0]
