"""`surctl simulate` of a system: one run, costs, --save, plot; other words go to an application."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.application import to_application
from surctl.cli.output import as_json, finish, out_folder, saving
from surctl.cli.subject import (
    OwnSystem,
    assigned,
    command_line,
    cost_data,
    cost_lines,
    end_text,
    is_system,
    load_system,
    seconds_option,
)
from surctl.errors import InputError, check_known

if TYPE_CHECKING:
    from surctl.system import Record


@click.command
@click.argument("words", nargs=-1, metavar="FILE.py:FUNCTION NAME=VALUE...")
@seconds_option
@click.option("--save", metavar="FORMAT", help="Save each run in --out DIR as csv, mat, nc or mcap.")
@out_folder
@as_json
def simulate(
    words: tuple[str, ...], seconds: float | None, save: str | None, out: Path | None, as_json: bool, **_: Any
) -> None:
    """Simulate a closed loop."""
    if is_system(words):
        from surctl.recorded_write import RECORD_FORMATS

        check_save(save, RECORD_FORMATS, out=out)
        simulate_own_system(words, seconds=seconds, out=out, save=save or "csv", as_json=as_json)
    to_application(words)


def check_save(save: str | None, formats: Sequence[str], *, out: Path | None) -> None:
    """Raise InputError if the format of `--save` is not among the formats, or no folder is given."""
    if save is not None:
        check_known(save, formats, key="--save")
        if out is None:
            raise InputError("needs an output folder", key="--save", remedy="add --out DIR")


def where(out: Path | None) -> list[str]:
    """Return where the files of runs are, for a summary."""
    return [] if out is None else [f"files {out}"]


def simulate_own_system(
    words: Sequence[str], *, seconds: float | None, out: Path | None, save: str, as_json: bool
) -> None:
    """Simulate one run, print how it ended and its costs, and write signals (as csv, mat or nc) and plot to `out`."""
    from surctl.assessment import ClosedLoop, assess
    from surctl.files import prepare_folder
    from surctl.system import LOST, run_system

    own = load_system(words)
    duration, values = own.seconds(seconds), assigned(own.settings)
    if out is not None:
        prepare_folder(out)
    record = run_system(own.system, duration, values)
    assessment = assess(ClosedLoop(own.system, values, record=record), parts=["run"])
    judged = [f"{line.mark} {line.text}".strip() for line in assessment.lines if line.about]
    lines = [end_text(own, record), *cost_lines(own.system, record.figures), *judged]
    files = [] if out is None else _write(own, record, out, save)
    lines += [f"  {file}" for file in files]
    data = {
        **own.names,
        "values": {name: value.ravel().tolist() for name, value in values.items()},
        "stopped": record.stopped,
        "not_finite": record.lost or None,
        "duration_s": record.duration,
        "costs": cost_data(own.system, record.figures),
        "assessment": assessment.to_dict(),
        "files": [str(file) for file in files],
    }
    fine = record.stopped != LOST
    swept = [
        command_line("sweep", own, a, "--seconds", f"{duration:g}", "--out", "sweep") for a in own.default_axes({})
    ]
    then = [command_line("verify", own, *own.settings), *swept[:1]] if fine else []
    good = [line for line in judged if line.startswith("ok ")]
    brief = [lines[0], *(line for line in judged if line not in good)]
    brief += [" ".join(line.split()) for line in cost_lines(own.system, record.figures)] + good
    finish(data, lines, as_json=as_json, passed=assessment.accepted(), then=then, brief=brief, files=where(out))


def _write(own: OwnSystem, record: Record, out: Path, kind: str) -> list[Path]:
    from surctl.files import file_name
    from surctl.system import save_record

    name = file_name(f"{own.system.plant.name}-{own.system.controller.name}")
    origin = own.origin | {"values": json.dumps({n: v.tolist() for n, v in assigned(own.settings).items()})}
    files = list[Path]()
    with saving("record"):
        files.append(save_record(record, out / f"{name}.{kind}", about=origin))
    with saving("plot"):
        from surctl.report.theme import save_figure

        files.insert(0, save_figure(record.plot(), out, (name,)))
    return files
