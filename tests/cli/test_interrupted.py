"""An exception that Ctrl-C caused inside a library ends a command as Ctrl-C does; others pass."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from typing import Any

import casadi
import pytest

from surctl.cli.output import Stopped, doing, interrupted, noting_interrupts, stoppable


def converted(cause: type[BaseException]) -> Exception:
    """What CasADi does with any exception inside a conversion."""
    try:
        try:
            raise cause
        except BaseException:
            raise TypeError("use a CasADi function")  # noqa: B904  # as a library does that names no cause
    except TypeError as error:
        return error


def test_ctrl_c_inside_a_conversion_is_ctrl_c() -> None:
    assert interrupted(converted(KeyboardInterrupt)) and not interrupted(converted(ValueError))
    with pytest.raises(Stopped, match="saved"), stoppable("saved"):
        raise converted(KeyboardInterrupt)
    with pytest.raises(TypeError), stoppable("saved"):
        raise converted(ValueError)


def test_the_inner_message_stays() -> None:
    with pytest.raises(Stopped, match="inner"), stoppable("outer"), stoppable("inner"):
        raise KeyboardInterrupt


@pytest.mark.parametrize("as_json", [False, True])
@pytest.mark.parametrize("lines", [[], ["claim 1"]])
def test_nothing_is_said_to_be_above_where_nothing_is_printed(
    lines: list[str], as_json: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    for message in ("", "for the others: again"):
        with pytest.raises(Stopped) as end, stoppable(message, lines, above="see above", as_json=as_json):
            raise KeyboardInterrupt
        printed = capsys.readouterr().out
        assert ("see above" in str(end.value)) == bool(printed) == bool(lines and not as_json)
        assert message in str(end.value) and str(end.value)


class Pressed:
    """An argument during whose conversion Ctrl-C is pressed."""

    def __getattr__(self, name: str) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        raise AttributeError(name)


def test_ctrl_c_that_casadi_replaces_by_an_exception_without_a_cause() -> None:
    x = casadi.SX.sym("x")
    function: Any = casadi.Function("f", [x], [x])
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(Stopped, match="saved"), noting_interrupts(), stoppable("saved"):
            function(Pressed())
        with pytest.raises(Stopped, match="inner"), noting_interrupts(), stoppable("outer"), stoppable("inner"):
            function(Pressed())
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        with pytest.raises(ValueError), noting_interrupts(), stoppable("saved"):
            raise ValueError
    finally:
        signal.signal(signal.SIGINT, before)


def test_an_interrupt_that_a_shell_has_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with noting_interrupts():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


class Dropped:
    """An object whose finaliser is interrupted; Python ignores what a finaliser raises."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


@pytest.fixture
def _usual_interrupt() -> Iterator[None]:
    """Let Ctrl-C raise, also where the tests run in the background of a shell, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_usual_interrupt")
def test_an_interrupt_that_is_lost_is_not_printed_and_comes_with_the_next_progress() -> None:
    with noting_interrupts():
        Dropped()
        with pytest.raises(KeyboardInterrupt) as raised:
            doing("work")
        assert interrupted(raised.value)
        doing("more work")  # once
        with pytest.raises(KeyboardInterrupt) as raised:
            signal.raise_signal(signal.SIGINT)
        assert interrupted(raised.value)
        doing("what is saved")
