"""`surctl verify` of a system, its margins and region, and of claims about dynamics; other words: an application."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.application import to_application
from surctl.cli.output import FOLDER, Count, FiniteRange, as_json, finish, progress, saving, stoppable, timed
from surctl.cli.subject import (
    assigned,
    command_line,
    is_system,
    load_system,
    loop_data,
    loop_lines,
    refuse_others,
    region_words,
)
from surctl.errors import InputError, NotApplicable

if TYPE_CHECKING:
    from surctl.lyapunov import Solution

_LONG = 60.0  # s


@click.command
@click.argument("words", nargs=-1, metavar="FILE.py:FUNCTION]...")
@click.option("--seed", type=Count(0), default=0, help="Seed of the search for counterexamples (default 0).")
@click.option(
    "--time-limit",
    type=FiniteRange(min=0, max=1e6, min_open=True),
    default=None,
    metavar="S",
    help="Largest processor time per claim [s] (default 20; 60 for dynamics of your own).",
)
@click.option("--out", type=FOLDER, help="Folder for certificates and plots (default: no files).")
@as_json
def verify(
    words: tuple[str, ...], seed: int, time_limit: float | None, out: Path | None, as_json: bool, **_: Any
) -> None:
    """Prove or refute claims, and print margins of the loop."""
    if time_limit is not None and math.isnan(time_limit):  # click accepts NaN in any range
        raise InputError("is not a valid time", key="--time-limit", value=time_limit, remedy="give seconds, above 0")
    if is_system(words):
        verify_system(words, seed=seed, time_limit=time_limit or _LONG, out=out, as_json=as_json)
    if are_problems(words):
        verify_motion(words, seed=seed, time_limit=time_limit or _LONG, out=out, as_json=as_json)
    to_application(words)


def are_problems(words: Sequence[str]) -> bool:
    """Return whether the words are files about dynamics.

    Raises:
        InputError: only some of the words are such files, or an option does not apply to them.
    """
    files = [word for word in words if word.endswith(".toml") and Path(word).is_file()]
    if not files:
        return False
    from surctl.lyapunov import is_problem

    about = [word for word in files if is_problem(Path(word))]
    if not about:
        return False
    other = next((word for word in words if word not in about), None)
    if other is not None:
        remedy = "check it by a command of its own"
        raise InputError(
            "is not a claim about dynamics, unlike the other arguments", key="claim", value=other, remedy=remedy
        )
    refuse_others("a claim about dynamics")
    return True


def verify_motion(words: Sequence[str], *, seed: int, time_limit: float, out: Path | None, as_json: bool) -> None:
    """Prove or refute the claims; exit with status 1 if a verdict is not the expected one."""
    from surctl.files import prepare_folder
    from surctl.lyapunov import load_problem, solve

    problems = {word: load_problem(Path(word)) for word in words}
    names = [problem.dynamics.name for problem in problems.values()]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError("is given twice", key="claim", value=twice, remedy="rename or drop one of them")
    if out is not None:
        prepare_folder(out)
    lines: list[str] = []
    claims: list[dict[str, Any]] = []
    failures: list[str] = []
    files: list[Path] = []
    for word, problem in problems.items():
        with (
            timed(problem.dynamics.name, time_limit),
            stoppable("", lines, above="the finished claims are above", as_json=as_json),
        ):
            try:
                solution = solve(problem, time_limit=time_limit, seed=seed, progress=progress)
            except InputError as error:
                raise (error if error.file else error.inside(Path(word))) from None
        lines += solution.lines()
        data = solution.to_dict() | {"expected": problem.expected}
        if out is not None:
            written = write_solution(solution, out)
            files += written[:1]
            data["files"] = [str(path) for path in written]
            lines += [f"  {path}" for path in written]
        claims.append(data)
        if solution.verdict != problem.expected:
            failures.append(f"{problem.dynamics.name} is {solution.verdict}, not {problem.expected}")
    if failures:
        lines.append(f"NOT accepted: {'; '.join(failures)}")
    then = [shlex.join(["surctl", "check", str(file)]) for file in files[:1]]
    if out is None and any(claim["verdict"] == "proved" for claim in claims):
        then = [shlex.join(["surctl", "verify", *words, "--out", "proofs"])]
    result = {"claims": claims} | ({"failures": failures} if failures else {})
    where = [f"certificates, plots {out}"] if files else []
    finish(result, lines, as_json=as_json, passed=not failures, then=then, files=where)


def write_solution(solution: Solution, out: Path) -> list[Path]:
    """Write the certificate, if there is one, and the picture of a region; return the files."""
    from surctl.files import write_file
    from surctl.lyapunov import Safety

    if solution.decision is None or not solution.document:
        return []
    claim = solution.decision.claim
    name = claim.dynamics.name
    text = json.dumps(solution.document, ensure_ascii=False, separators=(",", ":"))
    files = []
    with saving("certificate"):
        files.append(write_file(out / f"{name}.json", text + "\n"))
    if not isinstance(claim, Safety):
        with saving("plot"):
            from surctl.report.motion_plots import plot_motion
            from surctl.report.theme import save_figure

            figure = plot_motion(solution.dynamics, claim.function, level=claim.level, falsified=solution.falsified)
            files.append(save_figure(figure, out, (name,)))
    return files


def verify_system(words: Sequence[str], *, seed: int, time_limit: float, out: Path | None, as_json: bool) -> None:
    """Print equilibrium, sampled closed-loop poles and margins, and prove a region of attraction if its box is given.

    The exit status is 1 if a margin is too small at a corner of the ranges, or if no region is proved.
    """
    from surctl.assessment import ClosedLoop, assess
    from surctl.files import prepare_folder
    from surctl.lyapunov import Solution, solve

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
        if isinstance(problem, NotApplicable):
            raise problem
        assert problem is not None  # the subject asks only then
        with timed("region of attraction", time_limit):
            return solve(problem, time_limit=time_limit, seed=seed, progress=progress)

    subject = ClosedLoop(own.system, values, uncertain, region=None if problem is None else solved)
    ready = assess(subject, parts=["loop"])
    loop = ready.sources["loop"]
    if isinstance(loop, InputError):
        raise loop
    shown = [f"{line.mark} {line.text}" for line in ready.lines if line.counts]
    with stoppable("the region of attraction is not decided", shown, as_json=as_json):
        assessment = assess(subject, computed=ready.parts)
    lines, data = loop_lines(own, loop), loop_data(own, loop)
    data |= {"values": {name: value.ravel().tolist() for name, value in values.items()}}
    certificates = list[str]()
    solution = assessment.sources.get("region")
    if solution is not None:
        data["region"] = solution.to_dict()
    if isinstance(solution, Solution):
        about = f" of {solution.about}" if solution.decision is not None else ""
        lines += [f"region of attraction{about}:", *solution.lines()]
        if out is not None:
            written = [str(path) for path in write_solution(solution, out)]
            data["region"]["files"] = written
            lines += [f"  {path}" for path in written]
            certificates = written[:1]
    lines += [f"{line.mark} {line.text}" for line in assessment.lines]
    decisive = sorted(assessment.lines, key=lambda line: (line.rank, line.about != "region"))
    passed = assessment.accepted("loop", "region")
    data = {**own.names, **data, "assessment": assessment.to_dict()}
    settings = [word for word in others if not word.startswith("start.")]
    # without a duration of the system, a run of 100 periods
    time = () if own.system.duration else ("--seconds", f"{100 * own.system.dt:g}")
    then = [command_line("export", own, *settings, *time, "--out", "firmware")]
    then += [shlex.join(["surctl", "check", path, "--bundle", "firmware"]) for path in certificates]
    finish(
        data, lines, as_json=as_json, passed=passed, then=then if passed else (),
        brief=[f"{line.mark} {line.text}" for line in decisive],
        files=[f"certificate, plot {out}"] if certificates else [],
    )  # fmt: skip
