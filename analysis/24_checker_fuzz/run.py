"""Study 24: does the checker of certificates accept false claims?

    python analysis/24_checker_fuzz/run.py [--quick] [--points N] [--claims N] [--seed N] [--workers N] [--write]
    python analysis/24_checker_fuzz/run.py --resources [--quick]

Prints Markdown. The exit status is 0 if every interval contains the value at every point and no false claim is
accepted, 1 otherwise, and 2 for a bad option. With `--resources`, it is 0 if no check takes more memory or time than
the checker states.
"""

from __future__ import annotations

import argparse
import csv
import math
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from fractions import Fraction
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import hostile_bundles
import numpy as np
from false_claims import false_claims
from hostile import KINDS, measured, write
from mpmath import libmp

from surctl.certcheck import PATIENCE, check_document
from surctl.certcheck.enclosure import Undefined, decimal, enclose
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.jets import Tape

BITS = 260  # 78 digits
BLOCK = 5_000  # boxes in one array
ARRAYS = ", arrays"  # after the text of a function: its ranges in arrays of doubles
Raw = Any
Interval = tuple[Any, Any]

_TRUE: dict[str, Callable[..., Raw]] = {
    "sin(x)": lambda x, _: libmp.mpf_sin(x, BITS),
    "cos(x)": lambda x, _: libmp.mpf_cos(x, BITS),
    "atan(x)": lambda x, _: libmp.mpf_atan(x, BITS),
    "acos(x)": lambda x, _: libmp.mpf_acos(x, BITS),
    "atan2(y, x)": lambda x, y: libmp.mpf_atan2(y, x, BITS),
    "tan(x)": lambda x, _: libmp.mpf_tan(x, BITS),
    "asin(x)": lambda x, _: libmp.mpf_asin(x, BITS),
    "exp(x)": lambda x, _: libmp.mpf_exp(x, BITS),
    "log(x)": lambda x, _: libmp.mpf_log(x, BITS),
    "sinh(x)": lambda x, _: sinh(x),
    "cosh(x)": lambda x, _: libmp.mpf_cosh(x, BITS),
    "tanh(x)": lambda x, _: libmp.mpf_tanh(x, BITS),
    "x^0.5": lambda x, _: powr(x, 1, 2),
    "x^(3/2)": lambda x, _: powr(x, 3, 2),
    "x^-1.5": lambda x, _: powr(x, -3, 2),
    "x^(1/3)": lambda x, _: powr(x, 1, 3),
    "x^63.999": lambda x, _: powr(x, 63999, 1000),
}
"""Round to 78 digits; exact values stay exact."""

_POSITIVE = frozenset({"sqrt(x)", "log(x)", *(text for text in _TRUE if text.startswith("x^"))})
_WITHIN_ONE = frozenset({"acos(x)", "asin(x)"})
_EXPONENTIAL = frozenset({"exp(x)", "sinh(x)", "cosh(x)"})
_LARGEST = 1e6  # of the argument of an exponential

_EXACT: dict[str, Callable[[Fraction, Fraction], Fraction]] = {
    "x + y": lambda x, y: x + y,
    "x*y": lambda x, y: x * y,
    "x/y": lambda x, y: x / y,
    "x^7": lambda x, _: x**7,
    "x^-2": lambda x, _: 1 / (x * x),
}


def sinh(x: Raw) -> Raw:
    """Return sinh x to 78 digits; the difference loses twice the bits by which x is small."""
    if x == libmp.fzero:
        return x
    bits = BITS + 20 + 2 * max(0, -(x[2] + x[3]))
    both = libmp.mpf_exp(x, bits), libmp.mpf_exp(libmp.mpf_neg(x), bits)
    return libmp.mpf_shift(libmp.mpf_sub(*both, bits), -1)


def powr(x: Raw, p: int, q: int) -> Raw:
    """Return x^(p/q) to 78 digits."""
    if x == libmp.fzero:
        return x
    times = libmp.mpf_mul(libmp.mpf_log(x, 2 * BITS), libmp.from_int(p), 2 * BITS)
    return libmp.mpf_exp(libmp.mpf_div(times, libmp.from_int(q), 2 * BITS), BITS)


