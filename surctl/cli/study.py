"""`surctl study`: how every study runs and ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from surctl.cli import lib
from surctl.cli.application import to_application
from surctl.cli.options import FOLDER, Count
from surctl.cli.output import as_json, finish, note_replaced, same_command, stoppable
from surctl.cli.subject import is_system, seconds_option


@click.command
@click.argument("words", nargs=-1, metavar="FILE.py:FUNCTION [WORD]...]")
@click.option(
    "--out", type=FOLDER, default=Path("surctl-out"), help="Folder for report, gains and code (default surctl-out)."
)
@click.option("--workers", type=Count(1), default=2, help="Number of processes of the sweep (default 2).")
@seconds_option
@as_json
def study(words: tuple[str, ...], out: Path, workers: int, seconds: float | None, as_json: bool, **_: Any) -> None:
    """Simulate, verify, sweep and export in one command, and write one report."""
    if is_system(words):
        from surctl.cli.system_study import study_of

        one = study_of(words, seconds=seconds, workers=workers, out=out)
        conduct_study(one, out, below=one.lines, then=one.next_commands, as_json=as_json)
    to_application(words)


def conduct_study(
    study: lib.StudyParts,
    out: Path,
    *,
    above: Sequence[str] = (),
    below: Callable[[], Sequence[str]],
    then: Callable[[], Sequence[str]],
    as_json: bool,
) -> None:
    """Conduct a study, print its lines or its data, and end the command.

    Args:
        study: what the study is about.
        out: its folder.
        above, below: lines above and below those of the assessment.
        then: returns the commands to suggest next.
        as_json: print the data in place of the lines.
    """
    note_replaced(out / "export" / "manifest.json", study.command)
    with stoppable(f"what is finished is in {out}; to continue: {same_command()}", study.ran, as_json=as_json):
        lib.conduct_parts(study, out)
    assessment, report, code = study.assessment, study.report, out / "export"
    head = f"study {study.title}: {study.verdict} {study.suggestion * study.passed}".rstrip()
    marked = [f"{line.mark} {line.text}" for line in assessment.lines]
    lines = [head, *above, *marked, *below(), ""]
    lines += [f"gains  {study.gain_file}"] if study.gain_file else []
    lines += [f"code   {code} ({len(study.files)} files)"] if study.files else []
    lines += [f"report {report}"] if report else []
    # the verdict itself is about the worst line unless all holds
    weakest = assessment.weakest(3, *study.decided)[assessment.passed is not True :]
    worst = [f"{line.mark} {line.text}" for line in weakest]
    brief = [head, *worst[:1], *assessment.caveats, *worst[1:]]
    files = [*([f"report {report}"] if report else []), f"code {code}"]
    finish(study.to_dict(), lines, as_json=as_json, passed=study.passed, then=then(), brief=brief, files=files)
