"""`surctl simulate`: how runs are conducted, printed and written; of a system, and of what an application brings."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click

from surctl.cli import lib
from surctl.cli.application import to_application
from surctl.cli.options import out_folder
from surctl.cli.output import as_json, finish, prepare_out, progress, saving, stoppable, warnings_in
from surctl.cli.subject import OwnSystem, assigned, is_system, load_system, seconds_option
from surctl.errors import InputError, check_known


@click.command
@click.argument("words", nargs=-1, metavar="FILE.py:FUNCTION NAME=VALUE...")
@seconds_option
@click.option("--save", metavar="FORMAT", help="Save runs in --out DIR: csv, mat or nc; missions also mcap.")
@out_folder
@as_json
def simulate(
    words: tuple[str, ...], seconds: float | None, save: str | None, out: Path | None, as_json: bool, **_: Any
) -> None:
    """Simulate a closed loop."""
    if is_system(words):
        check_save(save, lib.RECORD_FORMATS, out=out)
        simulate_own_system(words, seconds=seconds, out=out, save=save or "csv", as_json=as_json)
    to_application(words)


def check_save(save: str | None, formats: Sequence[str], *, out: Path | None) -> None:
    """Raise InputError if the format of `--save` is not among the formats, or no folder is given."""
    if save is not None:
        check_known(save, formats, key="--save")
        if out is None:
            raise InputError("needs an output folder", key="--save", remedy="add --out DIR")


class Ran(NamedTuple):
    """A run: plain data, lines to print, those that decide, whether it is as expected, and commands to run next."""

    data: Mapping[str, Any]
    lines: Sequence[str]
    brief: Sequence[str]
    passed: bool
    then: Sequence[str] = ()


def conduct_runs(
    cases: Iterable[tuple[Sequence[str], Iterable[Ran]]],
    *,
    out: Path | None,
    as_json: bool,
    single: bool = True,
    above: Sequence[str] = (),
    series: Callable[[Sequence[Mapping[str, Any]]], list[str]] | None = None,
    short: bool = False,
    beside: str = "",
) -> None:
    """Simulate runs, print what they show, and end the command; Ctrl-C prints the finished ones.

    Args:
        cases: lines about each case, and its runs, which are simulated one after another.
        out: folder of the files; it exists.
        as_json: print the data in place of the lines.
        single: whether there is one run, whose data are those of the command.
        above: lines above all others.
        series: returns lines about several runs of a case, which are what decides of them.
        short: whether these lines take the place of those of the runs.
        beside: text beside the folder.
    """
    done, lines, brief = list[Ran](), list(above), list[str]()
    message = "the run was not finished" if single else "to begin at another seed: --seed N"
    finished = "" if single else "the runs above are finished" + ("" if out is None else f", files in {out}")
    with stoppable(message, lines, above=finished, as_json=as_json):
        for head, runs in cases:
            lines += head
            start, first, said = len(lines), len(done), len(brief)
            for ran in runs:
                done.append(ran)
                lines += ran.lines
                brief += ran.brief
                if series is not None and as_json:
                    progress(ran.lines[0])
                elif series is not None and short:
                    lines[start:] = series([one.data for one in done[first:]])
            if series is not None and len(done) - first > 1:
                brief[said:] = [line.strip() for line in series([one.data for one in done[first:]])]
    data = done[0].data if series is None else {"runs": [one.data for one in done]}
    files, brief = [] if out is None else [f"files {out}{beside}"], [*brief, *warnings_in(lines)]
    passed, then = all(one.passed for one in done), [command for one in done[:1] for command in one.then]
    finish(data, lines, as_json=as_json, passed=passed, then=then, brief=brief, files=files)


def simulate_own_system(
    words: Sequence[str], *, seconds: float | None, out: Path | None, save: str, as_json: bool
) -> None:
    """Simulate one run, print how it ended and its costs, and write signals (as csv, mat or nc) and plot to `out`."""
    own = load_system(words)
    duration, values = own.seconds(seconds), assigned(own.settings)
    if out is not None:
        prepare_out(out)
    runs = (_ran(own, one, duration, out, save) for one in [values])  # simulated where Ctrl-C is handled
    conduct_runs([((), runs)], out=out, as_json=as_json)


def _ran(own: OwnSystem, values: Mapping[str, Any], duration: float, out: Path | None, save: str) -> Ran:
    record = lib.run_system(own.system, duration, values)
    assessment = lib.assess(lib.ClosedLoop(own.system, values, record=record), parts=["run"])
    judged = [f"{line.mark} {line.text}".strip() for line in assessment.lines if line.about]
    costs, files = own.cost_lines(record.figures), [] if out is None else _write(own, record, out, save)
    data = {
        **own.names,
        "values": {name: value.ravel().tolist() for name, value in values.items()},
        "stopped": record.stopped,
        "not_finite": record.lost or None,
        "duration_s": record.duration,
        "costs": own.cost_data(record.figures),
        "assessment": assessment.to_dict(),
        "files": [str(file) for file in files],
    }
    swept = [own.command("sweep", a, "--seconds", f"{duration:g}", "--out", "sweep") for a in own.default_axes({})]
    then = [own.command("verify", *own.settings), *swept[:1]] if record.stopped != lib.LOST else []
    good = [line for line in judged if line.startswith("ok ")]
    brief = [own.end_text(record), *(line for line in judged if line not in good)]
    end = {"duration": record.duration, "dt": own.system.dt}
    verdicts = {n: lib.cost_verdicts(n, cost, record.figures[n], **end) for n, cost in own.system.costs.items()}
    doubtful = [name for name, lines in verdicts.items() if any(line.rank < 2 for line in lines)]
    shown = [] if record.lost else own.cost_lines(record.figures, without=doubtful)
    brief += [*(" ".join(line.split()) for line in shown), *good]
    lines = [brief[0], *costs, *judged, *(f"  {file}" for file in files)]
    return Ran(data, lines, brief, assessment.accepted(), then)


def _write(own: OwnSystem, record: lib.Record, out: Path, kind: str) -> list[Path]:
    name = lib.file_name(f"{own.system.plant.name}-{own.system.controller.name}")
    origin = own.origin | {"values": json.dumps({n: v.tolist() for n, v in assigned(own.settings).items()})}
    files = list[Path]()
    with saving("record"):
        files.append(lib.save_record(record, out / f"{name}.{kind}", about=origin))
    with saving("plot"):
        files.insert(0, lib.save_figure(record.plot(), out, (name,)))
    return files
