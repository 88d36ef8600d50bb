"""Claims with exp, log, tanh, tan, asin, sinh, cosh and fractional powers: proved, and refuted where they are false."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from surctl.certcheck import check_document
from surctl.verification import Claim, decide, load_claim
from surctl.verification.claim import Variable
from surctl.verification.falsifier import falsify
from surctl.verification.formula import parse, variable
from surctl.verification.proving import prove
from surctl.verification.proving.tape import build_tape

TRUE = [
    ("1 + x", "exp(x)", (-1.0, 1.0), 0.0), ("log(1 + x)", "x", (-0.9, 5.0), 0.0), ("x", "tan(x)", (0.0, 1.5), 0.0),
    ("x", "asin(x)", (0.0, 1.0), 0.0), ("tanh(x)", "x", (0.0, 9.0), 0.0), ("x", "sinh(x)", (0.0, 5.0), 0.0),
    ("1", "cosh(x)", (-2.0, 2.0), 0.0), ("tanh(x)^2", "x^2", (-1.0, 1.0), 1e-9),
    ("x^(1/3)", "1 + (x - 1)/3", (0.0, 4.0), 1e-9), ("-x^-1.5", "-1/8", (0.25, 4.0), 1e-9),
]  # fmt: skip


def claim(folder: Path, left: str, right: str, box: tuple[float, float], constants: str = "") -> Claim:
    path = folder / "claim.toml"
    lines = ['kind = "claim"', 'name = "c"', f'left = "{left}"', f'right = "{right}"', "[constants]", constants]
    path.write_text(
        "\n".join([*lines, "[variables]", f"x = {{ lower = {box[0]}, upper = {box[1]} }}"]), encoding="utf-8"
    )
    return load_claim(path)


@pytest.mark.parametrize(("left", "right", "box", "slack"), TRUE[1::2])  # all of them: study 40
def test_a_true_claim_is_proved_and_one_that_is_false_by_a_millionth_is_refuted(
    left, right, box, slack, tmp_path
) -> None:
    proof = prove(claim(tmp_path, left, right, box), slack=slack, time_limit=5)
    assert proof.certificate is not None, proof.remaining
    assert check_document(proof.certificate).accepted and proof.slack <= slack / 1000
    wrong = claim(tmp_path, f"{left} + 1e-6", right, box)
    assert decide(wrong, samples=64, starts=2, time_limit=1).verdict == "refuted"


def test_an_equality_is_proved_by_a_tangent_at_its_point(tmp_path) -> None:
    proof = prove(claim(tmp_path, "1 + x", "exp(x)", (-1.0, 1.0)))
    assert [(case["tree"], case["points"]) for case in proof.certificate["cases"]] == [("c", [[0.0]])]


def test_a_claim_in_casadi_may_use_them() -> None:
    x = ca.SX.sym("x")
    left = ca.tanh(x) * ca.exp(-x) + ca.power(x, 0.75) - ca.log1p(x) - ca.tan(x / 9)
    one = Claim("c", "", "", (), "proved", (Variable("x", x, "1", 0.0, 2.0, ""),), left, ca.SX(0.9), "1")
    assert decide(one, samples=64, starts=2, time_limit=5).verdict == "proved"


def test_an_exponent_may_be_a_constant_of_the_file(tmp_path) -> None:
    proof = prove(claim(tmp_path, "x^n", "1", (0.0, 1.0), "n = 0.8"))
    assert proof.certificate is not None and proof.certificate["claim"]["left"] == "x^0.8"


@pytest.mark.parametrize(
    ("left", "box", "told"),
    [("-log(x)", (0.0, 1.0), "logarithm of an interval"), ("-tan(x)^2", (0.0, 3.0), "tangent of an interval"),
     ("-exp(x)", (0.0, 2e5), "exp of an interval beyond 100000"),
     ("-x^0.5", (-1e-9, 1.0), "fractional power of an interval"),
     ("exp(exp(exp(x)))", (0.0, 9.0), "exp of an interval beyond 100000")],
)  # fmt: skip
def test_where_a_function_is_not_defined_is_told_in_one_line(left, box, told) -> None:
    tape = build_tape(("x",), [parse(left, {"x": variable("x")})])
    _, trouble = tape.trouble((np.array([[box[0]]]), np.array([[box[1]]])))
    assert told in trouble and "\n" not in trouble


def test_a_tower_of_exponentials_is_answered_in_one_line(tmp_path) -> None:
    tower = falsify(claim(tmp_path, "exp(exp(exp(x)))", "1", (0.0, 9.0)), samples=64, starts=2)
    assert tower.verdict == "refuted" and tower.counterexample is not None
    proof = prove(claim(tmp_path, "-exp(exp(exp(x)))", "0", (0.0, 9.0)), time_limit=0.3)
    assert proof.certificate is None and proof.remaining and "\n" not in proof.remaining
