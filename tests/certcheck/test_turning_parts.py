"""The parts of the checker of a turning cruise: each condition fails alone."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from surctl.certcheck import check_document
from surctl.certcheck.document import Rejected
from surctl.certcheck.turning import _flow, _slopes, _thrust, check_cells
from surctl.certcheck.turning_claim import TurningClaim, read_claim
from tests.certcheck.altering import put, sealed

HERE = Path(__file__).parent
STORED: dict[str, Any] = json.loads((HERE / "region-turning-20-lag.json").read_text())
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
    proof = put(copy.deepcopy(STORED["proof"]), path, value)
    with pytest.raises(Rejected, match=says):
        check_cells(CLAIM, proof, (Fraction(0), Fraction(0)))


@pytest.mark.parametrize("changes", [{"curvature": Fraction(1, 100)}, {"terms": {"m12": Fraction(1, 100)}}])
def test_late_thrust_is_not_covered_on_a_curve_or_with_coupled_inertia(changes: dict[str, Any]) -> None:
    _thrust(CLAIM, STORED["proof"]["thrust"])
    with pytest.raises(Rejected, match="not covered together"):
        _thrust(replace(CLAIM, **changes), STORED["proof"]["thrust"])


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
    assert _slopes([1.0, 2.0]) == TWO
    with pytest.raises(Rejected):
        _slopes(bad)
