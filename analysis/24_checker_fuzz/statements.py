"""Study 24, third part: false statements near the truth, and true ones like them, decided as by `surctl verify`.

    python analysis/24_checker_fuzz/statements.py             # 400 of each, about 10 minutes of processor time
    python analysis/24_checker_fuzz/statements.py --quick     # 18 of each

The exit status is 1 if a false statement is proved, a true one refuted, or fewer than 90 % of the false ones refuted
with a point that the evaluation of this file (mpmath with 90 digits, fractions) confirms.
"""

from __future__ import annotations

import argparse
import math
import random
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from mpmath import mp, mpf

sys.path.insert(0, str(Path(__file__).parent))
from false_claims import _MONOTONE, DIGITS, decimal, worth

At = Mapping[str, float]
SECONDS = 1.0  # processor time for the proof of a true statement


@dataclass(frozen=True)
class Drawn:
    """A false statement and a true neighbour as files, and whether a point refutes the false one."""

    false: str
    true: str
    fails: Callable[[At], bool]


def exact(at: At) -> dict[str, Any]:
    """Return the decimals of a point."""
    return {name: mpf(repr(value)) for name, value in at.items()}


def claim(left: str, right: str, box: Mapping[str, tuple[float, float]]) -> str:
    """Return a claim file."""
    rows = "".join(f"{name} = {{ lower = {low!r}, upper = {high!r} }}\n" for name, (low, high) in box.items())
    return f'kind = "claim"\nname = "drawn"\nleft = "{left}"\nright = "{right}"\n[variables]\n{rows}'


def exceeds(left: str, right: str, box: Mapping[str, tuple[float, float]], at: At) -> bool:
    """Return whether left exceeds right at a point of the box."""
    inside = all(mpf(repr(low)) <= exact(at)[n] <= mpf(repr(high)) for n, (low, high) in box.items())
    try:  # decimals in binary numbers are not exactly equal where they should be
        names = {name: Fraction(repr(value)) for name, value in at.items()}
        return inside and fraction(left, names) > fraction(right, names)
    except NameError:
        return bool(inside and worth(left, exact(at)) - worth(right, exact(at)) > 0)


def fraction(text: str, at: Mapping[str, Fraction]) -> Fraction:
    """Return the value of an expression of + - * / and select as a fraction; NameError if it has other functions."""
    numbers = re.sub(r"(?<![\w.])(\d+\.?\d*(?:e[-+]?\d+)?)", r"Fraction('\1')", text)
    known = {"select": lambda a, b, x, y: x if a <= b else y, "Fraction": Fraction, **at}
    if "^" in text:
        raise NameError("^")
    return Fraction(eval(numbers, {"__builtins__": {}}, known))


def pair(left: str, right: str, true: str, box: Mapping[str, tuple[float, float]]) -> Drawn:
    """Return claims with the same left side."""
    return Drawn(claim(left, right, box), claim(left, true, box), partial(exceeds, left, right, box))


def constant(draw: random.Random) -> Drawn:
    """Compare with an expression that is exactly 0, which doubles miss."""
    a, b = (Fraction(draw.randint(1, 99), 10) for _ in range(2))
    big, root = 10 ** draw.randint(16, 25), draw.choice((2, 3, 5, 7))
    zero = draw.choice((
        f"{float(a)} + {float(b)} - {float(a + b)}", f"{float(a)}*{float(b)} - {float(a * b)}",
        f"{big} - 1 - {big} + 1", f"x + {big} - x - {big}", "sin(pi)", "cos(pi/2)", f"sqrt({root})^2 - {root}",
    ))  # fmt: skip
    tiny = f"1e-{draw.randint(12, 40)}"
    if draw.random() < 0.3:
        text = f"x*select({float(a)} + {float(b)}, {float(a + b)}, 1, 0.25)"
        return pair(text, f"{draw.choice(('0.5', '0.75', '0.999'))}*x", "x", {"x": (0.0, 1.0)})
    return pair(f"x*{tiny}", zero, f"{zero} + 2*{tiny}", {"x": (0.0, 1.0)})


def bound(draw: random.Random) -> Drawn:
    """Bound a function just below or above its largest value, which it has at an end of the box."""
    text, (low, high), up = draw.choice(_MONOTONE)
    top = worth(text, {"x": mpf(repr((low, high)[up]))})
    size = max(abs(top), mpf(1)) * mpf(10) ** -draw.uniform(5, 20)
    return pair(text, decimal(top - size), decimal(top + size + mpf(10) ** -9), {"x": (low, high)})


