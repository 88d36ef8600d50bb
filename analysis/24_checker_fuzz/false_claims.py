"""False claims, each with evidence that would suffice if it were true, and a point at which it is false."""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from mpmath import mp, mpf

from surctl.certcheck import seal

DIGITS = 90
Box = dict[str, tuple[float, float]]


@dataclass(frozen=True)
class Forged:
    """A certificate, and where its claim is false by how much (60 digits and more); `twin` is a true one like it."""

    kind: str
    document: dict[str, Any]
    excess: Any
    twin: dict[str, Any] | None = None


def worth(text: str, at: dict[str, Any]) -> Any:
    """Return the value of an expression at a point, with every number taken as the exact decimal."""
    names: dict[str, Any] = {
        "sin": mp.sin, "cos": mp.cos, "acos": mp.acos, "atan": mp.atan, "atan2": mp.atan2, "sqrt": mp.sqrt,
        "tan": mp.tan, "asin": mp.asin, "exp": mp.exp, "log": mp.log, "sinh": mp.sinh, "cosh": mp.cosh, "tanh": mp.tanh,
        "abs": abs, "min": min, "max": max, "select": lambda a, b, x, y: x if a <= b else y, "pi": mp.pi, "mpf": mpf,
    }  # fmt: skip
    exact = re.sub(r"(?<![\w.])(\d+\.?\d*(?:e[-+]?\d+)?)", r"mpf('\1')", text).replace("^", "**")
    exact = re.sub(r"\*\*mpf\('(\d+)'\)", r"**\1", exact)
    return mpf(eval(exact, {"__builtins__": {}}, names | at))


def sealed(
    left: str,
    right: str,
    box: Box,
    *,
    cases: Sequence[dict[str, Any]] = (),
    constraints: Sequence[str] = (),
    **case: Any,
) -> dict[str, Any]:
    """Return a certificate of kind interval, by default with the expression as its only case."""
    variables = [{"name": n, "unit": "1", "lower": low, "upper": high} for n, (low, high) in box.items()]
    claim = {
        "name": "forged", "statement": "", "unit": "1", "left": left, "right": right,
        "constraints": list(constraints), "slack": 0.0, "variables": variables,
    }  # fmt: skip
    margin = f"({left}) - ({right})"
    for name, (low, high) in box.items():  # a variable of zero width equals its decimal
        margin = re.sub(rf"\b{re.escape(name)}\b", f"({low!r})", margin) if low == high else margin
    plain = {
        "choice": "", "numerator": margin, "denominators": [],
        "multipliers": ["0"] * len(constraints), "tree": "n", "points": [],
    }  # fmt: skip
    return seal("interval", claim, {"cases": [plain | one for one in (cases or [case])]})


def forged(kind: str, left: str, right: str, box: Box, at: dict[str, Any], twin: str = "", **rest: Any) -> Forged:
    """Return the certificate after checking that its claim is false at the point; ValueError otherwise."""
    excess = worth(left, at) - worth(right, at)
    inside = all(mpf(repr(low)) <= at[n] <= mpf(repr(high)) for n, (low, high) in box.items())
    if not (excess > 0 and inside and all(worth(c, at) <= 0 for c in rest.get("constraints", ()))):
        raise ValueError(f"{left} <= {right} is no false claim at {at}")
    true = sealed(left, twin, box, **rest) if twin else None
    return Forged(kind, sealed(left, right, box, **rest), excess, true)


def decimal(value: Any) -> str:
    """Return a number as text of the grammar; negative numbers are in parentheses."""
    text = mp.nstr(value, 70, min_fixed=-30, max_fixed=60, strip_zeros=True)
    return f"({text})" if value < 0 else text


def short_of(value: Any, draw: random.Random) -> tuple[str, str]:
    """Return a bound slightly below the value (22nd digit, an ulp, or up to 1e-6 of it), and a bound safely above."""
    size = max(abs(value), mpf(10) ** -6)
    share = draw.choice([mpf(10) ** -draw.uniform(6, 16), mpf(2) ** -draw.randint(52, 54), mpf(10) ** -22])
    return decimal(value - size * share), decimal(value + size * mpf(10) ** -11)


