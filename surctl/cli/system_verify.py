"""`surctl verify FILE.py:FUNCTION`: equilibrium, poles and margins of a system of the user's own."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from surctl.cli.activity import progress, timed
from surctl.cli.output import finish
from surctl.cli.system_option import OwnSystem, assigned, command_line, load_system

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from surctl.ir import Layout
    from surctl.system import Operating, System
    from surctl.verification.linear.disk import DiskMargin
    from surctl.verification.margins import LoopMargins

__all__ = ["LinearResults", "linear_loop", "verify_system"]


def verify_system(words: Sequence[str], *, seed: int, time_limit: float, out: Path | None, as_json: bool) -> None:
    """Print equilibrium, sampled closed-loop poles and margins, and prove a region of attraction if its box is given.

    The exit status is 1 if the loop is unstable, or if no region is proved.
    """
    from surctl.cli.motion_verify import write_solution
    from surctl.cli.system_region import region_words
    from surctl.errors import InputError
    from surctl.files import prepare_folder
    from surctl.lyapunov import solve

    own = load_system(words)
    others, region = region_words(own.settings)
    values = assigned(others)
    if out is not None:
        if region is None:
            remedy = "add within.STATE=LOW..HIGH for every state, or drop it"
            raise InputError(
                "has no effect: no region of attraction is requested, so there is no certificate to write",
                key="--out",
                remedy=remedy,
            )
        prepare_folder(out)
    problem = None if region is None else region.problem(own.system, values)
    linear = linear_loop(own, values)
    stable, lines = linear.stable, linear.lines
    data = {**own.names, "values": {name: value.ravel().tolist() for name, value in values.items()}, **linear.data}
    passed, certificates = stable, list[str]()
    if problem is not None:
        with timed("region of attraction", time_limit):
            solution = solve(problem, time_limit=time_limit, seed=seed, progress=progress)
        lines += ["region of attraction of the control law in continuous time:", *solution.lines()]
        data["region"] = solution.to_dict()
        if out is not None:
            written = [str(path) for path in write_solution(solution, out)]
            data["region"]["files"] = written
            lines += [f"  {path}" for path in written]
            certificates = written[:1]
        passed = stable and solution.verdict == "proved"
    settings = [word for word in others if not word.startswith("start.")]
    then = [command_line("export", own, *settings, "--seconds", f"{100 * own.system.dt:g}", "--out", "firmware")]
    then += [shlex.join(["surctl", "check", path, "--bundle", "firmware"]) for path in certificates]
    finish(data, lines, as_json=as_json, passed=passed, then=then if passed else ())


class LinearResults(NamedTuple):
    """Equilibrium, sampled poles and margins of a system.

    Attributes:
        resting: (label, value, unit) of every number at the equilibrium, by kind.
        stable: whether the linear loop is stable.
        mode: what the slowest mode does, as text.
        margins: margins of the loops opened at one command.
        together: disk margin of all commands, and of all commands and measurements, opened at once.
        lines, data: the results as text and for JSON.
    """

    resting: Mapping[str, Sequence[tuple[str, float, str]]]
    stable: bool
    mode: str
    margins: Sequence[LoopMargins]
    together: Mapping[str, DiskMargin]
    lines: list[str]
    data: dict[str, Any]


def linear_loop(own: OwnSystem, values: Mapping[str, ArrayLike]) -> LinearResults:
    """Return the linear loop about the equilibrium.

    Raises:
        InputError: no equilibrium was found.
    """
    from surctl.system import find_equilibrium, linearise
    from surctl.verification.sampled_margins import system_disk_margin, system_margins

    at = find_equilibrium(own.system, values)
    linear = linearise(own.system, values, at=at)
    poles = linear.poles()
    commands = linear.channels()[: own.system.commands.size]
    margins = system_margins(linear, *commands)
    together = {"commands": system_disk_margin(linear, *commands)} if len(commands) > 1 else {}
    together["commands and measurements"] = system_disk_margin(linear)
    stable = together["commands and measurements"].stable
    mode = _slowest(complex(poles[0]), own.system.dt)
    resting = _equilibrium(own.system, at)
    lines = [f"{own.title}, linear about its equilibrium, with references and disturbances of t = 0:"]
    lines += [f"  {kind} {label} = {value:.6g} {unit}" for kind, rows in resting.items() for label, value, unit in rows]
    lines.append(f"sampled every {own.system.dt:g} s: {'stable' if stable else 'UNSTABLE'}, {len(poles)} poles")
    lines.append(f"  slowest mode: {_mode_text(mode)}")
    if stable:
        lines += ["loop opened at a command, all others closed:", *(f"  {m.line()}" for m in margins)]
        lines += [margin.line(what) for what, margin in together.items()]
    data = {
        "equilibrium": {kind: {label: value for label, value, _ in rows} for kind, rows in resting.items()},
        "stable": stable,
        "poles": [[float(pole.real), float(pole.imag)] for pole in poles],
        "slowest_mode": mode,
        "margins": [margin.to_dict() for margin in margins],
        "disk_margins": [margin.to_dict() for margin in together.values()],
    }
    return LinearResults(resting, stable, _mode_text(mode), margins, together, lines, data)


def _equilibrium(system: System, at: Operating) -> dict[str, list[tuple[str, float, str]]]:
    """Return (label, value, unit) of every number at the equilibrium, by kind."""
    from surctl.system import entry_labels, entry_units

    def rows(layout: Layout, numbers: Sequence[float]) -> list[tuple[str, float, str]]:
        return list(
            zip(entry_labels(layout), (float(number) + 0.0 for number in numbers), entry_units(layout), strict=True)
        )

    return {
        "state": rows(system.plant.state, at.x.tolist()),
        "controller state": rows(system.controller.state, at.z.tolist()),
        "command": rows(system.commands, at.f.tolist()),
    }


def _slowest(pole: complex, dt: float) -> dict[str, Any]:
    """Return magnitude, time constant [s] (negative if unstable) and angular frequency [rad/s] of a sampled pole."""
    size = abs(pole)
    rate = math.log(size) / dt if size > 0.0 else -math.inf
    return {
        "pole": [pole.real, pole.imag],
        "size": size,
        "time_constant_s": -1.0 / rate if rate else math.inf,
        "frequency_rad_per_s": abs(math.atan2(pole.imag, pole.real)) / dt,
    }


def _mode_text(mode: dict[str, Any]) -> str:
    constant, frequency = mode["time_constant_s"], mode["frequency_rad_per_s"]
    change = f"{'decays' if constant >= 0 else 'grows'} with time constant {abs(constant):.4g} s"
    beat = f", oscillates at {frequency:.4g} rad/s" if frequency > 0 else ""
    return f"|z| = {mode['size']:.6g}, {'does not decay' if math.isinf(constant) else change}{beat}"