def undefined(draw: random.Random) -> Drawn:
    """Hide a point without a value in an inequality that holds wherever it is defined."""
    a, b = round(draw.uniform(-2, 2), draw.randint(0, 3)), round(draw.uniform(0.1, 2), 1)
    inside, outside = (a - b, a + b), (a + b / 2, a + b)
    x = f"(x - {a})" if a >= 0 else f"(x + {-a})"
    kind, left, right, gap = draw.choice((
        ("zero", f"{x}/{x}", "1", x), ("zero", f"0/{x}", "0", x), ("zero", f"0*{x}^-2", "0", x),
        ("closed", f"log({x}) - log({x})", "0", x), ("negative", f"sqrt({x})^2", x, x),
        ("negative", f"0*{x}^0.5", "0", x), ("negative", f"0*acos({x})", "0", f"1 - {x}^2"),
        ("zero", f"0*tan({x})", "0", f"cos({x})"), ("zero", f"0/({x}^2 - 2)", "0", f"{x}^2 - 2"),
        ("zero", f"0*atan2({x}, 0*x)", "0", x), ("zero", f"min(0, 1/(1/{x}))", "0", x),
    ))  # fmt: skip
    if "acos" in left:
        inside, outside = (a - 1 - b / 1000, a + 0.5), (a - 0.9, a + 0.9)
    elif "cos" in gap or "^2 - 2" in gap:
        inside, outside = (a, a + 2), (a, a + 1)
    ends = [{"x": (round(low, 6), round(high, 6))} for low, high in (inside, outside)]

    def fails(at: At) -> bool:
        (low, high), value = ends[0]["x"], at["x"]
        near = [worth(gap, {"x": mpf(repr(y))}) for y in beside(value) if low <= y <= high]
        own = worth(gap, exact(at))
        if not low <= value <= high:
            return False
        if kind == "zero":
            return bool(abs(own) < mpf(10) ** -70 or any(p * q < 0 for p, q in pairwise(near)))
        return bool(own < 0 or (kind == "closed" and own == 0))

    return Drawn(claim(left, right, ends[0]), claim(left, right, ends[1]), fails)


def beside(value: float) -> list[float]:
    """Return a double with its neighbours, in order."""
    below, above = math.nextafter(value, -math.inf), math.nextafter(value, math.inf)
    return [math.nextafter(below, -math.inf), below, value, above, math.nextafter(above, math.inf)]


def stability(rates: Mapping[str, str], box: float, **entries: Any) -> str:
    """Return a file of kind lyapunov about 0."""
    lines = [
        f"{key} = {value!r}" if isinstance(value, float) else f'{key} = "{value}"' for key, value in entries.items()
    ]
    states = [f'{n} = {{ rate = "{rate}", lower = {-box!r}, upper = {box!r} }}' for n, rate in rates.items()]
    return "\n".join(['kind = "lyapunov"', 'name = "drawn"', *lines, "[states]", *states, ""])


@dataclass(frozen=True)
class Linear:
    """A stable linear loop with fractions, and V = p x² + q x y + r y²."""

    a: tuple[tuple[Fraction, Fraction], tuple[Fraction, Fraction]]
    v: tuple[Fraction, Fraction, Fraction]

    @property
    def rates(self) -> dict[str, str]:
        """The rates as texts."""
        return {n: f"{float(row[0])!r}*x + {float(row[1])!r}*y" for n, row in zip("xy", self.a, strict=True)}

    @property
    def text(self) -> str:
        """V as text."""
        p, q, r = map(float, self.v)
        return f"{p!r}*x^2 + {q!r}*x*y + {r!r}*y^2"

    def excess(self, at: At, rate: Fraction = Fraction(0)) -> Fraction:
        """Return V' + rate V at a point, exactly."""
        x, y = Fraction(repr(at["x"])), Fraction(repr(at["y"]))
        (a, b), (c, d) = self.a
        p, q, r = self.v
        change = (2 * p * x + q * y) * (a * x + b * y) + (q * x + 2 * r * y) * (c * x + d * y)
        return change + rate * (p * x * x + q * x * y + r * y * y)

    def fastest(self) -> float:
        """Return the largest rate of V, in doubles."""
        a, (p, q, r) = np.array(self.a, dtype=float), map(float, self.v)
        m = np.array([[p, q / 2], [q / 2, r]])
        return float(-np.linalg.eigvals(np.linalg.solve(m, a.T @ m + m @ a)).real.max())


def linear(draw: random.Random) -> Linear:
    """Draw a loop and a V that decreases clearly."""
    while True:
        numbers = [Fraction(draw.randint(-30, 30), 10) for _ in range(4)]
        a = (numbers[0], numbers[1]), (numbers[2], numbers[3])
        matrix = np.array(a, dtype=float)
        if np.linalg.eigvals(matrix).real.max() > -0.2:
            continue
        from scipy.linalg import solve_continuous_lyapunov

        m = solve_continuous_lyapunov(matrix.T, -np.diag([draw.uniform(0.5, 2), draw.uniform(0.5, 2)]))
        loop = Linear(a, tuple(Fraction(f"{z:.4f}") for z in (m[0, 0], 2 * m[0, 1], m[1, 1])))  # type: ignore[arg-type]
        if loop.fastest() > 0.05:
            return loop


