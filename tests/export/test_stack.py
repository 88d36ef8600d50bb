"""Stack of a C text."""

from __future__ import annotations

import pytest

from surctl.errors import InputError
from surctl.export.check import stack_from_report
from tests.stack import stack_of
from tests.tools import need_compiler

TEXT = "void fill(float *x);\nfloat mean(void) { float x[1000]; fill(x); return x[9]; }\n"


def test_a_function_that_the_text_does_not_have_is_named() -> None:
    need_compiler()
    with pytest.raises(InputError, match=r"entry = 'man': is not a function of the compiled C; did you mean 'mean'\?"):
        stack_of(TEXT, "man")


def test_a_function_of_a_header_counts_once_however_many_files_include_it() -> None:
    """8 and 8 of two pieces of `half`, which two files tell, and 32 of `mean`."""
    told = "a.h:1:7:half\t8\tstatic\na.h:1:7:half.part.0\t8\tstatic\n"
    text = "float half(float x) { return x / 2; }\nfloat mean(float x) { return half(x + 1); }\n"
    assert stack_from_report(f"{told}{told}b.c:3:7:mean\t32\tstatic\n", text, "mean") == 48
