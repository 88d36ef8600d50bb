"""Parts of the check of a braking certificate, each the only one that decides."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.certcheck import braking, check_document
from surctl.certcheck.braking import Distance, bound_distance, read_distance
from surctl.certcheck.braking_claim import STOPPING, BrakingClaim, read_claim
from surctl.certcheck.document import Rejected
from surctl.certcheck.elementary import Undefined
from surctl.certcheck.law_points import values_at
from tests.certcheck.altering import sealed

HERE = Path(__file__).parent
F = Fraction


def document(name: str) -> dict[str, Any]:
    return dict(json.loads((HERE / f"braking-{name}.json").read_text()))


def claim(name: str = "rule-20", **changes: Any) -> BrakingClaim:
    return replace(read_claim(document(name)["claim"]), **changes)


def of_law(own: BrakingClaim, **changes: Any) -> BrakingClaim:
    assert own.law is not None
    return replace(own, law=replace(own.law, **changes))


def distance(own: BrakingClaim, *knots: int, obstacle: int = 0, slopes: tuple[int, ...] = (0, 9)) -> Distance:
    return Distance(own, F(obstacle), tuple(map(F, knots or (0, 9))), tuple(map(F, slopes)), True)


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: distance(claim(ratio=F(2), current=F(1, 100))), "a current together with unequal masses"),
        (lambda: distance(claim(), 0, 99, obstacle=9), "braking guarantees nothing for an obstacle that"),
        (lambda: distance(claim(brake=F(999)), obstacle=1), "an obstacle of 1 m/s is faster than fastest_m_per_s"),
        (lambda: distance(claim(), 1, 9), "must start at 0 and rise"),
        (lambda: distance(claim(), 0, 0, 9, slopes=(0, 1, 2)), "must start at 0 and rise"),
        (lambda: distance(claim(), 0, 9, 9, slopes=(0, 1, 2)), "must start at 0 and rise"),
        (lambda: distance(claim(), 0, 9, slopes=(0, 1, 2)), "with a slope for each knot"),
        (lambda: distance(claim(), slopes=(-1, 9)), "must not fall"),
        (lambda: distance(claim(), 0, 8, 9, slopes=(0, 9, 8)), "must not fall"),
        (lambda: distance(claim(), 0, 8, 9, slopes=(9, 8, 9)), "must not fall"),
    ],
)
def test_what_is_no_braking_distance(build: Callable[[], Distance], says: str) -> None:
    with pytest.raises(Rejected, match=says):
        build()


@pytest.mark.parametrize(
    "changes",
    [{"knots": []}, {"knots": 0.0}, {"slopes": []}, {"slopes": [1.0]}, {"slopes": {}}, {"slopes": [0.0] * 13}],
)  # fmt: skip
def test_rows_of_a_distance_are_short_lists_of_numbers(changes: dict[str, Any]) -> None:
    entry = {"knots": [0.0, 9.0], "slopes": [0.0, 9.0], "retreats": True}
    read_distance(claim(), F(0), entry)
    with pytest.raises(Rejected, match=r"must be a list of 1 to 12 numbers|with a slope for each knot"):
        read_distance(claim(), F(0), entry | changes)


def test_the_figures_are_those_of_the_mass_with_the_longer_distance() -> None:
    own = claim(mass=(F(60), F(120)))
    light, both = (distance(replace(own, mass=(F(60), most))).needed(F(1, 10)) for most in own.mass)
    assert light < both
    swung = replace(own, lag=F(50))  # then the lighter mass takes longer
    heavy, both = (distance(replace(swung, mass=(least, F(120)))).needed(F(1, 10)) for least in (F(120), F(60)))
    assert heavy < both


def test_a_retreat_is_as_fast_as_the_late_thrust_or_the_vehicle_allows() -> None:
    own = claim(law=None, lag=F(100))
    (last,) = [one for one in distance(own).obligations() if one.names == ("r",)]
    assert last.box[0][0] == 0.0 and last.box[0][1] == pytest.approx(float(own.fastest))
    own = replace(own, lag=F(1, 100))
    (last,) = [one for one in distance(own).obligations() if one.names == ("r",)]
    assert 0.0 < last.box[0][1] < float(own.fastest)


def test_a_law_brakes_at_least_as_much_as_is_guaranteed_and_wants_no_higher_speed() -> None:
    own = claim("simple-20")
    assert own.law is not None
    with pytest.raises(Rejected, match="the law's thrust limit is below brake_n"):
        distance(of_law(own, limit=own.brake / 2)).obligations()
    with pytest.raises(Rejected, match="the law wants a higher speed than fastest"):
        distance(of_law(own, cap=own.fastest * 2)).obligations()


def test_the_command_below_the_bound_is_that_of_the_heavier_axis_of_the_model() -> None:
    nothing = (F(0), F(0))
    own = of_law(claim("simple-20", sideways=F(0)), mass=(F(90), F(120)), linear=nothing, quadratic=nothing)
    assert own.law is not None
    (condition,) = distance(own).obligations()[-1].constraints
    command = -values_at(["b", "v"], np.array([[0.2], [0.1]]), {"c": condition})["c"] - float(own.brake)
    assert command[0] == pytest.approx(120 * float(own.law.k_v) * 0.1)


def test_the_bound_of_the_law_is_that_of_its_heavier_axis() -> None:
    law = claim("simple-20").law
    assert law is not None
    heavy, both = (bound_distance(replace(law, mass=mass), F(0), F(1, 10)) for mass in ((F(9), F(9)), (F(5), F(9))))
    assert both == heavy
    late = replace(law, barrier="inertia", stopping=dict(zip(STOPPING, map(F, (5, 9, 1, 0, 1000, 0)), strict=True)))
    with pytest.raises(Rejected, match="assumes too little braking force at the speed of the obstacle"):
        bound_distance(late, F(9), F(1, 10))


def test_there_is_one_distance_for_each_obstacle() -> None:
    whole = document("rule-20")
    whole["distances"].append(whole["distances"][-1])
    assert check_document(sealed(whole)).reason == "there must be one braking distance for each obstacle"


@pytest.mark.parametrize("row", [0, -1])
def test_every_speed_of_the_table_is_compared(row: int) -> None:
    whole = document("rule-20")
    whole["claim"]["table"]["needed_m"][row][0] = 0.0
    assert "table.needed_m at" in check_document(sealed(whole)).reason


def test_an_undefined_expression_is_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    def undefined(*_: object) -> None:
        raise Undefined("a root")

    monkeypatch.setattr(braking, "check_all", undefined)
    assert check_document(document("rule-20")).reason == "the certificate is malformed: Undefined: a root"
