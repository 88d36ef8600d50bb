"""Fill the templates: C text of layouts, values and the law's block."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from surctl import __version__
from surctl.export.contract import STATUS, Exportable, telemetry_ports, thrust
from surctl.export.vectors import TOLERANCE, SelfTest
from surctl.ir import C_TYPE, Layout, Port, Real, c_literal, emit_block, memory
from surctl.ir.compiler import FLAGS

__all__ = ["render_files", "render_unit"]

Vector = NDArray[np.float64]


def render_files(
    law: Exportable, gains: Vector, *, name: str, identity: str, tests: SelfTest, real: Real = "float64"
) -> dict[str, str]:
    """Text of every file but the manifest, by file name.

    Args:
        law: the law, its names already checked.
        gains: tuned gains (np,).
        name: prefix of files and symbols.
        identity: the law's id.
        tests: vectors of the built-in self-test.
        real: precision of every number.
    """
    values = _values(law, gains, name, identity, tests, real)
    templates = {
        f"{name}.h": "law.h.j2",
        f"{name}.c": "law.c.j2",
        "sil_main.c": "sil_main.c.j2",
        "Makefile": "Makefile.j2",
        "target_start.c": "target_start.c.j2",
        "target.ld": "target.ld.j2",
        "README.md": "README.md.j2",
    }
    environment = _environment()
    return {file: environment.get_template(t).render(values) for file, t in templates.items()}


def render_unit(law: Exportable, *, name: str, identity: str, real: Real) -> str:
    """Text of the C around the bundle that makes it a functional mock-up unit."""
    values = {
        "name": name,
        "id": identity,
        "period": repr(float(law.dt)),
        "dt": repr(float(law.dt)),
        "inputs": law.inputs,
        "gains": law.gains,
        "outputs": law.outputs,
        "input_starts": [(k, repr(float(v))) for k, v in enumerate(law.inputs.pack()) if v],
        "transfers": transfers,
        **_words(real),
    }
    return _environment().get_template("fmu.c.j2").render(values)


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("surctl.export"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["comment"] = comment
    environment.filters["cell"] = cell
    environment.filters["wrapped"] = wrapped
    return environment


def _words(real: Real) -> dict[str, Any]:
    """What C calls things in that precision."""
    double = real == "float64"
    return {
        "real": C_TYPE[real],
        "precision": real,
        "largest": "DBL_MAX" if double else "FLT_MAX",
        "absolute": "fabs" if double else "fabsf",
    }


def _values(law: Exportable, gains: Vector, name: str, identity: str, tests: SelfTest, real: Real) -> dict[str, Any]:
    """What the templates know."""
    n_tau = thrust(law).size
    literal = partial(c_literal, real=real)
    return {
        "name": name,
        "NAME": name.upper(),
        "id": identity,
        "version": __version__,
        **_words(real),
        "f": lambda text: literal(float(text)),
        "dt": literal(float(law.dt)),
        "period": repr(float(law.dt)),
        "status": STATUS,
        "structs": _structs(law),
        "state": law.state,
        "inputs": law.inputs,
        "gains": law.gains,
        "tau": thrust(law),
        "telemetry": telemetry_ports(law),
        "n_tau": n_tau,
        "n_telemetry": law.outputs.size - n_tau,
        "field": field,
        "starts": starts,
        "ram": _ram(law, np.dtype(real).itemsize),
        "transfers": transfers,
        "initial": runs(law.initial_state(), text=literal),
        "gain_values": [literal(float(v)) for v in gains],
        "gain_table": _gain_table(law.gains, gains),
        "law": emit_block(law.block, symbol=f"{name}_law", folded=True, real=real),
        "operations": law.block.operations,
        "libm": sorted(law.block.libm),
        "tolerance": literal(TOLERANCE[real]),
        "tests": len(tests.status),
        "test_inputs": _rows(tests.inputs, real),
        "test_tau": _rows(tests.tau, real),
        "test_state": [run for row in tests.state for run in runs(row, text=partial(_decimal, real=real))],
        "test_status": ", ".join(str(s) for s in tests.status),
        "flags": " ".join(FLAGS),
    }


def _structs(law: Exportable) -> list[tuple[str, str, tuple[Port, ...]]]:
    return [
        ("state", "what the controller remembers between steps; owned by the caller", law.state.ports),
        ("input", "what it is told in each step", law.inputs.ports),
        ("gains", "tuned constants", law.gains.ports),
        ("output", "what it commands, then what it reports", law.outputs.ports),
    ]


def _ram(law: Exportable, width: int) -> dict[str, int]:
    """Bytes by what holds them, as far as the routine alone decides it; `width` bytes a number."""
    other = law.inputs.size + law.gains.size + law.outputs.size
    held = {"state": 2 * law.state.size, "structs": other, "arrays": memory(law.block) - 2 * law.state.size}
    return {what: width * count for what, count in held.items()}


def starts(layout: Layout) -> list[tuple[Port, int]]:
    """Ports that hold numbers, with their first entries in the flat vector."""
    return [(port, layout.slice(port.name).start) for port in layout if port.size]


def field(port: Port) -> str:
    """C declarator: a scalar for one entry, else an array of the port's shape, rows first."""
    return port.name if port.size == 1 else port.name + "".join(f"[{n}]" for n in port.shape)


