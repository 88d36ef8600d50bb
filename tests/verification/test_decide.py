import re
import sys
import time
from collections import Counter
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from surctl.certcheck import Checked, check_document
from surctl.errors import InputError
from surctl.verification import Claim, Variable, decide, evaluate, prove
from surctl.verification.proving import certain_excess
from tests.verification.made_claims import claim_from, made

EACH = 6


def verdicts(*, true: bool) -> Counter[str]:
    found: Counter[str] = Counter()
    for seed in range(EACH):
        claim, gap = made(seed, true=true)
        verdict = decide(claim, samples=256, starts=4, time_limit=3.0)
        wrong = "refuted" if true else "proved"
        assert verdict.verdict != wrong, (claim.name, claim.statement, gap, verdict.to_dict())
        if verdict.certificate is not None:
            assert check_document(verdict.certificate).accepted
        found[verdict.verdict] += 1
    return found


def test_no_true_claim_is_refuted_and_nearly_all_are_proved() -> None:
    assert verdicts(true=True)["proved"] >= EACH - 2


def test_no_false_claim_is_proved_and_nearly_all_are_refuted() -> None:
    assert verdicts(true=False)["refuted"] >= EACH - 1


def test_a_claim_that_is_false_by_a_hair_is_not_proved_whatever_the_falsifier_sees() -> None:
    # the excess of 1e-6 is met on a spot of 1e-3: two samples and one search that starts far away do not see it
    claim = claim_from("spot", {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, "1e-6 - (x - 0.3)^2 - (y - 0.4)^2", "0")
    proof = prove(claim, time_limit=0.6, slack=1e-9)
    assert proof.certificate is None and "open" in proof.remaining
    (told, *_) = proof.open_boxes
    # what is open lies about the spot
    assert all(abs(sum(told[name]) / 2 - at) < 0.1 for name, at in (("x", 0.3), ("y", 0.4)))


def test_what_stops_a_proof_is_named() -> None:
    divided = prove(claim_from("d", {"x": (-1.0, 1.0)}, "-1/x^2", "0"), time_limit=0.2)
    assert "division by an interval that contains 0" in divided.remaining
    rooted = prove(claim_from("r", {"x": (-1.0, 1.0)}, "-sqrt(x)", "0"), time_limit=0.2)
    assert "square root of an interval that is partly negative" in rooted.remaining


def test_the_time_limit_is_kept() -> None:
    hard = claim_from("hard", dict.fromkeys("abcdef", (-2.0, 2.0)), "sin(a*b)*cos(c*d) + sin(e*f)*sin(a + c)", "1.9999")
    began = time.process_time()
    verdict = decide(hard, samples=64, starts=2, time_limit=1.0)
    assert verdict.verdict in ("unknown", "refuted") and time.process_time() - began < 8


def test_what_is_left_open_counts_the_boxes_of_all_attempts(monkeypatch: pytest.MonkeyPatch) -> None:
    module = sys.modules["surctl.verification.proving.prove"]
    for name in ("_ROUNDS", "_EXACT_ROUNDS"):
        monkeypatch.setattr(module, name, ((20, 0.0), (200, 1.0)))
    monkeypatch.setattr(module, "_SHARE", 0.0)  # no sums of squares
    proof = prove(claim_from("close", {"x": (-4.0, 4.0), "y": (-4.0, 4.0)}, "sin(3*x)*cos(2*y)*sin(x*y)", "0.9"))
    words = r"the limit on boxes was reached after (\d+) boxes: (\d+) open"
    matched = re.search(words, proof.remaining)
    assert matched is not None, proof.remaining
    said, open_boxes = matched.groups()
    assert int(said) >= 220 and int(said) == proof.boxes and int(open_boxes) == len(proof.open_boxes)


def test_bounds_given_as_integers_are_halved_like_numbers() -> None:
    x = ca.SX.sym("x")
    for kind in (int, float):
        bounds = Variable("x", x, "1", kind(0), kind(3), "")
        claim = Claim("waves", "", "", (), "proved", (bounds,), ca.sin(3 * x) + x / 10, ca.SX(1.3), "1")
        assert decide(claim).verdict == "proved"


@pytest.mark.parametrize(
    ("left", "right", "constraints"),
    [
        ("atan2(y, x)", "1", ()),  # the worst lies on the branch cut, where intervals hold all angles
        ("atan2(y, x)", "1", ("x - y",)),
        ("-atan2(y, x)", "1", ()),
        ("abs(atan2(y, x))", "3", ()),
        ("sqrt(x + 1) + sqrt(1 - y)", "2", ()),  # and on the edge of where a root is defined
        ("acos(x)", "2", ("y - 0.5",)),
    ],
)
def test_whoever_has_a_violating_sample_has_a_counterexample(left, right, constraints) -> None:
    box = {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}
    verdict = decide(claim_from("cut", box, left, right, constraints), samples=256, starts=4, time_limit=1.0)
    assert verdict.verdict == "refuted" and verdict.counterexample is not None, verdict.remaining
    margin, inside = evaluate(verdict.claim, verdict.counterexample.values)
    assert inside and margin > 0


def test_how_certain_an_excess_is_at_many_points_at_once() -> None:
    claim = claim_from("cut", {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, "atan2(y, x)", "1")
    sure = certain_excess(claim, np.array([[-0.5, -0.5, 2.0], [0.0, 0.5, 0.5]]))
    assert sure[0] < 0 and sure[1] == pytest.approx(0.75 * np.pi - 1) and sure[2] == -np.inf


def test_a_constraint_prunes() -> None:
    box = {"x": (-2.0, 2.0), "y": (-2.0, 2.0)}
    assert decide(claim_from("in", box, "x*y", "0.5001", ("x^2 + y^2 - 1",))).verdict == "proved"
    assert decide(claim_from("out", box, "x*y", "0.4999", ("x^2 + y^2 - 1",))).verdict == "refuted"


def test_equality_at_a_point_is_proved_exactly() -> None:
    verdict = decide(claim_from("touch", {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, "x*y", "x^2 + y^2"))
    assert verdict.verdict == "proved" and verdict.certificate is not None
    assert verdict.certificate["claim"]["slack"] == 0.0


def test_a_claim_that_is_proved_to_within_a_slack_says_so_beside_its_worst_margin() -> None:
    claim = claim_from("near", {"x": (-1.0, 1.0)}, "x^2", "0.95")
    told = decide(replace(claim, tolerance=0.1)).to_dict()  # of the larger side, 1
    assert told["verdict"] == "proved" and 0 < told["worst_margin"] <= told["slack"] <= 0.1 * 1.0001
    exact = decide(claim_from("sure", {"x": (-1.0, 1.0)}, "x^2", "1")).to_dict()
    assert 0 <= exact["slack"] < 1e-9 and exact["worst_margin"] <= 0
    assert decide(claim).to_dict()["slack"] is None


def test_rounding_alone_refutes_nothing() -> None:
    # both sides are 0 but for rounding, so that any threshold relative to them is below it
    zero = claim_from("zero", {"x": (-3.0, 3.0), "y": (0.1, 3.0)}, "x - sqrt(x^2 + y^2)*sin(atan2(x, y))", "0")
    assert decide(zero).verdict == "proved"


def test_an_identity_is_proved_exactly() -> None:
    plain = decide(claim_from("plain", {"x": (-3.0, 3.0), "y": (0.1, 3.0)}, "x", "sqrt(x^2 + y^2)*sin(atan2(x, y))"))
    assert plain.certificate is not None
    assert plain.verdict == "proved" and plain.certificate["claim"]["slack"] == 0.0


def test_a_counterexample_lies_in_the_domain_by_interval_arithmetic() -> None:
    # without care the search would sit 1e-9 outside of the thin strip, where a slope of 1e4 makes an excess of 1e-5
    claim = claim_from("edge", {"x": (0.0, 1.0), "y": (0.0, 1.0)}, "10000*(x - 0.5)", "0", ("x - 0.5",))
    assert decide(claim).verdict == "proved"


def test_what_the_checker_rejects_is_not_proved(monkeypatch: pytest.MonkeyPatch) -> None:
    claim = claim_from("x", {"x": (0.0, 1.0)}, "x", "2")
    assert decide(claim).verdict == "proved"
    refusal = Checked(False, "because", "interval", {}, 0.0)
    # the package gives the function the name of its module
    monkeypatch.setattr(sys.modules["surctl.verification.decide"], "check_document", lambda _: refusal)
    verdict = decide(claim)
    assert verdict.verdict == "unknown" and verdict.certificate is None
    assert "rejects the proof: because" in (verdict.remaining or "")


def test_operations_that_the_grammar_does_not_have_are_left_open() -> None:
    x = ca.SX.sym("x")
    claim = Claim(
        "floor", "", "", (), "proved", (Variable("x", x, "1", 0.0, 1.0, ""),), ca.floor(x), ca.SX(2), "1"
    )  # fmt: skip
    verdict = decide(claim)
    assert verdict.verdict == "unknown" and "floor" in (verdict.remaining or "")


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_nonsense_limits_are_refused(limit) -> None:
    with pytest.raises(InputError):
        prove(claim_from("x", {"x": (0.0, 1.0)}, "x", "2"), time_limit=limit)