def function(draw: random.Random) -> Drawn:
    """State a V that fails to decrease in a narrow cone, or the one from which it comes."""
    loop = linear(draw)
    while True:
        p, q, r = (z * Fraction(f"{1 + draw.uniform(-0.9, 3):.3f}") for z in loop.v)
        other = Linear(loop.a, (p, q, r))
        if 4 * p * r > q * q and -0.3 < other.fastest() < -1e-3:
            break
    level = {"level": 0.01} if draw.random() < 0.5 else {}
    files = [stability(loop.rates, 1.0, function=one.text, **level) for one in (other, loop)]
    return Drawn(files[0], files[1], lambda at: other.excess(at) > 0)


def rate(draw: random.Random) -> Drawn:
    """State a rate slightly above or below the largest one of V."""
    loop, off = linear(draw), 10 ** -draw.uniform(1, 4)
    high, low = (float(f"{loop.fastest() * (1 + sign * off):.6g}") for sign in (1, -1))
    level = {"level": 0.01} if draw.random() < 0.5 else {}
    files = [stability(loop.rates, 1.0, function=loop.text, rate=one, **level) for one in (high, low)]
    return Drawn(files[0], files[1], lambda at: loop.excess(at, Fraction(repr(high))) > 0)


def level(draw: random.Random) -> Drawn:
    """State a level slightly above or below the one at which V' = 0."""
    c, k = Fraction(draw.randint(5, 20), 10), Fraction(draw.randint(2, 20), 10)
    rates = {"x": f"-{float(k)!r}*x*(1 - (x/{float(c)!r})^2)", "y": "-y + 0*x"}
    off = 10 ** -draw.uniform(2, 5)
    high, low = (float(f"{float(c * c) * (1 + sign * off):.8g}") for sign in (1, -1))
    files = [stability(rates, 3.0, function="x^2 + y^2", level=one) for one in (high, low)]

    def fails(at: At) -> bool:
        x, y = Fraction(repr(at["x"])), Fraction(repr(at["y"]))
        return (
            x * x + y * y < Fraction(repr(high))
            and -k * x * x * (1 - (x / c) ** 2) - y * y >= 0
            and (bool(x) or bool(y))
        )

    return Drawn(files[0], files[1], fails)


def region(draw: random.Random) -> Drawn:
    """State a level whose region leaves the box slightly, or stays in it."""
    box, turn = round(draw.uniform(0.5, 2), 2), round(draw.uniform(1, 3), 1)
    p = round(draw.uniform(0.5, 2), 2)
    rates = {"x": f"-0.1*x + {turn}*y", "y": f"-{turn}*{p}*x - 0.1*y"}
    least = min(p, 1.0) * box**2
    off = 10 ** -draw.uniform(2, 6)
    high, low = (float(f"{least * (1 + sign * off):.9g}") for sign in (1, -1))
    files = [stability(rates, box, function=f"{p}*x^2 + y^2", level=one) for one in (high, low)]

    def fails(at: At) -> bool:
        x, y, edge = (Fraction(repr(z)) for z in (at["x"], at["y"], box))
        return edge in (abs(x), abs(y)) and Fraction(repr(p)) * x * x + y * y < Fraction(repr(high))

    return Drawn(files[0], files[1], fails)


def barrier(draw: random.Random) -> Drawn:
    """State a barrier that is slightly inside the initial set, outside the unsafe set, or with a wrong multiplier."""
    c, k = round(draw.uniform(1, 2), 2), round(draw.uniform(0.5, 2), 2)
    off = 10 ** -draw.uniform(2, 6)
    start, bad, multiplier = round(c - 0.3, 2), round(c + 0.3, 2), -k
    which = draw.choice(("initial", "unsafe", "multiplier"))

    def text(start: float, bad: float, multiplier: float) -> str:
        return (
            f'kind = "barrier"\nname = "drawn"\nbarrier = "x - {c!r}"\nmultiplier = "{multiplier!r}"\n'
            f'initial = ["x <= {start!r}", "x >= 0"]\nunsafe = ["x >= {bad!r}"]\n'
            f'[states]\nx = {{ rate = "-{k!r}*x", lower = -3, upper = 3 }}\n'
        )

    wrong = {
        "initial": (c + off, bad, multiplier), "unsafe": (start, c - off, multiplier),
        "multiplier": (start, bad, -k * (3 / (3 - c)) * (1 + off)),
    }[which]  # fmt: skip

    def fails(at: At) -> bool:
        x = Fraction(repr(at["x"]))
        own = x - Fraction(repr(c))
        if which == "initial":
            return 0 <= x <= Fraction(repr(wrong[0])) and own > 0
        if which == "unsafe":
            return Fraction(repr(wrong[1])) <= x <= 3 and own <= 0
        return abs(x) <= 3 and -Fraction(repr(k)) * x > Fraction(repr(wrong[2])) * own

    return Drawn(text(*wrong), text(start, bad, multiplier), fails)