def tree(rule: str, dimensions: int, draw: random.Random, depth: int) -> str:
    """Return a tree that bisects a box at random, with every part decided by the rule."""
    if depth == 0 or draw.random() < 0.3:
        return rule
    at = str(draw.randrange(dimensions))
    return at + tree(rule, dimensions, draw, depth - 1) + tree(rule, dimensions, draw, depth - 1)


def ends(draw: random.Random, low: float, high: float) -> tuple[float, float]:
    """Return an interval within [low, high] whose ends are decimals of few digits or any doubles."""
    a, b = sorted(draw.uniform(low, high) for _ in range(2))
    if draw.random() < 0.5:
        a, b = round(a, 3), round(b, 3)
    return (a, b) if low <= a < b <= high else (low, high)


_MONOTONE: tuple[tuple[str, tuple[float, float], int], ...] = (
    ("sin(x)", (-1.5, 1.5), 1), ("cos(x)", (0.01, 3.1), 0), ("acos(x)", (-1.0, 1.0), 0), ("atan(x)", (-9.0, 9.0), 1),
    ("sqrt(x)", (1e-9, 40.0), 1), ("x^3", (-3.0, 3.0), 1), ("x^7 + x/3", (-2.0, 2.0), 1), ("1/x", (0.01, 7.0), 0),
    ("x - 1/x", (-9.0, -0.1), 1), ("atan2(x, 0.7)", (-3.0, 3.0), 1), ("atan2(1, x)", (-3.0, 3.0), 0),
    ("atan2(0.3, x)", (-3.0, -0.1), 0), ("x*sqrt(x) - pi", (0.1, 9.0), 1), ("-acos(x/3)*2", (-3.0, 3.0), 1),
    ("sin(x + 40*pi)", (-1.2, 1.2), 1), ("max(x, 2*x)", (0.1, 3.0), 1), ("select(x, 9, x, 0)", (-3.0, 3.0), 1),
    ("exp(x)", (-9.0, 9.0), 1), ("log(x)", (1e-9, 9.0), 1), ("tanh(x)", (-3.0, 3.0), 1), ("tan(x)", (-1.5, 1.5), 1),
    ("asin(x)", (-1.0, 1.0), 1), ("sinh(x)", (-3.0, 3.0), 1), ("cosh(x)", (0.01, 3.0), 1), ("x^0.7", (1e-9, 9.0), 1),
    ("x^-1.5", (0.1, 9.0), 0), ("x^(2/3) + tan(x/9)", (0.0, 9.0), 1), ("exp(-exp(x))", (-3.0, 1.5), 0),
)  # fmt: skip


def monotone(draw: random.Random) -> Forged:
    """Claim a bound just below the value at the end where it is largest, or at a fixed number."""
    text, (low, high), up = draw.choice(_MONOTONE)
    side = ends(draw, low, high)
    if draw.random() < 0.3:
        side = side[up], side[up]
    at = {"x": mpf(repr(side[up]))}
    bound, twin = short_of(worth(text, at), draw)
    # acos and sqrt have no derivative at the end of their domain: there the value decides
    rule = "n" if side[0] == side[1] else draw.choice("nm")
    return forged("bound", text, bound, {"x": side}, at, twin, tree=tree(rule, 1, draw, 4))


def concave(draw: random.Random) -> Forged:
    """Claim a bound just below a maximum, with a tangent at the maximum as evidence."""
    p, q = round(draw.uniform(-1, 1), 3), round(draw.uniform(-1, 1), 3)
    a, b = round(draw.uniform(0.1, 3), 3), round(draw.uniform(0.1, 3), 3)
    u = f"(x - ({p}))"
    hill = draw.choice(
        [f"2 - {u}^2", f"{u} - exp({u})", f"2 - cosh({u})", f"log(2 + {u}) - {u}/2", f"(2 - {u}^2)^0.75"]
    )
    text = f"{a}*({hill}) + cos(y - ({q}))*{b}"
    at = {"x": mpf(repr(p)), "y": mpf(repr(q))}
    bound, twin = short_of(worth(text, at), draw)
    box = {"x": (p - 0.5, p + 0.75), "y": (q - 0.5, q + 0.75)}
    return forged("top", text, bound, box, at, twin, tree="c", points=[[p, q]])


