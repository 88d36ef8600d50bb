import json
import math
import re
from decimal import Decimal
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.certcheck import canonical, check_document, check_file, seal
from surctl.certcheck.document import VERSION, parse
from surctl.errors import InputError


def certificate() -> dict:
    return seal("interval", {"name": "é", "bound": 0.1}, {"cells": (1, 2)})


def test_the_canonical_text_is_sorted_dense_and_without_the_hash() -> None:
    text = canonical({"b": 0.1, "a": [1, "é"], "sha256": "x"})
    assert text == '{"a":[1,"é"],"b":0.1}'.encode()


def test_the_hash_survives_the_file(tmp_path) -> None:
    path = tmp_path / "c.json"
    path.write_text(json.dumps(certificate(), indent=2, ensure_ascii=True))
    assert "hash" not in check_file(path).reason


@pytest.mark.parametrize("key", ["version", "kind", "claim", "cells", "sha256", "extra"])
def test_any_changed_key_is_rejected_by_the_hash(key, tmp_path) -> None:
    document = certificate()
    document[key] = {"sha256": "0" * 64, "claim": {}, "version": VERSION + 1}.get(key, "other")
    path = tmp_path / "c.json"
    path.write_text(json.dumps(document))
    found = check_file(path)
    assert not found.accepted
    assert "version" in found.reason if key == "version" else "hash" in found.reason


def test_a_kind_that_is_not_known_is_rejected() -> None:
    found = check_document(seal("document", {}, {}))
    assert not found.accepted and "kind 'document'" in found.reason


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"format": "other"}', '{"a": NaN}', '{"a": 1, "a": 2}', '{"a": 1e999}']
)
def test_what_is_no_certificate_is_the_users_mistake(text, tmp_path) -> None:
    path = tmp_path / "c.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"c\.json"):
        check_file(path)


def test_a_missing_file_is_named(tmp_path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        check_file(tmp_path / "none.json")


def test_evidence_may_not_bear_names_of_the_frame() -> None:
    with pytest.raises(ValueError, match="version"):
        seal("interval", {}, {"version": 3})


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        ("9007199254740993.0", "write 9007199254740992.0"),
        ("1.000000000000000111", "write 1.0"),
        ("0.3000000000000000444", "write 0.30000000000000004"),
        ("4.9e-324", "write 5e-324"),
        ("1e-400", "write 0.0"),
        ("1e-99999999999999999999", "write 0.0"),
        ("-1E400", "too large for a double"),
        ("[0.5, 2e999]", "too large for a double"),
    ],
)
def test_a_number_that_no_double_prints_is_refused_with_its_key(number, remedy, tmp_path) -> None:
    path = tmp_path / "c.json"
    path.write_text(json.dumps(certificate()).replace("0.1", f'[0.25, {{"upper": {number}}}]'))
    with pytest.raises(InputError, match=r"c\.json: claim\.bound\[1\]\.upper(\[1\])? = ") as caught:
        check_file(path)
    assert remedy in str(caught.value)


@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(0, 25), st.sampled_from("eE"))
def test_a_number_is_read_exactly_or_not_at_all(x, digits, letter) -> None:
    for text in (repr(x), f"{x:.{digits}{letter}}", f"{x:.{digits}f}", str(Decimal(x))):
        try:
            value = parse(text.encode(), "c.json", remedy="")
        except InputError:
            assert Fraction(text) != Fraction(repr(float(text)))
        else:
            assert Fraction(text) == Fraction(repr(value))


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b"[" + b"9" * 5000 + b"]", "an integer has 5000 characters"),
        (b'["\\ud800"]', "surrogates"),
        (b"\xef\xbb\xbf{}", "BOM"),
        (b"{} {}", "Extra data"),
        (b"[-Infinity]", "-Infinity is not a JSON number"),
        (b"\xff", "utf-8"),
        (b"[" * 50_000, "nested too deeply"),
        (b"[" * 4_000_000, "4000000 lists"),
        (b'{"' + b"k\\n" * 9999 + b'": 1.5e-999}', "kk"),
    ],
)
def test_a_text_that_cannot_be_read_gets_one_short_line(raw, reason) -> None:
    with pytest.raises(InputError, match=reason.replace("kk", re.escape(r"k\nk\n"))) as caught:
        parse(raw, "c.json", remedy="give a certificate file")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


def test_integers_and_signs_of_zero_are_read_as_written() -> None:
    read = parse(b"[-0.0, -0, 123456789012345678901234567890, 1E2]", "c.json", remedy="")
    assert str(read) == "[-0.0, 0, 123456789012345678901234567890, 100.0]"


def test_what_has_no_canonical_text_is_rejected() -> None:
    assert "canonical" in check_document(certificate() | {"cells": [math.inf]}).reason
