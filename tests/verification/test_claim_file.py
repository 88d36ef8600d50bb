import re

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.verification import claims
from surctl.verification import decide, evaluate, load_claim, replay
from surctl.verification.claim_file import write_claim

TEXT = """
kind = "claim"
name = "sway"
left = "y_e*u*sin(atan2(-y_e, ahead))"
right = "0"
unit = "m^2/s"
constraints = ["y_e^2 <= 4*ahead^2", "u >= 0.1"]
[constants]
ahead = 0.5
[variables]
y_e = { lower = -2, upper = 2, unit = "m", meaning = "cross-track error" }
u = { lower = 0.05, upper = 0.25, unit = "m/s" }
[motion]
watched = "y_e^2/2"
name = "V"
unit = "m^2"
rates = { y_e = "u*sin(atan2(-y_e, ahead))" }
"""


def from_text(tmp_path, text):
    path = tmp_path / "claim.toml"
    path.write_text(text, encoding="utf-8")
    return load_claim(path)


def test_a_file_is_the_claim_that_it_says(tmp_path) -> None:
    claim = from_text(tmp_path, TEXT)
    margin, inside = evaluate(claim, {"y_e": 0.5, "u": 0.2})
    assert margin == pytest.approx(0.5 * 0.2 * np.sin(-np.pi / 4)) and inside
    assert not evaluate(claim, {"y_e": 1.5, "u": 0.2})[1]
    assert not evaluate(claim, {"y_e": 0.5, "u": 0.06})[1]
    assert (claim.expected, claim.unit, claim.variables[0].meaning) == ("proved", "m^2/s", "cross-track error")
    assert decide(claim).verdict == "proved"


def test_a_refuted_file_is_replayed_on_its_motion(tmp_path) -> None:
    text = TEXT.replace('left = "', 'left = "0.05*u + ').replace("rates = { y_e =", 'rates = { u = "0*u", y_e =')
    claim = from_text(tmp_path, text)
    verdict = decide(claim)
    assert verdict.verdict == "refuted" and verdict.counterexample is not None
    assert replay(claim, verdict.counterexample).inside


@pytest.mark.parametrize("name", [c.name for c in claims()[::3]])
def test_every_claim_of_the_library_goes_out_and_comes_back(name, tmp_path) -> None:
    original = claims(names=[name])[0]
    again = from_text(tmp_path, write_claim(original))
    # CasADi drops what is written twice; from then on the text stays
    assert write_claim(from_text(tmp_path, write_claim(again))) == write_claim(again)
    rng = np.random.default_rng(0)
    for _ in range(40):
        at = original.values(rng.uniform(original.lower, original.upper))
        (a, inside), (b, also) = evaluate(original, at), evaluate(again, at)
        assert a == pytest.approx(b, abs=1e-13) and inside == also
    assert (again.statement, again.expected, again.errata) == (
        original.statement, original.expected, original.errata,
    )  # fmt: skip
    assert again.witnesses == tuple(dict(w) for w in original.witnesses)
    assert (again.motion is None) == (original.motion is None)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("sin(atan2(", "sinn(atan2(", r"left: 'sinn' at column 7 is not a function; did you mean 'sin'\?"),
        ("y_e*u*", "y_f*u*", r"left: 'y_f' at column 1 is not known; did you mean 'y_e'\?"),
        ("-y_e, ahead", "-y_e, ahed", r"'ahed' at column 23 is not known; did you mean 'ahead'\?"),
        ("y_e*u*", "y_e u*", r"'u' at column 5 is not expected here; write \* between"),
        ("y_e*u*", "y_e**u*", r"'\*\*' at column 4 .* write \^ for a power"),
        ("y_e*u*", "y_e^u*", r"'u' at column 5 is not an exponent; write a constant"),
        ("y_e*u*", "y_e^2^2*", r"'\^' at column 6 has no defined order here; write parentheses"),
        ("y_e*u*", "y_e.real*", r"'\.' at column 4 is not part of the grammar"),
        ("y_e*u*", "__import__(1)*", r"'__import__' at column 1 is not a function"),
        ("ahead))", "ahead)", r"'end of text' at column 29 appears where '\)' is expected; write \)"),
        ("atan2(-y_e, ahead)", "atan2(-y_e)", r"'atan2' at column 11 has 1 argument; give 2 arguments"),
        ("sin(atan2", "sin*(atan2", r"'sin' at column 7 is a function"),
        ("<= 4*ahead^2", "<= 4*ahed^2", r"constraints\.0: 'ahed' at column 12"),
        ("y_e^2 <= 4", "y_e^2 < 4", r"constraints\.0.*needs one <= or >="),
        ("u >= 0.1", "0 <= u <= 1", r"constraints\.1.*needs one <= or >="),
        ("lower = -2, upper = 2", "lower = 2, upper = -2", r"variables\.y_e.*above the upper"),
        ("lower = -2", "lower = nan", r"variables\.y_e\.lower"),
        ("ahead = 0.5", "u = 0.5", r"constants\.u: is also a variable"),
        ("ahead = 0.5", "pi = 0.5", r"constants\.pi: is not a name"),
        ("ahead = 0.5", '"a b" = 0.5', r"is not a name"),
        ("y_e = { lower", "sin = { lower", r"variables\.sin: is not a name"),
        ('right = "0"', "right = 0", r"right = 0"),
        ('unit = "m^2/s"', 'units = "m^2/s"', r"units: unknown key.*did you mean 'unit'"),
        ('kind = "claim"', 'kind = "gains"', r"kind"),
        ('name = "sway"', 'name = "../sway"', r"name"),
        ("rates = { y_e", "rates = { z_e", r"has a rate for a name that is not among its variables"),
        ("y_e*u*", "1e9999*", r"'1e9999' at column 1 is out of range"),
        ("y_e*u*", "(" * 200, r"nested too deeply"),
    ],
)
def test_a_mistake_is_told_with_file_key_token_and_column(old, new, told, tmp_path) -> None:
    assert old in TEXT
    with pytest.raises(InputError) as caught:
        from_text(tmp_path, TEXT.replace(old, new, 1))
    message = str(caught.value)
    assert "claim.toml" in message and re.search(told, message), message
    assert "\n" not in message


def test_powers_bind_tighter_than_signs(tmp_path) -> None:
    claim = from_text(tmp_path, TEXT.replace('left = "y_e*u*sin(atan2(-y_e, ahead))"', 'left = "-y_e^2 - -2^-1*u/2/2"'))
    assert evaluate(claim, {"y_e": 0.5, "u": 0.2})[0] == pytest.approx(-0.25 + 0.5 * 0.2 / 4)
