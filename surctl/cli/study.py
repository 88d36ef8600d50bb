"""`surctl study`: sweep, verify, simulate and export in one command."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from surctl.cli.law_option import law_words, trust_option
from surctl.cli.output import as_json, at_hand, finish, progress, refusal_line, same_command, stoppable
from surctl.cli.verify import claim_line

__all__ = ["study"]


@click.command
@click.argument("file", required=False)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("surctl-out"),
    metavar="DIR",
    help="Folder for report, gains and code (default surctl-out).",
)
@click.option(
    "--workers", type=click.IntRange(min=1), default=2, metavar="N", help="Processes of the sweep (default 2)."
)
@trust_option
@as_json
def study(file: str | None, out: Path, workers: int, trust: bool, as_json: bool) -> None:
    """Sweep gains, select the best point, verify the claims, simulate the scenarios, and export and check the C code.

    FILE is a study file or a vehicle file; without FILE, the built-in study runs.

    Examples: surctl study; surctl study my-vehicle.toml --out results; surctl study --json > study.json
    """
    from surctl.study import conduct, load_plan

    command = " ".join(["surctl study", *([file] if file else []), f"--out {out}"])
    plan = load_plan(file, trust=trust)
    with stoppable(f"the finished points are in {out}; to continue: {same_command()}"):
        result = conduct(plan, out, workers=workers, progress=progress, command=command)
    lines = [f"study {result.plan.name}: {'passed' if result.passed else 'NOT passed'}"]
    lines += [] if plan.derivation is None else [f"started from {line.strip()}" for line in plan.derivation.lines()]
    marks = {True: "ok  ", False: "FAIL", None: "    "}
    lines += [f"{marks[note.passed]} {note.text}" for note in result.notes]
    loops = result.loops
    lines += ["", "loop          gain   phase   delay   disk"] if loops.margins else []
    if loops.mode is not None and not loops.stable:
        lines.append(f"unstable      loop {loops.mode.loop}; margins of an unstable loop are 0")
    for m in loops.margins if loops.stable else ():
        numbers = f"{m.gain_margin:5.2f} {m.phase_margin_deg:6.1f}° {m.delay_margin_s:6.2f}s {m.disk_margin:6.2f}"
        lines.append(f"{m.name:<12} {numbers}")
    lines += ["", *(claim_line(v) for v in result.verdicts), *(refusal_line(v) for v in result.inapplicable)]
    lines += ["", f"gains  {result.gain_file}", f"code   {out / 'export'}", f"report {result.report}"]
    tuning = ["surctl", "tune", *([file] if file else []), *(["--trust"] if trust else [])]
    about = at_hand(plan.deciding[0].scenario, plan.vehicle, str(result.gain_file))
    then = [shlex.join(words) for words in (tuning, _examined(plan.law, about))]
    finish(result.to_dict(), lines, as_json=as_json, passed=result.passed, then=then)


def _examined(law: str, about: list[str]) -> list[str]:
    """Return the command that checks the selected gains: `verify`, or `simulate` if no claim is about the law."""
    from surctl.control import law_source

    _, scenario, *others = about
    simulated = ["surctl", "simulate", scenario, *others, *law_words(law)]
    return ["surctl", "verify", *about] if law_source(law).parts else simulated
