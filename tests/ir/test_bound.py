"""The bound on the operations of a procedure: exact where each loop runs to its end, and its statements are checked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from surctl.ir import replay
from surctl.ir.bound import spending
from surctl.ir.procedure import Procedure, anew, back, fabs, once, seldom, source_of, within


class Memory:
    n: int
    budget: int
    spent: int
    x: list[float]
    first: list[int]
    kind: list[int]
    total: list[float]


def arrange(s: Memory) -> None:
    s.first[0] = 0
    s.first[1] = 1
    s.first[2] = 4
    s.kind[0] = 0
    s.kind[1] = 1


def add(s: Memory, lo: int, hi: int) -> None:
    """Add the entries lo … hi."""
    assert hi - lo <= s.n
    for i in within(lo, hi, s.n):
        s.total[0] += s.x[i]


def groups(s: Memory) -> None:
    """Add 1 + 3 entries of the groups, the second kind twice."""
    arrange(s)
    s.total[0] = 0.0
    for group in range(2):
        add(s, s.first[group], s.first[group + 1])
        if s.kind[group] != 0:
            add(s, s.first[group], s.first[group + 1])


def triangle(s: Memory) -> None:
    """Add n (n + 1) / 2 entries."""
    s.total[0] = 0.0
    for i in back(0, s.n, s.n):
        for j in within(i, s.n, s.n):
            s.total[0] += s.x[j]


def rarely(s: Memory) -> None:
    """Add one entry, of n + 1."""
    s.total[0] = 0.0
    for i in range(s.n):
        if i == 2 and seldom(1):
            s.total[0] += s.x[i]


def shared(s: Memory) -> None:
    """Add the tail of each entry once, in two loops that share the entries."""
    anew()
    s.total[0] = 0.0
    stop = 1 if fabs(s.x[0]) > 0.5 else 2
    assert stop <= s.n
    for i in within(0, stop, s.n):
        once(i, s.n)
        for j in within(i, s.n, s.n):
            s.total[0] += s.x[j]
    for i in within(stop, s.n, s.n):
        once(i, s.n)
        for j in within(i, s.n, s.n):
            s.total[0] += s.x[j]


def early(s: Memory) -> None:
    """Add two entries, or one and return."""
    s.total[0] = 0.0
    if s.x[0] > 0.0:
        s.total[0] += s.x[0]
        return
    s.total[0] += s.x[1]
    s.total[0] += s.x[2]


def halves(s: Memory) -> None:
    """Add n entries in two loops."""
    s.total[0] = 0.0
    stop = 1 if s.x[0] > 0.5 else 2
    assert stop in range(s.n + 1)
    for i in within(0, stop, s.n):
        s.total[0] += s.x[i]
    for i in within(stop, s.n, s.n):
        s.total[0] += s.x[i]


def positive(s: Memory, i: int) -> int:
    """Return 1 for a positive entry; add another one and return 0."""
    if s.x[i] > 0.0:
        return 1
    s.total[0] += s.x[i]
    return 0


def either(s: Memory) -> None:
    """Add two entries if the first is positive."""
    s.total[0] = 0.0
    found = positive(s, 0)
    if found > 0:
        s.total[0] += s.x[1]
        s.total[0] += s.x[2]


def each(s: Memory) -> None:
    """Add each entry once, in three turns."""
    s.total[0] = 0.0
    for turn in range(3):
        for i in range(s.n):
            if turn == 0 and seldom(1, i):
                s.total[0] += s.x[i]


def limited(s: Memory) -> None:
    """Add entries, two in each turn, until the budget is used; then one more."""
    s.total[0] = 0.0
    for i in range(s.n):
        if s.spent > s.budget:
            break
        for j in within(i, i + 2, 2):
            s.total[0] += s.x[j]
    if s.spent > s.budget:
        s.total[0] -= s.x[0]
        return
    s.total[0] = s.total[0] + s.x[0] + s.x[0]


def of(*functions: Callable[..., Any]) -> Procedure:
    return Procedure.of(
        "sums", functions, inputs=(("x", 4),), outputs=(("total", 1),), sizes={"n": 4}, reals={},
        wholes={"first": 3, "kind": 2},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("functions", "most"),
    [
        ((arrange, add, groups), 2 + 1 + 3 + 3),
        ((triangle,), 10),
        ((rarely,), 4 + 1),
        ((shared,), 10 + 2),
        ((early,), 1 + 2),
        ((halves,), 1 + 4),
        ((positive, either), 1 + 1 + 2),
        ((each,), 3 * 4 + 4),
    ],
)
def test_the_bound_is_what_a_run_may_need(functions: tuple[Callable[..., Any], ...], most: int) -> None:
    procedure = of(*functions)
    assert procedure.operations == most
    assert not any(word in procedure.text() for word in ("assert", "seldom", "once", "anew"))
    assert replay(procedure, [1.0, 2.0, 3.0, 4.0])[0][0] > 0.0


@pytest.mark.parametrize(("budget", "total"), [(1, 2.0), (2, 7.0), (5, 10.0)])
def test_a_budget_ends_a_run_and_bounds_it(budget: int, total: float) -> None:
    procedure = Procedure.of(
        "sums", [spending(source_of(limited))], inputs=(("x", 4),), outputs=(("total", 1),),
        sizes={"n": 2, "budget": budget}, reals={}, wholes={"spent": 0},
    )  # fmt: skip
    assert procedure.operations == budget + 3
    assert replay(procedure, [1.0, 2.0, 3.0, 4.0])[0][0] == total


def test_statements_that_do_not_hold_are_errors() -> None:
    def wrong(*functions: Callable[..., Any], old: str, new: str) -> Procedure:
        bounded = of(*functions).bounded
        assert old in bounded
        return Procedure.of(
            "sums", [bounded.replace(old, new)], inputs=(("x", 4),), outputs=(("total", 1),), sizes={"n": 4},
            reals={}, wholes={"first": 3, "kind": 2},
        )  # fmt: skip

    for functions, old, new, error in (
        ((arrange, add, groups), "hi - lo <= s.n", "hi - lo <= 2", AssertionError),
        ((rarely,), "i == 2 and", "i >= 2 and", IndexError),
        ((shared,), "within(stop, s.n, s.n)", "within(stop - 1, s.n, s.n)", IndexError),
        ((shared,), "once(i, s.n)", "once(i, s.n - 1)", IndexError),
        ((halves,), "range(s.n + 1)", "range(1)", AssertionError),
        ((each,), "turn == 0", "turn <= 1", IndexError),
    ):
        with pytest.raises(error):
            replay(wrong(*functions, old=old, new=new), [1.0, 2.0, 3.0, 4.0])
