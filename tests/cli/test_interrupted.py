"""An exception that Ctrl-C caused inside a library ends a command as Ctrl-C does; others pass."""

from __future__ import annotations

import pytest

from surctl.cli.output import Stopped, interrupted, stoppable


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
