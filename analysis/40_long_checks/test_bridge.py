"""Bridge: the scenario of the bar, in which an obstacle comes head-on."""

from __future__ import annotations

import pytest

from tests.bridge.test_rehearsal import session, takes_as_long, tank


def test_a_run_through_the_bridge_takes_as_long_as_the_direct_one() -> None:
    result = session(of=tank(), seconds=60.0)
    direct = takes_as_long(tank(), result, 0.45)
    assert result.clearance == pytest.approx(direct.metrics.min_clearance_m, abs=0.01)
