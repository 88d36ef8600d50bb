"""Wiring of an exported law, for the README of its bundle: where every input comes from, and what a status demands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import groupby
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable, is_robot_law
from surctl.ir import Real

__all__ = [
    "DEMANDS",
    "RESTART",
    "UNKNOWN",
    "aged",
    "aged_runs",
    "forgotten",
    "forgotten_runs",
    "longest_gap",
    "step_line",
    "wiring_values",
]

Vector = NDArray[np.float64]

RESTART = 10
"""Number of older samples, after the first, whose numbers must rise before the counter counts as started again."""

_MEMORY = 0.15
"""[s] Longest gap between two accepted steps after which estimates from the last steps still describe the present."""


def longest_gap(dt: float) -> int:
    """Return the largest number of periods between two accepted steps after which short memories are kept."""
    return max(1, int(_MEMORY / dt + 1e-9))


def aged(law: Exportable, x: Vector, periods: int, *, real: Real) -> Vector:
    """Return the state (nx,) `periods` after the last accepted step, as the exported C computes it before the law.

    A part of the state with the rule `age` grows by the missed periods, up to its initial value, which is the largest
    age. A part with the rule `anew` returns to its initial value after more than `longest_gap` periods.
    """
    number = np.dtype(real).type
    out, start = np.array(x, dtype=float), np.asarray(law.initial_state(), dtype=real).astype(float)
    more = number(periods - 1) * number(law.dt)
    for port in law.state:
        part = law.state.slice(port.name)
        if port.gap == "age":
            out[part] = np.minimum(out[part].astype(real) + more, start[part].astype(real))
        elif port.gap == "anew" and periods > longest_gap(law.dt):
            out[part] = start[part]
    return out


def forgotten(law: Exportable) -> str:
    """Return the names of the parts of the state that begin anew after a long gap."""
    return ", ".join(port.name for port in law.state if port.gap == "anew")


def aged_runs(law: Exportable, text: Callable[[float], str]) -> list[tuple[int, int, str]]:
    """Return (first index, end, C text of the largest age) of the entries of the state that grow in a gap."""
    return list(_runs(law, "age", text))


def forgotten_runs(law: Exportable, text: Callable[[float], str]) -> list[tuple[int, int, str]]:
    """Return (first index, end, C text of the initial value) of the entries that begin anew after a long gap."""
    return list(_runs(law, "anew", text))


def _runs(law: Exportable, rule: str, text: Callable[[float], str]) -> Iterator[tuple[int, int, str]]:
    start = law.initial_state()
    rules = [port.gap for port in law.state for _ in range(port.size)]
    entries = ((k, text(float(start[k]))) for k in range(law.state.size) if rules[k] == rule)
    for value, group in groupby(enumerate(entries), key=lambda item: (item[1][0] - item[0], item[1][1])):
        indices = [k for _, (k, _) in group]
        yield indices[0], indices[-1] + 1, value[1]


DEMANDS: Mapping[str, str] = MappingProxyType(
    {
        "OK": "Apply the command.",
        "SATURATED": "Apply it. Alone it is no sign of trouble: a robot that brakes or evades uses all its thrust, by "
        "sonar in about half of the steps, for seconds in a row (the simulated run: see Evidence); unarmed it means "
        "nothing. If it comes "
        "with a `path_error` that grows, the robot cannot follow: lower `cruise`, or surface.",
        "SWITCHED": "Apply it, and log.",
        "DEGRADED": "Apply it, and log. Normal in the first steps, before a position and echoes have arrived. If the "
        "bit stays for a second later on, an obstacle is too near or too fast: be ready to stop.",
        "TRAPPED": "Apply it: the robot holds its place. To end it, the operator disarms and arms: `loop.c` then "
        "begins the mission anew, with an empty map. It may come long after `patience`: new ground counts as progress. "
        "A program of your own calls `initialize`, which also sets the "
        "tuned gains. If the way is closed, give it another mission before.",
        "RESTARTED": "Apply it, and log: the board that counts samples was started again; every age is at its largest.",
        "NULL": "Thrusters to zero. A mistake in the program: stop.",
        "NONFINITE": "Thrusters to zero in this period. Go on calling the step; find the input that is no number.",
        "RANGE": "Thrusters to zero in this period. Go on calling the step. `gains_check` reports whether a gain is "
        "wrong; otherwise an input is out of its range or jumped.",
        "STALE": "Thrusters to zero in this period. The sample number did not rise: the sensor task stands still.",
        "ITER": "Thrusters to zero in this period. Go on calling the step, and report it: the law must not return it.",
    }
)
"""What a program does after a step with this status."""

UNKNOWN = "See unit and meaning in the table of inputs."
"""Origin of an input of which nothing more is known."""


def _demands(law: Exportable) -> dict[str, str]:
    texts = dict(DEMANDS)
    if not law.gains.size:
        texts["RANGE"] = (
            "Thrusters to zero in this period. Go on calling the step; an input is out of its range or jumped."
        )
    return texts if is_robot_law(law) else {k: v.replace("Thrusters", "Actuators") for k, v in texts.items()}


def step_line(law: Exportable) -> str:
    """Return the line that says how often the step runs."""
    return f"Step: every {law.dt:g} s, from a timer; a period that is missed is counted, not caught up."


def wiring_values(law: Exportable) -> dict[str, Any]:
    """Return the values of the template of the wiring section, for a controller of which no more is known."""
    return {
        "demands": _demands(law),
        "wires": [(port.name, UNKNOWN) for port in law.inputs],
        "sonar_lines": [],
        "rate_lines": [step_line(law), "Inputs: measured within the period before the step; the law assumes no delay."],
        "thruster_rows": [],
        "ages": [port.name for port in law.state if port.gap == "age"],
        "restart_samples": RESTART,
        "gap_s": f"{longest_gap(law.dt) * law.dt:.3g}",
        "kept_periods": longest_gap(law.dt),
        "flag_names": [port.name for port in law.inputs if port.name == "fresh" or port.name.endswith("_fresh")],
        "own_age": False,
        "arriving": False,
        "stalling": [],
        "listening": False,
        "plant_line": "",
        "coasting": "",
        "own_known": False,
        "fed": False,
        "rows": [],
        "safe_periods": max(1, round(1.0 / law.dt)),
        "input_defaults": {port.name: np.asarray(port.default).tolist() for port in law.inputs if np.any(port.default)},
    }
