"""Names that pass are no macro of a compiler or of a header that an exported file includes."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from shutil import which

import pytest

import surctl.export
from surctl.errors import InputError
from surctl.ir.c99 import identifier
from tests.tools import need_compiler

TEMPLATES = Path(surctl.export.__file__).parent / "templates"
INCLUDED = sorted(
    {
        header
        for file in TEMPLATES.rglob("*.j2")
        for header in re.findall(r"#include <([\w/]+(?:\.h)?)>", file.read_text())
        if not header.startswith("zephyr") and header != "loop.h"
    }
)
IN_C = [header for header in INCLUDED if header.endswith(".h")]


def macros(command: list[str], headers: list[str]) -> set[str]:
    text = "".join(f"#include <{header}>\n" for header in headers)
    done = subprocess.run([*command, "-dM", "-E", "-"], input=text, capture_output=True, text=True, check=True)
    return set(re.findall(r"^#define ([A-Za-z]\w*)(?:\s|$)", done.stdout, re.MULTILINE))  # those without arguments


def passes(name: str) -> bool:
    try:
        return identifier(name) == name
    except InputError:
        return False


@pytest.mark.parametrize("standard", ["c99", "gnu99", "gnu11", "gnu17"])
def test_no_macro_of_the_headers_in_c_passes(standard: str) -> None:
    assert {"math.h", "stdint.h", "netdb.h"} <= set(IN_C)
    found = macros([need_compiler(), f"-std={standard}", "-x", "c", "-D_GNU_SOURCE"], IN_C)
    assert len(found) > 1000 and {name for name in found if passes(name)} == set()


def test_no_macro_of_the_headers_in_cpp_passes() -> None:
    cpp = which("c++")
    if cpp is None:
        pytest.skip("no C++ compiler")
    found = macros([cpp, "-std=gnu++17", "-x", "c++"], INCLUDED)
    assert len(found) > 1000 and {name for name in found if passes(name)} == set()


@pytest.mark.parametrize(
    "name",
    [
        *("INFINITY", "NAN", "HUGE_VAL", "SIZE_MAX", "UINT32_MAX", "DBL_MAX", "FLT_EPSILON", "unix", "linux", "M_PI"),
        *("UINT_FAST16_WIDTH", "PRIx64", "EDOM", "SIGINT", "PI", "B101"),
    ],
)
def test_a_macro_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(InputError, match=f"name = '{name}': is a macro in C"):
        identifier(name)


@pytest.mark.parametrize("name", ["E1", "EKF", "K_MAX", "F_max", "M_x", "si_x", "P", "SOC", "R_1", "B2", "pi", "low"])
def test_a_name_of_the_same_form_passes(name: str) -> None:
    assert identifier(name) == name
