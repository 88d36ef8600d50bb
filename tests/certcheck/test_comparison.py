"""Each comparison of a number of a claim with numbers of a bundle: what agrees, what differs, and what is not known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from surctl.certcheck.bundle import Manifest
from surctl.certcheck.comparison import ALIKE, Comparison

BUNDLE = Manifest(
    id="", real="float64", period=0.05, laws=("a" * 64, "b" * 64), vehicle="c" * 64, claims={}, wrong=(),
    gains={"k": (1.0, 2.0), "thrust_limit": (5.0, 6.0, 7.0, 8.0), "mass": (95.0, 96.0)},
    values={"m11": 50.0, "m22": 60.0, "Xu": 2.0, "Yv": 3.0, "thrust_lag": 0.3},
    ranges={"m11": (40.0, 60.0), "m22": (45.0, 70.0), "Fu_max": (4.0, 9.0), "Fv_max": (3.0, 9.0)},
)  # fmt: skip
UNKNOWN = "{}: the bundle does not state it; export the controller again"
CLAIM: dict[str, Any] = {
    "system": "cruise", "sha256_law": "b" * 64, "sha256_vehicle": "c" * 64, "excludes": ["waves"],
    "law": {"mass_kg": [50.0, 50.0], "period_s": 0.05},
}  # fmt: skip


def found(compare: Callable[[Comparison], None], claim: dict[str, Any] = CLAIM, **bundle: Any) -> tuple[list[str], ...]:
    """What differs and what is not covered."""
    comparison = Comparison(claim, replace(BUNDLE, **bundle))
    compare(comparison)
    return comparison.differs, comparison.excludes


def differs(compare: Callable[[Comparison], None], *texts: str, **bundle: Any) -> None:
    assert found(compare, **bundle) == (list(texts), [])


def excludes(compare: Callable[[Comparison], None], *texts: str, **bundle: Any) -> None:
    assert found(compare, **bundle) == ([], list(texts))


def test_a_number_is_that_of_the_bundle() -> None:
    differs(lambda c: c.equal("k", 1.0, (1.0, 2.0)))
    differs(lambda c: c.equal("k", 2.0, (1.0, 2.0)), "k: 2.0 certified, 1.0 exported")
    differs(lambda c: c.equal("k", 2.0, ()), UNKNOWN.format("k"))
    differs(lambda c: c.gain("k", 2.0, 1))
    differs(lambda c: c.gain("k", 1.0, 1), "k[1]: 1.0 certified, 2.0 exported")
    differs(lambda c: c.gain("k", 2.0, 2), UNKNOWN.format("k[2]"))
    differs(lambda c: c.gain("h", 2.0), UNKNOWN.format("h[0]"))


def test_an_entry_of_a_vector_is_a_number_or_lies_in_the_range_of_a_parameter() -> None:
    ranges = {"w": (1.5, 2.5)}
    differs(lambda c: c.entry("k", 2.0, (1.0, 2.0), 1, ranges))
    differs(lambda c: c.entry("k", 1.0, (1.0, 2.0), 1, ranges), "k[1]: 1.0 certified, 2.0 exported")
    differs(lambda c: c.entry("k", "w", (1.0, 2.0), 1, ranges))
    for name, at in (("w", 0), ("w", 2), ("v", 1)):
        text = f"k[{at}]: the range of {name} does not contain the exported number"
        differs(lambda c, name=name, at=at: c.entry("k", name, (1.0, 2.0), at, ranges), text)
    differs(lambda c: c.entry("k", "w", (3.0,), 0, ranges), "k[0]: the range of w does not contain the exported number")


def test_limits_hold_for_the_least_and_the_largest_number() -> None:
    differs(lambda c: c.at_least("F", 5.0, "N", [6.0, 5.0]))
    differs(lambda c: c.at_least("F", 5.5, "N", [6.0, 5.0]), "F: at least 5.5 N certified, 5.0 exported")
    differs(lambda c: c.at_least("F", 5.5, "N", []), UNKNOWN.format("F"))
    differs(lambda c: c.at_most("r", 6.0, "rad/s", [6.0, 5.0]))
    differs(lambda c: c.at_most("r", 5.5, "rad/s", [6.0, 5.0]), "r: at most 5.5 rad/s certified, 6.0 exported")
    differs(lambda c: c.at_most("r", 5.5, "rad/s", []), UNKNOWN.format("r"))


def test_a_vehicle_lies_in_the_certified_ranges() -> None:
    both = ("m11", "m22")
    excludes(lambda c: c.within("mass", (40.0, 70.0), both))
    for low, high in ((41.0, 70.0), (40.0, 69.0)):  # one of the vehicle file's ranges is wider at one end
        text = f"mass: 40.0 to 70.0 in the vehicle file, {low} to {high} certified"
        excludes(lambda c, ends=(low, high): c.within("mass", ends, both), text)
    differs(lambda c: c.within("mass", (51.0, 70.0), both), "mass: 51.0 to 70.0 certified, the vehicle's m11 is 50.0",
            ranges=None)  # fmt: skip
    differs(lambda c: c.within("mass", (50.0, 59.0), both), "mass: 50.0 to 59.0 certified, the vehicle's m22 is 60.0",
            ranges=None)  # fmt: skip
    differs(lambda c: c.within("mass", (40.0, 70.0), ("m33",)), UNKNOWN.format("m33"))
    excludes(lambda c: c.lower_ends("thrust", 3.0, "N"))
    text = "thrust: 3.0 N in the vehicle file, 3.5 N certified"
    excludes(lambda c: c.lower_ends("thrust", 3.5, "N"), text)


def test_masses_are_equal_or_have_the_certified_ratio() -> None:
    ranges = {"mass_kg": (50.0, 50.0), "linear_drag": (2.0, 3.0), "quadratic_drag": (1.0, 1.0)}
    square = {"Xuu": 1.0, "Yvv": 1.0}

    def compared(ratio: float, mass: tuple[float, float]) -> list[str]:
        claim: Any = {**ranges, "mass_kg": mass}
        values = {**BUNDLE.values, **square}
        return found(lambda c: c.vehicle(claim, ratio=ratio), values=values, ranges=None)[0]

    assert compared(1.2, (50.0, 50.0)) == [] and compared(1.5, (45.0, 55.0)) == []
    assert compared(1.1, (50.0, 50.0)) == [
        "mass: at most 1.1 times the lighter one certified, 50.0 kg and 60.0 kg exported"
    ]
    assert compared(1.2, (51.0, 60.0)) == ["mass: 51.0 to 60.0 certified, the vehicle's m11 is 50.0"]
    assert compared(1.0, (50.0, 60.0)) == ["mass: equal for surge and sway certified, 50.0 kg and 60.0 kg exported"]


def test_drag_and_factors_differ_by_a_share() -> None:
    differs(lambda c: c.alike(0.4))
    text = "linear drag: surge and sway may differ by a share of 0.39, but 2.0 and 3.0 are exported"
    differs(lambda c: c.alike(0.39), text)
    differs(lambda c: c.factors("mass", 2 / 11, ALIKE[:1]))  # 1.0 and 1.2: 0.2 apart, 1.1 on average
    text = "mass: factors that differ by a share of 0.18 certified, factors that differ by 0.2 exported"
    differs(lambda c: c.factors("mass", 0.18, ALIKE[:1]), text)
    differs(lambda c: c.factors("mass", 0.19, ALIKE[:1]))


def test_hashes_and_terms() -> None:
    excluded = ["waves", "rounding: the proof holds for exact real numbers; the bundle computes in float64"]

    def hashes(claim: dict[str, Any] | None = None, lawless: bool = False, **bundle: Any) -> list[str]:
        texts = found(lambda c: c.hashes(lawless=lawless), CLAIM | (claim or {}), **bundle)
        assert texts[1] == excluded
        return texts[0]

    assert hashes() == hashes({"sha256_law": "a" * 64}) == hashes({"sha256_law": "d" * 64}, lawless=True) == []
    assert hashes({"sha256_law": "d" * 64}) == [f"law: SHA-256 {'d' * 12} certified, {'a' * 12} exported"]
    assert hashes({"sha256_vehicle": "d" * 64}) == [f"vehicle: SHA-256 {'d' * 12} certified, {'c' * 12} exported"]
    assert hashes(vehicle="") == ["vehicle: the bundle does not name a vehicle"]
    assert hashes(ranges=None) == [UNKNOWN.format("ranges of the vehicle")]
    more = {**BUNDLE.values, "m24": 1.0}
    uncovered = "vehicle: it has m24, which the certificate does not cover"
    assert hashes(values=more) == [uncovered]
    differs(lambda c: c.terms(), uncovered, values=more)
    differs(lambda c: c.terms({"m24": 1.0}), values=more)
    differs(lambda c: c.terms({"m24": 2.0}), "m24: 2.0 certified, 1.0 exported", values=more)
    differs(lambda c: c.terms({"m24": 1.0}), "vehicle: it does not have m24, which is certified")
    comparison = Comparison(CLAIM, BUNDLE)
    comparison.hashes()
    assert comparison.leaves.left() == ["law.mass_kg[0] = 50.0", "law.mass_kg[1] = 50.0", "law.period_s = 0.05"]


def test_lag_and_period() -> None:
    late = "thrust lag: the certificate assumes thrust without lag"
    held = "sampling: the certificate does not cover commands that are held for a control period"
    excludes(lambda c: c.late((0.0, 0.3), 0.05))
    excludes(lambda c: c.late((0.0, 0.0), 0.0), held, late)
    text = "thrust_lag: 0.0 to 0.2 certified, the vehicle's thrust_lag is 0.3"
    differs(lambda c: c.late((0.0, 0.2), 0.05), text)
    differs(lambda c: c.late((0.3, 0.3), 0.1), "period: 0.1 s certified, 0.05 s exported")


def test_the_slack_is_a_share_of_the_largest_side() -> None:
    claim = {"variables": [{"name": "x", "lower": -3.0, "upper": 2.0}], "left": "x", "right": "0", "unit": "m"}
    for slack, text in ((0.0, ""), (2.9e-9, ""), (3.1e-9, "slack: 3.1e-09 m is more than rounding")):
        assert found(lambda c, slack=slack: c.slack(slack), claim)[0] == ([text] if text else [])
    undefined = claim | {"right": "log(x)"}
    assert found(lambda c: c.slack(1e-300), undefined)[0] == ["slack: 1e-300 m is more than rounding"]


@pytest.mark.parametrize(("mass", "linear"), [([95.0, 95.0], [2.0, 2.0]), ([95.0, 96.0], [2.0, 2.5])])
def test_the_law_s_model_is_the_certified_one(mass: Any, linear: Any) -> None:
    gains = {"mass": (95.0, 96.0), "linear_drag": (2.0, 2.5), "quadratic_drag": (0.0, 0.0)}
    law: Any = {"mass_kg": mass, "linear_drag": linear, "quadratic_drag": [0.0, 0.0]}
    expected = [] if mass[1] == 96.0 else ["mass[1]: 95.0 certified, 96.0 exported",
                                                  "linear_drag[1]: 2.0 certified, 2.5 exported"]  # fmt: skip
    differs(lambda c: c.believed(law), *expected, gains=gains)


def test_conditions_are_printed() -> None:
    claim = {"vehicle": {"current": 0.1, "force": 2.0}}
    assert found(lambda c: c.conditions("vehicle", "current", "force"), claim) == (
        [], ["conditions: current = 0.1, force = 2.0"],
    )  # fmt: skip
