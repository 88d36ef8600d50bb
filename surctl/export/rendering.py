"""Text of the exported files from `templates` (C, README, examples, FMU): C of the law, own names, stated RAM."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from types import MappingProxyType
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import ArrayLike, NDArray

from surctl import __version__
from surctl.export.contract import (
    Exportable,
    command_size,
    command_word,
    commands,
    entries,
    field,
    glance,
    is_robot_law,
    starts,
    status_table,
    telemetry_ports,
    transfers,
)
from surctl.export.envelope import TOLERANCE, Envelope, SelfTest
from surctl.export.guard_text import (
    ANY_NUMBER,
    EXAMPLES,
    MANY,
    bound_text,
    box_lines,
    example_values,
    flat_lines,
    number_calls,
    range_text,
    rate_groups,
    templates_of,
)
from surctl.export.supplement import (
    RESTART,
    Supplement,
    aged_runs,
    forgotten,
    forgotten_runs,
    gains_values,
    longest_gap,
    wiring_values,
)
from surctl.ir import Parts, Port, Program, Real, c_literal, memory
from surctl.ir.c99 import C_TYPE
from surctl.ir.c99_program import PRAGMA, inline_helpers, own_helpers, program_lines
from surctl.ir.c99_routine import emit_parts
from surctl.ir.cache import FLAGS
from surctl.ir.program import LEAVES, TRUTHS

_FUNCTION = re.compile(r"^static (?:inline )?(?:const )?\w+ \*?(\w+)\(", re.MULTILINE)


def with_own_names(text: str, prefix: str, *, bundle: str) -> str:
    """Return C text whose static functions begin with `prefix`, unless they begin with the bundle's name already.

    Members of structs (after `.` or `->`) keep their names, and so do comments and strings without a call.
    """
    names = {name for name in _FUNCTION.findall(text) if not name.startswith(f"{bundle}_")}
    if not names:
        return text
    call = re.compile(rf"(?<![\w.>])({'|'.join(sorted(map(re.escape, names)))})(?=\()")
    return call.sub(rf"{prefix}_\1", text)


def _one_line(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def comment(text: str) -> str:
    """Return the text in a form that cannot end, nest or (as a trigraph) escape a C comment."""
    safe = _one_line(text)
    for bad in ("*/", "/*", "??"):
        while bad in safe:
            safe = safe.replace(bad, f"{bad[0]} {bad[1]}")
    return safe


def _cell(text: str) -> str:
    """Return the text in a form that fits one cell of a Markdown table."""
    return _one_line(text).replace("|", "\\|")


_IN_QUOTES = {'"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#09;"}
"""Characters that the attribute of an XML element holds in another form, apart from &, < and >."""


def _general(numbers: ArrayLike, digits: int = 6) -> str:
    """Return one or more numbers with at most this many digits, separated by commas."""
    return ", ".join(f"{number:.{digits}g}" for number in np.atleast_1d(numbers))


def _direct_law(law: Exportable, block: Program, name: str, real: Real) -> Parts:
    """Return the C text of the function `<name>_law(state, gains, input, next, status, output)`.

    The function reads state->x, *gains and *input. It writes next, *status and *output, and never reads their old
    values.
    """
    members = [
        [f"state->x[{k}]" for k in range(law.state.size)],
        [f"input->{member}" for member, _ in entries(law.inputs)],
        [f"gains->{member}" for member, _ in entries(law.gains)],
    ]
    stays = {f"next[{k}]" for k in range(law.state.size)} - {f"next[{k}]" for k in _changing(block)}
    stores = [(to, ref) for to, ref in _stores(law, block, "next") if to not in stays]
    kind = C_TYPE[real]
    body = program_lines(
        block.instructions, stores, address=lambda which, at: members[which][at], real=real, apart=True
    )
    # searched in the text, because the instruction list also reads state entries that do not change
    used = "\n".join(body)
    head = [
        f"void {name}_law(const {name}_state_t *state, const {name}_gains_t *gains,",
        f"    const {name}_input_t *input, {kind} *next, {kind} *status, {name}_output_t *output)",
    ]
    lines = [
        f"/* {block.operations} operations */",
        *head,
        "{",
        *(f"    (void){word};" for word in ("state", "input", "gains") if f"{word}->" not in used),
        *([] if _changing(block) else ["    (void)next;"]),
        *body,
        "}",
    ]
    text = "\n".join([*own_helpers([block], real), *lines]) + "\n"
    return Parts({"": text}, (*inline_helpers([block], real), "\n".join(head) + ";"))


def _changing(block: Program) -> list[int]:
    """Return the indices of the state entries that a step may change."""
    refs = block.output_refs[1]
    moved = [(k, block.instructions[ref]) for k, ref in enumerate(refs)]
    return [k for k, i in moved if i.op != "input" or i.args != (0, k)]


def _stores(law: Exportable, block: Program, state: str) -> Iterator[tuple[str, int]]:
    """Return the C text of each result of a step, with the next state in the array `state`, and its list position."""
    left = [
        *(f"output->{member}" for member, _ in entries(commands(law))),
        *(f"{state}[{k}]" for k in range(law.state.size)),
    ]
    left += ["*status", *(f"output->{member}" for member, _ in entries(telemetry_ports(law)))]
    return zip(left, itertools.chain(*block.output_refs), strict=True)


def _results(law: Exportable, block: Program) -> list[str]:
    """Return the C names of results that may be NaN or infinite; constants, copied inputs and truth values cannot."""
    checked: dict[int, str] = {}
    for to, ref in _stores(law, block, "state->next"):
        if to != "*status" and block.instructions[ref].op not in LEAVES | TRUTHS:
            checked.setdefault(ref, to)
    return list(checked.values())


Vector = NDArray[np.float64]


def render_files(
    law: Exportable,
    gains: Vector,
    within: Envelope,
    *,
    name: str,
    identity: str,
    tests: SelfTest,
    real: Real = "float64",
    supplement: Supplement,
) -> dict[str, str]:
    """Return the text of every file except the manifest, by file name.

    Args:
        gains: tuned gains (np,).
        within: ranges that the input check of the exported C accepts, rounded to `real`.
        identity: id of the law (see `law_id`).
        tests: inputs and expected results of the built-in self-test.
        supplement: what an application adds.
    """
    block = law.block
    parts = (
        _direct_law(law, block, name, real)
        if isinstance(block, Program)
        else emit_parts(block, symbol=f"{name}_law", real=real)
    )
    values = _values(law, gains, within, name, identity, tests, real) | {"prototypes": parts.prototypes}
    named = {part: _PARTS.get(part, (f"law_{part}", f"{part}, a part of the law")) for part in parts.files}
    # (file name, description of the contents, C text)
    of_law = [(f"{name}_{named[part][0]}.c", named[part][1], text) for part, text in parts.files.items()]
    values |= {"law_files": [(file, about) for file, about, _ in of_law]}
    values |= (
        wiring_values(law)
        | supplement.values(law, real)
        | example_values(law, within, name=name, arrays=values["ram"]["arrays"])
    )
    code = [f"{name}.c", *([f"{name}_gains.c"] if law.gains.size else []), *(file for file, _, _ in of_law)]
    headers = [f"{name}.h", *([f"{name}_gains.h"] if law.gains.size else []), f"{name}_internal.h"]
    values |= {"headers": " ".join(headers), "sources": " ".join(code), "arrivals": _arrivals(law)}
    sources = {
        f"{name}.h": "law.h.j2",
        f"{name}_internal.h": "internal.h.j2",
        f"{name}.c": "law.c.j2",
        **({f"{name}_gains.h": "gains.h.j2", f"{name}_gains.c": "gains.c.j2"} if law.gains.size else {}),
        **{file: "law_part.c.j2" for file, _, _ in of_law},
        f"{name}_selftest.c": "selftest.c.j2",
        **templates_of("sil_main.c", "Makefile", "link.h", "link.c", "controller.c"),
        **templates_of("target_start.c", "target_link.c", "target.ld"),
        **EXAMPLES,
        **templates_of("CMakeLists.txt", "pyproject.toml", "setup.py"),
        f"{name}.py": "wrapper.py.j2",
        **templates_of("library.properties", "arduino_example.ino", "LICENSE", "README.md"),
        **supplement.templates(law),
    }
    own = {file: {"about": about, "text": text} for file, about, text in of_law}
    texts = {file: templates().get_template(t).render(values, **own.get(file, {})) for file, t in sources.items()}
    joined = (
        *(file for file in texts if file.startswith(name) and file.endswith(".c")),
        "link.c",
        "loop.c",
        "mission.c",
    )  # files of the controller
    return {
        file: with_own_names(text, _stem(file, name), bundle=name) if file in joined else text
        for file, text in texts.items()
    }


def _stem(file: str, name: str) -> str:
    # the prefix of the file's own names: that of the bundle, and what the file is about
    stem = file.rpartition(".")[0]
    return stem if stem.startswith(name) else f"{name}_{stem}"


_PARTS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "": ("law", "the control law"),
        "perception": ("map", "the map of obstacles around the robot, and the inputs of the decision"),
        "measure": ("sensing", "memory of own motion, sonar echoes and moving obstacles"),
        "pre": ("guidance", "desired velocities of the tasks, and limits of the velocity"),
        "projected_step": ("priorities", "solution of the tasks in order of priority within the limits"),
    }
)
"""File name and contents for large functions of the built-in laws; other files are named after their function."""


def _arrivals(law: Exportable) -> list[tuple[str, str]]:
    # (loop header, C member access) of the inputs that say that something has arrived
    flags = [port for port in law.inputs if port.name == "fresh" or port.name.endswith("_fresh")]
    return [(each, member) for each, member, _ in transfers(flags)]


def render_unit(
    law: Exportable, *, name: str, identity: str, real: Real, fmi: int = 2, rows: int = 0
) -> dict[str, str]:
    """Return the C files that turn the bundle into a functional mock-up unit; `rows`: waypoints of its mission."""
    values = {
        "name": name,
        "id": identity,
        "period": repr(float(law.dt)),
        "inputs": law.inputs,
        "gains": law.gains,
        "outputs": law.outputs,
        "word": command_word(law),
        "input_starts": [(k, repr(float(v))) for k, v in enumerate(law.inputs.pack()) if v],
        "transfers": transfers,
        "f": lambda text: c_literal(float(text), real),
        "mission_rows": rows,
        **_words(real),
    }
    return {file: templates().get_template(f"{file}.j2").render(values) for file in (f"fmi{fmi}.c", "fmu.h")}


@cache
def templates() -> Environment:
    """Return the templates; each is compiled once in a process."""
    environment = Environment(
        loader=PackageLoader("surctl.export"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"comment": comment, "cell": _cell, "line": _one_line, "wrapped": _wrapped}
    environment.filters |= {"g": _general, "degrees": math.degrees, "xml": partial(escape, entities=_IN_QUOTES)}
    return environment


def _words(real: Real) -> dict[str, Any]:
    double = real == "float64"
    return {
        "real": C_TYPE[real],
        "precision": real,
        "largest": "DBL_MAX" if double else "FLT_MAX",
        "absolute": "fabs" if double else "fabsf",
        "floor": "floor" if double else "floorf",
        "turn": 2.0 * math.pi,
    }


def _values(
    law: Exportable, gains: Vector, within: Envelope, name: str, identity: str, tests: SelfTest, real: Real
) -> dict[str, Any]:
    n_tau = command_size(law)
    literal = partial(c_literal, real=real)
    return {
        "name": name,
        "NAME": name.upper(),
        "id": identity,
        "version": __version__,
        **_words(real),
        "f": lambda text: literal(float(text)),
        "dt": repr(float(law.dt)) if real == "float64" else f"{np.float32(law.dt)!s}f",
        "period": repr(float(law.dt)),
        "status": status_table(law),
        "restart": RESTART,
        "longest_gap": longest_gap(law.dt),
        "aged": aged_runs(law, literal),
        "anew": forgotten_runs(law, literal),
        "forgotten": forgotten(law),
        **(gains_values(law, real) if law.gains.size else {}),
        "structs": [
            ("state", "state of the controller between steps; owned by the caller", law.state.ports),
            ("input", "inputs of each step", law.inputs.ports),
            ("gains", "gains and other parameters", law.gains.ports),
            ("output", "commands, then telemetry", law.outputs.ports),
        ],
        "state": law.state,
        "inputs": law.inputs,
        "gains": law.gains,
        "commands": commands(law),
        "robot": is_robot_law(law),
        "word": command_word(law),
        "zero": _fields(commands(law)),
        "telemetry": telemetry_ports(law),
        "n_tau": n_tau,
        "n_telemetry": law.outputs.size - n_tau,
        "many": MANY,
        "glance": glance(law),
        "n_glance": sum(port.size for ports in glance(law) for port in ports),
        "index": {
            (struct, port.name): layout.slice(port.name).start
            for struct, layout in (("state", law.state), ("input", law.inputs), ("output", law.outputs))
            for port in layout
        },
        "field": field,
        "starts": starts,
        "ram": _ram(law, within, np.dtype(real).itemsize),
        **_guard(law, within, real),
        "constants": [
            (port, ", ".join(repr(float(v)) for v in value)) for port, value in getattr(law, "constant_table", ())
        ],
        "transfers": transfers,
        "initial": _runs(law.initial_state(), text=literal),
        "gain_values": [literal(float(v)) for v in gains],
        "gain_indices": [f"{name}_gain_{port.name} = {at + 1}" for port, at in starts(law.gains)],
        "gain_table": [(p, ", ".join(repr(float(v)) for v in gains[law.gains.slice(p.name)])) for p in law.gains],
        "direct": isinstance(law.block, Program),
        "changing": _changing(law.block) if isinstance(law.block, Program) else [],
        "results": _results(law, law.block) if isinstance(law.block, Program) else [],
        "thrusts": _thrusts(law),
        "pragma": PRAGMA,
        "operations": law.block.operations,
        "libm": sorted(law.block.libm),
        "tolerance": literal(TOLERANCE[real]),
        "tests": len(tests.status),
        "test_inputs": _rows(tests.inputs, real),
        "test_tau": _rows(tests.tau, real),
        "test_state": [run for row in tests.state for run in _runs(row, text=partial(_decimal, real=real))],
        "test_status": ", ".join(str(s) for s in tests.status),
        "flags": " ".join(FLAGS),
    }


def _fields(ports: Sequence[Port]) -> str:
    """Return the names of output members and "is" or "are", such as "output.tau is", as the start of a sentence."""
    return f"{', '.join(f'output.{port.name}' for port in ports)} {'is' if len(ports) == 1 else 'are'}"


def _guard(law: Exportable, within: Envelope, real: Real) -> dict[str, Any]:
    boxes = ((law.state, within.state), (law.inputs, within.inputs), (law.gains, within.gains))
    ranges = {
        port.name: range_text(box[layout.slice(port.name)]) for layout, box in boxes for port in layout if port.size
    }
    inputs, members = entries(law.inputs), entries(law.gains)
    return {
        "box": [
            flat_lines(law.state, within.state, "state->x", real),
            box_lines(law.inputs, within.inputs, lambda part, _: f"input->{part}", real),
            box_lines(law.gains, within.gains, lambda part, _: f"gains->{part}", real, refuse=_numbered),
        ],
        "numbers": [
            call
            for (layout, _), struct in zip(boxes, ("state", "input", "gains"), strict=True)
            for call in number_calls(layout, struct)
        ],
        "bound": partial(bound_text, real=real),
        "limits": [
            (member, ends)
            for member, ends in zip(_thrusts(law), () if within.commands is None else within.commands, strict=False)
            if max(-ends[0], ends[1]) < np.finfo(real).max
        ],
        "orders": [[members[at] for at in pair] for pair in within.orders],
        "rates": rate_groups(law.inputs, within),
        "watched": [(k, inputs[rate.entry][0], rate) for k, rate in enumerate(within.rates)],
        "allowed": lambda port: ranges.get(port.name, ""),
        "bounded": lambda port: f"; {ranges[port.name]}" if ranges.get(port.name, ANY_NUMBER) != ANY_NUMBER else "",
        "reasons": dict(within.reasons),
        "outside": _outside(law, within),
    }


def _numbered(at: str) -> str:
    # the statement that returns the index, from 1, of a gain out of its range
    return f"return {int(at) + 1 if at.isdigit() else f'{at} + 1'};"


def _thrusts(law: Exportable) -> list[str]:
    # C text of each command before it is stored in the output
    if isinstance(law.block, Program):
        return [f"output->{member}" for member, _ in entries(commands(law))]
    return [f"tau[{k}]" for k in range(command_size(law))]


def _outside(law: Exportable, within: Envelope) -> tuple[int, float] | None:
    # (index of an input, number outside its range), for the self-test
    largest = 1e38
    for at, (_, high) in enumerate(within.inputs):
        if high < largest:
            return at, 2.0 * abs(float(high)) + 1.0
    return None


def _ram(law: Exportable, within: Envelope, width: int) -> dict[str, int]:
    # bytes, without compiler temporaries; a number has `width` bytes
    other = law.inputs.size + law.gains.size + law.outputs.size
    arrays = 0 if isinstance(law.block, Program) else memory(law.block) - 2 * law.state.size
    held = {"state": 2 * law.state.size + len(within.rates), "structs": other, "arrays": arrays}
    # the input has one counter (the sample), the state five or six; a struct's size is a multiple of `width`
    counters = 6 if any(port.gap != "keep" for port in law.state) else 5
    padded = {"state": -(-4 * counters // width) * width, "structs": width}
    return {what: width * count + padded.get(what, 0) for what, count in held.items()}


def _runs(values: Vector, *, text: Callable[[float], str] = c_literal) -> list[str]:
    """Return C initialisers {number, repetitions}; if `values` is empty, return one zero, as C has no empty array."""
    literals = [text(float(v)) for v in values]
    initialisers = [f"{{{number}, {len(list(same))}}}" for number, same in itertools.groupby(literals)]
    return initialisers or ["{0.0, 1}"]


def _wrapped(items: Sequence[str], width: int = 110) -> list[str]:
    """Return lines of the items, separated by commas, with as many items per line as fit."""
    lines: list[str] = []
    for item in items:
        if lines and len(lines[-1]) + len(item) + 3 <= width:
            lines[-1] += f", {item}"
        else:
            lines.append(item)
    return [f"{line}," for line in lines[:-1]] + lines[-1:]


def _rows(table: Vector, real: Real) -> list[str]:
    lines = (_wrapped([_decimal(float(v), real) for v in row]) for row in table)
    return ["{" + "\n         ".join(row) + "}" for row in lines]


def _decimal(value: float, real: Real) -> str:
    # the sign of a zero is left out, because it is not compared
    return repr(value + 0.0) if real == "float64" else f"{np.float32(value + 0.0)!s}f"
