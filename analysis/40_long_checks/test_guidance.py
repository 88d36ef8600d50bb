"""Guidance: the braking rule in every setting of its independent simulation."""

from __future__ import annotations

import pytest

from tests.guidance import test_braking


@pytest.mark.parametrize("k", range(len(test_braking.SETTINGS)))
def test_nothing_is_ever_hit(k: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(test_braking, "EPISODES", 500)
    monkeypatch.setattr(test_braking, "SECONDS", 25.0)  # in the suite's 10 s, few robots without drag come near
    test_braking.test_nothing_is_ever_hit(k)


def test_a_rule_that_asks_for_less_hits_what_moves() -> None:
    for rule in (test_braking.scaled(0.9), test_braking.without_lag):
        test_braking.test_a_rule_that_asks_for_less_hits(3, rule)
