"""The readers of claims about motion: each entry has one form, and a claim with another one is refused by name."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from surctl.certcheck import braking_claim, check_document, turning_claim
from surctl.certcheck.document import Rejected, seal
from surctl.certcheck.fields import number
from surctl.certcheck.turning_claim import axis_pairs
from tests.certcheck.altering import put, value_of

READERS: dict[str, tuple[Callable[[Any], Any], str]] = {
    "turning": (turning_claim.read_claim, "region-turning-20"),
    "braking": (braking_claim.read_claim, "braking-inertia-ranges"),
}


@cache
def stored(kind: str) -> Any:
    return json.loads(Path(__file__).with_name(f"{READERS[kind][1]}.json").read_text())["claim"]


def refuses(kind: str, path: tuple[Any, ...], value: Any, says: str | None = None) -> None:
    with pytest.raises(Rejected, match=says):
        READERS[kind][0](put(copy.deepcopy(stored(kind)), path, value))


def lists(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where lists of numbers, or of such lists, stand."""
    if isinstance(value, dict):
        return [place for key, entry in value.items() for place in lists(entry, (*path, key))]
    if not isinstance(value, list) or not value or isinstance(value[0], str):
        return []
    return [path, *(place for at, entry in enumerate(value) for place in lists(entry, (*path, at)))]


@pytest.mark.parametrize("kind", READERS)
def test_every_list_of_a_claim_has_its_length(kind: str) -> None:
    READERS[kind][0](stored(kind))
    for path in lists(stored(kind)):
        value = value_of(stored(kind), path)
        for wrong in (None, value[:-1], [*value, value[-1]], "ab", {}):
            refuses(kind, path, wrong)


RANGES = [
    *(("braking", key) for key in ("mass_kg", "linear_drag", "quadratic_drag")),
    *(("turning", key) for key in ("mass_factor", "drag_factor", "lag_s")),
]


@pytest.mark.parametrize(("kind", "key"), RANGES)
def test_a_range_is_least_then_largest(kind: str, key: str) -> None:
    refuses(kind, ("vehicle", key), [2.0, 1.0], "the least value exceeds the largest")


@pytest.mark.parametrize(
    ("kind", "path", "value", "says"),
    [
        *((kind, ("system",), "other", "claim.system 'other' is not known") for kind in READERS),
        *((kind, ("excludes",), ["another"], "claim.excludes differs") for kind in READERS if kind != "braking"),
        ("braking", ("assumes",), [], "claim.assumes differs"),
        *((kind, (key,), value, f"claim.{key} is not a SHA-256") for kind in READERS
          for key in ("sha256_vehicle", "sha256_law") for value in (3, None, "A" * 64, "0" * 63)),
        *((kind, ("law", key), 0.1, "must be 0: the certified loop has no integral action")
          for kind, key in (("turning", "k_i"), ("braking", "k_i_per_s2"))),
        ("turning", ("vehicle", "mass_asymmetry"), 2.0, "an asymmetry must be below 2"),
        ("turning", ("vehicle", "drag_asymmetry"), 2.0, "an asymmetry must be below 2"),
        ("turning", ("motion", "ultimate_bound_m"), [0.1], "ultimate_bound_m must have two entries"),
        ("turning", ("vehicle", "lag_s"), [0.0, 0.1], "lag_s must be a range above 0"),
        ("braking", ("vehicle", "drag"), "other", "claim.vehicle.drag must be along or axes"),
        ("braking", ("vehicle", "mass_ratio"), 0.9, "must be at least 1"),
        ("braking", ("watch", "more"), 1.0, "claim.watch must have exactly the keys"),
        ("braking", ("law", "stopping", "more"), 1.0, "claim.law.stopping must have exactly the keys"),
        ("braking", ("encounter", "obstacles_m_per_s"), [0.0, 0.0], "obstacles_m_per_s must rise"),
        ("braking", ("encounter", "obstacles_m_per_s"), [0.1, 0.0], "obstacles_m_per_s must rise"),
        ("braking", ("encounter", "obstacles_m_per_s"), [], "must be a list of 1 to 12 numbers"),
        ("braking", ("encounter", "obstacles_m_per_s"), [0.1 * k for k in range(13)], "must be a list of 1 to 12"),
        ("braking", ("table", "speeds_m_per_s"), None, "must be a list of 1 to 12 numbers"),
        ("braking", ("law", "barrier"), "other", "claim.law.barrier must be inertia or simple"),
        ("braking", ("law", "stopping", "lightest_kg"), 1e6, "lightest_kg exceeds heaviest_kg"),
    ],
)  # fmt: skip
def test_an_entry_of_another_form_is_named(kind: str, path: tuple[Any, ...], value: Any, says: str) -> None:
    refuses(kind, path, value, says)


