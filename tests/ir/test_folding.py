"""Constants put into a program: the same numbers with less work."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import Program, lower, replay
from surctl.ir.folding import with_constants
from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.vehicle import load_vehicle
from tests.ir.expressions import EXACT

PICKS = (
    lambda x, p: (x[0], x[1], p[2]),
    lambda x, p: (x[0], p[0], x[2]),
    lambda x, p: (p[0], p[1], p[2]),
)


def alone(make: object, constants: list[float]) -> tuple[Program, Program]:
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", len(constants))
    program = lower(ca.Function("f", [x, p], [make(x, p)]))  # type: ignore[operator]
    return program, with_constants(program, 1, constants)


@pytest.mark.parametrize("name", sorted(EXACT))
def test_every_operation_of_numbers_and_constants(name: str) -> None:
    rng = np.random.default_rng(3)
    X = np.vstack([rng.normal(size=(200, 3)), np.zeros((1, 3)), np.ones((1, 3))])
    for constants in ([0.0, 1.0, -1.0], [1.0, 0.0, 2.5], [-1.0, 0.3, 0.0]):
        for pick in PICKS:
            program, folded = alone(lambda x, p, pick=pick: EXACT[name](*pick(x, p)), constants)
            want = replay(program, X, np.tile(constants, (len(X), 1)))[0]
            have = replay(folded, X, np.tile(constants, (len(X), 1)))[0]
            assert np.array_equal(np.broadcast_to(have, want.shape), want, equal_nan=True)
            assert folded.operations <= program.operations


@pytest.mark.parametrize(
    ("make", "operations"),
    [
        (lambda x, p: x[0] + 0 * p[0] * x[1], 0),
        (lambda x, p: x[0] * p[1] - (-x[1]), 1),
        (lambda x, p: ca.fmax(ca.sqrt(x[0] * x[0] + x[1]), p[0]), 3),
        (lambda x, p: ca.fmax(x[0] > 0, x[1] > 0), 3),
        (lambda x, p: x[1] + ca.if_else(x[0] > 0, -x[2], 0), 3),
        (lambda x, p: ca.sin(ca.SX(0)) + ca.sqrt(p[1] + 3) * x[0], 1),
    ],
)
def test_what_follows_from_constants_is_not_computed(make: object, operations: int) -> None:
    _, folded = alone(make, [0.0, 1.0])
    assert folded.operations == operations
    assert not any(i.op == "input" and i.args[0] == 1 for i in folded.instructions)


def test_the_law_is_the_same_and_shorter() -> None:
    mission, law = load_scenario("tank-slalom"), build_law("closed_form")
    p = law_numbers(mission, load_gains("default"), load_vehicle(mission.vehicle))
    assert isinstance(law.block, Program)
    folded = with_constants(law.block, 2, list(p))
    rng = np.random.default_rng(0)
    X, U = law.initial_state() + rng.uniform(-1, 5, (500, law.state.size)), rng.uniform(-3, 3, (500, law.inputs.size))
    X[:, -1], U[:, -1] = rng.integers(-1, 2, 500), rng.integers(0, 2, 500)
    P = np.tile(p, (500, 1))
    for want, have in zip(replay(law.block, X, U, P), replay(folded, X, U, P), strict=True):
        np.testing.assert_allclose(have, want, rtol=0, atol=1e-12)
    assert folded.operations < 0.75 * law.block.operations


def test_mistakes_are_named() -> None:
    program, _ = alone(lambda x, p: x[0] * p[0], [1.0])
    with pytest.raises(InputError, match="needs 1 finite numbers"):
        with_constants(program, 1, [1.0, 2.0])
    with pytest.raises(InputError, match="finite"):
        with_constants(program, 1, [float("nan")])
    x = ca.SX.sym("x")
    with pytest.raises(InputError, match="mathematical library"):
        with_constants(lower(ca.Function("f", [x], [ca.sin(x)])), 0, [1.0])
