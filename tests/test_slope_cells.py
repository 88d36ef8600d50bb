"""The slope rule on many boxes of study 46: its points, slopes, trim errors and decreases contain all samples."""

from __future__ import annotations

import copy
import json
import runpy
import sys
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.certcheck import Rejected
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.jets import Tape
from surctl.certcheck.slope_rows import Number
from surctl.verification.formula import parse, values_of, variable

STUDY = Path(__file__).parents[1] / "analysis" / "46_slope_rule"
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def study() -> Iterator[SimpleNamespace]:
    sys.path.insert(0, str(STUDY))
    yield SimpleNamespace(
        **{name: SimpleNamespace(**runpy.run_path(str(STUDY / f"{name}.py"))) for name in ("cells", "angles", "cruise")}
    )
    sys.path.remove(str(STUDY))


@pytest.mark.parametrize(("powers", "count"), [
    ([(0, 0), (2, 0), (1, 1)], 3), ([(0, 0), (1, 0), (0, 1)], 3), ([(4, 0), (1, 1), (3, 1), (0, 0)], 5),
    ([(1, 0), (2, 0), (1, 1), (0, 1), (0, 0)], 5), ([(3, 0), (2, 1), (0, 1)], 7),
])  # fmt: skip
@pytest.mark.parametrize("half", [0.001, 0.02, 0.3])
def test_monomials_of_an_angle_lie_in_the_hull_of_few_points(
    study: SimpleNamespace, powers: list[tuple[int, int]], count: int, half: float
) -> None:
    random = np.random.default_rng(count)
    middle = random.uniform(-4, 4, 5)
    points = np.array(list(study.cells.monomials(middle, np.full(5, half), powers).values()))
    assert points.shape == (len(set(powers)), count, 5)
    angles = middle + half * np.linspace(-1, 1, 41)[:, None]
    values = np.array([np.cos(angles) ** a * np.sin(angles) ** b for a, b in dict.fromkeys(set(powers))])
    ways = random.normal(size=(500, len(values)))
    # the sizes of the hull shrink like half² or faster, so that random directions are relative to them
    least = (np.tensordot(ways, points, 1).max(axis=1) - np.tensordot(ways, values, 1).max(axis=1)).min()
    assert least > -1e-13
    assert np.abs(points[:, [0, -1]] - values[:, [0, -1]]).max() < 1e-12, "the ends of a cell are points"


def test_a_wide_cell_of_an_angle_is_rejected(study: SimpleNamespace) -> None:
    with pytest.raises(Rejected, match="too wide"):
        study.cells.monomials(np.zeros(1), np.full(1, 0.8), [(2, 0), (1, 1)])


def rows_of(study: SimpleNamespace, rates: list[str], *, level: float = 1.0, n: int = 2, width: float = 0.1) -> Any:
    """Return rows for an angle from 0.3 on, a parameter p in two cells, and a pair (u, w) in a polytope."""
    names = [*(f"x{k}" for k in range(n)), "psi", "p", "u", "w"]
    box = [(np.array([0.3, 0.3]), np.full(2, 0.3 + width)), (np.array([0.8, 1.0]), np.array([1.0, 1.3]))]
    box += [(np.full(2, 0.9), np.full(2, 1.1))] * 2
    cover = np.eye(n) + 0.3
    same, pair = np.arange(2), {("u", "w"): study.angles.PAIR}
    return study.cells.Cells(names, rates, cover, np.full(2, level), box, pair, same), names, np.linalg.inv(cover)


def sampled(study: SimpleNamespace, rows: Any, names: list[str], p: Array, cell: int, count: int) -> dict[str, Array]:
    """Return states in the region and parameters in a cell."""
    random, n = np.random.default_rng(cell), len(p)
    x = random.normal(size=(n, count))
    x *= rows.radius[cell] * random.random(count) ** 0.3 / np.sqrt(np.einsum("in,ij,jn->n", x, p, x))
    ends = [(own[0][cell], own[1][cell]) for own, _ in rows.box[n : n + 2]]
    inner = [
        np.where(random.random(count) < 0.5, random.choice(one, count), random.uniform(*one, count)) for one in ends
    ]
    pair = random.dirichlet(np.full(len(study.angles.PAIR), 0.2), count) @ study.angles.PAIR
    return dict(zip(names, (*x, *inner, *pair.T), strict=True))


def exact(names: list[str], texts: list[str], at: dict[str, Array]) -> Array:
    return np.asarray(values_of([parse(text, {name: variable(name) for name in names}) for text in texts], at))


FURTHER = (
    "min(x0 + 0.3, 0.25 + 0.4*x1)", "max(x0 - 0.3, 0.4*x1 - 0.25)", "min(x0 + 0.3, 2.5 + 0.4*x1)", "p + x0*u",
    "abs(p - 0.82) + abs(p - 0.82)*x0", "p*(x0 + u)*(x1 + w)", "max(x0 + p, -1.2 + 0.2*x1^2)", "abs(p - 0.82) - p + x0",
)  # fmt: skip


