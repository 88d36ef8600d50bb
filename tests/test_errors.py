"""The tree of errors: one line, with its payload, and the next step."""

from __future__ import annotations

import errno
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl import errors
from surctl.errors import (
    LOSSES,
    LOST,
    InputError,
    SolverError,
    SurctlError,
    ToolMissing,
    UnsupportedOperation,
    cannot_write,
    mistakes_in,
    nearest,
    writing,
)


@pytest.mark.parametrize(
    ("kind", "status"),
    [
        (SurctlError, 1),
        (SolverError, 1),
        (InputError, 2),
        (ToolMissing, 2),
        (UnsupportedOperation, 2),
    ],
)
def test_every_error_has_its_exit_status(kind: type[SurctlError], status: int) -> None:
    assert issubclass(kind, SurctlError)
    assert kind.exit_status == status


def test_only_a_place_that_takes_no_more_output_is_no_mistake_of_the_user() -> None:
    for code in errno.errorcode:
        lost = cannot_write("out", OSError(code, os.strerror(code)))
        assert lost.exit_status == (LOST if code in LOSSES else 2)
        assert os.strerror(code) in str(lost) and str(lost).startswith("out: ")


def test_a_place_that_cannot_be_written_is_named() -> None:
    with pytest.raises(InputError) as caught, writing("out", remedy="name another folder"):
        raise OSError(errno.EACCES, os.strerror(errno.EACCES))
    assert str(caught.value) == f"out: cannot be written ({os.strerror(errno.EACCES)}); name another folder"
    with pytest.raises(ValueError, match="other"), writing("out"):
        raise ValueError("other")


def test_public_names() -> None:
    assert errors.__all__ == [
        "LOSSES",
        "LOST",
        "EmptyDomain",
        "Finding",
        "InputError",
        "NotApplicable",
        "SolverError",
        "SurctlError",
        "ToolMissing",
        "UnsupportedOperation",
        "cannot_write",
        "check_count",
        "check_known",
        "check_number",
        "check_once",
        "nearest",
    ]


def test_input_error_tells_file_key_value_problem_and_remedy_in_this_order() -> None:
    error = InputError("must be greater than 0", file="a.toml", key="gains.k1", value=-1.0, remedy="raise it")
    assert str(error) == "a.toml: gains.k1 = -1.0: must be greater than 0; raise it"
    assert (error.file, error.key, error.value, error.remedy) == ("a.toml", "gains.k1", -1.0, "raise it")


def test_input_error_leaves_out_what_is_not_given() -> None:
    assert str(InputError("is empty", file="a.toml")) == "a.toml: is empty"
    assert str(InputError("is missing", key="k1")) == "k1: is missing"
    assert str(InputError("nothing to do")) == "nothing to do"


def test_a_value_of_zero_or_false_is_shown() -> None:
    assert "k = 0:" in str(InputError("bad", key="k", value=0))
    assert "k = False:" in str(InputError("bad", key="k", value=False))


def test_a_long_value_is_cut() -> None:
    shown = str(InputError("bad", key="k", value="x" * 500, remedy="shorten it"))
    assert "..." in shown
    assert len(shown) < 120


texts = st.text(max_size=80)


@settings(derandomize=True, deadline=None)
@given(problem=texts, file=texts, key=texts, value=st.one_of(texts, st.floats(), st.lists(st.integers())), remedy=texts)
def test_the_message_is_one_line_whatever_the_file_holds(
    problem: str, file: str, key: str, value: object, remedy: str
) -> None:
    text = str(InputError(problem, file=file, key=key, value=value, remedy=remedy))
    assert len(text.splitlines()) <= 1


def test_nearest_names_the_close_name_else_lists_all() -> None:
    assert nearest("lokahead", ["k1", "lookahead"]) == "did you mean 'lookahead'?"
    assert nearest("zzz", ["k2", "k1"]) == "known: k1, k2"


@pytest.mark.parametrize(
    ("file", "key", "error", "text"),
    [
        ("a.toml", None, InputError("is wrong", key="x"), "a.toml: x: is wrong"),
        ("a.toml", None, InputError("is wrong", file="b.toml", key="x"), "b.toml: x: is wrong"),
        ("a.toml", "y", InputError("is wrong", file="b.toml", key="x"), "a.toml: y: is wrong"),
        ("a.toml", "list.0.", InputError("is wrong", key="x", value=1), "a.toml: list.0.x = 1: is wrong"),
        (None, "--plant mujoco:", InputError("is wrong"), "--plant mujoco: is wrong"),
    ],
)
def test_mistakes_in_names_the_file_and_the_key_and_keeps_the_file_of_the_mistake(
    file: str | None, key: str | None, error: InputError, text: str
) -> None:
    with pytest.raises(InputError) as caught, mistakes_in(file, key):
        raise error
    assert str(caught.value) == text
