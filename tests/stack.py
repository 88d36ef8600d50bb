"""Stack of generated C on this machine, as its compiler reports it."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from surctl.errors import SurctlError, ToolMissing
from surctl.export.check import stack_from_report
from surctl.ir import Block, Real
from surctl.ir.c99 import C_TYPE
from surctl.ir.c99_routine import emit_block
from surctl.ir.cache import compile_program, compiler_version


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
