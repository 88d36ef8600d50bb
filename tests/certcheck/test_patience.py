"""Memory of a check, and results that its accounts must not change."""

import json
import runpy
import time
import tracemalloc
from collections.abc import Callable
from fractions import Fraction
from math import lcm
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from surctl.certcheck import check_document, instructions, patience
from surctl.certcheck.belonging import compare
from surctl.certcheck.bundle import read_bundle
from surctl.certcheck.document import Rejected
from surctl.certcheck.enclosure import enclose, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.identity import Exact, Sum, _product
from surctl.certcheck.instructions import digest, evaluate, read_list
from surctl.certcheck.patience import MEMORY, Account, afford, go_on, patient
from surctl.certcheck.region_exact import Matrix, inverse, is_positive_definite
from surctl.certcheck.series import same_sign
from surctl.certcheck.squares import _Block, _whole
from surctl.certcheck.squares import _product as packed_product
from surctl.errors import InputError

HERE = Path(__file__).parent
HOSTILE, BUNDLES = (
    runpy.run_path(str(HERE.parents[1] / "analysis" / "24_checker_fuzz" / name))
    for name in ("hostile.py", "hostile_bundles.py")
)
SMALL = ("many atoms", "dense blocks", "derivatives")
COUNTED = (
    "many products", "many atoms", "long names", "fractions", "operations", "dense blocks", "block products", "facts",
    "tangents", "derivatives",
)  # fmt: skip


@pytest.mark.parametrize("kind", SMALL)
def test_a_small_file_takes_little_memory(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    HOSTILE["write"](kind, 45_000, path)
    assert path.stat().st_size < 100_000
    used = HOSTILE["measured"](path)
    assert used.status == "1" and used.memory < 100e6


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("many names", ""),
        ("long ports", "is not the manifest of an export"),
        ("deep procedure", "it is nested too deeply"),
        ("long procedure", "law takes vectors"),
        ("squares", "a number with too many digits"),
        ("branches", "more than 50000 operations"),
        ("manifest of depth", "nested too deeply"),
    ],
)
def test_a_small_bundle_takes_little_memory_and_time(kind: str, says: str, tmp_path: Path) -> None:
    document, began = json.loads(BUNDLES["write"](kind, 20_000, tmp_path).read_text()), time.thread_time()
    tracemalloc.start()
    try:
        found = compare(document, read_bundle(tmp_path / "bundle"))
        assert says in " ".join(found.differs) and not found.belongs
    except InputError as error:
        assert says in str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 40e6 and time.thread_time() - began < 3.0


def test_a_list_is_longer_or_larger_than_the_checker_reads() -> None:
    text = BUNDLES["bundle"]()[1]["law.txt"]
    with pytest.raises(Rejected, match="has more than 2000000 characters"):
        read_list(text + "\n" * 2_000_000)
    with pytest.raises(Rejected, match="law has more than 100000 characters"):
        read_list("procedure law\n" + "def f(s):\n pass\n" * 9_000)
    with pytest.raises(Rejected, match="more than 60000 numbers"):
        read_list("routine r\nin a 40000\nin b 40000\nout a\n")


def test_many_numbers_are_evaluated_at_a_few_points_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(instructions, "_TABLE", 10_000)
    row = "program row\nin0 k 1\nin1 x 1\nv0 = in0[0]\nv1 = in1[0]\nv2 = mul v0 v1\nout0 y v2\n"
    loop = f"y = loop row:{digest(row)[:16]} count 500 index 1 until None carried  sliced  fixed x spread  lanes 1"
    block, x = read_list(f"{row}\nroutine rows\nin x 1\n{loop}\nout y\n"), np.arange(400.0)[None]
    tracemalloc.start()
    (y,) = evaluate(block, x)
    peak = tracemalloc.get_traced_memory()[1] - y.nbytes
    tracemalloc.stop()
    assert block.size == 501 + 3 and np.array_equal(y, np.arange(500.0)[:, None] * x)
    assert peak < 2.5 * y.nbytes  # all at once, it would be four times as much


def test_the_largest_proof_of_a_craft_takes_little_memory() -> None:
    used = HOSTILE["measured"](HERE / "region-steered-20-remus100.json")
    assert used.status == "0" and used.memory < 100e6