def number(draw: random.Random) -> float:
    """Return any double, or a difficult one: huge, denormal, at a branch cut, near a tie, near ±1, a multiple of π/2 or
    of ln 2, or an argument whose exponential nearly overflows.
    """
    near = [-math.inf, math.inf]
    sign = draw.choice((1, -1))
    match draw.randrange(12):
        case 0 | 1:
            return draw.uniform(-4, 4)
        case 2:
            return sign * 10.0 ** draw.uniform(-323, 308)
        case 3:
            return draw.randrange(-64, 65) * math.pi / 2
        case 4:
            return math.nextafter(draw.randrange(-64, 65) * math.pi / 2, draw.choice(near))
        case 5:
            return draw.randrange(-(10**15), 10**15) * math.pi / 2
        case 6:
            return draw.choice((0.0, 5e-324, -5e-324, 1.0, -1.0, 2.0**-40, 2.0**-41, 1.7976931348623157e308))
        case 7:
            return sign * (1 - 2.0 ** -draw.randrange(1, 54))
        case 8:
            return sign * (1 + 2.0 ** -draw.randrange(1, 53))
        case 9:
            return math.nextafter(sign * math.log(2) * draw.randrange(1, 1100), draw.choice(near))
        case 10:
            return draw.choice(
                (709.78, -745.2, 2.0**8, -_LARGEST, sign * draw.random() * 2.0 ** draw.randrange(-45, 20))
            )
        case _:
            return sign * math.sqrt(draw.uniform(0, 1)) * 2.0 ** draw.randrange(-60, 60)


def side(x: float, draw: random.Random) -> tuple[float, float]:
    """Return the number alone, with its neighbours, or an interval that contains it."""
    if draw.random() < 0.5:
        return x, x
    if draw.random() < 0.5:
        return math.nextafter(x, -math.inf) if x > -1 else x, math.nextafter(x, math.inf) if x < 1 else x
    width = draw.choice((abs(x), 1.0, 3.0, 1e-9)) * draw.random()
    low, high = x - width, x + width
    return (low, high) if math.isfinite(low) and math.isfinite(high) else (x, x)


def doubles(low: float, high: float) -> Interval:
    """Return [low, high] as doubles, without rounding outward."""
    return libmp.from_float(low), libmp.from_float(high)


def fraction(x: Raw) -> Fraction:
    """Return the number in the checker's format."""
    p, q = libmp.to_rational(x)
    return Fraction(int(p), int(q))


def suited(text: str, x: float, y: float) -> bool:
    """Return whether the function is defined, and its reference can be computed."""
    if text in _WITHIN_ONE:
        return abs(x) <= 1
    if text in _EXPONENTIAL:
        return abs(x) <= _LARGEST
    if text in ("log(x)", "x^-1.5"):
        return x > 0
    return y != 0 if text == "x/y" else x != 0 or text != "x^-2"


def within(text: str, box: tuple[float, float]) -> tuple[float, float]:
    """Return the part of a range of x on which the function is defined."""
    low, high = box
    if text in _WITHIN_ONE:
        return max(low, -1.0), min(high, 1.0)
    if text in _EXPONENTIAL:
        return max(low, -_LARGEST), min(high, _LARGEST)
    if text in ("log(x)", "x^-1.5"):
        return (low if low > 0 else 5e-324), high
    return (max(low, 0.0), high) if text in _POSITIVE else box


def relative_width(found: Interval) -> float:
    """Return the width of an interval as a share of its ends; 0 for an interval that contains 0."""
    if libmp.mpf_le(found[0], libmp.fzero) and libmp.mpf_ge(found[1], libmp.fzero):
        return 0.0
    size = min(map(libmp.mpf_abs, found), key=libmp.to_rational)
    return float(libmp.to_float(libmp.mpf_div(libmp.mpf_sub(found[1], found[0], BITS), size, BITS)))


def missed(text: str, points: int, seed: int) -> tuple[int, int, float]:
    """Return for one function the numbers of points, and of points whose value is outside the interval, and the largest
    relative width of the interval at a single number.
    """
    sheet, looked, outside, widest = ExpressionTable(("x", "y")), 0, 0, 0.0
    at = sheet.read(text)
    for box, x, y in arguments(text, seed):
        if looked == points:
            break
        try:
            (value,) = enclose(sheet, [at], [doubles(*ends) for ends in box])
        except Undefined:
            if text != "tan(x)" or box[0][0] == box[0][1]:  # the tangent has poles
                outside += 1
            continue
        looked += 1
        outside += not held(text, value, x, y)
        if is_number(box):
            widest = max(widest, relative_width(value))
    return looked, outside, widest


def missed_by_arrays(text: str, points: int, seed: int) -> tuple[int, int, float]:
    """Return the same for the ranges of many boxes at once; a range that is not known cannot be wrong."""
    sheet, outside, widest, source = ExpressionTable(("x", "y")), 0, 0.0, arguments(text, seed)
    at = sheet.read(text)
    for begin in range(0, points, BLOCK):
        some = list(islice(source, min(BLOCK, points - begin)))
        ends = np.array([box for box, _, _ in some]).transpose(2, 1, 0)
        (jet,), (defined,) = Tape(sheet, (at,)).run((ends[0], ends[1]))
        for (box, x, y), low, high, fine in zip(some, *(part.tolist() for part in (*jet.value, defined)), strict=True):
            if not fine:
                continue
            found = low_end(low), libmp.mpf_neg(low_end(-high))
            outside += not held(text, found, x, y)
            if is_number(box) and math.isfinite(high - low):
                widest = max(widest, relative_width(found))
    return points, outside, widest