@pytest.mark.parametrize("k", range(16 + len(FURTHER)))
def test_rates_lie_between_the_corners_of_their_rows(study: SimpleNamespace, k: int) -> None:
    term = (*study.angles.TERMS, *FURTHER)[k].format(a="0.7", b="0.4", c="cos(psi)", s="sin(psi)", z="x0", y="x1")
    rows, names, p = rows_of(study, [term])
    trim = rows.value(rows.roots[0])
    for cell in range(2):
        at = sampled(study, rows, names, p, cell, 3000)
        still = {name: np.zeros(3000) if name in ("x0", "x1") else value for name, value in at.items()}
        value, rest = exact(names, [term], at)[0], exact(names, [term], still)[0]
        [low], [high] = ([end[cell]] for end in rows.range[rows.roots[0]])
        assert low - 1e-12 <= value.min() and value.max() <= high + 1e-12
        low, high = (end[cell] for end in rows._bounds(trim))
        assert low - 1e-12 <= rest.min() and rest.max() <= high + 1e-12
        # value − rest = r·x for a convex combination of rows: so it lies between the least and the largest
        corners = rows.corners([entry.poly for entry in rows.rows[0]])[:, :, cell]
        error = sum(float(entry.error) for entry in rows.rows[0]) * 2 + 1e-12
        moved = np.einsum("iv,in->vn", corners, np.array([at["x0"], at["x1"]]))
        assert np.all(moved.min(axis=0) - error <= value - rest)
        assert np.all(value - rest <= moved.max(axis=0) + error)


def test_products_of_polynomials_are_exact_for_every_angle_and_slope(study: SimpleNamespace) -> None:
    rows, *_ = rows_of(study, ["p*x0 + u*x1 + cos(psi)*w"])
    random = np.random.default_rng(1)
    k = rows._of_parameter[3]
    a = Number({(0, 1, k): Fraction(2), (): Fraction(1, 3), (0, 0): Fraction(5)})
    b = Number({(1, k): Fraction(-7), (k,): Fraction(3), (0,): Fraction(1)})
    product = rows.times(rows.times(a, b), b)
    for angle, value in zip(random.uniform(-9, 9, 20), random.uniform(0.8, 1.3, 20), strict=True):
        slopes = {0: np.cos(angle), 1: np.sin(angle), k: value}
        for other, (middle, square) in rows._squares.items():
            slopes[square] = (slopes[other] - float(middle)) ** 2

        def at(number: Number, slopes: dict[int, float] = slopes) -> float:
            return sum(float(x) * np.prod([slopes[one] for one in term]) for term, x in number.poly.items())

        assert at(product) == pytest.approx(at(a) * at(b) ** 2, abs=1e-9)


@pytest.mark.parametrize(
    "text", ["t*abs(t)", "max(-0.3, min(0.5, t))", "t^3 - t", "tanh(2*t)", "abs(t - 0.1)", "1/(2 + t)"]
)
@pytest.mark.parametrize("wide", [0.0, 1e-3, 0.2])
def test_secant_slopes_contain_samples_and_are_close_to_them(study: SimpleNamespace, text: str, wide: float) -> None:
    table = ExpressionTable(["t"])
    tape = Tape(table, (table.read(text),))
    random = np.random.default_rng(0)
    c = random.uniform(-0.6, 0.6, 4)
    rest, reach = (c - wide / 2, c + wide / 2), random.uniform(0.05, 0.8, 4)
    whole = rest[0] - reach, rest[1] + 0.7 * reach
    low, high = study.cells.secant(tape, whole, rest, reach)
    for k in range(4):
        at, d = random.uniform(rest[0][k], rest[1][k], 20_000), random.uniform(-reach[k], reach[k], 20_000)
        inside = (at + d >= whole[0][k]) & (at + d <= whole[1][k]) & (np.abs(d) > 1e-6)
        at, d = at[inside], d[inside]
        ends, starts = (values_of([parse(text, {"t": variable("t")})], {"t": t})[0] for t in (at + d, at))
        slopes = (ends - starts) / d
        assert low[k] - 1e-9 <= slopes.min() and slopes.max() <= high[k] + 1e-9
        assert high[k] - low[k] <= np.ptp(slopes) + 0.35


