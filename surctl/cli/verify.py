"""`surctl verify`: claims are decided one after another; of a system, of dynamics, of what an application brings."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click

from surctl.cli import lib
from surctl.cli.application import to_application
from surctl.cli.options import FOLDER, Count, FiniteRange
from surctl.cli.output import (
    as_json,
    finish,
    prepare_out,
    progress,
    refusal_line,
    same_command,
    saving,
    stoppable,
    timed,
)
from surctl.cli.subject import assigned, is_system, load_system, refuse_others, region_words
from surctl.errors import InputError, NotApplicable, check_once, mistakes_in

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


class Decided(NamedTuple):
    """A claim with its verdict: plain data, lines to print, files of certificate and picture, and the proof itself.

    `failure` says why the verdict is not the expected one; it is empty if it is.
    """

    data: Mapping[str, Any]
    lines: Sequence[str]
    files: Sequence[Path] = ()
    failure: str = ""
    proof: Any = None


class Claimed(NamedTuple):
    """A claim to decide: its name, the function that decides it, and the limit of processor time [s] that it has."""

    name: str
    decide: Callable[[], Decided]
    limit: float | None = None


def refused(one: lib.Inapplicable, *, counts: bool = True) -> Decided:
    """Return what is said of a claim that does not apply; it fails the command if it `counts`."""
    return Decided(one.to_dict(), [refusal_line(one)], failure=f"{one.claim} is not applicable" if counts else "")


def decide_claims(
    claims: Sequence[Claimed | Decided], message: str = "", *, out: Path | None, as_json: bool
) -> list[Decided]:
    """Decide claims one after another, except those that are decided already; Ctrl-C prints those that are finished."""
    done, lines = list[Decided](), list[str]()
    above = "the finished claims are above" + ("" if out is None or not message else f", certificates in {out}")
    for claim in claims:
        if isinstance(claim, Claimed):
            with timed(claim.name, claim.limit), stoppable(message, lines, above=above, as_json=as_json):
                done.append(claim.decide())
        else:
            done.append(claim)
        lines += done[-1].lines
    return done


def written(name: str, document: Mapping[str, Any], out: Path) -> list[Path]:
    """Write a certificate to `out` as NAME.json; return the file, or none if it cannot be written."""
    files = list[Path]()
    with saving(f"certificate of {name}"):
        text = json.dumps(document, ensure_ascii=False, separators=(",", ":"))
        files.append(lib.write_file(out / f"{name}.json", text + "\n"))
    return files


def failed_lines(done: Sequence[Decided], failing: Sequence[str] = ()) -> tuple[list[str], dict[str, list[str]]]:
    """Return the line that names what fails, and the same for JSON; nothing if all is as expected."""
    failures = [*failing, *(one.failure for one in done if one.failure)]
    return ([f"NOT accepted: {'; '.join(failures)}"], {"failures": failures}) if failures else ([], {})


def next_check(done: Sequence[Decided], out: Path | None, *words: str) -> list[str]:
    """Return the command that checks the first certificate, or that writes one."""
    files = [file for one in done for file in one.files[:1]]
    if out is None and any(one.data["verdict"] == "proved" for one in done):
        return [f"{same_command()} --out proofs"]
    return [shlex.join(["surctl", "check", str(file), *words]) for file in files[:1]]


def are_problems(words: Sequence[str]) -> bool:
    """Return whether the words are files about dynamics.

    Raises:
        InputError: only some of the words are such files, or an option does not apply to them.
    """
    files = [word for word in words if word.endswith(".toml") and Path(word).is_file()]
    if not files:
        return False
    about = [word for word in files if lib.is_problem(Path(word))]
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
    """Prove or refute claims about dynamics; exit with status 1 if a verdict is not the expected one."""
    problems = {word: lib.load_problem(Path(word)) for word in words}
    names = (problem.dynamics.name for problem in problems.values())
    check_once(names, "is given twice", key="claim", remedy="rename or drop one of them")
    if out is not None:
        prepare_out(out)

    def decided(word: str, problem: lib.Problem) -> Decided:
        with mistakes_in(Path(word)):
            solution = lib.solve(problem, time_limit=time_limit, seed=seed, progress=progress)
        return solved(solution, out, expected=problem.expected)

    claims = [Claimed(one.dynamics.name, partial(decided, word, one), time_limit) for word, one in problems.items()]
    done = decide_claims(claims, out=out, as_json=as_json)
    failed, failures = failed_lines(done)
    where = [f"certificates, plots {out}"] if any(one.files for one in done) else []
    finish(
        {"claims": [one.data for one in done], **failures}, [*(line for one in done for line in one.lines), *failed],
        as_json=as_json, passed=not failures, then=next_check(done, out), files=where,
    )  # fmt: skip


def solved(solution: lib.Solution, out: Path | None, *, expected: str | None = None) -> Decided:
    """Return the verdict on dynamics, and write the certificate, if there is one, and the picture of a region."""
    data = solution.to_dict() | ({} if expected is None else {"expected": expected})
    files = list[Path]()
    if out is not None and solution.decision is not None and solution.document:
        claim = solution.decision.claim
        files = written(claim.dynamics.name, solution.document, out)
        if not isinstance(claim, lib.Safety):
            with saving("plot"):
                figure = lib.plot_motion(
                    solution.dynamics, claim.function, level=claim.level, falsified=solution.falsified
                )
                files.append(lib.save_figure(figure, out, (claim.dynamics.name,)))
    if out is not None:
        data["files"] = [str(file) for file in files]
    bad = expected is not None and solution.verdict != expected
    failure = f"{data['claim']} is {solution.verdict}, not {expected}" if bad else ""
    return Decided(data, [*solution.lines(), *(f"  {file}" for file in files)], files, failure, solution)


def verify_system(words: Sequence[str], *, seed: int, time_limit: float, out: Path | None, as_json: bool) -> None:
    """Print equilibrium, sampled closed-loop poles and margins, and prove a region of attraction if its box is given.

    The exit status is 1 if a margin is too small at a corner of the ranges, or if no region is proved.
    """
    own = load_system(words)
    others, region, uncertain = region_words(own.settings, own.system)
    values = assigned(others)
    uncertain = {**own.system.ranges, **uncertain}
    if out is not None:
        if region is None:
            remedy = "add within.STATE=LOW..HIGH for every state, or drop it"
            problem = "has no effect: no region of attraction is requested, so there is no certificate to write"
            raise InputError(problem, key="--out", remedy=remedy)
        prepare_out(out)
    with mistakes_in(own.word):
        claim = None if region is None else region.problem(own.system, values)

    def proved() -> lib.Solution:
        if isinstance(claim, NotApplicable):
            raise claim
        assert claim is not None  # the subject asks only then
        with timed("region of attraction", time_limit):
            return lib.solve(claim, time_limit=time_limit, seed=seed, progress=progress)

    subject = lib.ClosedLoop(own.system, values, uncertain, region=None if claim is None else proved)
    with mistakes_in(own.word):
        ready = lib.assess(subject, parts=["loop"])
    loop = ready.sources["loop"]
    if isinstance(loop, InputError):
        raise loop.inside(own.word)
    shown = [f"{line.mark} {line.text}" for line in ready.lines if line.counts]
    with stoppable("the region of attraction is not decided", shown, as_json=as_json):
        assessment = lib.assess(subject, computed=ready.parts)
    lines, data = own.loop_lines(loop), own.loop_data(loop)
    data |= {"values": {name: value.ravel().tolist() for name, value in values.items()}}
    files: Sequence[Path] = ()
    solution = assessment.sources.get("region")
    if isinstance(solution, lib.Solution):
        about = f" of {solution.about}" if solution.decision is not None else ""
        decided = solved(solution, out)
        lines += [f"region of attraction{about}:", *decided.lines]
        data["region"], files = decided.data, decided.files
    elif solution is not None:
        data["region"] = solution.to_dict()
    lines += [f"{line.mark} {line.text}" for line in assessment.lines]
    decisive = sorted(assessment.lines, key=lambda line: (line.rank, line.about != "region"))
    brief = [f"{line.mark} {line.text}" for line in decisive]
    passed = assessment.accepted("loop", "region")
    settings = [word for word in others if not word.startswith("start.")]
    # without a duration of the system, a run of 100 periods
    time = () if own.system.duration else ("--seconds", f"{100 * own.system.dt:g}")
    then = [own.command("export", *settings, *time, "--out", "firmware")]
    then += [shlex.join(["surctl", "check", str(file), "--bundle", "firmware"]) for file in files[:1]]
    finish(
        {**own.names, **data, "assessment": assessment.to_dict()}, lines, as_json=as_json, passed=passed,
        then=then if passed else (), brief=[*brief[:1], *assessment.caveats, *brief[1:]],
        files=[f"certificate, plot {out}"] if files else [],
    )  # fmt: skip