def low_end(x: float) -> Raw:
    """Return a lower end in the checker's format; far below every value for an infinite one."""
    return libmp.from_man_exp(-1, 10**7) if math.isinf(x) else libmp.from_float(x)


def is_number(box: Sequence[tuple[float, float]]) -> bool:
    """Return whether all ranges are numbers."""
    return all(low == high for low, high in box)


def arguments(text: str, seed: int) -> Iterator[tuple[list[tuple[float, float]], float, float]]:
    """Yield boxes on which a function is defined, and a point x, y of each."""
    draw = random.Random(f"{text}/{seed}")
    while True:
        x, y = number(draw), number(draw)
        if text in _POSITIVE:
            x = abs(x)
        if not suited(text, x, y):
            continue
        box = [within(text, side(x, draw)), side(y, draw)]
        if any(not low <= at_ <= high for (low, high), at_ in zip(box, (x, y), strict=True)):
            continue
        if text == "atan2(y, x)" and all(low <= 0 <= high for low, high in box):
            continue
        if text in ("x/y", "x^-2") and box["xy".index(text[-1] if text == "x/y" else "x")][0] <= 0:
            box = [(x, x), (y, y)]
        yield box, x, y


def held(text: str, found: Interval, x: float, y: float) -> bool:
    """Return whether an interval contains the value."""
    low, high = found
    if text in _TRUE:
        value = _TRUE[text](libmp.from_float(x), libmp.from_float(y))
        return bool(libmp.mpf_le(low, value) and libmp.mpf_le(value, high))
    first, last = fraction(low), fraction(high)
    if text == "sqrt(x)":
        return first >= 0 and first**2 <= Fraction(x) <= last**2
    return first <= _EXACT[text](Fraction(x), Fraction(y)) <= last


def missed_decimals(points: int, seed: int) -> tuple[int, int, float]:
    """Return the same for the decimal that is printed for a double."""
    draw, outside, widest = random.Random(f"decimal/{seed}"), 0, 0.0
    for _ in range(points):
        x = number(draw)
        found = decimal(x)
        low, high = map(fraction, found)
        outside += not low <= Fraction(repr(x)) <= high
        widest = max(widest, relative_width(found))
    return points, outside, widest