@pytest.mark.parametrize("kept", [10, 1])
@pytest.mark.parametrize("k", range(6))
def test_trim_errors_are_covered_and_the_covering_touches_them(
    study: SimpleNamespace, k: int, kept: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(study.cells.Cells.spread.__globals__, "_KEPT", kept)
    texts = [study.angles.TRIM[(k + j) % 6].format(a="0.3", c="cos(psi)", s="sin(psi)") + f" - 2*x{j}" for j in (0, 1)]
    rows, names, p = rows_of(study, texts)
    factor, spread = rows.spread(p)
    for cell in range(2):
        at = sampled(study, rows, names, p, cell, 4000)
        still = {name: np.zeros(4000) if name in ("x0", "x1") else value for name, value in at.items()}
        e = exact(names, texts, still)
        scale = still["p"] if factor >= 0 else np.ones(4000)
        size = np.einsum("in,ij,jn->n", e / scale, np.linalg.inv(spread[cell] + 1e-18 * np.eye(2)), e / scale)
        assert size.max() <= 1
        assert size.max() > (0.5 if kept > 1 else 0.1)


@pytest.mark.parametrize(("share", "decreases"), [(1.001, True), (0.999, False)])
def test_a_decrease_that_a_trim_error_prevents_by_little_is_rejected(
    study: SimpleNamespace, share: float, decreases: bool
) -> None:
    # x' = −x + 0.3 p with p ≤ 1.3 and V = x²/1.3: V' < −0.05 V from x = 2 · 0.39/1.95 = 0.4 on
    rows, _, p = rows_of(study, ["-x0 + 0.3*p"], n=1)
    decrease = study.cells.Decrease(rows, [study.cells.Form(p, np.zeros((1, 1)))], p)
    low = share * 0.4**2 * p[0, 0]
    assert (decrease.growth(np.array([0, 1]), 0.05, low, [0.39 / 0.4 / share**0.5]) is not None) is decreases


@pytest.mark.parametrize(("period", "decreases"), [(0.05, True), (0.15, True), (0.78, False), (1.2, False)])
def test_the_rule_for_held_commands_shows_a_decrease_only_for_short_periods(
    study: SimpleNamespace, period: float, decreases: bool
) -> None:
    # x' = −2 p x̂: x⁺ = (1 − 2 p period) x, which does not converge for 2 p period ≥ 2, p ≤ 1.3
    names, box = ["x0", "x", "psi", "p"], [(np.array([0.3]), np.array([0.4])), (np.array([0.8]), np.array([1.3]))]
    rows = study.cells.Cells(
        names, ["-2*p*x", "0"], np.eye(2), np.ones(1), box, {}, np.zeros(1, dtype=int), groups=[1, 1]
    )
    shown = []
    for pull in (1.0, 3.0, 10.0, 30.0):
        forms = study.cells.held(np.eye(1), 1, period, pull)
        decrease = study.cells.Decrease(rows, forms, np.eye(2))
        shown.append(decrease.growth(np.zeros(1, dtype=int), 0.05, 0.1, [1e-3]) is not None)
    assert any(shown) is decreases


def test_no_decrease_is_shown_that_a_state_contradicts(study: SimpleNamespace) -> None:
    shown = 0
    for seed in range(100, 104):
        system = study.angles.drawn(seed)
        level = study.angles.largest(system, np.geomspace(1e-3, 100.0, 16))
        shown += level > 0
        assert not level or not system.contradicted(level, seed)
    assert shown >= 3


@pytest.mark.parametrize(("gain", "decreases"), [(1.075, True), (1.1005, False)])
@pytest.mark.parametrize(("c", "s"), [("cos(psi)", "sin(psi)"), ("sin(psi)", "cos(psi)")])
def test_a_decrease_that_fails_by_little_at_one_angle_is_rejected(
    study: SimpleNamespace, gain: float, decreases: bool, c: str, s: str
) -> None:
    # V' = (−1.15 + gain cos²) x² at the worst angle, with terms that cancel, and a growth of 0.02 in the proof
    rate = f"0.5*x0*(-1.15 + {gain}*{c}^2) + {s}*({c}*x0 - 3*{s}*x0) - {c}*({s}*x0 + 3*{c}*x0) + 3*x0"
    first = -0.5 if c == "cos(psi)" else np.pi / 2 - 0.5
    assert study.angles.System((rate,), np.eye(1), (first, first + 1.0), 20).shown(1.0) is decreases


def test_a_cruise_decays_at_all_samples_of_the_level_that_is_shown(study: SimpleNamespace) -> None:
    document = json.loads((STUDY.parents[1] / "tests" / "certcheck" / "region-cruise-20.json").read_text())
    proof, rate = document["proof"], document["claim"]["motion"]["rate_per_s"]
    proof |= {"floor": proof["shells"][-3]["level"], "shells": proof["shells"][-2:]}
    loop = study.cruise.cruise(document["claim"], proof)
    p = np.array(study.cruise.triangle(proof["P"], 4, "P"), dtype=float)
    random, count = np.random.default_rng(0), 10_000
    x = np.linalg.inv(np.linalg.cholesky(p)).T @ random.normal(size=(4, count))
    v = np.einsum("in,ij,jn->n", x, p, x)
    x *= np.sqrt(random.uniform(proof["floor"], 1, count) / v)
    at = {name: random.choice(ends, count) for name, ends in loop.ranges.items()}
    for pair, vertices in loop.polytopes.items():
        at |= dict(zip(pair, vertices[random.integers(len(vertices), size=count)].T, strict=True))
    at |= dict(zip(loop.states, x, strict=True)) | {"psi": random.uniform(0, np.pi / 2, count)}
    f = exact(list(at), loop.rates, at)
    excess = 2 * np.einsum("in,ij,jn->n", f, p, x) / np.einsum("in,ij,jn->n", x, p, x)
    assert excess.max() < -rate
    assert study.cruise.check(document, 48, 1.0)[0] == proof["floor"]
    false = copy.deepcopy(document)
    false["claim"]["motion"]["rate_per_s"] = 1.001 * float(-excess.max())
    assert study.cruise.check(false, 48, 1.0)[0] > proof["floor"]
