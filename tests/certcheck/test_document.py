import json

import pytest

from surctl.certcheck import canonical, check_document, check_file, seal
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
    document[key] = {"sha256": "0" * 64, "claim": {}, "version": 3}.get(key, "other")
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


def test_what_has_no_canonical_text_is_rejected(tmp_path) -> None:
    path = tmp_path / "c.json"
    path.write_text(json.dumps(certificate()).replace("[1, 2]", "[1e999]"))
    assert "canonical" in check_file(path).reason