def overflow(draw: random.Random) -> Forged:
    """Claim on boxes at the ends of the range of doubles, where the sum of two ends overflows, and at its smallest
    numbers.
    """
    top = 1.7976931348623157e308
    low, high = sorted(draw.uniform(0.45, 0.99) * top for _ in range(2))
    if draw.random() < 0.3:
        low, high = draw.choice([(5e-324, 1e-323), (0.0, 5e-324), (5e-324, 2.5e-320), (-5e-324, 5e-324)])
    sign = draw.choice([1, -1])
    box = {"x": tuple(sorted((sign * low, sign * high)))}
    at = {"x": mpf(repr(draw.choice(box["x"])))}
    far = repr(draw.choice([math.nextafter(high, top), max(high, 1.78e308), top]))
    text = draw.choice([f"select(abs(x), {far}, 1, -1)", f"2 - max(abs(x)/{far}, 1)", "1 + abs(x - x)", "x/x"])
    if text == "x/x" and min(map(abs, box["x"])) == 0:
        text = "1 + x - x"
    rules = {"tree": tree(draw.choice("nm"), 1, draw, 3)}
    if draw.random() < 0.5:  # a constraint that holds, marked as violated
        told = f"select({'-' if sign < 0 else ''}x, {far}, -1, 1)"
        rules = {"constraints": [told], "tree": tree(draw.choice("ij"), 1, draw, 3)}
    return forged("overflow", text, "0.5", box, at, **rules)


def shadowed(draw: random.Random) -> Forged:
    """Claim with a variable whose name is that of a number or function, or has look-alike characters."""
    name = draw.choice(
        [
            "pi",
            "sin",
            "select",
            "sqrt",
            "abs",
            "atan2",
            "exp",
            "tan",
            "х",
            "x٣",
            "x³",
            "ｘ",
            "x y",
            "x\r",
            "1x",
            "_",
            "",
        ]
    )
    high = draw.uniform(4, 9)
    certificate = sealed(name or "x", "3.2", {name: (0.0, high)}, tree=draw.choice("nm"))
    return Forged("name", certificate, mpf(high) - mpf("3.2"))


def holed(draw: random.Random) -> Forged:
    """Claim that is false on a small part of the box, which the tree omits, excludes, or loses by bisection."""
    c = draw.uniform(0.2, 0.9)
    width = 10 ** -draw.uniform(1, 6)
    text, at = f"1 - ((x - {c!r})/{width!r})^2", {"x": mpf(repr(c))}
    bound, _ = short_of(mpf(1), draw)
    whole, low, high = "", 0.0, 1.0
    for _ in range(40):  # bisect down to the part where the claim is false
        middle = (low + high) / 2
        whole, low, high = (whole + "0", low, middle) if c < middle else (whole + "0n", middle, high)
        if high - low < width / 40:
            break
    # the right part of each chosen half follows later
    rest = "n" * (2 * whole.count("0") + 1 - len(whole) - 1)
    last = draw.choice(["", "i", "j", "m", "n", "0nn", "00nnn", "1nn", "c"])
    return forged(
        "hole", text, bound, {"x": (0.0, 1.0)}, at, tree=whole + last + rest, points=[[c]] if last == "c" else [],
        constraints=["x - 2"],
    )  # fmt: skip


def read_wrongly(draw: random.Random) -> Forged:
    """Claim with a number whose decimal and double differ, or with ends that form no interval."""
    while True:
        d = round(draw.uniform(0.01, 9), draw.randint(1, 6))
        off = mpf(d) - mpf(repr(d))
        if off > 0:
            break
    eps, at = decimal(off * mpf(draw.choice([0.1, 0.5, 0.9, 1]))), {"x": mpf(repr(d))}
    high = draw.choice([d, d + 1, math.nextafter(d, 9e9)])
    wrong = forged("end", eps, f"x - {d!r}", {"x": (d, high)}, at, tree=draw.choice("nm"))
    if draw.random() < 0.5:
        return wrong
    big = 2**53 + 2 * draw.randrange(2**20) + 1
    box: Any = {"x": (0, big)}
    return Forged("end", sealed("x", f"{big - 1}", box, tree=draw.choice("nm")), mpf(1))


