"""Quotients by one number: a single division, and what that costs in exactness."""

from __future__ import annotations

import casadi as ca
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.ir import Program, lower, replay
from surctl.ir.folding import shared_divisors


def quotients() -> Program:
    """Two numbers by the third, the fourth by the fifth, and one by the third."""
    x = ca.SX.sym("x", 5)
    return lower(ca.Function("q", [x], [ca.vertcat(x[0] / x[2], x[1] / x[2], x[3] / x[4], 1 / x[2])]))


def divisions(program: Program) -> int:
    return sum(i.op in ("div", "inv") for i in program.instructions)


def test_one_division_for_each_divisor() -> None:
    plain, shared = quotients(), shared_divisors(quotients())
    assert (divisions(plain), divisions(shared)) == (4, 2)


def test_a_divisor_of_one_quotient_is_left_alone() -> None:
    x = ca.SX.sym("x", 2)
    program = lower(ca.Function("q", [x], [x[0] / x[1] + x[0]]))
    assert shared_divisors(program).instructions == program.instructions


def test_what_is_lowered_with_reciprocals_is_the_same_but_for_rounding() -> None:
    x = ca.SX.sym("x", 5)
    function = ca.Function("q", [x], [ca.vertcat(x[0] / x[2], x[1] / x[2], x[3] / x[4])])
    plain, shared = lower(function), lower(function, reciprocals=True)
    assert (divisions(plain), divisions(shared)) == (3, 2)
    given = np.random.default_rng(0).uniform(0.1, 9.0, (200, 5)) * [1, -1, 1, 1, -1]
    (wanted,), (found,) = replay(plain, given), replay(shared, given)
    np.testing.assert_allclose(found, wanted, rtol=4e-16, atol=0)
    assert np.array_equal(found[:, 2], wanted[:, 2])


size = st.floats(1e-6, 1e6)
signed = st.one_of(size, size.map(lambda v: -v))


@settings(max_examples=24)
@given(st.lists(signed, min_size=5, max_size=5))
def test_a_quotient_is_off_by_two_units_at_most(x: list[float]) -> None:
    wanted, found = (np.array(replay(p, x)[0], dtype=float) for p in (quotients(), shared_divisors(quotients())))
    assert np.all(np.abs(found - wanted) <= 2 * np.spacing(np.abs(wanted)))
    assert found[2] == wanted[2]
