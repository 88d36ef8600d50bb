import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.simulation import Case, load_scenario
from surctl.marine.tuning.request import refuted_claims
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import claims
from surctl.verification import Claim, Variable, decide, falsify
from surctl.verification.counterexample import build_oracle


def claim_of(left: ca.SX, x: ca.SX, *, half: float = 1.0, constraints: ca.SX | None = None) -> Claim:
    variables = tuple(Variable(f"x{i}", x[i], "1", -half, half, "test") for i in range(x.numel()))
    extra = {} if constraints is None else {"constraints": constraints}
    return Claim("test", "left ≤ 0", "none", (), "refuted", variables, left, ca.SX(0), "1", **extra)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.lists(st.floats(-0.9, 0.9), min_size=3, max_size=3))
def test_a_region_of_a_thousandth_of_the_box_is_found_by_the_search(centre: list[float]) -> None:
    # a ball of 1/1000 of the box: 64 samples see it in 6 % of the draws, the gradient leads there
    x = ca.SX.sym("x", 3)
    squared = (8 * 1e-3 * 3 / (4 * np.pi)) ** (2 / 3)
    verdict = falsify(claim_of(squared - ca.sumsqr(x - ca.DM(centre)), x), samples=64)
    assert verdict.verdict == "refuted"
    assert verdict.worst_margin == pytest.approx(squared, rel=1e-6)


def test_samples_alone_would_miss_it() -> None:
    x = ca.SX.sym("x", 3)
    verdict = falsify(claim_of(1e-6 - ca.sumsqr(x - 0.3), x), samples=64)
    assert verdict.verdict == "refuted" and verdict.fraction == 0.0


def test_several_hills_need_several_starts() -> None:
    x = ca.SX.sym("x", 2)
    low, high = ca.exp(-8 * ca.sumsqr(x + 0.5)), 1.2 * ca.exp(-60 * ca.sumsqr(x - 0.6))
    assert falsify(claim_of(low + high - 1.1, x), samples=256, starts=16).verdict == "refuted"
    assert falsify(claim_of(low + high - 1.1, x), samples=16, starts=1).verdict == "not refuted"


def test_the_optimum_on_a_constraint_is_met() -> None:
    x = ca.SX.sym("x", 2)
    verdict = falsify(claim_of(x[0] + x[1], x, constraints=ca.sumsqr(x) - 0.5), samples=64)
    assert verdict.worst_margin == pytest.approx(1.0, abs=1e-7)
    assert verdict.counterexample is not None
    assert sum(v**2 for v in verdict.counterexample.values.values()) <= 0.5 + 1e-9


def test_a_domain_that_no_sample_meets_is_still_searched() -> None:
    x = ca.SX.sym("x", 2)
    thin = ca.vertcat(x[0] - x[1] - 1e-7, x[1] - x[0] - 1e-7)
    verdict = falsify(claim_of(x[0] - 0.9, x, constraints=thin), samples=16)
    assert verdict.samples == 0 and verdict.verdict == "refuted"


def test_an_empty_domain_is_the_users_mistake() -> None:
    x = ca.SX.sym("x", 1)
    with pytest.raises(InputError, match="no sample lies in its domain"):
        falsify(claim_of(x, x, constraints=1 + x**2), samples=16)


def test_a_margin_that_is_not_finite_is_named_and_not_passed_over() -> None:
    x = ca.SX.sym("x", 1)
    with pytest.raises(InputError, match="not finite"):
        falsify(claim_of(ca.sqrt(x), x))


def test_equality_refutes_nothing() -> None:
    x = ca.SX.sym("x", 2)
    identity = ca.sin(x[0] + x[1]) - ca.sin(x[0]) * ca.cos(x[1]) - ca.cos(x[0]) * ca.sin(x[1])
    claim = claim_of(ca.sin(x[0] + x[1]), x)
    same = Claim(**{**vars(claim), "right": claim.left - identity})
    assert falsify(same).verdict == "not refuted"
    assert falsify(claim_of(-ca.sumsqr(x), x)).verdict == "not refuted"


def test_a_violation_just_above_rounding_is_kept() -> None:
    x = ca.SX.sym("x", 1)
    assert falsify(claim_of(1e-6 - x**2, x), samples=16).verdict == "refuted"


def test_the_same_seed_gives_the_same_verdict_and_another_seed_others_samples() -> None:
    x = ca.SX.sym("x", 2)
    claim = claim_of(x[0] * x[1] - 0.2, x)
    first, again, other = (falsify(claim, samples=128, seed=s) for s in (3, 3, 4))
    assert first == again
    assert first.fraction != other.fraction


def test_counterexamples_are_printed_short() -> None:
    x = ca.SX.sym("x", 2)
    found = falsify(claim_of(0.001 - ca.sumsqr(x - ca.DM([0.312345, 0.4])), x)).counterexample
    assert found is not None and found.values == {"x0": 0.31, "x1": 0.4}


@pytest.mark.parametrize(("samples", "starts"), [(1, 4), (0, 4), (16, 0), (16, -1)])
def test_nonsense_numbers_are_refused(samples: int, starts: int) -> None:
    x = ca.SX.sym("x", 1)
    with pytest.raises(InputError, match="at least"):
        falsify(claim_of(x, x), samples=samples, starts=starts)


def test_gradients_are_exact_and_survive_a_saturated_arccos() -> None:
    x = ca.SX.sym("x", 2)
    smooth = build_oracle(claim_of(ca.sin(3 * x[0]) * x[1], x, half=2.0))
    at = np.array([0.3, 0.8])
    step = np.array([[1e-6, 0], [0, 1e-6]])
    differences = [(smooth.margin(at + s) - smooth.margin(at - s)) / 2e-6 for s in step]
    assert smooth.gradient(at) == pytest.approx(np.array(differences), abs=1e-8)
    # slope 1 along x0 where the arccos is flat: its own derivative is not finite there
    flat = ca.acos(ca.fmin(ca.fmax(2 * x[0], -1), 1))
    saturated = build_oracle(claim_of(flat + x[0] + x[1] - 3.5, x))
    assert saturated.gradient(np.array([0.02, 0.5])) == pytest.approx([2.0, 2.0], abs=1e-6)
    assert falsify(saturated.claim, samples=64).worst_margin == pytest.approx(np.pi - 3.0, abs=1e-5)  # on a kink


def test_a_counterexample_beside_a_pole_is_not_rounded_onto_it() -> None:
    x = ca.SX.sym("x", 1)
    found = falsify(claim_of(1 / x, x)).counterexample
    assert found is not None and np.isfinite(found.margin) and found.values["x0"] > 0


def test_an_empty_domain_of_a_built_in_claim_is_vacuous_and_refutes_no_gains() -> None:
    gains = {"kappa": 30.0, "margin": 1.0}  # above every speed
    (claim,) = claims(gains, ["clearance-corrected"])
    verdict = decide(claim)
    assert verdict.verdict == "proved" and verdict.vacuous
    case = Case(load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default"), "closed_form")
    assert "clearance-corrected" not in {v.claim.name for v in refuted_claims(gains, [case])}
