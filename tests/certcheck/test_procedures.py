"""The checker's evaluator of procedures computes what the text says, and refuses every other text."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from surctl.certcheck.document import Rejected
from surctl.certcheck.patience import patient
from surctl.certcheck.procedures import evaluator

PORTS = ([("x", 2), ("far", 1)], [("y", 2)])
MEMORY = [("k", "whole", 0), ("place", "whole", 2), ("r", "real", 2)]
SIZES = {"n": 2, "m": 3}


def run(body: str, *x: list[float], before: str = "", head: str = "def f(s):") -> list[list[float]]:
    """Return y, one list a point, of a procedure whose last function has this body."""
    points = np.array(x or [[1.0, 2.0]]).T
    function, _ = evaluator(f"{before}{head}\n    {body}\n", SIZES, MEMORY, PORTS)
    (y,) = function([points, np.array([[5.0]])])
    result: list[list[float]] = y.T.tolist()
    return result


SAYS: Mapping[str, list[float]] = {
    "s.y[0] = s.x[1]\n    s.y[1] = s.far[0]": [2.0, 5.0],
    "s.y[0] = s.n\n    s.y[1] = s.k + s.place[1]": [2.0, 0.0],
    "s.y[0] = s.r[1]\n    s.y[1] = fabs(-2.0)": [math.nan, 2.0],
    "s.y[0] = 1.0 / 0.0\n    s.y[1] = sqrt(-1.0)": [math.inf, math.nan],
    "s.y[0] = 2.0 * (1.0 / (s.k * 1.0))\n    s.y[1] = sqrt(9.0) / 2.0": [math.inf, 1.5],
    "s.y[0] = 1.0 / (2.0 / 0.0)\n    s.y[1] = 0.0 / 0.0": [0.0, math.nan],
    "s.y[0] = -3.0 / 0.0\n    s.y[1] = 3.0 / -0.0": [-math.inf, -math.inf],
    "s.y[0] = s.r[0] / 0.0\n    s.y[1] = 7.0 / -2.0": [math.nan, -3.5],
    "for i in range(s.n):\n        s.y[i] = 10.0 * s.x[i]": [10.0, 20.0],
    "for i in within(1, 3, s.m):\n        s.k += i\n    s.y[0] = s.k\n    s.y[1] = 1.0": [3.0, 1.0],
    "for i in back(0, 3, s.n + 1):\n        s.k = 10 * s.k + i\n    s.y[0] = s.k\n    s.y[1] = 1.0": [210.0, 1.0],
}


@pytest.mark.parametrize("body", list(SAYS))
def test_a_procedure_computes_what_it_says(body: str) -> None:
    assert np.array_equal(run(body), [SAYS[body]], equal_nan=True)


def test_every_point_has_a_memory_of_its_own_and_numbers_serve_all_points() -> None:
    body = "s.k += 1\n    s.y[0] = s.x[0] + s.far[0]\n    s.y[1] = s.k"
    assert run(body, [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]) == [[6.0, 1.0], [7.0, 1.0], [8.0, 1.0]]


def test_the_last_function_is_evaluated_and_calls_those_before_it() -> None:
    before = "def g(s: Anything, a: int) -> float:\n    return a / 4.0\n"
    assert run("s.y[0] = g(s, 3)\n    s.y[1] = 0.0", before=before, head="def f(s: Memory) -> None:") == [[0.75, 0.0]]


ASSIGNED = "    s.y[0] = 1.0\n"


def test_operations_are_counted_and_a_loop_counts_by_its_bound() -> None:
    def count(source: str) -> int:
        return evaluator(source, SIZES, MEMORY, PORTS)[1]

    one = 9  # assignment, element, array, memory, and their roles
    assert count(f"def f(s):\n{ASSIGNED}") == one
    assert count(f"def f(s):\n{ASSIGNED}{ASSIGNED}{ASSIGNED}") == 3 * one
    assert count(f"def f(s):\n    for i in range(7):\n    {ASSIGNED}") == 7 * (1 + one) + 1
    assert count(f"def f(s):\n    for i in range(s.n + s.m - 1):\n    {ASSIGNED}") - count(
        f"def f(s):\n    for i in range(s.n + s.m - 2):\n    {ASSIGNED}"
    ) == (1 + one)
    pair = "def f(s):\n    for i in range(9):\n        pass\n    for i in range({}):\n        pass\n"
    assert count(pair.format("1 - 9")) > count(pair.format(0))  # no loop makes up for another one
    call = count("def g(s):\n    pass\ndef f(s):\n    g(s)\n")
    assert count(f"def g(s):\n{ASSIGNED}def f(s):\n    g(s)\n") == call - 1 + one


REFUSED = {
    "def f(s):\n    while s.k < 1:\n        pass": "construct While",
    "def f(s):\n    s.k = s.k % 2": "construct Mod",
    "def f(s):\n    fabs(x=1.0)": "construct keyword",
    "def f(s):\n    s.k = s.other": "attribute other",
    "def f(s):\n    for i in range(2):\n        s.k = i.n": "attribute n",
    "def f(s):\n    s.k = s.x.n": "attribute n",
    "def f(s):\n    s.k = _times(1, 2)": "name _times",
    "def f(s):\n    range = 2": "name range",
    "def f(s, within):\n    pass": "name within",
    "def f(s, _a):\n    pass": "name _a",
    "def f(s):\n    s.k *= 2": "product in place",
    "def f(s):\n    return 'x'": "constant that is no number",
    "def f(s):\n    s.k = True": "constant that is no number",
    "k = 1\ndef f(s):\n    pass": "outside its functions",
    "def f(s):\n    pass\nk = 1": "outside its functions",
    "def f(s):\n    pass\n@f\ndef g(s):\n    pass": "outside its functions",
    "def f(s):\n    pass\ndef f(s):\n    pass": "outside its functions",
    "def sqrt(s):\n    pass": "outside its functions",
    "def _times(s, a):\n    return a": "function _times",
    "def f(s, a=1):\n    pass": "function f",
    "def f():\n    pass": "function f",
    "": "without a function",
    "def f(s):\n    def g(s):\n        pass": "function inside another",
    "def f(s):\n    for i in s.k:\n        pass": "loop over something else",
    "def f(s):\n    for i in s.k(2):\n        pass": "loop over something else",
    "def f(s):\n    for i in fabs(2):\n        pass": "loop over something else",
    "def f(s):\n    for i in range(2):\n        pass\n    else:\n        pass": "loop over something else",
    "def f(s):\n    for i in range(s.k):\n        pass": "without a bound",
    "def f(s):\n    open(1)": "call of open",
    "def f(s):\n    f(s)": "call of f",
    "def f(s):\n    s.k = 1\n    open(1)": "call of open",
    "def f(s):\n    open(1)\n    s.k = 1": "call of open",
    "def f(s):\n    fabs(1.0, 2.0)": "call of fabs",
    "def f(s):\n    s.k(1)": "call of something",
    "def f(s):\n    s.place = s.place * 30000000": "place as a whole",
    "def f(s):\n    s.r += s.r": "r as a whole",
    "def f(s):\n    s.y[0] = s.x": "x as a whole",
    "def f(s):\n    s.k[0] = 1": "k as a whole, or with an entry of a number",
    "def f(s):\n    s.n = 100000": "changes the size n",
    "def f(s):\n    s.k = s.x[0:1]": "construct Slice",
    "def f(s):\n    s.k = s.x[0, 0]": "construct Tuple",
    "def f(s):\n    s.y[0] = s.x[0][0]": "entry of something else than an array",
    "def f(s):\n    s.y[0] = s[0]": "entry of something else than an array",
}


@pytest.mark.parametrize("source", list(REFUSED))
def test_any_other_text_is_refused(source: str) -> None:
    with pytest.raises(ValueError, match=f"a procedure .*{REFUSED[source]}"):
        evaluator(source, SIZES, MEMORY, PORTS)


@pytest.mark.parametrize("names", [["_k"], ["a b"], ["k", "__class__"], ["__dict__", "k"]])
def test_arrays_have_plain_names(names: list[str]) -> None:
    memory = [(name, "whole", 0) for name in names]
    with pytest.raises(ValueError, match="an array of a wrong name"):
        evaluator("def f(s):\n    pass", {}, memory, ([], []))


def test_an_evaluation_ends_at_its_bounds() -> None:
    with pytest.raises(ValueError, match="more iterations than declared"):
        run("for i in within(0, 4, s.m):\n        pass")
    with pytest.raises(ValueError, match="too large"):
        run("s.k = 3\n    for i in range(6):\n        s.k = s.k * s.k")


def test_a_long_loop_looks_at_the_clock() -> None:
    with pytest.raises(Rejected, match="processor time"), patient(0.001):
        run("for i in range(1000000):\n        s.k += s.k + 1")


INDICES = (
    "-1",
    "s.k - 1",
    "s.place[0] - 1",
    "i - 1",
    "s.place[-1]",
    "s.place[i - 1] + 1",
    "-(1 - i) * 2 - 1",
    "0 - s.n",
)


@pytest.mark.parametrize("index", INDICES)
@pytest.mark.parametrize(
    "statement", ["s.y[0] = s.x[{}]", "s.y[{}] = 1.0", "s.y[{}] += 1.0", "s.place[s.place[{}]] = 1"]
)
def test_an_index_before_the_first_entry_is_refused(index: str, statement: str) -> None:
    body = f"for i in range(s.n):\n        {statement.format(index)}"
    with pytest.raises(ValueError, match="negative index"):
        run(body)


@pytest.mark.parametrize("index", ["2", "s.m", "i + 1", "s.place[i] + s.n"])
@pytest.mark.parametrize("statement", ["s.y[0] = s.x[{}]", "s.y[{}] = 1.0"])
def test_an_index_behind_the_last_entry_is_refused(index: str, statement: str) -> None:
    with pytest.raises(IndexError):
        run(f"for i in range(s.n):\n        {statement.format(index)}")


def test_an_index_may_be_an_entry_itself() -> None:
    body = "s.place[0] = 1\n    s.y[s.place[s.place[1]]] = s.x[s.place[0] - s.place[0]]\n    s.y[s.place[1]] = 7.0"
    assert run(body, [3.0, 4.0]) == [[7.0, 3.0]]
