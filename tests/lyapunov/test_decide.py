from __future__ import annotations

from pathlib import Path

import pytest

from surctl.certcheck import check_document
from surctl.lyapunov import Bound, decide_motion, load_problem, solve
from surctl.verification.formula import parse, variable
from tests.lyapunov.problems import DECAY, MAP, VAN_DER_POL, written

TRUE_AND_FALSE = [
    # the least V at which V' = 0 is 2.32 (checked by an optimisation over the angle)
    (VAN_DER_POL, ("level = 2.0", "level = 2.0"), "proved"),
    (VAN_DER_POL, ("level = 2.0", "level = 2.4"), "refuted"),
    (VAN_DER_POL, ("level = 2.0", "level = 0.5\nrate = 0.3"), "proved"),
    (VAN_DER_POL, ("level = 2.0", "level = 0.5\nrate = 1.0"), "refuted"),
    # V is not positive
    (VAN_DER_POL, ("1.5*x^2 - x*y + y^2", "x^2 - 2*x*y + 0.9*y^2"), "refuted"),
    # the level set leaves the box
    (VAN_DER_POL, ("lower = -3, upper = 3, unit = \"m\"", "lower = -1, upper = 1, unit = \"m\""), "refuted"),
    (DECAY, ("x - 1.5", "x - 1.5"), "proved"),
    (DECAY, ("x - 1.5", "x - 0.9"), "refuted"),  # B > 0 in the initial set
    (DECAY, ("x - 1.5", "x - 2.5"), "refuted"),  # B < 0 in the unsafe set
    (DECAY, ("multiplier = \"-1\"", "multiplier = \"-2\""), "refuted"),  # -k x > -2 (x - 1.5) at x = 3, k = 0.8
    (MAP, ("rate = 0.2", "rate = 0.2"), "proved"),
    (MAP, ("rate = 0.2", "rate = 0.9"), "refuted"),
    (MAP, ("0.5*x + 0.2*y^2", "3*x"), "refuted"),  # the successor leaves the box
]  # fmt: skip


@pytest.mark.parametrize(("text", "change", "verdict"), TRUE_AND_FALSE)
def test_true_claims_are_proved_and_false_ones_refuted(
    tmp_path: Path, text: str, change: tuple[str, str], verdict: str
) -> None:
    decision = solve(load_problem(written(tmp_path, text, change)))
    assert decision.verdict == verdict, decision.reason
    assert bool(decision.document) == (verdict == "proved")
    assert bool(decision.counterexample) == (verdict == "refuted")
    if decision.document:
        assert check_document(decision.document).accepted


def test_an_ultimate_bound_is_proved_with_its_gain(tmp_path: Path) -> None:
    # x' = -x + w with V = x²: V' + V = -x² + 2xw <= 1.5 w²
    text = """
kind = "lyapunov"
name = "driven"
[states]
x = { rate = "-x + w", lower = -2, upper = 2 }
[parameters]
w = { lower = -0.5, upper = 0.5 }
"""
    d = load_problem(written(tmp_path, text)).dynamics
    square = parse("x^2", {"x": variable("x")})
    bound = Bound(d, square, level=1.0, rate=1.0, gains={"w": 1.5})
    assert bound.ultimate == 0.375
    assert decide_motion(bound).verdict == "proved"
    assert decide_motion(Bound(d, square, level=1.0, rate=1.0, gains={"w": 0.9})).verdict == "refuted"
    # a level below the bound is not invariant
    low = decide_motion(Bound(d, square, level=0.2, rate=1.0, gains={"w": 1.5}))
    assert low.verdict == "unknown"
    assert "exceeds the level" in low.reason


STRICT = [
    # only bounds of a proof fail: V' = -2 x^8 - 2 y^2, V' = 0 on the boundary V = 1 of the region, B = 1e-10 at x = 1
    ("-x^7", "-y", 'function = "x^2 + y^2"\nlevel = 0.5', "unknown"),
    ("-x + x^3", "-y", 'function = "x^2 + y^2"\nlevel = 1', "unknown"),
    # V' = 0 away from the equilibrium
    ("y", "-x - y", 'function = "x^2 + y^2"\nlevel = 1', "refuted"),
    ("sin(y)", "-sin(x) - y", 'function = "2 - cos(x) - cos(y)"\nlevel = 0.5', "refuted"),
    ("-y", "x", 'function = "x^2 + y^2"\nlevel = 1\ntime = "discrete"', "refuted"),
    # V = 0 away from the equilibrium
    ("-x", "-y", 'function = "(x - y)^2"\nlevel = 1', "refuted"),
]


@pytest.mark.parametrize(("x", "y", "claim", "verdict"), STRICT)
def test_only_a_counterexample_to_the_claim_refutes_it(
    tmp_path: Path, x: str, y: str, claim: str, verdict: str
) -> None:
    word = "next" if "discrete" in claim else "rate"
    states = "".join(
        f'{name} = {{ {word} = "{text}", lower = -1.5, upper = 1.5 }}\n' for name, text in (("x", x), ("y", y))
    )
    text = f'kind = "lyapunov"\nname = "strict"\n{claim}\n[states]\n{states}'
    decision = solve(load_problem(written(tmp_path, text)), time_limit=5.0)
    assert decision.verdict == verdict, decision.reason
    assert ("bound of the proof fails" in decision.reason) == (verdict == "unknown")


def test_a_barrier_that_is_barely_positive_in_the_unsafe_set_is_not_refuted(tmp_path: Path) -> None:
    small = ("x - 1.5", "1e-10*(x - 1.5)")
    assert solve(load_problem(written(tmp_path, DECAY, small))).verdict == "unknown"
    touching = ("x - 1.5", "x - 2")
    assert solve(load_problem(written(tmp_path, DECAY, touching))).verdict == "refuted"


def test_the_statement_of_a_barrier_contains_what_may_be_refuted(tmp_path: Path) -> None:
    # no solution from |x| <= 1 reaches x >= 2; only the inequality with this multiplier fails
    decision = solve(load_problem(written(tmp_path, DECAY, ('multiplier = "-1"', 'multiplier = "-2"')))).decision
    assert decision is not None
    assert decision.verdict == "refuted"
    assert decision.claim.statement.endswith("reaches the unsafe set, and B' <= (-2)*B")
