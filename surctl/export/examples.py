"""Example programs of a bundle: bare metal, FreeRTOS, Zephyr and ROS 2; the values that their templates need."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable, commands, is_robot_law
from surctl.export.envelope import Envelope
from surctl.export.fields import entries, transfers
from surctl.export.guard_text import ANY_NUMBER, range_text
from surctl.ir import Layout, Port

__all__ = ["EXAMPLES", "example_values"]

EXAMPLES: Mapping[str, str] = MappingProxyType(
    {
        **{file: f"{file}.j2" for file in ("main_example.c", "loop.h", "loop.c", "board.h", "board_example.c")},
        **{f"freertos/{file}": f"freertos/{file}.j2" for file in ("control_task.h", "control_task.c")},
        **{f"freertos/{file}": f"freertos/{file}.j2" for file in ("main_example.c", "README.md")},
        **{f"zephyr/{file}": f"zephyr/{file}.j2" for file in ("module.yml", "CMakeLists.txt", "Kconfig", "README.md")},
        "zephyr/sample/CMakeLists.txt": "zephyr/sample_CMakeLists.txt.j2",
        "zephyr/sample/prj.conf": "zephyr/sample_prj.conf.j2",
        "zephyr/sample/src/main.c": "zephyr/sample_main.c.j2",
        **{f"ros2/{file}": f"ros2/{file}.j2" for file in ("package.xml", "CMakeLists.txt", "README.md")},
        "ros2/src/controller_node.cpp": "ros2/controller_node.cpp.j2",
        "ros2/launch/controller.launch.py": "ros2/controller.launch.py.j2",
        "ros2/config/params.yaml": "ros2/params.yaml.j2",
    }
)
"""Template of each file of the example programs."""

_STACK = 6144  # [bytes] of the compiler's intermediate results and of the functions of the board
_OPTIONAL = ("working", "column")  # inputs that keep their default until a message arrives


def example_values(law: Exportable, within: Envelope, *, name: str, arrays: int) -> dict[str, Any]:
    """Return the values of the templates of `EXAMPLES`.

    Args:
        law: the law.
        within: ranges of the inputs and gains.
        name: prefix of files and symbols.
        arrays: bytes of the arrays on the stack of a step.
    """
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
        "package": _package(name),
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


def _package(name: str) -> str:
    # REP 144: lower-case letters, digits, single underscores, a letter first
    return re.sub(r"_+", "_", name.lower()).strip("_") or "controller"


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
