"""Claims that sums of squares prove: exactly, with the checker's consent, and never a false one."""

import numpy as np
import pytest

from surctl.certcheck import check_document
from surctl.certcheck.enclosure import span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.series import same_sign
from surctl.sos.polynomial import Polynomial
from surctl.verification import prove
from surctl.verification.proving.touching import VALUES, fact_polynomial, facts_about
from tests.verification.by_squares import certificate, squares_first
from tests.verification.made_claims import claim_from

SQUARE = {"x": (-2.0, 2.0), "y": (-2.0, 2.0)}
MOTZKIN = "x^4*y^2 + x^2*y^4 + 1 - 3*x^2*y^2"
ROBINSON = "x^6 + y^6 + 1 + 3*x^2*y^2 - (x^4*(y^2 + 1) + y^4*(x^2 + 1) + x^2 + y^2)"


def coupled(count: int):
    """The rate of sum x_i^2/2 along x_i' = -x_i + 0.1 x_(i-1) x_(i+1), in a ring."""
    rate = " + ".join(f"x{i}*(-x{i} + 0.1*x{(i - 1) % count}*x{(i + 1) % count})" for i in range(count))
    return claim_from(f"coupled-{count}", {f"x{i}": (-3.0, 3.0) for i in range(count)}, rate, "0")


def test_a_coupled_system_of_six_states_is_proved() -> None:
    assert check_document(certificate(coupled(6)), time_limit=2.0).accepted


@pytest.mark.parametrize("polynomial", [MOTZKIN])  # Robinson: study 40
def test_a_polynomial_with_several_zeros_is_proved_without_slack(polynomial: str) -> None:
    claim = claim_from("zeros", SQUARE, "0", polynomial)
    assert check_document(certificate(claim), time_limit=2.0).accepted
    assert squares_first(claim_from("false", SQUARE, "1e-6", polynomial), time_limit=0.2).certificate is None


def test_a_pendulum_on_carts_rail_is_proved_on_a_level_set() -> None:
    """Sine, cosine and a denominator: the energy of a damped pendulum on a cart."""
    box = {"a": (-0.8, 0.8), "w": (-2.0, 2.0)}
    acceleration = "(-2*sin(a) - w + 0.1*w^2*sin(a)*cos(a))/(1 + 0.3*sin(a)^2)"
    claim = claim_from(
        "cart", box, f"w*(2*a + 0.4*w) + (w + 0.4*a)*{acceleration}", "0", ("a^2 + w^2/2 + 0.4*a*w - 0.4",)
    )
    document = certificate(claim)
    assert check_document(document, time_limit=2.0).accepted
    assert document["cases"][0]["denominators"]


def test_prove_turns_to_squares_when_boxes_do_not_suffice() -> None:
    claim = claim_from("zeros", SQUARE, "0", ROBINSON)
    proof = prove(claim, time_limit=40.0)
    assert proof.certificate is not None and "squares" in proof.certificate["cases"][0]


def test_an_unproved_claim_says_what_was_tried() -> None:
    proof = squares_first(claim_from("false", SQUARE, "0.01", MOTZKIN), time_limit=0.3)
    assert proof.certificate is None
    assert "sums of squares of degree up to" in proof.remaining


@pytest.mark.parametrize("seed", range(1))
def test_a_claim_false_by_a_millionth_is_never_proved(seed: int) -> None:
    """The maximum of the left side is known, and the right side lies below it by a millionth."""
    rng = np.random.default_rng(seed)
    a, b = (round(float(v), 2) for v in rng.uniform(-0.9, 0.9, size=2))
    shapes = (
        f"1 - (x - ({a}))^2*(1 + y^2) - (y - ({b}))^4",
        f"cos(x - ({a})) - (y - ({b}))^2 + x*0",
        f"sin(x - ({a}))^2 + 1 - 2*(x - ({a}))^2 - (y - ({b}))^2",
    )
    claim = claim_from("hill", {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, shapes[seed % 3], "1 - 1e-6")
    assert squares_first(claim, time_limit=0.1).certificate is None


@pytest.mark.parametrize(
    ("box", "left", "right"),
    [
        ({"x": (-1e200, 1e200)}, "-x^4*(1 + x^2)", "0"),
        ({"x": (-1e-200, 1e-200)}, "-x^2", "1e-300*x^4"),
        ({"x": (0.0, 0.0), "y": (-1.0, 1.0)}, "x*y", "0"),
        ({"x": (0.1, 0.1), "y": (-1.0, 1.0)}, "y^2*x", "0.1"),
        ({"x": (-1.0, 1.0)}, "0", "0"),
        ({"x": (-1.0, 1.0)}, "1e300*x^2", "1e300"),
        ({"x": (-1.0, 1.0)}, "sqrt(x + 1)*abs(x)", "2"),
        ({"x": (-1.0, 1.0)}, "1/(2 + x)", "1 + x^2*0"),
        ({"x": (0.0, 1.0)}, "sqrt(x) - atan2(x, 1)", "sqrt(x)"),
    ],
)  # fmt: skip
def test_odd_numbers_and_ranges_end_with_a_proof_that_is_accepted_or_with_none(box, left: str, right: str) -> None:
    proof = squares_first(claim_from("odd", box, left, right), time_limit=2.0)
    assert proof.certificate is None or check_document(proof.certificate, time_limit=2.0).accepted


@pytest.mark.parametrize("touching", [True, False])
@pytest.mark.parametrize("op", [op for op in (*VALUES, "sqrt", "acos") if op in ("sin", "cos", "atan", "sqrt", "acos")])
def test_facts_are_shown_by_the_checker_and_true(op: str, touching: bool) -> None:
    function = {"sqrt": np.sqrt, "acos": np.arccos}.get(op) or VALUES[op][0]
    for low, high in ((-0.8, 0.5), (0.25, 0.75), (-1e-3, 0.9)):
        if op == "sqrt" and low < 0:
            continue
        for fact in facts_about(op, low, high, touching=touching):
            table = ExpressionTable(["t"])
            assert same_sign(table, [table.read(text) for text in fact], span(low, high)), fact
            for t in np.linspace(low, high, 5).tolist():
                total = Polynomial.constant(1)
                for text in fact:
                    total = total * fact_polynomial(
                        text, op, Polynomial.constant(t), Polynomial.constant(float(function(t)))
                    )
                assert total.value([]) >= -1e-12