def gain(draw: random.Random) -> Drawn:
    """State a controller gain slightly too low or high enough for the rate of the loop, in a file with constants."""
    a, r = round(draw.uniform(0.5, 2), 2), round(draw.uniform(0.2, 2), 2)
    off = 10 ** -draw.uniform(2, 6)
    high, low = (float(f"{(a + r / 2) * (1 + sign * off):.9g}") for sign in (1, -1))

    def text(k: float) -> str:
        entries = {"function": "x^2", "level": 0.5, "rate": r}
        return stability({"x": f"{a!r}*x - k*x - x^3"}, 1.0, **entries).replace(
            "[states]", f"[constants]\nk = {k!r}\n[states]"
        )

    def fails(at: At) -> bool:
        x, k = Fraction(repr(at["x"])), Fraction(repr(low))
        change = 2 * x * ((Fraction(repr(a)) - k) * x - x**3)
        return x * x < Fraction(1, 2) and change + Fraction(repr(r)) * x * x > 0

    return Drawn(text(low), text(high), fails)


KINDS = (constant, bound, undefined, function, rate, level, region, barrier, gain)


def verdict_of(text: str, seconds: float) -> tuple[str, Mapping[str, float]]:
    """Return verdict and counterexample of a file, as `surctl verify` decides it."""
    from surctl.lyapunov import is_problem, load_problem, solve
    from surctl.verification import decide, load_claim

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.toml"
        path.write_text(text, encoding="utf-8")
        if is_problem(path):
            solution = solve(load_problem(path), time_limit=seconds)
            return solution.verdict, solution.counterexample
        verdict = decide(load_claim(path), time_limit=seconds)
        return verdict.verdict, {} if verdict.counterexample is None else verdict.counterexample.values


def judged(number: int, seed: int) -> tuple[str, str, bool, str, Drawn]:
    """Return kind, verdict on the false statement, whether its point is confirmed, and verdict on the true one."""
    mp.dps = DIGITS
    kind = KINDS[number % len(KINDS)]
    drawn = kind(random.Random(1_000_003 * seed + number))
    word, at = verdict_of(drawn.false, SECONDS)
    other, _ = verdict_of(drawn.true, SECONDS)
    return kind.__name__, word, word == "refuted" and bool(at) and drawn.fails(at), other, drawn


def main(words: Sequence[str] | None = None) -> int:
    """Run the study and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="18 of each")
    parser.add_argument("--count", type=int, default=400, metavar="N", help="false statements")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes")
    options = parser.parse_args(words)
    count = 2 * len(KINDS) if options.quick else options.count
    seen: dict[str, Counter[str]] = {kind.__name__: Counter() for kind in KINDS}
    one = partial(apart, seed=options.seed)
    with ProcessPoolExecutor(options.workers) as pool:
        for name, word, sure, other, texts in (pool.map if options.workers > 1 else map)(one, range(count)):
            seen[name].update(["drawn", f"false {word}", *(["confirmed"] if sure else []), f"true {other}"])
            if not sure or other == "refuted":
                print(
                    f"{name}: false {word}{'' if sure else ', not confirmed'}, true {other}\n{texts}", file=sys.stderr
                )
    total = sum(seen.values(), Counter[str]())
    columns = (
        "drawn",
        "false proved",
        "false refuted",
        "confirmed",
        "false unknown",
        "true proved",
        "true refuted",
        "true unknown",
    )
    print(f"| kind | {' | '.join(columns)} |\n|---{'|---' * len(columns)}|")
    for name, row in [*seen.items(), ("all", total)]:
        print(f"| {name} | {' | '.join(str(row[column]) for column in columns)} |")
    return int(bool(total["false proved"] or total["true refuted"]) or total["confirmed"] < 0.9 * total["drawn"])


def apart(number: int, seed: int) -> tuple[str, str, bool, str, str]:
    """Return `judged` without functions, which processes cannot exchange."""
    name, word, sure, other, drawn = judged(number, seed)
    return name, word, sure, other, f"{drawn.false}--\n{drawn.true}"


if __name__ == "__main__":
    sys.exit(main())
