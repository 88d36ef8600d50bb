"""Problem files that several tests use."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from surctl.lyapunov import Dynamics, Range, State
from surctl.verification.formula import parse, variable

VAN_DER_POL = """
kind = "lyapunov"
name = "van-der-pol"
function = "1.5*x^2 - x*y + y^2"
level = 2.0
[constants]
mu = 1.0
[definitions]
damping = "mu*(1 - x^2)"
[states]
x = { rate = "-y", lower = -3, upper = 3, unit = "m" }
y = { rate = "x - damping*y", lower = -3, upper = 3, unit = "m/s" }
"""

DECAY = """
kind = "barrier"
name = "decay"
barrier = "x - 1.5"
multiplier = "-1"
initial = ["x^2 <= 1"]
unsafe = ["x >= 2"]
[states]
x = { rate = "-k*x", lower = -3, upper = 3, unit = "m" }
[parameters]
k = { lower = 0.8, upper = 1.2, unit = "1/s" }
"""

MAP = """
kind = "lyapunov"
name = "map"
time = "discrete"
function = "x^2 + y^2"
level = 1.0
rate = 0.2
[states]
x = { next = "0.5*x + 0.2*y^2", lower = -2, upper = 2 }
y = { next = "0.4*y - 0.3*x*y", lower = -2, upper = 2 }
"""


def written(folder: Path, text: str, *changes: tuple[str, str]) -> Path:
    """Write a problem file after some replacements, each of which must occur; return its path."""
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "problem.toml"
    path.write_text(text, encoding="utf-8")
    return path


def dynamics(
    states: Mapping[str, tuple[float, ...]],
    rates: list[str],
    parameters: Mapping[str, tuple[float, float]] | None = None,
    *,
    discrete: bool = False,
) -> Dynamics:
    """Return dynamics; a state has bounds, and an equilibrium if it is not 0."""
    ranges = tuple(Range(name, *ends) for name, ends in (parameters or {}).items())
    known = {name: variable(name) for name in (*states, *(r.name for r in ranges))}
    axes = tuple(State(k, v[0], v[1], equilibrium=v[2] if len(v) > 2 else 0.0) for k, v in states.items())
    return Dynamics(
        "example", "discrete" if discrete else "continuous", axes, tuple(parse(rate, known) for rate in rates), ranges
    )