def by_cases(draw: random.Random) -> Forged:
    """Claim with missing, duplicated or wrong cases, or with multipliers and denominators of the wrong sign."""
    c = round(draw.uniform(0.1, 2), 3)
    side, at = {"x": (-c, c)}, {"x": mpf(repr(c))}
    bound, _ = short_of(mpf(repr(c)), draw)
    good = {"multipliers": ["0"], "tree": "m"}
    first, second = (good | {"choice": k, "numerator": f"{s}x - {bound}"} for k, s in (("0", ""), ("1", "-")))
    bad = draw.choice([
        [first, second], [second], [first, first], [second, first | {"numerator": second["numerator"]}],
        [first | {"tree": "i"}, second], [first | {"tree": "j"}, second], [first | {"multipliers": ["-1"]}, second],
        [first | {"denominators": ["-1"], "numerator": f"{bound} - x"}, second], [first | {"choice": ""}],
        [first | {"numerator": f"0.9999999*x - {bound}"}, second], [first | {"multipliers": ["x"], "numerator": "0"}],
    ])  # fmt: skip
    return forged("case", "abs(x)", bound, side, at, cases=bad)


def rewritten(draw: random.Random) -> Forged:
    """Claim whose numerator equals the margin except for a coefficient, the branch of a root, or a quarter turn."""
    wrong = repr(1 - 10 ** -draw.uniform(6, 15))
    left, numerator, box, at = draw.choice([
        ("x*y", f"{wrong}*x*y - 0.25", {"x": (0.0, 0.5), "y": (0.0, 0.5)}, {"x": mpf("0.5"), "y": mpf("0.5")}),
        ("sqrt(x^2)", "x - 0.25", {"x": (-0.5, 0.25)}, {"x": mpf("-0.5")}),
        ("acos(cos(x))", "x - 0.25", {"x": (-0.5, 0.25)}, {"x": mpf("-0.5")}),
        ("sin(x)^2", "0.75 - cos(x)^2 - 0.0000001", {"x": (0.6, 0.7)}, {"x": mpf("0.7")}),
        ("atan2(x, -1)", "atan2(-x, 1) - 0.25", {"x": (0.5, 0.7)}, {"x": mpf("0.6")}),
        ("cos(x/2)", "cos(x/3) - 1", {"x": (1.0, 2.0)}, {"x": mpf(1)}),
        ("x^1.5", "x^(13/9) - 0.5", {"x": (0.25, 0.5)}, {"x": mpf("0.5")}),
        ("exp(x)", f"exp({wrong}*x) - 3", {"x": (0.5, 1.0)}, {"x": mpf(1)}),
        ("log(x^2)", "2*log(x) - 1", {"x": (0.5, 1.5)}, {"x": mpf("1.5")}),
        ("asin(sin(x))", "x - 4", {"x": (1.0, 3.0)}, {"x": mpf("1.5")}),
    ])  # fmt: skip
    right = decimal(worth(left, at) * (1 - mpf(10) ** -draw.uniform(7, 20)))
    return forged("rewriting", left, right, box, at, numerator=numerator, tree="n")


KINDS: tuple[Callable[[random.Random], Forged], ...] = (
    monotone, concave, overflow, shadowed, holed, read_wrongly, by_cases, rewritten,
)  # fmt: skip


def false_claims(count: int, seed: int = 0) -> Iterator[Forged]:
    """Yield the given number of false claims, of every kind in turn, half of them bounds."""
    draw = random.Random(seed)
    for k in range(count):
        with mp.workdps(DIGITS):
            make = monotone if k % 3 == 0 else KINDS[(k - k // 3 - 1) % len(KINDS)]
            yield make(draw)