def entries(ports: Layout | Sequence[Port], base: int = 0) -> list[tuple[str, int]]:
    """(C member access, flat index) of every number, in layout order, counted from `base`."""
    members: list[str] = []
    for port in ports:
        if port.size == 1:
            members.append(port.name)
            continue
        indices = itertools.product(*(range(n) for n in port.shape))
        members += [port.name + "".join(f"[{i}]" for i in index) for index in indices]
    return [(member, base + at) for at, member in enumerate(members)]


def transfers(ports: Layout | Sequence[Port], base: int = 0) -> list[tuple[str, str, str]]:
    """How to go through every number of the ports in layout order, a port an item.

    Returns:
        Loop headers (empty for a single number; they leave one brace open), C member access, and flat index in C,
        counted from `base`.
    """
    items, at = [], base
    for port in ports:
        if port.size == 1:
            items.append(("", port.name, str(at)))
        elif port.size:
            items.append(_walk(port, at))
        at += port.size
    return items


def _walk(port: Port, at: int) -> tuple[str, str, str]:
    names = [f"k{d}" if len(port.shape) > 1 else "k" for d in range(len(port.shape))]
    loops = " ".join(f"for (int {k} = 0; {k} < {n}; ++{k})" for k, n in zip(names, port.shape, strict=True))
    strides = [math.prod(port.shape[d + 1 :]) for d in range(len(port.shape))]
    terms = [k if stride == 1 else f"{stride} * {k}" for k, stride in zip(names, strides, strict=True)]
    member = port.name + "".join(f"[{k}]" for k in names)
    return f"{loops} {{ ", member, " + ".join([str(at)] * bool(at) + terms)


def runs(values: Vector, *, text: Callable[[float], str] = c_literal) -> list[str]:
    """C initialisers {number, how often it stands in a row}; C has no empty arrays: one of a zero for no numbers."""
    literals = [text(float(v)) for v in values]
    found = [f"{{{number}, {len(list(same))}}}" for number, same in itertools.groupby(literals)]
    return found or ["{0.0, 1}"]


def wrapped(items: Sequence[str], width: int = 110) -> list[str]:
    """The items with commas in between, as many a line as fit."""
    lines: list[str] = []
    for item in items:
        if lines and len(lines[-1]) + len(item) + 3 <= width:
            lines[-1] += f", {item}"
        else:
            lines.append(item)
    return [f"{line}," for line in lines[:-1]] + lines[-1:]


def _rows(table: Vector, real: Real) -> list[str]:
    lines = (wrapped([_decimal(float(v), real) for v in row]) for row in table)
    return ["{" + "\n         ".join(row) + "}" for row in lines]


def _decimal(value: float, real: Real) -> str:
    """A number of the self-test; the sign of a zero is not compared. A double has twelve digits, a float all of its."""
    return repr(value + 0.0) if real == "float64" else c_literal(value + 0.0, real)


def _gain_table(layout: Layout, gains: Vector) -> list[tuple[Port, str]]:
    return [(port, ", ".join(repr(float(v)) for v in gains[layout.slice(port.name)])) for port in layout]


def _one_line(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def comment(text: str) -> str:
    """Text that cannot end, nest or (as a trigraph) escape a C comment."""
    safe = _one_line(text)
    for bad in ("*/", "/*", "??"):
        while bad in safe:
            safe = safe.replace(bad, f"{bad[0]} {bad[1]}")
    return safe


def cell(text: str) -> str:
    """Text for one cell of a Markdown table."""
    return _one_line(text).replace("|", "\\|")
