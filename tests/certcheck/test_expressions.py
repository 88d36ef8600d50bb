"""The grammar of expressions, text by text, and the limits of a table."""

from __future__ import annotations

import re
from fractions import Fraction

import pytest

from surctl.certcheck import patience
from surctl.certcheck.document import Rejected
from surctl.certcheck.expressions import Entry, ExpressionTable


def entries(text: str) -> list[Entry]:
    table = ExpressionTable(["x", "y"])
    table.read(text)
    return table.entries


X, Y = Entry("var", (), Fraction(0)), Entry("var", (), Fraction(1))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x^2", [X, Entry("pow", (0,), Fraction(2))]),
        ("x^-2", [X, Entry("pow", (0,), Fraction(-2))]),
        ("x^(3)", [X, Entry("pow", (0,), Fraction(3))]),
        ("x^(1/2)", [X, Entry("powr", (0,), Fraction(1, 2))]),
        ("x^(-1/2)", [X, Entry("powr", (0,), Fraction(-1, 2))]),
        ("x^0.5 + y", [X, Entry("powr", (0,), Fraction(1, 2)), Y, Entry("add", (1, 2))]),
        ("atan2(y, x)", [Y, X, Entry("atan2", (0, 1))]),
        ("select(x, y, x, y)", [X, Y, Entry("select", (0, 1, 0, 1))]),
        ("(x)*-y", [X, Y, Entry("neg", (1,)), Entry("mul", (0, 2))]),
        ("pi", [Entry("pi")]),
        ("-2.5e1", [Entry("num", (), Fraction(25)), Entry("num", (), Fraction(-25))]),
    ],
)
def test_an_expression_is_read(text: str, expected: list[Entry]) -> None:
    assert entries(text) == expected


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x $ y", "cannot be read at column 2: ' $ y'"),
        (3, "is not a text of at most 60000 characters"),
        (["x"], "is not a text of at most 60000 characters"),
        ("1" * 60_001, "is not a text of at most 60000 characters"),
        ("x y", "cannot be read at 'y'"),
        ("x)", "cannot be read at ')'"),
        ("*x", "cannot be read at '*'"),
        ("", "cannot be read at ''"),
        ("(" * 200 + "x" + ")" * 200, "nested too deeply"),
        ("x^2^3", "a power of a power needs parentheses"),
        ("x^(1/0)", "the denominator of an exponent is 0"),
        ("x^(1/2", "a parenthesis is not closed"),
        ("x^65", "65 is not an exponent"),
        ("x^(129/2)", "129/2 is not an exponent"),
        ("x^y", "'y' is not an exponent"),
        ("x^0." + "0" * 40 + "1", "is not an exponent"),
        ("sin(x, y)", "no function 'sin' with 2 arguments"),
        ("atan2(x)", "no function 'atan2' with 1 arguments"),
        ("f(x)", "no function 'f' with 1 arguments"),
        ("z", "'z' is not one of the claim's variables"),
        ("(x", "a parenthesis is not closed"),
        ("sin(x", "a parenthesis is not closed"),
        ("sin(x y)", "a parenthesis is not closed"),
    ],
)
def test_what_is_no_expression_is_named(text: object, says: str) -> None:
    with pytest.raises(Rejected, match=re.escape(says)):
        ExpressionTable(["x", "y"]).read(text)


@pytest.mark.parametrize(
    ("text", "total"),
    [("x + y*pi - 3", True), ("x/2", True), ("x/0", False), ("1/y", False), ("2*(1/y)", False), ("x^2", True),
     ("x^-2", False), ("sqrt(x)", False), ("x", True)],
)  # fmt: skip
def test_an_expression_is_total_if_each_operation_is(text: str, total: bool) -> None:
    table = ExpressionTable(["x", "y"])
    assert table.total([table.read(text)]) == total


def test_a_table_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    table = ExpressionTable(["x"])
    chain = [table.read("x")]
    for _ in range(1000):
        chain.append(table.put("add", chain[-1], chain[0]))
    for at in chain[800:]:
        assert len(table.needed([at])) == at + 1
    assert sum(map(len, table._live.values())) <= 100_000
    for k in range(50_000 - len(table.entries)):
        table.put("num", value=k)
    with pytest.raises(Rejected, match="more than 50000 operations"):
        table.put("num", value=-1)
    monkeypatch.setattr(patience, "MEMORY", 10_000)
    with patience.patient(9.0):
        small = ExpressionTable(["x"])
        with pytest.raises(Rejected, match="memory"):
            for k in range(30):
                small.put("num", value=k)