def test_a_table_has_a_row_for_each_speed_and_a_column_for_each_obstacle() -> None:
    name, table = "needed_m", stored("braking")["table"]["needed_m"]
    for rows in (table[:-1], [*table, table[0]]):
        refuses("braking", ("table", name), rows, "must have one row for each speed")
    for at in range(len(table)):
        rows = [[*row, 1.0] if k == at else row for k, row in enumerate(table)]
        refuses("braking", ("table", name), rows, "and one column for each obstacle")


def test_numbers_are_decimals_of_a_limited_size() -> None:
    assert number(0.1, "it") == Fraction(1, 10) and number(0, "it") == 0 and number(1e-18, "it", above=True)
    assert number(-3, "it", least=-(10**9)) == -3
    for value in (True, "1", None, float("nan"), float("inf"), 10**30):
        with pytest.raises(Rejected, match="it must be a finite number"):
            number(value, "it")
    for value, more in ((-0.1, {}), (0.0, {"above": True}), (0.9, {"least": 1}), (1, {"least": 1, "above": True})):
        with pytest.raises(Rejected, match=r"it must be (above|at least) [01], not"):
            number(value, "it", **more)
    for value in (1e30, 9e-19):
        with pytest.raises(Rejected, match="it is too large or too close to 0"):
            number(value, "it")


def test_terms_of_a_vehicle_are_those_beside_equation_3() -> None:
    own = put(copy.deepcopy(stored("turning")), ("vehicle", "terms"), {"m24": -1.0, "Yrr": 2.0})
    assert turning_claim.read_claim(own).terms == {"m24": -1, "Yrr": 2}
    for terms in (None, ["m24"], "m24", {f"m{k}": 1.0 for k in range(1000)}):
        refuses("turning", ("vehicle", "terms"), terms, "terms must be an object")
    for name in ("m11", "Xu", "x", "m24 ", "", "thrust_lag"):
        for terms in ({name: 1.0, "m24": 1.0}, {"m24": 1.0, name: 1.0}):
            refuses("turning", ("vehicle", "terms"), terms, "is not a term beside equation")


def test_the_vertices_hold_all_pairs_that_differ_by_at_most_the_asymmetry() -> None:
    """Each vertex is a pair of the set, and the two extreme pairs are among the vertices."""
    assert axis_pairs((1.0, 2.0), 2.0) == [(1, 1), (1, 2), (2, 1), (2, 2)]
    assert axis_pairs((Fraction(1), Fraction(1)), Fraction(0)) == [(1, 1)]
    for share in (Fraction(1, 20), Fraction(1, 2), Fraction(3, 2)):
        ends = Fraction(4, 5), Fraction(6, 5)
        found = axis_pairs(ends, share)
        for a, b in found:
            assert all(ends[0] <= end <= ends[1] for end in (a, b))
            assert abs(a - b) <= share * (a + b) / 2
        widest = max(found, key=lambda pair: (pair[0] - pair[1], pair))
        assert widest[0] == ends[1] and widest[1] == max(ends[0], ends[1] * (2 - share) / (2 + share))
        lowest = min(found, key=lambda pair: (pair[1], -pair[0]))
        assert lowest == (min(ends[1], ends[0] * (2 + share) / (2 - share)), ends[0])


@pytest.mark.parametrize("kind", ["document", "patience", "", "os", "region.x"])
def test_a_kind_is_one_of_those_that_are_checked(kind: str) -> None:
    assert check_document(seal(kind, {}, {})).reason == f"the kind {kind!r} is not known to this checker"
