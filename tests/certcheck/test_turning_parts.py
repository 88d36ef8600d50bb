"""The parts of the checker of a turning cruise: each condition fails alone."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from surctl.certcheck import check_document
from surctl.certcheck.document import Rejected
from surctl.certcheck.region_exact import largest_eigenvalue
from surctl.certcheck.turning import _flow, _phases, cruise_of, require_bound, require_starts, shells_of, triangle
from surctl.certcheck.turning_claim import TurningClaim, read_claim
from surctl.certcheck.turning_form import lipschitz
from surctl.certcheck.turning_terms import outer_force
from tests.certcheck.altering import put, sealed

HERE = Path(__file__).parent
STORED: dict[str, Any] = json.loads((HERE / "region-turning-20-sampled.json").read_text())
CLAIM: TurningClaim = read_claim(STORED["claim"])
TWO = (Fraction(1), Fraction(2))


def test_a_certificate_has_no_further_entry() -> None:
    assert "the certificate" in check_document(sealed(copy.deepcopy(STORED) | {"more": 1})).reason


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (("P", 3, 3), -1.0, "P is not positive definite"),
        *((("P", *place), 1e-6, "not symmetric under reflection") for place in ((1, 0), (3, 0), (2, 1), (3, 2))),
        *((("cells",), value, "must be a whole number from 4 to 96") for value in (3, 97, 24.0, True)),
    ],
)
def test_the_matrix_and_the_number_of_cells_are_checked(path: tuple[Any, ...], value: Any, says: str) -> None:
    found = check_document(sealed(put(copy.deepcopy(STORED), ("proof", *path), value)))
    assert not found.accepted and says in found.reason


@pytest.mark.parametrize("rows", [None, "ab", [1.0, [0.0, 1.0]], [[1.0], 1.0], [1.0, 1.0], [[1.0], [0.0]], [[1.0]]])
def test_a_matrix_is_a_triangle_of_lists(rows: object) -> None:
    with pytest.raises(Rejected, match="must be a lower triangle with 2 rows"):
        triangle(rows, 2, "P")


@pytest.mark.parametrize("shells", [None, "a", {}, [], [{"level": 1.0, "growth": 0.1}] * 25])
def test_shells_are_a_list_of_at_least_one_and_not_too_many(shells: object) -> None:
    with pytest.raises(Rejected, match="must hold 1 to 24 shells"):
        shells_of(CLAIM, {"floor": 0.1, "shells": shells})


def test_the_largest_eigenvalue_is_rounded_up() -> None:
    a, b, c = Fraction(0), Fraction(1), Fraction(1)
    assert (2 * largest_eigenvalue([[a, b], [b, c]]) - a - c) ** 2 > (a - c) ** 2 + 4 * b**2  # the root is irrational


@pytest.mark.parametrize("order", [1, -1])
def test_errors_of_measurement_count_with_the_axis_on_which_they_change_more_thrust(order: int) -> None:
    """The heavier axis answers an error of the velocity, the one with more drag as well an error of the position."""
    mass, linear = (Fraction(20), Fraction(30))[::order], (Fraction(40), Fraction(10))[::order]
    quadratic, none = (Fraction(0), Fraction(0)), Fraction(0)
    ideal = replace(CLAIM, mass=mass, linear=linear, quadratic=quadratic, k_v=Fraction(1), force=none, place_error=none)
    assert outer_force(replace(ideal, velocity_error=Fraction(1)), 0.1) >= 30.0
    found = outer_force(replace(ideal, place_error=Fraction(1, 100), velocity_error=none), 0.1)
    assert found >= (20.0 + 40.0) * float(CLAIM.cap / CLAIM.lookahead) * 0.01
    assert found >= (20.0 + 40.0) * float(CLAIM.k1) * 0.01


def test_the_commanded_velocity_changes_by_the_place_on_the_path_and_by_the_cap() -> None:
    slow, fast = replace(CLAIM, cap=Fraction(1, 1000)), replace(CLAIM, k1=Fraction(1, 1000))
    assert lipschitz(slow, 0.0, 0.0) >= float(slow.k1) and lipschitz(fast, 0.0, 0.0) >= float(fast.cap / fast.lookahead)


@pytest.mark.parametrize("changes", [
    {"curvature": Fraction(1, 100)}, {"terms": {"m12": Fraction(1, 100)}}, {"force": Fraction(1, 100)},
    {"place_error": Fraction(1, 100)}, {"velocity_error": Fraction(1, 100)},
])  # fmt: skip
def test_late_thrust_is_not_covered_on_a_curve_or_with_coupled_inertia(changes: dict[str, Any]) -> None:
    assert len(_phases(CLAIM, STORED["proof"])[1]) == 2
    with pytest.raises(Rejected, match="not covered together"):
        _phases(replace(CLAIM, **changes), STORED["proof"])


def test_every_time_constant_of_the_thrust_is_decided_at_its_ends() -> None:
    lags = Fraction(1, 10), Fraction(1, 5)
    assert [one.lag for one in _phases(replace(CLAIM, lag=lags, period=Fraction(0)), {})[1]] == [0.1, 0.2]
    assert [one.lag for one in _phases(replace(CLAIM, lag=lags), STORED["proof"])[1]] == [0.1, 0.1, 0.2, 0.2]


GOOD = [[1.0, 2.0], [0.0, 0.0], [0.0, 0.0]]


@pytest.mark.parametrize("bad", [GOOD[:2], [*GOOD, [0.0, 0.0]], [[1.0], *GOOD[1:]], [*GOOD[:2], [1.0, 2.0, 3.0]],
                                 (*GOOD,), [(1.0, 2.0), *GOOD[1:]], {"a": 1.0}])  # fmt: skip
def test_a_flow_has_three_pairs(bad: Any) -> None:
    prompt = replace(CLAIM, lag=(Fraction(0), Fraction(0)), period=Fraction(0))
    assert not prompt.behind and _flow(prompt, GOOD)[0] == TWO
    with pytest.raises(Rejected):
        _flow(prompt, bad)


@pytest.mark.parametrize("row", range(3))
def test_with_late_thrust_a_flow_is_0(row: int) -> None:
    nothing = [[0.0, 0.0] for _ in range(3)]
    assert CLAIM.behind and not any(map(any, _flow(CLAIM, nothing)))
    with pytest.raises(Rejected, match=r"proof\.flow must be 0"):
        _flow(CLAIM, [[0.0, 1.0] if k == row else pair for k, pair in enumerate(nothing)])


@pytest.mark.parametrize("bad", [[1.0], [1.0, 2.0, 3.0], (1.0, 2.0), {"a": 1.0, "b": 2.0}])
def test_a_trim_has_two_entries(bad: Any) -> None:
    assert cruise_of(CLAIM, {"trim": [0.01, 0.02]}).slopes == (Fraction(1, 100), Fraction(1, 50))
    with pytest.raises(Rejected):
        cruise_of(CLAIM, {"trim": bad})


def placed(**entries: float) -> list[list[Fraction]]:
    """A matrix P of (x, y, U_x, U_y)."""
    p = [[Fraction(i == j) for j in range(4)] for i in range(4)]
    for name, value in entries.items():
        i, j = "xyuv".index(name[0]), "xyuv".index(name[1])
        p[i][j] = p[j][i] = Fraction(value)
    return p


HALF = Fraction(1, 2)
ROUND: Any = SimpleNamespace(k1=Fraction(1), offset=HALF, cruise=HALF, ultimate_bound=(Fraction(1), Fraction(1)))


@pytest.mark.parametrize("moved", [(Fraction(1), Fraction(0)), (Fraction(0), Fraction(-1))])
def test_a_start_lies_in_the_region_of_every_steady_cruise(moved: Any) -> None:
    require_starts(ROUND, placed(), (HALF, -HALF), Fraction(0))
    with pytest.raises(Rejected, match="a start with the target's velocity"):
        require_starts(ROUND, placed(), moved, Fraction(0))


@pytest.mark.parametrize("coupling", [0.9, -0.9])
def test_a_start_lies_in_the_region_on_both_sides_of_the_path(coupling: float) -> None:
    moved, most = (Fraction(3, 4), Fraction(3, 4)), replace_offset(Fraction(3, 5))
    require_starts(most, placed(), moved, Fraction(0))
    with pytest.raises(Rejected, match="a start with the target's velocity"):
        require_starts(most, placed(xy=coupling), moved, Fraction(0))


def replace_offset(offset: Fraction) -> Any:
    return SimpleNamespace(**{**vars(ROUND), "offset": offset})


@pytest.mark.parametrize(("moved", "beside"), [((HALF, 0 * HALF), 0), ((0 * HALF, -HALF), 0), ((0 * HALF,) * 2, HALF)])
def test_the_floor_lies_within_the_ultimate_bound(moved: Any, beside: Any) -> None:
    covariance, floor = placed(), Fraction(9, 25)  # 0.6 m from the steady cruise
    require_bound(ROUND, covariance, (Fraction(1, 4), -Fraction(1, 4)), Fraction(1, 4), floor)
    with pytest.raises(Rejected, match="beyond the claimed ultimate bound"):
        require_bound(ROUND, covariance, moved, Fraction(beside), floor)
