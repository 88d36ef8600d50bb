"""A list that is the stated expression in real numbers, but not in double precision, does not belong."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

from surctl.certcheck.bundle import Listed, Port
from surctl.certcheck.derivation import Derivation
from surctl.certcheck.document import Rejected
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.instructions import read_list
from surctl.certcheck.loop_dynamics import compare_dynamics
from surctl.certcheck.rounding import STEP, TINY, propagated, rounding_error

PLANT = "program p\nin0 x 1\nin1 u 1\nin2 d 0\nin3 p 0\nv0 = in1[0]\nout0 = v0\n"
MEASURED = "program m\nin0 x 1\nin1 d 0\nin2 p 0\nv0 = in0[0]\nout0 = v0\n"


def law(steps: str) -> str:
    """A controller that computes the gain -2 times x as v2, then further steps, of which the last is the command."""
    words = [word for word in steps.split("; ") if word]
    lines = ["v0 = in1[0]", "v1 = in2[0]", "v2 = mul v1 v0", *(f"v{k} = {w}" for k, w in enumerate(words, 3))]
    return "\n".join(("program c\nin0 z 0\nin1 u 1\nin2 g 1", *lines, f"out0 = v{len(lines) - 1}\nout1 =\n"))


def unlike(steps: str, text: str = "-2*x") -> tuple[list[str], list[str]]:
    place, force = (Port("y", 1, "m"),), (Port("f", 1, "N"),)
    lists = (
        Listed(law(steps), {"inputs": place, "commands": force}, {}),
        Listed(PLANT, {"inputs": force}, {}),
        Listed(MEASURED, {"outputs": place}, {}),
    )
    vectors: dict[str, list[float | str]] = {"plant_state": ["x"], "gains": [-2.0]}
    vectors |= {key: [] for key in ("controller_state", "parameters", "reference", "disturbance")}
    return compare_dynamics(["x"], [(-1.0, 1.0)], {"x": text}, vectors, lists, 0.01)


def const(value: float) -> str:
    return f"const {value.hex()}"


@pytest.mark.parametrize(
    "steps",
    [
        f"{const(1e30)}; add v2 v3; sub v4 v3",
        f"{const(1e30)}; {const(0.9375)}; sub v0 v4; const 0x0.0p+0; fmax v5 v6; mul v7 v3; add v2 v8; sub v9 v8",
        f"{const(1e300)}; mul v2 v3; mul v4 v3; div v5 v3; div v6 v3",
        f"{const(1e-300)}; mul v2 v3; mul v4 v3; div v5 v3; div v6 v3",
        f"{const(2.0**53)}; {const(1.0)}; add v3 v4; sub v5 v3; mul v2 v6",
    ],
    ids=("absorbed", "absorbed in a part of the box", "too large", "too small", "numbers"),
)
def test_what_is_absorbed_or_out_of_range_in_double_precision_is_not_shown(steps: str) -> None:
    differs, undecided = unlike(steps)
    assert not differs
    assert undecided[0].startswith("rate of x: the rounding of the code may change it by ")


def test_a_comparison_of_numbers_that_rounding_decides_is_not_computed() -> None:
    steps = f"{const(2.0**53)}; {const(1.0)}; add v3 v4; eq v5 v3; neg v2; select v6 v7 v2"
    assert unlike(steps)[1]
    assert unlike(steps.replace(const(2.0**53), const(2.0**52))) == ([], [])
    steps = f"{const(2.0**53)}; {const(1.0)}; add v3 v4; sub v5 v3; neg v2; select v6 v2 v7"
    assert unlike(steps)[1]


def test_a_comparison_with_the_state_that_rounding_decides_is_not_shown() -> None:
    near = f"{const(1e16)}; {const(0.5)}; add v0 v3; add v4 v3; lt v6 v5; neg v2; select v7 v8 v2"
    (message,) = unlike(near, "select(x + 1e16, 1e16 + 0.5, -2*x, 2*x)")[1]
    assert message.endswith("may change it by inf")
    branch = f"{const(0.5)}; lt v3 v0; neg v2; select v4 v5 v2"
    assert unlike(branch, "select(x, 0.5, -2*x, 2*x)") == ([], [])


def test_an_infinite_constant_is_named() -> None:
    for steps in (
        "const inf",
        "const inf; fmin v2 v3",
        "const inf; sub v3 v3; add v2 v4",
        "const inf; neg v3; add v3 v4",
    ):
        with pytest.raises(Rejected, match="an instruction list computes with infinity"):
            unlike(steps)


def test_common_laws_are_rounded_little() -> None:
    assert unlike("") == ([], [])
    assert unlike(f"{const(0.1)}; mul v2 v3; div v4 v3") == ([], [])
    assert unlike("sq v0; sqrt v3; mul v2 v4", "-2*x*sqrt(x^2)") == ([], [])


def test_a_loop_whose_end_rounding_decides_has_no_expression() -> None:
    algebra = Derivation(["x"])
    tenth = algebra.constant(0.1)
    total = algebra.constant(0.0)
    for _ in range(10):
        total = algebra.apply("add", (total, tenth))
    with pytest.raises(Rejected, match="selects by rounding"):
        algebra.truth([algebra.apply("sub", (total, algebra.constant(1.0)))])
    with pytest.raises(Rejected, match="selects by rounding"):
        algebra.places([total], 9)
    assert algebra.truth([total]) == [True]
    assert algebra.places([algebra.constant(2.5)], 9) == [2]


def test_an_error_without_a_bound_is_infinite() -> None:
    algebra = Derivation(["x"])
    text = "program f\nin0 x 1\nv0 = in0[0]\nv1 = inv v0\nout0 = v1\n"
    (out,) = read_list(text).run([np.array([[algebra.variable("x")]])], algebra)
    assert rounding_error(algebra.table, int(out[0, 0]), [(-1.0, 1.0)], {}) == float("inf")
    assert rounding_error(algebra.table, int(out[0, 0]), [(0.0, 0.0)], {}) == float("inf")
    assert rounding_error(algebra.table, int(out[0, 0]), [(0.5, 1.0)], {}) < 1e-15


OPERATIONS: dict[str, Callable[..., float]] = {
    "add": lambda a, b: a + b, "mul": lambda a, b: a * b, "div": lambda a, b: a / b, "sqrt": math.sqrt,
    "atan2": math.atan2, "max": max, "min": min, "select": lambda a, b, x, y: x if a <= b else y,
}  # fmt: skip


@pytest.mark.parametrize("op", OPERATIONS)
def test_no_operation_increases_an_error_beyond_its_bound(op: str) -> None:
    draw, decided = random.Random(op), 0
    for _ in range(400):
        count = {"sqrt": 1, "select": 4}.get(op, 2)
        ends = [(low, low + draw.uniform(0.1, 2)) for low in (draw.uniform(0.2, 2) for _ in range(count))]
        if op in ("mul", "add") and draw.random() < 0.5:
            ends = [(-high, -low) for low, high in ends]
        errors = [draw.choice((0.0, 10 ** draw.uniform(-4, -2))) for _ in range(count)]
        if op == "select":
            ends[1] = (ends[0][1] + 0.5, ends[0][1] + 0.6)
        at = [draw.choice((*pair, draw.uniform(*pair))) for pair in ends]
        off = [x + draw.choice((-1, 1)) * e for x, e in zip(at, errors, strict=True)]
        corners = [OPERATIONS[op](*pair) for pair in (at, off)]
        size = max(abs(OPERATIONS[op](a, b)) for a in ends[0] for b in ends[1]) if count == 2 else 9.0
        bound = propagated(op, errors, ends, size)
        assert abs(corners[0] - corners[1]) <= bound * (1 + 1e-9) + 1e-15
        decided += bound < 1
    assert decided > 300


def test_a_box_is_halved_where_it_is_widest() -> None:
    table = ExpressionTable(["y", "x"])
    root = table.read("1/(x*(x - 0.5) + 0.1 + 0*y)")
    assert rounding_error(table, root, [(0.5, 0.5), (-1.0, 1.0)], {}) < 1e-10


def test_the_error_of_a_constant_is_rounded_up_and_a_large_one_is_refused() -> None:
    algebra = Derivation(["x"])
    for pair in ((0.1, 0.2), (0.1, 0.7), (3.3, 1e-20)):
        at = algebra.apply("add", tuple(map(algebra.constant, pair)))
        exact = abs(sum(map(Fraction, pair))) * Fraction(STEP) + Fraction(TINY)
        assert exact <= Fraction(algebra.constants[at]) <= exact * Fraction(1.0000001)
    with pytest.raises(Rejected, match="computes a number that is too large for the code"):
        algebra.apply("mul", (algebra.constant(1e300), algebra.constant(1e300)))
