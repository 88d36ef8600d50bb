"""Stack of a C text."""

from __future__ import annotations

import pytest

from surctl.errors import InputError
from surctl.ir import stack_of
from tests.tools import need_compiler

TEXT = "void fill(float *x);\nfloat mean(void) { float x[1000]; fill(x); return x[9]; }\n"


def test_a_function_that_the_text_does_not_have_is_named() -> None:
    need_compiler()
    with pytest.raises(InputError, match=r"entry = 'man': is not a function in the text; did you mean 'mean'\?"):
        stack_of(TEXT, "man")
