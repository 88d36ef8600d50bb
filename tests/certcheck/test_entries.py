"""Entries of a certificate, each with the one form that it may have."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import pytest

from surctl.certcheck import interval
from surctl.certcheck.document import Rejected, listed, number, parse, read, read_bytes, record, seal, verify_frame
from surctl.errors import InputError
from tests.certcheck.test_lyapunov import _case, _state

CLAIM: dict[str, Any] = {
    "name": "n", "statement": "", "unit": "m", "variables": [_state("x", 0.0, 1.0), _state("y", 0.0, 1.0)],
    "left": "x", "right": "1", "constraints": [], "slack": 0.0,
}  # fmt: skip
PROOF = {"cases": [_case("x - 1", multipliers=())]}


def refuses(says: str, call: Any, *words: Any) -> None:
    with pytest.raises(Rejected, match=says):
        call(*words)


@pytest.mark.parametrize("value", [True, "1", None, [1.0], math.nan, math.inf, -math.inf])
def test_a_number_is_finite(value: object) -> None:
    assert number(-2.5) == -2.5 and number(2**53) == 2.0**53
    refuses("is not a finite number", number, value)


def test_an_integer_is_exact() -> None:
    for value in (2**53 + 1, -(2**53) - 1):
        refuses("too large to be represented exactly", number, value)


def test_lists_and_records() -> None:
    assert listed([]) == [] and record({"a": 1}, {"a"}, "it") == {"a": 1}
    for value in ((), {}, "ab", None):
        refuses("a list is missing", listed, value)
    for value in (["a"], "a", {}, {"a": 1, "b": 1}, None):
        refuses("it must have exactly the keys a, not", record, value, {"a"}, "it")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"format": "other"}, "the format is not 'surctl-certificate'"),
        ({"version": 1}, "this checker reads version 2 of kind 'interval' only: prove the claim again"),
        ({"version": 3}, "reads version 2"),
        ({"version": 2.0}, "the version is 2.0"),
        ({"kind": 3}, "the key kind or claim is missing"),
        ({"claim": []}, "the key kind or claim is missing"),
        ({"sha256": "0" * 64}, "the hash does not match the content"),
        ({"more": 1}, "the hash does not match the content"),
        ({"more": math.inf}, "cannot be written as canonical JSON"),
    ],
)
def test_the_frame_of_a_certificate(change: dict[str, Any], says: str, tmp_path: Path) -> None:
    good = seal("interval", CLAIM, PROOF)
    verify_frame(good)
    refuses(says, verify_frame, good | change)
    if "format" not in change and "inf" not in str(change):
        path = tmp_path / "c.json"
        path.write_text(json.dumps(good | change))
        refuses(says, read, path)


def test_a_kind_whose_format_changed_has_a_version_of_its_own() -> None:
    good = seal("braking", CLAIM, PROOF)
    verify_frame(good)
    says = "the version is 2, but this checker reads version 3 of kind 'braking' only: prove the claim again"
    refuses(says, verify_frame, good | {"version": 2})


def test_only_a_regular_file_of_limited_size_is_read(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_bytes(path, 5, remedy="") == b"12345"
    with pytest.raises(InputError, match="is larger than 4 bytes"):
        read_bytes(path, 4, remedy="")
    with pytest.raises(InputError, match="cannot be read"):
        read_bytes(tmp_path / "none", 5, remedy="")
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(InputError, match="is not a regular file"):
        read_bytes(tmp_path / "fifo", 5, remedy="")


def test_a_key_occurs_once() -> None:
    assert parse(b'{"a": {"b": 1}, "b": 2}', "c.json", remedy="") == {"a": {"b": 1}, "b": 2}
    with pytest.raises(InputError, match="the key 'b' occurs 2 times"):
        parse(b'{"a": 1, "b": 1, "b": 1}', "c.json", remedy="")


# inequalities


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"more": 1}, "claim must have exactly the keys"),
        ({"name": 3}, "3 is not a name or unit that can be printed"),
        ({"name": "a\nb"}, "can be printed"),
        ({"unit": "a\nb"}, "can be printed"),
        ({"unit": None}, "can be printed"),
        ({"slack": -1e-300}, "the slack is negative"),
        ({"left": "x + 1"}, "do not make up the claim"),
        ({"left": "2", "constraints": [], "cases": [_case("2 - 1", multipliers=())]}, "does not decide a box"),
        ({"cases": [_case("x - 1", multipliers=("log(x)",))], "constraints": ["0"]}, "not defined where it must be"),
        ({"proof": 1}, "the certificate must have exactly the keys"),
    ],
)
def test_an_inequality_and_its_proof(change: dict[str, Any], says: str) -> None:
    interval.check(seal("interval", CLAIM, PROOF))
    claim = CLAIM | {key: value for key, value in change.items() if key not in ("cases", "proof")}
    evidence = PROOF | {key: value for key, value in change.items() if key in ("cases", "proof")}
    refuses(says, interval.check, seal("interval", claim, evidence))


def named(*names: Any, **entries: Any) -> list[dict[str, Any]]:
    return [_state(name, 0.0, 1.0) | entries for name in names]


@pytest.mark.parametrize(
    ("variables", "says"),
    [
        ([], "must have 1 to 36 variables"),
        (named(*(f"x{k}" for k in range(37))), "must have 1 to 36 variables"),
        (named("x", "x"), "with different names"),
        *((named(*names), "is not a name of a variable") for names in ((3, "x"), ("x", 3), ("1x", "y"), ("x", "y z"))),
        (named("x", "sin"), "has the name of a number or a function"),
        (named("pi", "x"), "has the name of a number or a function"),
        *((named("x", "y", unit=unit), "can be printed") for unit in (3, "\n")),
        (named("x", more=1), "a variable must have exactly the keys"),
        *(([_state("x", *first), _state("y", *second)], "lower end lies above its upper end")
          for first, second in (((1.0, 0.0), (0.0, 1.0)), ((0.0, 1.0), (1.0, 0.0)))),
    ],
)  # fmt: skip
def test_the_variables_of_a_claim(variables: list[Any], says: str) -> None:
    assert interval.variables_of(named("x", "y_1")) == (["x", "y_1"], [(0.0, 1.0)] * 2)
    assert len(interval.variables_of(named(*(f"x{k}" for k in range(36))))[0]) == 36
    refuses(says, interval.variables_of, variables)


def test_each_word_is_printable() -> None:
    interval.printable("a", "b c", "")
    for words in (("\n", "a", "b"), ("a", "\n", "b"), ("a", "b", "\n"), ("a", 3)):
        refuses("can be printed", interval.printable, *words)