def one_function(text: str, points: int, seed: int) -> dict[str, str]:
    """Return what the table says about a function."""
    began = time.process_time()
    if text == "decimal":
        looked, outside, widest = missed_decimals(points, seed)
    elif text.endswith(ARRAYS):
        looked, outside, widest = missed_by_arrays(text.removesuffix(ARRAYS), max(points // 100, 100), seed)
    else:
        looked, outside, widest = missed(text, points, seed)
    print(f"{text}: {outside} of {looked}", file=sys.stderr)
    width = f"2^{math.log2(widest):.1f}" if widest else "0"
    took = f"{time.process_time() - began:.0f} s"
    return {"function": text, "points": str(looked), "outside": str(outside), "width": width, "took": took}


def functions(points: int, seed: int, workers: int, saved: Path | None) -> tuple[list[str], bool]:
    """Return the rows of the table, and whether every interval contains its value.

    Each finished function is saved in the file `saved`; those that it contains for this seed are not repeated.
    """
    done: dict[str, dict[str, str]] = {}
    if saved is not None and saved.is_file():
        with saved.open(newline="", encoding="utf-8") as file:
            done = {row["function"]: row for row in csv.DictReader(file) if row["points"] in asked_points(points)}
    one_by_one = (*_TRUE, "sqrt(x)", *_EXACT)
    texts = (*one_by_one, "decimal", *(text + ARRAYS for text in one_by_one))
    asked, missing = partial(one_function, points=points, seed=seed), [text for text in texts if text not in done]
    with ExitStack() as stack:
        pool = stack.enter_context(ProcessPoolExecutor(workers)) if workers > 1 else None
        for row in pool.map(asked, missing) if pool else map(asked, missing):
            done[row["function"]] = row
            if saved is not None:
                saved.parent.mkdir(exist_ok=True)
                with saved.open("w", newline="", encoding="utf-8") as file:
                    table = csv.DictWriter(file, list(row), lineterminator="\n")
                    table.writeheader()
                    table.writerows(done.values())
    found = [done[text] for text in texts]
    rows = ["| `{function}` | {points} | {outside} | {width} | {took} |".format(**row) for row in found]
    return rows, all(row["outside"] == "0" for row in found)


def asked_points(points: int) -> tuple[str, str]:
    """Return the numbers of points of a row: one by one, and in arrays."""
    return str(points), str(max(points // 100, 100))


def forgeries(count: int, seed: int) -> tuple[list[str], bool]:
    """Return the rows of the table, and whether no false claim was accepted."""
    tried, accepted, twins, good = (Counter[str]() for _ in range(4))
    least: dict[str, Any] = {}
    for one in false_claims(count, seed):
        tried[one.kind] += 1
        least[one.kind] = min(least.get(one.kind, math.inf), one.excess)
        if check_document(one.document).accepted:
            accepted[one.kind] += 1
            print(f"accepted: {one.document['claim']}", file=sys.stderr)
        if one.twin is not None:
            twins[one.kind] += 1
            good[one.kind] += check_document(one.twin).accepted
    rows = []
    for kind in tried:
        told = f"{good[kind]} of {twins[kind]}" if twins[kind] else "–"
        rows.append(f"| {kind} | {tried[kind]} | {accepted[kind]} | {float(least[kind]):.0e} | {told} |")
    return [*rows, f"| all | {tried.total()} | {accepted.total()} | | |"], not accepted.total()


SIZES = {90_000: 100e6, 7_900_000: 400e6}
"""Largest memory of a process [bytes] that checks a file of some size [bytes]."""


def resources(kinds: Sequence[str], sizes: Sequence[int]) -> tuple[list[str], bool]:
    """Return the rows of the table, and whether no check takes too much memory or time."""
    rows, good = [], True
    with tempfile.TemporaryDirectory() as folder:
        for kind in kinds:
            row = f"| {kind} |"
            for size in sizes:
                if kind in hostile_bundles.KINDS:
                    path = hostile_bundles.write(kind, size, Path(folder, f"{kind} {size}"))
                    within = path.parent / "bundle"
                    used, length = measured(path, within), max(file.stat().st_size for file in within.iterdir())
                else:
                    path = Path(folder) / "certificate.json"
                    write(kind, size, path)
                    used, length = measured(path), path.stat().st_size
                most = SIZES[90_000] if length < 100_000 else SIZES[7_900_000]
                good &= used.memory <= most and used.seconds <= PATIENCE + 4.0 and used.status in "012"
                row += f" {length / 1e3:.0f} | {used.memory / 1e6:.0f} | {used.seconds:.1f} |"
            print(row, file=sys.stderr)
            rows.append(row)
    head = ["| hostile in its |", "|---|"]
    for _ in sizes:
        head[0] += " file [kB] | memory [MB] | time [s] |"
        head[1] += "---|---|---|"
    return [*head, *rows], good


def main(words: Sequence[str] | None = None) -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="200 points a function, 120 claims")
    parser.add_argument("--points", type=int, default=1_000_000, metavar="N", help="of each function")
    parser.add_argument("--claims", type=int, default=20_000, metavar="N", help="false claims")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes, for the functions")
    parser.add_argument("--write", action="store_true", help="write README.md beside this file; resumes")
    parser.add_argument("--resources", action="store_true", help="memory and time of checks of hostile files instead")
    given = parser.parse_args(words)
    if given.resources:
        every = (*KINDS, *hostile_bundles.KINDS)
        kinds, sizes = (("long sum", "dense blocks", "long ports"), [90_000]) if given.quick else (every, list(SIZES))
        rows, good = resources(kinds, sizes)
        print("\n".join(rows))
        return 0 if good else 1
    if min(given.points, given.claims, given.workers) < 1 or (given.write and given.quick):
        parser.error("--points, --claims and --workers: at least 1; --write: not with --quick")
    points, claims = (200, 120) if given.quick else (given.points, given.claims)
    folder = Path(__file__).parent
    saved = folder / "parts" / f"functions-seed{given.seed}.csv" if given.write else None
    held_, sound = functions(points, given.seed, given.workers, saved)
    forged, safe = forgeries(claims, given.seed)
    lines = [
        "| function | points | outside of the range | width at a number | took |",
        "|---|---|---|---|---|",
        *held_,
        "",
    ]
    lines += [
        "| false in its | claims | accepted | by as little as | corresponding true claims accepted |",
        "|---|---|---|---|---|",
    ]
    text = "\n".join([*lines, *forged])
    print(text)
    if given.write:
        about = folder.joinpath("about.md").read_text(encoding="utf-8")
        folder.joinpath("README.md").write_text(f"{about}\n{text}\n", encoding="utf-8")
    return 0 if sound and safe else 1


if __name__ == "__main__":
    sys.exit(main())
