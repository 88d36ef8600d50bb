from __future__ import annotations

import pickle

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import Instruction, Program, lower, replay
from tests.ir.expressions import EXACT, LIBM_MAKERS, whole


def test_a_batch_is_its_rows() -> None:
    program = lower(whole(EXACT | LIBM_MAKERS))
    rows = np.random.default_rng(1).uniform(-2, 2, (50, 4))
    (batch,) = replay(program, rows)
    assert batch.shape == (50, len(EXACT | LIBM_MAKERS))
    for k, row in enumerate(rows):
        np.testing.assert_allclose(batch[k], replay(program, row)[0], rtol=1e-14, atol=1e-15)


def test_a_program_that_ran_is_pickled_as_one_that_did_not() -> None:
    program = lower(whole(EXACT))
    fresh = pickle.dumps(program)
    replay(program, np.ones(4))
    assert pickle.dumps(program) == fresh


def test_single_precision_rounds_every_intermediate() -> None:
    x = ca.SX.sym("x", 3)
    program = lower(ca.Function("f", [x], [(x[0] + x[1]) + x[2]]))
    (y,) = replay(program, [1e-9, 1.0, -1.0], real=np.float32)
    assert y.dtype == np.float32
    assert y[0] == 0.0  # 1 + 1e-9 is 1 in single precision
    assert replay(program, [1e-9, 1.0, -1.0])[0][0] != 0.0


def test_libm_is_named() -> None:
    assert lower(whole(LIBM_MAKERS)).libm == set(LIBM_MAKERS)
    assert not lower(whole(EXACT)).libm


def test_ties_and_nan_of_min_and_max_fall_as_in_c() -> None:
    two = (Instruction("input", (0, 0)), Instruction("input", (0, 1)))
    for op, want in (("fmin", -0.0), ("fmax", -0.0)):
        program = Program("m", (("x", 2),), (("y", 1),), (*two, Instruction(op, (0, 1))), ((2,),))
        (y,) = replay(program, [-0.0, 0.0])
        assert np.signbit(y[0]) == np.signbit(want)
        assert np.isnan(replay(program, [np.nan, 1.0])[0][0])
        assert replay(program, [1.0, np.nan])[0][0] == 1.0


def test_division_by_zero_raises_nothing() -> None:
    x = ca.SX.sym("x", 1)
    program = lower(ca.Function("f", [x], [ca.vertcat(1 / x, ca.sqrt(x - 1))]))
    (y,) = replay(program, [0.0])
    assert np.isinf(y[0]) and np.isnan(y[1])


def test_wrong_inputs_are_refused() -> None:
    x = ca.SX.sym("x", 2)
    program = lower(ca.Function("f", [x], [x]))
    with pytest.raises(InputError, match=r"expected \(…, 2\)"):
        replay(program, [1.0])
    with pytest.raises(InputError, match="takes 1 inputs, got 2"):
        replay(program, [1.0, 2.0], [1.0])
