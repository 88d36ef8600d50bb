"""Tuning: derived gains reach the margin at the speed stated as bearable, and the stated remedy helps."""

from __future__ import annotations

from surctl.tuning import derive_gains
from tests.tuning.test_derived import WU, made


def test_the_bearable_speed_is_borne_and_less_thrust_lag_raises_the_margin() -> None:
    fast = derive_gains(WU, cruise=0.47)
    assert not fast.reached
    assert derive_gains(WU, cruise=fast.bearable).reached
    quick = made("quick", **{n: p.value for n, p in WU.parameters.items()} | {"thrust_lag": 0.05})
    assert derive_gains(quick, cruise=0.47).disk_margin > fast.disk_margin + 0.2, "the remedy that it names"
