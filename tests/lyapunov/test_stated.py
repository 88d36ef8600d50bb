"""What a problem states is never exchanged, and a verdict's first line says what it does not cover."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from surctl.certcheck import check_document, seal
from surctl.errors import InputError
from surctl.lyapunov import Solution, continuous_dynamics, find_stability, load_problem, solve
from tests.lyapunov.problems import DECAY, written
from tests.lyapunov.test_search import _loop

PENDULUM = """
kind = "lyapunov"
name = "pendulum"
function = "0.5*w^2 + 9.81*(1 - cos(q))"
rate = 0.001
[states]
q = { rate = "w", lower = -1, upper = 1 }
w = { rate = "-9.81*sin(q) - 0.5*w", lower = -3, upper = 3 }
"""
HARMONIC = """
kind = "lyapunov"
name = "harmonic"
function = "x^2 - 0.1*x*y + y^2"
rate = 1.2
[states]
x = { rate = "-x - y", lower = -1, upper = 1 }
y = { rate = "x", lower = -1, upper = 1 }
"""
PREY = """
kind = "lyapunov"
name = "prey"
function = "x - 1 - log(x) + y - 1 - log(y)"
[states]
x = { rate = "x - x*y", lower = 0.5, upper = 1.5, equilibrium = 1 }
y = { rate = "x*y - y", lower = 0.5, upper = 1.5, equilibrium = 1 }
"""
DRIFT = """
kind = "barrier"
name = "drift"
barrier = "-1"
multiplier = "0"
initial = ["x <= 0"]
unsafe = ["x >= 5"]
[states]
x = { rate = "1", lower = -2, upper = 2 }
"""


def solved(folder: Path, text: str, *changes: tuple[str, str]) -> Solution:
    return solve(load_problem(written(folder, text, *changes)), time_limit=20.0)


def test_a_function_that_is_stated_is_refuted_and_another_one_offered(tmp_path: Path) -> None:
    found = solved(tmp_path, PENDULUM)
    q, w = found.counterexample["q"], found.counterexample["w"]
    energy = 0.5 * w**2 + 9.81 * (1 - np.cos(q))
    assert found.verdict == "refuted" and -0.5 * w**2 > -0.001 * energy
    assert "  V = 0.5*w^2 + 9.81*(1 - cos(q))" in found.lines()
    function, _, level = found.instead.partition('", level = ')
    again = solved(
        tmp_path, PENDULUM, ('"0.5*w^2 + 9.81*(1 - cos(q))"', f'{function.removeprefix("function = ")}"'),
        ("rate = 0.001", f"rate = 0.001\nlevel = {level}"),
    )  # fmt: skip
    assert again.verdict == "proved"
    still = solved(tmp_path, PENDULUM, ("rate = 0.001\n", ""))
    assert still.verdict == "refuted" and still.counterexample["w"] == 0


@pytest.mark.parametrize("level", ["", "level = 0.5\n"])
def test_a_rate_above_the_slowest_eigenvalue_is_refuted_by_it(level: str, tmp_path: Path) -> None:
    found = solved(tmp_path, HARMONIC, ("rate = 1.2\n", f"rate = 1.2\n{level}"))
    assert found.verdict == "refuted" and "eigenvalue -0.5 ± 0.866025i" in found.reason and "above 1" in found.reason
    x, y = (Fraction(found.counterexample[name]) for name in "xy")
    change = (2 * x - y / 10) * (-x - y) + (2 * y - x / 10) * x
    assert change > -Fraction(6, 5) * (x * x - x * y / 10 + y * y)
    searched = solved(tmp_path, HARMONIC, ('function = "x^2 - 0.1*x*y + y^2"\n', ""))
    assert searched.verdict == "refuted" and "eigenvalue" in searched.reason


def test_a_quartic_function_may_decay_faster(tmp_path: Path) -> None:
    text = HARMONIC.replace("x^2 - 0.1*x*y + y^2", "x^4 + y^4").replace("rate = 1.2", "rate = 3.9\nlevel = 0.5")
    rates = ('rate = "-x - y"', 'rate = "-x"'), ('rate = "x"', 'rate = "-y"')
    assert solved(tmp_path, text, *rates).verdict == "proved"


def test_an_equilibrium_that_is_stated_is_not_exchanged(tmp_path: Path) -> None:
    text = (
        'kind = "lyapunov"\nname = "one"\n[states]\nx = { rate = "1 - x", lower = -1, upper = 2, equilibrium = 0.5 }\n'
    )
    found = solved(tmp_path, text)
    assert (found.verdict, dict(found.counterexample)) == ("refuted", {"x": 0.5})
    assert "x = 0.5 is not an equilibrium" in found.reason and "equilibria are x = 1" in found.reason
    searched = solved(tmp_path, text, (", equilibrium = 0.5", ""))
    assert searched.verdict == "proved" and "  equilibrium x = 1" in searched.lines()
    with pytest.raises(InputError, match="is not an equilibrium"):
        find_stability(load_problem(written(tmp_path, text)).dynamics)


def test_a_centre_is_named(tmp_path: Path) -> None:
    conserved = solved(tmp_path, PREY)
    assert conserved.verdict == "refuted" and "a conserved quantity may exist" in conserved.reason
    searched = solved(tmp_path, PREY, ('function = "x - 1 - log(x) + y - 1 - log(y)"\n', ""))
    assert searched.verdict == "unknown" and "a centre" in searched.lines()[0]


@pytest.mark.parametrize("discrete", [False, True])
def test_a_barrier_says_in_its_first_line_whether_the_box_is_left(discrete: bool, tmp_path: Path) -> None:
    change = [('name = "drift"', 'name = "drift"\ntime = "discrete"'), ('multiplier = "0"\n', ""), ("rate =", "next =")]
    moves = [('unsafe = ["x >= 5"]', 'unsafe = ["x >= 1"]'), ('"-1"', '"x - 0.5"')]
    stops = ('= "1"', '= "-x"' if not discrete else '= "x/2"')
    leaves = ('= "1"', '= "-1"' if not discrete else '= "x - 1"')
    text = DRIFT
    for old, new in [*moves, *(change if discrete else [])]:
        assert old in text
        text = text.replace(old, new)
    decays = [] if discrete else [('multiplier = "0"', 'multiplier = "-1"')]
    inside, outside = solved(tmp_path, text, stops, *decays), solved(tmp_path, text, leaves)
    assert inside.verdict == outside.verdict == "proved"
    assert "leaves the box or reaches the unsafe set" in inside.lines()[0]
    assert "as long as it stays in the box" in outside.lines()[0]
    for found, word in ((inside, "leaves the box"), (outside, "as long as")):
        checked = check_document(found.document)
        assert checked.accepted and word in checked.proves
    # a certificate of solutions that leave cannot claim that they stay
    forged = {k: v for k, v in outside.document.items() if k not in ("format", "version", "kind", "claim", "sha256")}
    inward = None if discrete else [1e-3, 1e-3]
    more = forged | {"inward": inward, "proofs": forged["proofs"] + inside.document["proofs"][-2:]}
    document = seal("barrier", dict(outside.document["claim"]) | {"stays": True}, more)
    assert not check_document(document).accepted


def test_what_must_move_inwards_is_checked(tmp_path: Path) -> None:
    found = solved(tmp_path, DECAY)
    evidence = {k: found.document[k] for k in ("change", "margin", "proofs", "inward")}
    claim = dict(found.document["claim"])
    assert claim["stays"] is True and check_document(seal("barrier", claim, evidence)).accepted
    for inward in ([0.0, 1e-3], [-1.0, 1e-3], [1e-3], [10.0, 1e-3], [1e-3, 10.0], None):
        assert not check_document(seal("barrier", claim, evidence | {"inward": inward})).accepted
    assert not check_document(seal("barrier", claim | {"stays": False}, evidence)).accepted
    for proofs in (evidence["proofs"][:-1], evidence["proofs"][:-2]):
        assert not check_document(seal("barrier", claim, evidence | {"proofs": proofs})).accepted


def test_a_barrier_about_empty_sets_is_called_vacuous(tmp_path: Path) -> None:
    found = solved(tmp_path, DRIFT)
    assert found.verdict == "proved" and "vacuous, because the unsafe set has no point in the box" in found.lines()[0]
    assert check_document(found.document).vacuous == "the unsafe set has no point in the box"


def test_an_undecided_claim_does_not_read_as_an_assertion(tmp_path: Path) -> None:
    small = ("x >= 2", "x >= 1.5")
    line = solve(load_problem(written(tmp_path, DECAY, small)), time_limit=1.0).lines()[0]
    assert "the claim that as long as" in line and "is neither proved nor refuted" in line


def test_dynamics_without_a_value_in_the_region_are_refuted(tmp_path: Path) -> None:
    text = 'kind = "lyapunov"\nname = "pole"\nfunction = "x^2"\nlevel = 2.0\n[states]\n'
    found = solved(tmp_path, f'{text}x = {{ rate = "-x + 0/(x - 0.3)", lower = -2, upper = 2 }}\n')
    assert found.verdict == "refuted" and "0/(x - 0.3) is not defined at x = 0.3" in found.reason


def test_the_equilibrium_of_a_law_is_its_double() -> None:
    bounds = {"angle": (-0.5, 1.0), "rate": (-4.0, 4.0)}
    values = {"reference.target": 0.3, "start.angle": 0.3, "plant.gravity": 0.0}
    d = continuous_dynamics(_loop(integral=False), bounds, values=values)
    found = find_stability(d, first=True, degree=2, time_limit=20.0)
    assert found.verdict == "proved" and found.decision is not None
    stated = found.decision.document["claim"]["equilibrium"]["angle"]
    assert isinstance(stated, str) and Fraction(stated) == Fraction(0.3) != Fraction("0.3")


@pytest.mark.parametrize("time", ["continuous", "discrete"])
@pytest.mark.parametrize("given", ['function = "x^2"\nlevel = 1.0', 'function = "x^2"', ""])
@pytest.mark.parametrize("rate", ["-sqrt(x)", "-x^(1/3)", "-sqrt(abs(x))", "-x - x^1.5/x", "-x/abs(x)"])
def test_dynamics_without_a_slope_where_they_rest_end_in_one_line(
    rate: str, given: str, time: str, tmp_path: Path
) -> None:
    key = "rate" if time == "continuous" else "next"
    (tmp_path / "p.toml").write_text(
        f'kind = "lyapunov"\nname = "p"\ntime = "{time}"\n{given}\n[states]\n'
        f'x = {{ {key} = "{rate}", lower = -2, upper = 2 }}\n'
    )
    try:
        found = solve(load_problem(tmp_path / "p.toml"), time_limit=0.5)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert found.verdict in ("refuted", "unknown")
