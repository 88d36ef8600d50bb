"""`surctl verify FILE.toml` for files of kind `lyapunov` and `barrier`: claims about the solutions of any dynamics."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surctl.cli.activity import progress, timed
from surctl.cli.output import finish, saving, stoppable

if TYPE_CHECKING:
    from surctl.lyapunov import Solution

__all__ = ["are_problems", "verify_motion", "write_solution"]


def are_problems(words: Sequence[str], *, only: Sequence[str]) -> bool:
    """Return whether the words are files about dynamics.

    Args:
        words: positional arguments of the command.
        only: names of the parameters of the command that apply to such files.

    Raises:
        InputError: only some of the words are such files, or an option does not apply to them.
    """
    files = [word for word in words if word.endswith(".toml") and Path(word).is_file()]
    if not files:
        return False
    import click
    from click.core import ParameterSource

    from surctl.errors import InputError
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
    context = click.get_current_context()
    for option in context.command.params:
        typed = context.get_parameter_source(option.name or "") != ParameterSource.DEFAULT
        if isinstance(option, click.Option) and typed and option.name not in only:
            raise InputError("does not apply to a claim about dynamics", key=option.opts[0], remedy="drop it")
    return True


def verify_motion(words: Sequence[str], *, seed: int, time_limit: float, out: Path | None, as_json: bool) -> None:
    """Prove or refute the claims; exit with status 1 if a verdict is not the expected one."""
    from surctl.errors import InputError
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
            stoppable("the finished claims are above", lines, as_json=as_json),
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
        lines.append(f"exit status 1, because {'; '.join(failures)}")
    then = [shlex.join(["surctl", "check", str(file)]) for file in files[:1]]
    if out is None and any(claim["verdict"] == "proved" for claim in claims):
        then = [shlex.join(["surctl", "verify", *words, "--out", "proofs"])]
    result = {"claims": claims} | ({"failures": failures} if failures else {})
    finish(result, lines, as_json=as_json, passed=not failures, then=then)


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