@pytest.mark.parametrize("kind", COUNTED)
def test_what_is_stored_is_counted(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    document, began = HOSTILE["KINDS"][kind](45_000), time.thread_time()
    monkeypatch.setattr(patience, "MEMORY", 500_000)
    assert "more than 0.5 MB of memory" in check_document(document, time_limit=4.0).reason
    assert time.thread_time() - began < 1.0


def normal_form(text: str) -> Callable[[], object]:
    exact = Exact(ExpressionTable(["x", "y"]))
    root = exact.expressions.read(text)  # without a limit
    return lambda: Exact(exact.expressions).of(root)


def series_of(text: str) -> Callable[[], object]:
    table = ExpressionTable(["t"])
    root = table.read(text)
    return lambda: same_sign(table, [root], span(0.5, 1.0))


def block_of(over: int) -> Callable[[], object]:
    numbers = [1] * 820
    block = _Block({"factors": [], "monomials": [[k] for k in range(40)], "over": over, "gram": numbers}, 1)
    return block._integers


TERMS = {m: Fraction(1, m + 1) for m in range(40)}
STORED: dict[str, Callable[[], Callable[[], object]]] = {
    "operations": lambda: lambda: ExpressionTable(["x"]).read("+".join(f"{k}*x" for k in range(200))),
    "normal forms": lambda: normal_form("+".join(f"x^{k}" for k in range(1, 40))),
    "names": lambda: normal_form("exp(" + "+".join(f"{k}.123456789123456789e-90*x^{k}" for k in range(1, 25)) + ")"),
    "a product": lambda: lambda: _product({((f"v{k}", 1),): Fraction(k) for k in range(30)},
                                          {((f"w{k}", 1),): Fraction(k) for k in range(30)}),
    "series": lambda: series_of("+".join(f"t^{k}" for k in range(1, 30))),
    "ranges": lambda: lambda: enclose(*jets("*".join(f"(x+{k})" for k in range(200)))),
    "entries": lambda: block_of(3),
    "integers": lambda: lambda: _whole({m: Fraction(1, 10**300 + m % 2) for m in range(400)}),
    "a sum of squares": lambda: lambda: packed_product(TERMS, {m << 12: x for m, x in TERMS.items()}),
}  # fmt: skip


def jets(text: str) -> tuple[ExpressionTable, list[int], list]:
    with patient(9.0), pytest.MonkeyPatch.context() as patch:
        patch.setattr(patience, "MEMORY", 1e9)
        table = ExpressionTable(["x"])
        return table, [table.read(text)], [span(0.0, 1.0)]


@pytest.mark.parametrize("what", STORED)
def test_each_store_has_its_limit(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for memory in (MEMORY, 60_000):
        compute = STORED[what]()
        monkeypatch.setattr(patience, "MEMORY", memory)
        with patient(9.0):
            if memory == MEMORY:
                compute()
            else:
                with pytest.raises(Rejected, match="memory"):
                    compute()


def test_a_genuine_proof_needs_less_than_a_hundredth_of_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    document = json.loads((HERE / "lyapunov-van-der-pol.json").read_text())
    monkeypatch.setattr(patience, "MEMORY", MEMORY // 100)
    assert check_document(document).accepted
    monkeypatch.setattr(patience, "MEMORY", 40_000)
    assert check_document(document).reason.endswith("the check needs more than 0.04 MB of memory")


def test_an_account_ends_with_its_object() -> None:
    with patient(9.0):
        one, other = Account(), Account()
        one.hold(MEMORY // 2)
        other.hold(MEMORY // 3)
        with pytest.raises(Rejected, match="memory"):
            afford(MEMORY // 4)
        del one
        afford(MEMORY // 4)
        with pytest.raises(Rejected, match="memory"):
            other.hold(MEMORY)
    Account().hold(10 * MEMORY)  # without a limit


def by_single_squares(exact: Exact, a: Sum) -> Sum:
    """The normal form by the replacement of one square at a time."""
    for term, number in a.items():
        for atom, e in term:
            if e >= 2 and atom[:5] in ("sqrt{", "sine{"):
                rest = {k: n - 2 * (k == atom) for k, n in term}
                others = {t: x for t, x in a.items() if t != term}
                by = exact.under_root(atom) if atom[:5] == "sqrt{" else exact._sine_square(atom)
                replaced = dict(others)
                for t, x in by.items():
                    powers = dict(rest)
                    for k, n in t:
                        powers[k] = powers.get(k, 0) + n
                    key = tuple(sorted((k, n) for k, n in powers.items() if n))
                    replaced[key] = replaced.get(key, Fraction(0)) + number * x
                return by_single_squares(exact, {t: x for t, x in replaced.items() if x})
    return a


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(*[st.integers(0, 5)] * 4, st.integers(-3, 3)), max_size=6))
def test_powers_of_roots_and_sines_have_one_normal_form(drawn) -> None:
    table = ExpressionTable(["x", "y"])
    exact = Exact(table)
    inner, outer, sine = (
        next(iter(exact.of(table.read(text))[0]))[0][0] for text in ("sqrt(x + 2)", "sqrt(y - 3*sqrt(x + 2))", "sin(x)")
    )
    a: Sum = {}
    for p, q, r, s, number in drawn:
        powers = sorted((k, e) for k, e in ((inner, p), (outer, q), (sine, r), ("v0", s)) if e)
        a[tuple(powers)] = Fraction(number or 1, 3)
    assert exact._reduced(dict(a)) == by_single_squares(exact, a)


ENTRY = st.integers(-9, 9) | st.tuples(st.integers(-9, 9), st.integers(1, 12)).map(list)


@example([4, 6, 0, 2, 8, 10], 6, {})
@given(
    st.lists(ENTRY, min_size=6, max_size=6),
    st.integers(1, 24),
    st.dictionaries(st.integers(0, 5), st.fractions(max_denominator=9)),
)
def test_a_block_is_integers_over_the_least_denominator(gram, over, added) -> None:
    block = _Block({"factors": [], "monomials": [[0], [1], [2]], "over": over, "gram": gram}, 1)
    for at, more in added.items():
        block.add(at, more)
    wanted = [
        (Fraction(*x) if isinstance(x, list) else Fraction(x, over)) + added.get(at, 0) for at, x in enumerate(gram)
    ]
    numbers, whole = block._integers()
    assert [Fraction(x, whole) for x in numbers] == wanted
    assert whole == lcm(*(x.denominator for x in wanted))


def test_the_time_limit_holds_inside_its_block() -> None:
    with patient(60.0):
        go_on()
    with patient(-1.0), pytest.raises(Rejected, match="more than -1 s of processor time"):
        go_on()
    go_on()


@pytest.mark.parametrize("operation", [inverse, is_positive_definite])
def test_exact_algebra_looks_at_the_clock(operation: Callable[[Matrix], object]) -> None:
    with pytest.raises(Rejected, match="processor time"), patient(0.0):
        operation([[Fraction(2), Fraction(1)], [Fraction(1), Fraction(2)]])
