"""The checker's own reader and evaluator of instruction lists."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.certcheck import Rejected
from surctl.certcheck.instructions import digest, evaluate, read_list
from surctl.certcheck.leaves import Leaves
from surctl.ir import Gather, Loop, Program, Routine, replay
from surctl.ir.program import OPERATIONS, Instruction
from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.vehicle import load_vehicle


@pytest.mark.parametrize("law", ["guarded", "steered", "paper"])
def test_the_evaluator_computes_what_the_exported_code_computes(law: str) -> None:
    built, rng = build_law(law), np.random.default_rng(2)
    p = built.gains.pack({})
    if law == "guarded":
        p = law_numbers(load_scenario("pool-behind"), load_gains("default"), load_vehicle("sur400"))
    x = built.initial_state() + rng.normal(size=(20, built.state.size)) / 10
    u, p = rng.normal(size=(20, built.inputs.size)), np.tile(p, (20, 1))
    text = built.block.text()
    assert digest(text) == built.block.digest()
    own = evaluate(read_list(text), x.T, u.T, p.T)
    for mine, other in zip(own, replay(built.block, x, u, p), strict=True):
        assert np.array_equal(mine.T, other, equal_nan=True)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(sorted(OPERATIONS)), min_size=1, max_size=25), st.randoms(use_true_random=False))
def test_every_operation_is_that_of_the_list(names: list[str], draw: random.Random) -> None:
    steps = [Instruction("input", (0, k)) for k in range(3)] + [Instruction("const", (), draw.choice((-0.0, 0.1, 3.0)))]
    for name in names:
        arity = OPERATIONS[name].arity
        steps.append(Instruction(name, tuple(draw.randrange(len(steps)) for _ in range(arity))))
    program = Program("some", (("x", 3),), (("y", len(steps)),), tuple(steps), (tuple(range(len(steps))),))
    x = np.array([[draw.choice((0.0, -0.0, 0.5, -2.0, 1e3)) for _ in range(3)] for _ in range(5)])
    (own,), (other,) = evaluate(read_list(program.text()), x.T), replay(program, x)
    close = np.isclose(own.T, other, rtol=1e-12, atol=0, equal_nan=True)  # fma has two roundings here
    assert close.all() or "fma" in names


def looped(lanes: int) -> Routine:
    """A loop with every kind of array, and a gather from its result."""
    i = [Instruction("input", (k, 0)) for k in range(5)]
    body = Program(
        "body", (("k", 1), ("sum", 1), ("piece", 1), ("apart", 1), ("all", 1)), (("sum", 1), ("row", 1)),
        (*i, Instruction("mul", (2, 4)), *(Instruction("add", pair) for pair in ((5, 3), (1, 6), (7, 0)))),
        ((7,), (8,)),
    )  # fmt: skip
    loop = Loop(body, 3, ("s",), ("t", "rows"), ("a",), ("f",), True, None, ("b",), lanes)
    inputs = (("s", lanes), ("a", 3 * lanes), ("b", 3 * lanes), ("f", 1), ("at", 1))
    return Routine("whole", inputs, (loop, Gather("rows", "at", 1, "one", lanes)), ("t", "rows", "one"))


@pytest.mark.parametrize("lanes", [1, 2, 4])
def test_loops_in_lanes_and_gathers(lanes: int) -> None:
    routine, rng = looped(lanes), np.random.default_rng(lanes)
    vectors = [rng.normal(size=(7, size)) for _, size in routine.inputs]
    vectors[-1] = rng.uniform(-2, 3 * lanes + 2, size=(7, 1))
    own = evaluate(read_list(routine.text()), *(v.T for v in vectors))
    for mine, other in zip(own, replay(routine, *vectors), strict=True):
        assert np.array_equal(mine.T, other)


def test_what_is_no_list_is_rejected() -> None:
    text = looped(2).text()
    read_list(text)
    changes = (
        ("mul v2 v4", "mul v2 v9"), ("mul v2 v4", "mul v2"), ("mul", "power"), ("in4[0]", "in4[1]"),
        ("count 3", "count 9"), ("v0 =", "v1 ="),
        ("lanes 2", "lanes 3"), ("in s 2", "in s 3"), ("out t", "out u"), ("program body", "program other"),
    )  # fmt: skip
    for old, new in changes:
        assert old in text
        with pytest.raises(Rejected, match="not an instruction list"):
            read_list(text.replace(old, new, 1))
    for wrong in ("", "program x", text + "\n", text[:-1], text.split("\n\n")[1], "v0 = const nan"):
        with pytest.raises(Rejected):
            read_list(wrong)


def test_a_leaf_that_nothing_takes_is_named() -> None:
    leaves = Leaves({"a": {"b": 1.0, "c": [2.0, 3.0]}, "d": [], "e": {}, "f": None, "g": "text"})
    leaves.take("a", "c", 1), leaves.take("d"), leaves.take("g")
    assert leaves.left() == ["a.b = 1.0", "a.c[0] = 2.0", "e = {}", "f = None"]
    with pytest.raises(KeyError):
        leaves.take("a", "x")


def test_a_procedure_has_a_bounded_number_of_operations() -> None:
    with pytest.raises(Rejected, match="too large"):
        read_list("procedure f\nin x 1\nout y 1\ndef f(s):\n    for i in range(1000000000):\n        s.y[0] = 1.0\n")
