"""Certificates that try to make the checker use much memory or time: texts, numbers and lists as large as allowed."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from surctl.certcheck import seal

__all__ = ["KINDS", "Use", "measured", "write"]

_TEXT = 60_000  # characters that the checker reads in one expression
Document = dict[str, Any]


def _inequality(
    left: str, right: str = "0", *, cases: Sequence[Mapping[str, Any]], names: Iterable[str] = "xyz",
    slack: float = 0.0, constraints: Sequence[str] = (), bounds: tuple[float, float] = (-1.0, 1.5),
) -> Document:  # fmt: skip
    box = [{"name": name, "unit": "1", "lower": bounds[0], "upper": bounds[1]} for name in names]
    claim = {
        "name": "hostile", "statement": "", "unit": "1", "variables": box, "left": left, "right": right,
        "constraints": list(constraints), "slack": slack,
    }  # fmt: skip
    return seal("interval", claim, {"cases": list(cases)})


def _case(
    numerator: str, *denominators: str, tree: str = "n", multipliers: Sequence[str] = (), **more: Any
) -> Document:
    evidence = more or {"tree": tree, "points": []}
    return {
        "choice": "", "numerator": numerator, "denominators": list(denominators), "multipliers": list(multipliers),
        **evidence,
    }  # fmt: skip


def _identity(text: str, size: int) -> Document:
    """Return a claim of which the normal form is needed; the text may be up to `size` characters long."""
    return _inequality(text, "0", cases=[_case(f"0 + {text}", "1")])


def _fill(part: Callable[[int], str], size: int, sign: str = " + ") -> str:
    """Return parts joined to a text of at most `size` characters, and at most as long as the checker reads."""
    parts, length = list[str](), 0
    for k in itertools.count():
        one = part(k)
        length += len(one) + len(sign)
        if length > min(size, _TEXT - 100):
            return sign.join(parts)
        parts.append(one)
    raise AssertionError


def _many_texts(part: Callable[[int], str], size: int) -> Document:
    """Return a claim with as many denominators, each a long text, as the file may have."""
    texts, k, left = [], 0, size // 2
    while left > 0:
        first = k
        text = _fill(lambda j, first=first: part(first + j), left)
        if not text:
            break
        k += 1_000_003
        texts.append(text)
        left -= len(text)
    return _inequality("x", "2", cases=[_case("x - 2 + 0*x", *texts)])


def _squares(
    symbols: Sequence[str], blocks: Sequence[Mapping[str, Any]], *, left: str = "x", right: str = "2",
    facts: Sequence[Any] = (), relations: Sequence[Any] = (), denominators: Sequence[str] = (),
    multipliers: Sequence[str] = (), **claim: Any,
) -> Document:  # fmt: skip
    entry = {"symbols": list(symbols), "facts": list(facts), "blocks": list(blocks), "relations": list(relations)}
    numerator = f"{left} - ({right})" if not denominators else f"{left} - {right}"
    return _inequality(
        left, right, cases=[_case(numerator, *denominators, multipliers=multipliers, squares=entry)], **claim
    )


def _block(
    size: int, entry: Callable[[int, int], Any], over: int = 1, factors: Sequence[str] = (), count: int = 3
) -> Document:
    monomials = list(itertools.islice((list(e) for e in itertools.product(range(9), repeat=count)), size))
    gram = [entry(i, j) for i in range(size) for j in range(i + 1)]
    return {"factors": list(factors), "monomials": monomials, "over": over, "gram": gram}


def _blocks(size: int, block: Document, **more: Any) -> Document:
    times = max(1, min(600, size // len(json.dumps(block))))
    return _squares("xyz", [block] * times, **more)


def _nested(inner: str, name: str, depth: int = 70) -> str:
    for k in range(depth):
        inner = f"{name}({k} + {inner})"
    return inner


def powers(size: int) -> Document:
    """(x + y + z + 1)^8^8."""
    return _identity("((x + 2*y - z/3 + 1)^8)^8 + x*y", size)


def powers_of_fractions(size: int) -> Document:
    """Powers of a sum with coefficients of a thousand digits."""
    return _identity("(x*1.1e-300 + 7e300*y/3 + z*3.3e-301 + 1)^12", size)


def squared_sums(size: int) -> Document:
    """The product of two sums with many terms."""
    part = partial(_fill, lambda k: f"{k + 1.5}e{k % 600 - 300}*x^{k % 60}*y^{k // 60}", 40 * 105)
    return _identity(f"({part()})*({part(sign=' - ')})", size)


def many_products(size: int) -> Document:
    """Many different products of sums, all of which are stored."""
    return _many_texts(lambda k: f"((x + {k}.5e-99*y - z)^6*(x - {k}*y)^6)^2 + 1", size)


def long_sum(size: int) -> Document:
    """A sum of many terms: each partial sum is stored."""
    return _identity(_fill(lambda k: f"{k}.7e-200*x^{k % 50}*y^{k // 50 % 50}*z^{k // 2500}", size), size)


def many_atoms(size: int) -> Document:
    """A sum of exponentials: each partial sum is stored."""
    return _identity(_fill(lambda k: f"exp({k}*x)", size), size)


def long_names(size: int) -> Document:
    """Functions of functions of a long sum."""
    inner = [_fill(lambda k, f=f: f"{k}*{f}(x)", 6000) for f in ("atan", "exp", "tanh")]
    return _many_texts(lambda k: _nested(f"{k}*x + {inner[k % 3]}", "tanh"), size)


def roots(size: int) -> Document:
    """A power of a sum of roots, of which each square is replaced."""
    return _identity("(" + _fill(lambda k: f"sqrt(x + {k + 2})", 300) + ")^8", size)


def nested_roots(size: int) -> Document:
    """Roots of roots, and powers of them."""
    text = "x + 9"
    for k in range(20):
        text = f"(sqrt({text}) + {k} + y)"
    return _identity(f"{text}^16", size)


def sines(size: int) -> Document:
    """Powers of sines: the squares become 1 - cos^2."""
    return _identity("(" + _fill(lambda k: f"sin({k + 2}*x + y)", 150) + ")^16", size)


def many_sines(size: int) -> Document:
    """The sine of a sum of many angles, which has 2^n terms."""
    return _identity("sin(" + _fill(lambda k: f"8*x^{k + 1}", 200) + ")", size)


def high_sine(size: int) -> Document:
    """A long product of powers of one sine and one root."""
    return _identity("(1 + sin(x) + sqrt(2 + y))^64*(1 - sin(x))^64", size)


def angles(size: int) -> Document:
    """Sines and cosines of sums of arc tangents."""
    return _identity("cos(" + _fill(lambda k: f"8*atan2(x + {k}, y + 9)", 150) + ")", size)


def fractions(size: int) -> Document:
    """A sum of fractions, whose denominators are multiplied."""
    return _identity(_fill(lambda k: f"1/(x + {k + 3}*y + 99.25)", size), size)


def operations(size: int) -> Document:
    """As many operations as the checker stores, in several texts."""
    return _many_texts(lambda k: f"x*{k}", size)


def lexemes(size: int) -> Document:
    """Texts that consist of signs only."""
    return _many_texts(lambda k: "-" * 3000 + f"{k}", size)


def decimals(size: int) -> Document:
    """Numbers of a few characters and a thousand digits."""
    return _many_texts(lambda k: f"{k}e-999", size)


def long_decimals(size: int) -> Document:
    """Numbers of many digits."""
    return _many_texts(lambda k: f"{k}." + "7" * 4000, size)


def tree(size: int) -> Document:
    """A deep tree of boxes in 36 variables, as long as the file."""
    names = [f"v{k}" for k in range(36)]
    text = "".join("0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"[k % 36] for k in range(9_900)) + "n" * max(0, size - 15_000)
    return _inequality(
        " + ".join(names), "99", names=names, cases=[_case(f"{' + '.join(names)} - 99 + 0", "1", tree=text)]
    )


def wide_leaves(size: int) -> Document:
    """Many boxes, and a long expression for the arrays."""
    long = _fill(lambda k: f"sin({k}*x)*cos({k}*y)", min(size // 3, 20_000))
    return _inequality(long, "1e9", cases=[_case(f"{long} - 1e9", tree="0" * 600 + "m" * 601)])


def tangents(size: int) -> Document:
    """Second derivatives in 36 variables."""
    names = [f"v{k}" for k in range(36)]
    turned = [names[k:] + names[:k] for k in range(36)]  # the last term needs each variable, so that all are stored
    long = "0 - " + _fill(lambda k: f"({' + '.join(turned[k % 36])} + 0.{k})^2", min(size // 3, 30_000), " - ")
    return _inequality(
        long, "1e9", names=names, cases=[{**_case(f"{long} - 1e9"), "tree": "c", "points": [[0.0] * 36]}]
    )


def branches(size: int) -> Document:
    """Every choice of twelve functions with two."""
    text = " + ".join(f"abs(x - 0.{k})" for k in range(10, 22))
    cases = [_case(text + " - 99", multipliers=["0"] * 12) | {"choice": format(k, "012b")} for k in range(4096)]
    return _inequality(text, "99", cases=cases[: max(1, size // 130)])


def many_cases(size: int) -> Document:
    """As many cases as the file has space for."""
    return _inequality("x", "2", cases=[_case("x - 2")] * (size // 110))


def many_constraints(size: int) -> Document:
    """As many constraints and multipliers as the file has space for."""
    count = size // 20
    texts = [f"x - {k}" for k in range(count)]
    return _inequality("x", "2", constraints=texts, cases=[_case("x - 2", multipliers=["0"] * count)])


def many_variables(size: int) -> Document:
    """As many variables as the file has space for."""
    return _inequality("v1", "2", names=[f"v{k}" for k in range(size // 60)], cases=[_case("v1 - 2")])


def dense_blocks(size: int) -> Document:
    """Blocks with a large common denominator."""
    return _blocks(size, _block(130, lambda i, j: 7, over=10**1800 + 3))


def rational_blocks(size: int) -> Document:
    """Blocks whose entries have different large denominators."""
    return _blocks(size, _block(40, lambda i, j: [1, 10**170 + 2 * i + 1] if i == j else 1))


def small_blocks(size: int) -> Document:
    """Many blocks of small integers."""
    return _blocks(size, _block(130, lambda i, j: 9 * (i == j)))


def many_blocks(size: int) -> Document:
    """Many blocks, each with a large common denominator."""
    return _blocks(size, _block(12, lambda i, j: 10**1790 * (i == j), over=10**1800 + 7, factors=["l0"]))


def block_products(size: int) -> Document:
    """Blocks times products of constraints with many terms and long coefficients."""
    constraint = "(" + " + ".join(f"{k}.1e-99*x^{k}*y" for k in range(1, 9)) + " - 1e99*z - 3)^3"
    block = _block(40, lambda i, j: 1, over=10**1700 + 9, factors=["c0", "c0", "l0", "h1"])
    return _blocks(size, block, constraints=[constraint], multipliers=["0"])


def offsets(size: int) -> Document:
    """Symbols with an offset of many digits, and high powers."""
    digits = "7" * 40
    return _squares(
        [f"x + 0.{digits}1", f"y - 0.{digits}3", f"z + 0.{digits}9"], [_block(10, lambda i, j: 1)],
        left="x^40*y^40*z^40", right="1",
    )  # fmt: skip


def targets(size: int) -> Document:
    """A slack times many denominators."""
    below = [f"(x + {k}.123e-99*y + 7e99*z/{k + 3} + 1e100)^4" for k in range(13)]
    over = "*".join(f"({d})" for d in below)
    return _squares(
        "xyz", [_block(10, lambda i, j: 1)], left=f"x/({over})", right="1", denominators=below, slack=0.1,
    )  # fmt: skip


def facts(size: int) -> Document:
    """Facts with long texts, which are divided into many pieces."""
    long = _fill(lambda k: f"sin({k}*t)", min(size // 3, 50_000))
    block = _block(3, lambda i, j: 1, factors=["f0"])
    return _squares("xyz", [block], facts=[{"of": "x", "factors": [long]}])


def many_facts(size: int) -> Document:
    """Facts that expand to many terms."""
    long = _fill(lambda k: f"{k}*t^{k % 40}", min(size // 60, 3000))
    entries = [{"of": f"x + {k}", "factors": [f"{long} + 1e99"]} for k in range(60)]
    blocks = [_block(3, lambda i, j: 1, factors=[f"f{k}"]) for k in range(60)]
    return _squares("xyz", blocks, facts=entries)


def relations(size: int) -> Document:
    """A relation with many multipliers of large denominators."""
    symbols = ["x", "sqrt(x + 2)"]
    monomials = list(itertools.islice(([i, j] for i in range(61) for j in range(61)), min(3700, size // 30)))
    factors = [[1, 10**300 + 2 * (k % 20) + 1] for k in range(len(monomials))]
    block = _block(3, lambda i, j: 1, count=2)
    return _squares(symbols, [block], relations=[{"symbol": 1, "monomials": monomials, "factors": factors}])


def long_statement(size: int) -> Document:
    """A claim that is true, with a long statement and unit."""
    document = _inequality("x", "2", cases=[_case("x - 2")])
    claim = document["claim"] | {"statement": "\\" * (size // 4), "name": "\U0001f600" + "n" * (size // 4)}
    return seal("interval", claim, {"cases": document["cases"]})


def _motion(function: str, change: str, dynamics: Mapping[str, str], *, time: str = "continuous") -> Document:
    states = [{"name": name, "unit": "1", "lower": -1.0, "upper": 1.0} for name in dynamics]
    claim = {
        "name": "hostile", "time": time, "property": "safety", "states": states, "parameters": [],
        "dynamics": dict(dynamics), "function": function, "initial": ["1"], "unsafe": ["1"],
        "multiplier": "0" if time == "continuous" else None, "about": None,
    }  # fmt: skip
    return seal("barrier", claim, {"change": change, "margin": 0.1, "proofs": [[], [], []]})


def derivatives(size: int) -> Document:
    """The derivative of a long product."""
    text = _fill(lambda k: f"(x + {k}*y)", min(size // 3, 30_000), "*")
    return _motion(text, "x", {"x": "-x + y", "y": "-y"})


def iterated(size: int) -> Document:
    """A polynomial at the successor of a polynomial map."""
    return _motion("(x + y + 1)^12", "x", {"x": "(x - y/3 + 1)^12", "y": "(x*y - 7e-99)^12"}, time="discrete")


def undefined(size: int) -> Document:
    """Dynamics that may be undefined, in 36 states."""
    names = [f"v{k}" for k in range(36)]
    rates = {name: f"-{name} + 1/({' + '.join(names)} - 7.3)" for name in names}
    return _motion("v0", "v0", rates)


def _repeated(part: str, size: int) -> str:
    return '{"format": "surctl-certificate", "x": [' + ", ".join([part] * (size // (len(part) + 2))) + "]}"


def numbers(size: int) -> str:
    """A list of short numbers."""
    return _repeated("0.1", size)


def short_lists(size: int) -> str:
    """Lists of a few entries."""
    return _repeated("[0, 0, 0, 0, 0, 0]", size)


def shortest_lists(size: int) -> str:
    """Lists of one entry."""
    return _repeated("[0]", size)


def objects(size: int) -> str:
    """Objects with one key, and characters beyond 16 bits."""
    return _repeated('{"\U0001f600": ' + "9" * 20 + "}", size)


def depth(size: int) -> str:
    """A list in a list in a list."""
    return "[" * (size // 2) + "]" * (size // 2)


KINDS: dict[str, Callable[[int], Document | str]] = {
    function.__name__.replace("_", " "): function
    for function in (
        powers, powers_of_fractions, squared_sums, many_products, long_sum, many_atoms, long_names, roots,
        nested_roots, sines, many_sines, high_sine, angles, fractions, operations, lexemes, decimals, long_decimals,
        tree, wide_leaves, tangents, branches, many_cases, many_constraints, many_variables, dense_blocks,
        rational_blocks, small_blocks, many_blocks, block_products, offsets, targets, facts, many_facts, relations,
        long_statement, derivatives, iterated, undefined, numbers, short_lists, shortest_lists, objects, depth,
    )
}  # fmt: skip
"""Functions that return a certificate, or the text of a file, of about the given size [bytes] or less."""


def write(kind: str, size: int, path: Path) -> None:
    """Write a file of a kind with a size of at most about `size` bytes."""
    document = KINDS[kind](size)
    path.write_text(document if isinstance(document, str) else json.dumps(document), encoding="utf-8")


@dataclass(frozen=True)
class Use:
    """What the check of a file took: largest resident memory of its process [bytes], processor time [s], the reason."""

    memory: int
    seconds: float
    status: str


def measured(path: Path, bundle: Path | None = None) -> Use:
    """Return what the check of a certificate file, with a bundle, takes in a new process of the command line."""
    words = [str(path), *(("--bundle", str(bundle)) if bundle else ())]
    done = subprocess.run([sys.executable, "-c", _MEASURE, *words], capture_output=True, text=True, check=True)
    memory, seconds, status = done.stdout.rstrip("\n").rsplit("\n", 1)[-1].split(" ", 2)
    return Use(int(memory) * 1024, float(seconds), status)


# the largest resident memory of `getrusage` is that of the parent if this is larger
_MEASURE = """
import re, resource, sys
from surctl.cli import main
sys.argv = ["surctl", "check", *sys.argv[1:]]
try:
    main()
except SystemExit as end:
    status = end.code
used = resource.getrusage(resource.RUSAGE_SELF)
peak = re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]
print(f"\\n{peak} {used.ru_utime + used.ru_stime:.2f} {status}")
"""
