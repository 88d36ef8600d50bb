"""`surctl verify FILE.py:FUNCTION`: equilibrium, poles and margins of a system of the user's own."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surctl.cli.activity import progress, timed
from surctl.cli.output import finish
from surctl.cli.system_option import OwnSystem, assigned, command_line, load_system

if TYPE_CHECKING:
    from surctl.ir import Layout
    from surctl.lyapunov import Solution
    from surctl.system import Operating, System
    from surctl.verification.sampled_margins import SystemCorners, SystemLoop

__all__ = ["loop_data", "loop_lines", "mode_text", "resting", "verify_system"]


def verify_system(words: Sequence[str], *, seed: int, time_limit: float, out: Path | None, as_json: bool) -> None:
    """Print equilibrium, sampled closed-loop poles and margins, and prove a region of attraction if its box is given.

    The exit status is 1 if a margin is too small at a corner of the ranges, or if no region is proved.
    """
    from surctl.assessment import ClosedLoop, assess
    from surctl.cli.motion_verify import write_solution
    from surctl.cli.system_region import region_words
    from surctl.errors import InputError
    from surctl.files import prepare_folder
    from surctl.lyapunov import solve

    own = load_system(words)
    others, region, uncertain = region_words(own.settings, own.system)
    values = assigned(others)
    uncertain = {**own.system.ranges, **uncertain}
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

    def solved() -> Solution:
        assert problem is not None  # the subject asks only then
        with timed("region of attraction", time_limit):
            return solve(problem, time_limit=time_limit, seed=seed, progress=progress)

    subject = ClosedLoop(own.system, values, uncertain, region=None if problem is None else solved)
    assessment = assess(subject)
    loop = assessment.sources["loop"]
    if isinstance(loop, InputError):
        raise loop
    lines, data = loop_lines(own, loop), loop_data(own, loop)
    data |= {"values": {name: value.ravel().tolist() for name, value in values.items()}}
    certificates = list[str]()
    solution = assessment.sources.get("region")
    if solution is not None:
        about = "sampled loop, with held commands" if solution.sampled else "control law in continuous time"
        lines += [f"region of attraction of the {about}:", *solution.lines()]
        data["region"] = solution.to_dict()
        if out is not None:
            written = [str(path) for path in write_solution(solution, out)]
            data["region"]["files"] = written
            lines += [f"  {path}" for path in written]
            certificates = written[:1]
    lines += [f"{line.mark} {line.text}" for line in assessment.lines]
    passed = assessment.passed is True
    data = {**own.names, **data, "assessment": assessment.to_dict()}
    settings = [word for word in others if not word.startswith("start.")]
    then = [command_line("export", own, *settings, "--seconds", f"{100 * own.system.dt:g}", "--out", "firmware")]
    then += [shlex.join(["surctl", "check", path, "--bundle", "firmware"]) for path in certificates]
    finish(data, lines, as_json=as_json, passed=passed, then=then if passed else ())


def loop_lines(own: OwnSystem, loop: SystemCorners) -> list[str]:
    """Return lines of text: equilibrium, slowest mode, margins of each loop alone and of all loops at once."""
    nominal, period = loop.nominal, own.system.dt
    lines = [f"{own.title}, linear about its equilibrium, with references and disturbances of t = 0:"]
    lines += [
        f"  {kind} {label} = {value:.6g} {unit}"
        for kind, rows in resting(own.system, nominal.at).items()
        for label, value, unit in rows
    ]
    stable = "stable" if nominal.stable else "UNSTABLE"
    lines.append(f"sampled every {period:g} s: {stable}, {len(nominal.poles)} poles")
    lines.append(f"  slowest mode: {mode_text(nominal)}")
    if nominal.stable:
        lines += ["each loop alone, opened at one signal, all others closed:"]
        lines += [f"  {margin.line()}" for margin in nominal.margins]
        lines += [margin.line(margin.place) for margin in nominal.disks]
    if loop.count:
        word = f"disk margin {loop.disk:.2f}" if loop.stable else "no equilibrium" if loop.lost else "UNSTABLE"
        lines.append(f"worst of the {loop.count} corners of the ranges: {word} at {loop.corner}")
    return lines


def loop_data(own: OwnSystem, loop: SystemCorners) -> dict[str, Any]:
    """Return equilibrium, poles and margins as plain data for JSON."""
    nominal = loop.nominal
    return {
        "equilibrium": {
            kind: {label: value for label, value, _ in rows} for kind, rows in resting(own.system, nominal.at).items()
        },
        "stable": nominal.stable,
        "poles": [[float(pole.real), float(pole.imag)] for pole in nominal.poles],
        "slowest_mode": _slowest(nominal),
        "margins": [margin.to_dict() for margin in nominal.margins],
        "disk_margins": [margin.to_dict() for margin in nominal.disks],
        "worst": {"stable": loop.stable, "disk_margin": loop.disk, "corner": loop.corner, "corners": loop.count},
    }


def resting(system: System, at: Operating) -> dict[str, list[tuple[str, float, str]]]:
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


def _slowest(loop: SystemLoop) -> dict[str, Any]:
    """Return magnitude, time constant [s] (negative if unstable) and angular frequency [rad/s] of the slowest pole."""
    pole, dt = complex(loop.poles[0]), loop.linear.dt
    size = abs(pole)
    rate = math.log(size) / dt if size > 0.0 else -math.inf
    return {
        "pole": [pole.real, pole.imag],
        "size": size,
        "time_constant_s": -1.0 / rate if rate else math.inf,
        "frequency_rad_per_s": abs(math.atan2(pole.imag, pole.real)) / dt,
    }


def mode_text(loop: SystemLoop) -> str:
    """Return what the slowest mode does, as text."""
    mode = _slowest(loop)
    constant, frequency = mode["time_constant_s"], mode["frequency_rad_per_s"]
    change = f"{'decays' if constant >= 0 else 'grows'} with time constant {abs(constant):.4g} s"
    beat = f", oscillates at {frequency:.4g} rad/s" if frequency > 0 else ""
    return f"|z| = {mode['size']:.6g}, {'does not decay' if math.isinf(constant) else change}{beat}"
