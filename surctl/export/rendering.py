"""Fill the templates: C text of layouts, values and the instruction list."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from surctl import __version__
from surctl.export.contract import STATUS, Exportable, telemetry_ports, thrust
from surctl.export.vectors import TOLERANCE, SelfTest
from surctl.ir import Layout, Port, c_literal, emit_block
from surctl.ir.compiler import FLAGS

__all__ = ["render_files"]

Vector = NDArray[np.float64]


def render_files(law: Exportable, gains: Vector, *, name: str, identity: str, tests: SelfTest) -> dict[str, str]:
    """Text of every file but the manifest, by file name.

    Args:
        law: the law, its names already checked.
        gains: tuned gains (np,).
        name: prefix of files and symbols.
        identity: the law's id.
        tests: vectors of the built-in self-test.
    """
    values = _values(law, gains, name, identity, tests)
    environment = Environment(
        loader=PackageLoader("surctl.export"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["comment"] = comment
    environment.filters["cell"] = cell
    templates = {
        f"{name}.h": "law.h.j2",
        f"{name}.c": "law.c.j2",
        "sil_main.c": "sil_main.c.j2",
        "Makefile": "Makefile.j2",
        "README.md": "README.md.j2",
    }
    return {file: environment.get_template(t).render(values) for file, t in templates.items()}


def _values(law: Exportable, gains: Vector, name: str, identity: str, tests: SelfTest) -> dict[str, Any]:
    """What the templates know."""
    n_tau = thrust(law).size
    return {
        "name": name,
        "NAME": name.upper(),
        "id": identity,
        "version": __version__,
        "dt": c_literal(float(law.dt)),
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
        "entries": entries,
        "initial": [c_literal(float(v)) for v in law.initial_state()],
        "gain_values": [c_literal(float(v)) for v in gains],
        "gain_table": _gain_table(law.gains, gains),
        "law": emit_block(law.block, symbol=f"{name}_law"),
        "operations": law.block.operations,
        "libm": sorted(law.block.libm),
        "tolerance": c_literal(TOLERANCE),
        "tests": len(tests.status),
        "test_inputs": _rows(tests.inputs),
        "test_tau": _rows(tests.tau),
        "test_state": _rows(tests.state),
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


def _rows(table: Vector) -> list[str]:
    return ["{" + ", ".join(c_literal(float(v)) for v in row) + "}" for row in table]


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
