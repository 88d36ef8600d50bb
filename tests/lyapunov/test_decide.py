from __future__ import annotations

from pathlib import Path

import pytest

from surctl.certcheck import check_document
from surctl.lyapunov import Bound, decide_motion, load_problem, solve
from surctl.verification.formula import parse, variable
from tests.lyapunov.problems import DECAY, MAP, VAN_DER_POL, written

TRUE_AND_FALSE = [
    # the least V at which V' = 0 is 2.304477565 (roots along 6,000 rays, refined in the angle)
    (VAN_DER_POL, ("level = 2.0", "level = 2.3"), "proved"),
    (VAN_DER_POL, ("level = 2.0", "level = 2.30448"), "refuted"),
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


@pytest.mark.parametrize(("text", "change", "verdict"), TRUE_AND_FALSE[::3])  # all of them: study 40
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
    low = decide_motion(Bound(d, square, level=0.2, rate=1.0, gains={"w": 1.5}), time_limit=1.0)
    assert low.verdict == "unknown"
    assert "exceeds the level" in low.reason


@pytest.mark.parametrize(("x", "level"), [("-x^7", 0.5), ("-x + x^3", 1.0)])
def test_a_claim_is_not_refuted_where_only_a_bound_of_its_proof_fails(tmp_path: Path, x: str, level: float) -> None:
    # V' = -2 x^8 - 2 y^2; V' = 0 on the boundary V = 1 of the region
    states = "".join(
        f'{name} = {{ rate = "{rate}", lower = -1.5, upper = 1.5 }}\n' for name, rate in (("x", x), ("y", "-y"))
    )
    text = f'kind = "lyapunov"\nname = "strict"\nfunction = "x^2 + y^2"\nlevel = {level}\n[states]\n{states}'
    assert solve(load_problem(written(tmp_path, text)), time_limit=0.5).verdict != "refuted"


def test_a_barrier_that_is_barely_positive_in_the_unsafe_set_is_not_refuted(tmp_path: Path) -> None:
    small = ("x >= 2", "x >= 1.5")  # B = 0 at its edge
    assert solve(load_problem(written(tmp_path, DECAY, small)), time_limit=2.0).verdict == "unknown"


@pytest.mark.parametrize("scale", ["1e-10", "1e9"])
def test_a_barrier_may_have_any_unit(tmp_path: Path, scale: str) -> None:
    assert solve(load_problem(written(tmp_path, DECAY, ("x - 1.5", f"{scale}*(x - 1.5)")))).verdict == "proved"


def test_the_statement_of_a_barrier_contains_what_may_be_refuted(tmp_path: Path) -> None:
    # no solution from |x| <= 1 reaches x >= 2; only the inequality with this multiplier fails
    decision = solve(load_problem(written(tmp_path, DECAY, ('multiplier = "-1"', 'multiplier = "-2"')))).decision
    assert decision is not None
    assert decision.verdict == "refuted"
    assert decision.claim.statement.endswith("reaches the unsafe set, and B' <= (-2)*B")


def test_a_conserved_function_is_refuted_by_a_point_at_which_it_does_not_decrease(tmp_path: Path) -> None:
    change = ('"x - damping*y"', '"x"'), ("1.5*x^2 - x*y + y^2", "x^2 + y^2")
    decision = solve(load_problem(written(tmp_path, VAN_DER_POL, *change)))
    assert decision.verdict == "refuted"
