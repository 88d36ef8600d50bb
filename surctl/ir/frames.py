"""Stack size of generated C from the compiler's report: the sum of the frames along the deepest chain of calls."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path

from surctl.errors import SurctlError, ToolMissing, check_known
from surctl.ir.c99 import C_TYPE, Real
from surctl.ir.c99_routine import emit_block
from surctl.ir.cache import compile_program, compiler_version
from surctl.ir.routine import Block

_FUNCTION = re.compile(r"^\w[\w *]*\b(\w+)\([^;{}]*\)\s*\{([^\n]*\}$|\n.*?^\}$)", re.MULTILINE | re.DOTALL)
_CALL = re.compile(r"\b(\w+)\(")


def stack_bytes(block: Block, *, real: Real = "float64", flags: Sequence[str] = ("-Os",)) -> int:
    """Return how many bytes of stack the C of a program or routine uses on this machine, including its calls.

    Raises:
        ToolMissing: there is no compiler, or the compiler does not report stack frames (`-fstack-usage`).
        SurctlError: the compiler reports an error, or a frame has no fixed size.
    """
    kind, at, places = C_TYPE[real], 0, []
    for _, size in (*block.inputs, *block.outputs):
        places.append(f"memory + {at}")
        at += size
    text = emit_block(block, symbol="block", real=real)
    head = f"void surctl_run({kind} *memory)"
    return stack_of(
        f"#include <math.h>\n{text}\n{head};\n{head}\n{{\n    block({', '.join(places)});\n}}\n",
        "surctl_run",
        flags=flags,
    )


def stack_of(text: str, entry: str, *, flags: Sequence[str] = ("-Os",), compiler: str | None = None) -> int:
    r"""Return how many bytes of stack a C function uses, including its calls; the C text must not be recursive.

    The definition of every function must begin on a line of its own. The stack of libm functions such as sin is not
    counted. An inlined function is part of the stack frame of its caller.
    """
    with tempfile.TemporaryDirectory(prefix="surctl-") as name:
        source, report = Path(name) / "text.c", Path(name) / "text.su"
        source.write_text(text, encoding="utf-8")
        try:
            compile_program([source], Path(name) / "text.o", flags=("-c", *flags, "-fstack-usage"), compiler=compiler)
            rows = report.read_text(encoding="utf-8")
        except (SurctlError, FileNotFoundError) as error:
            if isinstance(error, SurctlError) and "stack-usage" not in str(error):
                raise
            raise ToolMissing("has no -fstack-usage report", key="CC", value=compiler_version(compiler)) from None
    return stack_from_report(rows, text, entry)


def stack_from_report(report: str, text: str, entry: str) -> int:
    r"""Return the stack size as `stack_of` does, from the report of a compilation with `-fstack-usage`.

    `report` may be the concatenated reports of several object files; `text` is the C text, including its own header
    files.

    Raises:
        InputError: the text has no function `entry`.
        SurctlError: a frame has no fixed size.
    """
    # every file that includes a header reports the functions of the header again
    rows = [line.split("\t") for line in dict.fromkeys(report.splitlines())]
    if any("dynamic" in row[2] and "bounded" not in row[2] for row in rows):
        raise SurctlError("a frame has no fixed size")
    # "text.c:12:3:name", or "name.part.0" for a part that the compiler split off
    frames: dict[str, int] = {}
    for where, size, _ in rows:
        function = where.rsplit(":", 1)[-1].split(".")[0]
        frames[function] = frames.get(function, 0) + int(size)
    callees = _callees(text)
    check_known(entry, callees, "is not a function of the compiled C", key="entry")
    return _deepest(entry, callees, frames, {})


def _callees(text: str) -> dict[str, set[str]]:
    functions = _FUNCTION.findall(text)
    names = {name for name, _ in functions}
    return {name: set(_CALL.findall(body)) & names for name, body in functions}


def _deepest(function: str, callees: dict[str, set[str]], frames: dict[str, int], known: dict[str, int]) -> int:
    if function not in known:
        below = [_deepest(inner, callees, frames, known) for inner in callees[function]]
        known[function] = frames.get(function, 0) + max(below, default=0)
    return known[function]
