"""C text of the guard: ranges, order of gains, jumps of inputs, limits of commands; values of example programs."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from decimal import Decimal
from itertools import groupby
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable, commands, entries, is_robot_law, transfers
from surctl.export.envelope import Envelope, Rate
from surctl.ir import Layout, Port, Real
from surctl.ir.c99 import C_TYPE

Vector = NDArray[np.float64]

ANY_NUMBER = "any finite number"

_FEW = 4  # up to this many numbers, each number gets its own line
_REFUSE = "return 0;"
MANY = 100
"""Numbers of state from which on a test of them, one by one, takes much of a step's time."""


def range_text(box: Vector) -> str:
    """Return ranges (n, 2) as text such as "0 to 1", or as a list if the ranges differ."""
    texts = [ANY_NUMBER if min(-low, high) > 1e38 else f"{low:.6g} to {high:.6g}" for low, high in box]
    if len(set(texts)) == 1:
        return texts[0]
    for period in range(2, len(texts)):
        if len(texts) % period == 0 and texts == texts[:period] * (len(texts) // period):
            texts = texts[:period]
            break
    return "; ".join(texts)


def box_lines(
    layout: Layout,
    box: Vector,
    member: Callable[[str, str], str],
    real: Real,
    *,
    refuse: Callable[[str], str] = lambda _: _REFUSE,
) -> list[str]:
    """Return C lines that end their function if a number is out of range (NaN is out of every range).

    `box` (n, 2) are the smallest and largest accepted values. `member` returns the C text of a number for (member
    access, flat index), and `refuse` the C statement for the flat index of a number out of range.
    """
    lines: list[str] = []
    for port in layout:
        if port.size:
            first = layout.slice(port.name).start
            lines += _port_lines(port, first, box[layout.slice(port.name)], member, real, refuse)
    return lines


def flat_lines(layout: Layout, box: Vector, array: str, real: Real) -> list[str]:
    """Return the C lines of `box_lines` for numbers in one array; neighbours with equal bounds share a loop."""
    lines: list[str] = []
    ports = [(port, layout.slice(port.name)) for port in layout if port.size]

    def shared(item: tuple[Port, slice]) -> tuple[float, ...] | str:
        port, part = item
        return tuple(box[part][0]) if (box[part] == box[part][0]).all() else port.name

    for _, group in groupby(ports, key=shared):
        these = list(group)
        first, end = these[0][1].start, these[-1][1].stop
        if len(these) > 1 and end - first > _FEW:
            unlimited = end - first >= MANY and -box[first][0] == box[first][1] >= float(np.finfo(real).max)
            each = f"for (int k = {first}; k < {end}; ++k) {{ {_test(f'{array}[k]', box[first], real)} }}"
            lines.append(f"if (!numbers({array} + {first}, {end - first}U)) {{ {_REFUSE} }}" if unlimited else each)
            continue
        for port, part in these:
            lines += _port_lines(port, part.start, box[part], lambda _, at: f"{array}[{at}]", real, lambda _: _REFUSE)
    return lines


def _port_lines(
    port: Port, first: int, box: Vector, member: Callable[[str, str], str], real: Real, refuse: Callable[[str], str]
) -> list[str]:
    alike = (box == box[0]).all()
    if alike and port.size > _FEW:
        ((each, access, at),) = transfers([port], first)
        return [f"{each}{_test(member(access, at), box[0], real, refuse(at))} }}"]
    if len(port.shape) == 2 and port.shape[0] > 2:
        rows = box.reshape(*port.shape, 2)
        if (rows == rows[0]).all():
            tests = []
            for c in range(port.shape[1]):
                at = f"{first + c} + {port.shape[1]} * k"
                tests.append(_test(member(f"{port.name}[k][{c}]", at), rows[0, c], real, refuse(at)))
            return [f"for (int k = 0; k < {port.shape[0]}; ++k) {{", *(f"    {t}" for t in tests), "}"]
    flat = entries([port], first)
    return [
        _test(member(access, str(at)), bounds, real, refuse(str(at)))
        for (access, at), bounds in zip(flat, box, strict=True)
    ]


def _test(text: str, bounds: Vector, real: Real, refuse: str = _REFUSE) -> str:
    low, high = (bound_text(float(b), real) for b in bounds)
    if float(bounds[0]) == -float(bounds[1]):
        return f"if (!({'fabs' if real == 'float64' else 'fabsf'}({text}) <= {high})) {{ {refuse} }}"
    return f"if (!(({text} >= {low}) && ({text} <= {high}))) {{ {refuse} }}"


def bound_text(value: float, real: Real) -> str:
    """Return the C text of the end of a range, DBL_MAX or FLT_MAX if it is none."""
    largest = float(np.finfo(real).max)
    name = "DBL_MAX" if real == "float64" else "FLT_MAX"
    if abs(value) >= largest:
        return name if value > 0 else f"-{name}"
    # the shortest decimal with exactly this value, for readers and for analysers that cannot read hexadecimal
    short = np.format_float_positional(np.dtype(real).type(value), trim="0")
    literal = short + ("f" if real == "float32" else "")
    # where the processor computes in a wider format, a cast takes the excess digits from a decimal that is not exact
    return literal if Decimal(short) == Decimal(value) else f"({C_TYPE[real]}){literal}"


def number_calls(layout: Layout, struct: str) -> list[str]:
    """Return C calls that test whether numbers are finite, one for each member of a struct; of the state, only x."""
    if struct == "state":
        return [f"numbers(state->x, {layout.size}U)"] if layout.size else []
    calls = []
    for port in layout:
        if port.size:
            first = f"&{struct}->{port.name}" + ("" if port.size == 1 else "".join("[0]" for _ in port.shape))
            calls.append(f"numbers({first}, {port.size}U)")
    return calls


_LOOP = 4  # from this many inputs with equal rates on, a loop is shorter


def rate_groups(layout: Layout, envelope: Envelope) -> list[tuple[Rate, list[tuple[int, str, str]]]]:
    """Return successive inputs with equal rates: the rate, and (count, C member access, C index in `last`) of each.

    `count` is the number of inputs in a loop over k, or 0 for a single one.
    """
    members = [member for member, _ in entries(layout)]
    groups: list[tuple[Rate, int, list[str]]] = []
    for k, rate in enumerate(envelope.rates):
        last = groups[-1] if groups else None
        if last and replace(last[0], entry=0) == replace(rate, entry=0) and not rate.turn:
            follows = last[0].entry + len(last[2]) == rate.entry
            if follows and members[rate.entry].split("[")[0] == last[2][0].split("[")[0]:
                last[2].append(members[rate.entry])
                continue
        groups.append((rate, k, [members[rate.entry]]))
    return [(rate, _each(same, first)) for rate, first, same in groups]


def _each(members: list[str], first: int) -> list[tuple[int, str, str]]:
    if len(members) < _LOOP:
        return [(0, member, str(first + k)) for k, member in enumerate(members)]
    stem, at = members[0].rstrip("]").rsplit("[", 1)
    return [(len(members), f"{stem}[{_plus(at)}]", _plus(first))]


def _plus(first: int | str) -> str:
    # C text of the index k from `first` on
    return "k" if int(first) == 0 else f"k + {first}"


def templates_of(*files: str) -> dict[str, str]:
    """Return the templates of files whose names are those of their templates, without the ending .j2."""
    return {file: f"{file}.j2" for file in files}


EXAMPLES: Mapping[str, str] = MappingProxyType(
    {
        **templates_of("main_example.c", "loop.h", "loop.c", "board.h", "board_example.c", "freertos/control_task.h"),
        **templates_of("freertos/control_task.c", "freertos/main_example.c", "freertos/README.md", "zephyr/module.yml"),
        **templates_of("zephyr/CMakeLists.txt", "zephyr/Kconfig", "zephyr/README.md"),
        "zephyr/sample/CMakeLists.txt": "zephyr/sample_CMakeLists.txt.j2",
        "zephyr/sample/prj.conf": "zephyr/sample_prj.conf.j2",
        "zephyr/sample/src/main.c": "zephyr/sample_main.c.j2",
        **templates_of("ros2/package.xml", "ros2/CMakeLists.txt", "ros2/README.md"),
        "ros2/src/controller_node.cpp": "ros2/controller_node.cpp.j2",
        "ros2/launch/controller.launch.py": "ros2/controller.launch.py.j2",
        "ros2/config/params.yaml": "ros2/params.yaml.j2",
    }
)
"""Template of each file of the example programs."""

_STACK = 6144  # [bytes] of the compiler's intermediate results and of the functions of the board
_OPTIONAL = ("working", "column")  # inputs that keep their default until a message arrives


def example_values(law: Exportable, within: Envelope, *, name: str, arrays: int) -> dict[str, Any]:
    """Return the values of the templates of `EXAMPLES`; `arrays` are the bytes of the arrays on the stack of a step."""
    own = _own_state(law.inputs)
    numbers_in = _numbers_in(law, own)
    outputs = [port for port in law.outputs if port.name == "thruster_command"]
    robot = is_robot_law(law)
    numbers_out = outputs if robot else [*commands(law)]
    sonars = law.inputs.port("samples") if {"samples", "fresh"} <= {port.name for port in law.inputs} else None
    messages = ["std_msgs", "diagnostic_msgs", "rcl_interfaces"]
    messages += ["geometry_msgs"] if robot else []
    messages += ["nav_msgs"] if own == "odometry" else []
    messages += ["sensor_msgs"] if own == "fix" or sonars else []
    return {
        "input_starts": _starts(law.inputs),
        "period_us": round(1e6 * law.dt),
        "stack_bytes": -(-(_STACK + arrays) // 1024) * 1024,
        # REP 144: lower-case letters, digits, single underscores, a letter first
        "package": re.sub(r"_+", "_", name.lower()).strip("_") or "controller",
        "own_state": own,
        "sonars": () if sonars is None else (*sonars.shape, repr(float(np.max(sonars.default)))),
        "numbers_in": numbers_in,
        "numbers_out": numbers_out,
        "wrench": robot,
        "gain_rows": [_gain_row(port, within.gains[law.gains.slice(port.name)]) for port in law.gains if port.size],
        "ros_packages": ["rclcpp", *sorted(messages)],
    }


def _starts(inputs: Layout) -> list[tuple[str, str, str]]:
    # (loop header, C member access, value) of the inputs whose default is not zero
    starts = []
    for port in inputs:
        if port.size and np.any(port.default):
            if np.ndim(port.default) == 0:
                starts += [(each, member, repr(float(port.default))) for each, member, _ in transfers([port])]
            else:
                numbers = np.asarray(port.default).tolist()
                starts += [("", member, repr(numbers[at])) for member, at in entries([port]) if numbers[at]]
    return starts


def _own_state(inputs: Layout) -> str:
    if "eta" in inputs and "nu" in inputs:
        return "odometry"
    return "fix" if all(name in inputs for name in ("fix", "fix_fresh", "yaw", "yaw_rate")) else ""


def _numbers_in(law: Exportable, own: str) -> list[dict[str, Any]]:
    # inputs that arrive as arrays of numbers
    known = {"odometry": ("eta", "nu"), "fix": ("fix", "yaw", "yaw_rate"), "": ()}[own]
    names = [port.name for port in law.inputs]
    flags = {name for name in names if name.endswith("_fresh") and name.removesuffix("_fresh") in names}
    if {"samples", "fresh"} <= set(names):
        known = (*known, "samples", "fresh")
    rows: list[dict[str, Any]] = []
    for port in law.inputs:
        if not port.size or port.name in known or port.name in flags:
            continue
        flag = f"{port.name}_fresh" if f"{port.name}_fresh" in flags else ""
        sample = not own and not any(row["sample"] for row in rows) and not flag
        needed = not flag and not sample and port.name not in _OPTIONAL
        shorter = len(port.shape) == 2 and port.name == "contacts"
        said = (
            "one message counts as one sample" if sample else "needed in every step" if needed else "when there is one"
        )
        rows.append({"port": port, "flag": flag, "sample": sample, "needed": needed, "shorter": shorter, "said": said})
    return rows


def _gain_row(port: Port, box: NDArray[np.float64]) -> dict[str, Any]:
    text = f"[{port.unit}] {port.meaning}; {range_text(box)}"
    said = "".join(c if c.isprintable() and c not in '"\\' else " " for c in text).replace("??", "? ?")
    low, high = (-np.inf, np.inf) if range_text(box) == ANY_NUMBER else (box[:, 0].max(), box[:, 1].min())
    return {"port": port, "said": said, "low": _number(low), "high": _number(high)}


def _number(value: float) -> str:
    if np.isfinite(value):
        return repr(float(value))
    return f"{'-' if value < 0 else ''}std::numeric_limits<double>::infinity()"
