"""`surctl tune`: search gains and test them; HARD GOALS NOT MET, files that it writes, exit status, next command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from surctl.cli.output import FOLDER, Count, as_json, finish, finite, progress, same_command, saving, stoppable
from surctl.cli.robot_options import SPEEDS, trust_option
from surctl.cli.subject import is_system, seconds_option
from surctl.cli.tuning_output import mission_plan, missions_tuned, serve_page, serve_system_page, system_tuned

if TYPE_CHECKING:
    from surctl.cli.tuning_output import Task


@click.command
@click.argument("words", nargs=-1, metavar="[STUDY | FILE.py:FUNCTION [NAME=VALUE,...]...]")
@click.option(
    "--gain", "gain", multiple=True, metavar="NAME[=LOW..HIGH]", help="Gain to tune, with its range; may be repeated."
)
@click.option(
    "--goals", "goals_file", metavar="FILE", help="Goals: name or file (default: the study's, else the built-in goals)."
)
@click.option("--cruise", type=SPEEDS, metavar="U1,U2,...", help="Cruise speeds [m/s] of loop goals that name none.")
@click.option(
    "--trials",
    type=Count(1),
    default=256,
    help="Gain sets per round, each simulated in all scenarios (default 256; multiple of 32).",
)
@click.option("--seed", type=Count(0), default=0, help="Seed of the search and of the new runs (default 0).")
@click.option("--seeds", type=Count(1, 1_000_000), default=4, help="Simulate with the seeds 0 to N-1 (default 4).")
@click.option(
    "--vehicle", "vehicles", multiple=True, metavar="FILE", help="Vehicle (name or file) of the runs; may be repeated."
)
@click.option(
    "--guidance", metavar="NAME", help="Path guidance: los, ilos or alos (default: STUDY). Loop margins always use los."
)
@click.option(
    "--rounds", type=Count(1), default=3, help="Largest number of rounds of tuning and verifying (default 3)."
)
@click.option(
    "--monte-carlo",
    "runs",
    type=Count(0),
    help="Random runs that test the gains after each round (default 2000; of a system 0).",
)
@click.option("--workers", type=Count(1), default=2, help="Number of threads (default 2).")
@click.option(
    "--out",
    type=FOLDER,
    default=Path("surctl-out"),
    help="Output folder (default surctl-out); an interrupted search resumes there.",
)
@click.option("--page", is_flag=True, help="Open a page with sliders instead of a search.")
@click.option("--law", metavar="NAME", help="Law: NAME or FILE.py:FUNCTION (default: STUDY).")
@click.option("--scenario", metavar="FILE", help="Scenario of --page (default: the study's first).")
@click.option("--gains", "gains_file", metavar="FILE", help="Gain set at the start: name or file (default: STUDY).")
@click.option("--port", type=Count(1, 65535), help="Port of --page (default: a free port).")
@click.option("--no-browser", is_flag=True, help="Print the address of --page, but do not open it.")
@trust_option
@seconds_option
@as_json
def tune(
    words: tuple[str, ...],
    gain: tuple[str, ...],
    goals_file: str | None,
    cruise: tuple[float, ...] | None,
    trials: int,
    seed: int,
    seeds: int,
    vehicles: tuple[str, ...],
    guidance: str | None,
    rounds: int,
    runs: int | None,
    workers: int,
    out: Path,
    page: bool,
    law: str | None,
    scenario: str | None,
    gains_file: str | None,
    port: int | None,
    no_browser: bool,
    trust: bool,
    seconds: float | None,
    as_json: bool,
) -> None:
    """Search for gains that meet goals; test them, and repeat with runs that fail.

    The gains must meet the hard goals for every scenario, seed and corner of the vehicle's ranges; the soft goals are
    minimised. New random runs and the claims test the tuned gains. Exit status: 1 if a hard goal is not met or fails
    in the test, or if a line of the assessment fails.

    FILE.py:FUNCTION names a system of your own: the search minimises its first cost, with the bounds of the
    other costs and a disk margin of at least 0.3, for every value of NAME=V1,V2. With --goals, the search minimises the
    worst soft goal.

    Examples: surctl tune my-study.toml --gain k_v=0.5..3 --goals my-goals.toml; surctl tune my-system.py:build --page
    """
    ranges = dict(_gain(text) for text in gain)
    if len(ranges) < len(gain):
        raise click.BadParameter("names a gain twice", param_hint="--gain")
    shown, search = ("page", "port", "no_browser"), ("trials", "seed", "rounds", "runs", "workers")
    own = is_system(words, "gain", "goals_file", "seconds", "out", "as_json", *shown, *search)
    if not own and len(words) > 1:
        raise click.UsageError(f"Got unexpected extra argument ({words[1]})")
    file = words[0] if words else None
    if page and own:
        serve_system_page(words, ranges, goals_file, seconds=seconds, port=port, browser=not no_browser)
        return
    if page:
        serve_page(
            file, goals_file, vehicles,
            scenario=scenario, gains=gains_file, law=law, cruise=cruise, port=port, browser=not no_browser, trust=trust,
        )  # fmt: skip
        return
    if scenario or port or no_browser:
        raise click.UsageError(_needs_page(scenario))
    if own:
        task: Task = system_tuned(words, ranges, goals_file, seconds=seconds, trials=trials, seed=seed, threads=workers)
    else:
        from surctl.ir.cache import find_compiler

        find_compiler()  # thousands of runs: without compiled code, hours
        plan = mission_plan(file, trust=trust, law=law, gains=gains_file, vehicles=vehicles, out=out)
        task = missions_tuned(
            plan, ranges, goals_file, cruise=cruise or (), guidance=guidance, seeds=seeds, seed=seed, threads=workers
        )
    runs = (0 if own else 2000) if runs is None else runs
    _search(task, trials=trials, rounds=rounds, runs=runs, out=out, as_json=as_json)


def _search(task: Task, *, trials: int, rounds: int, runs: int, out: Path, as_json: bool) -> None:
    """Search gains, test them, write them, and print each goal and figure before and after."""
    from surctl.files import prepare_folder, write_file
    from surctl.tuning import summary
    from surctl.tuning import tune as run_tuning
    from surctl.tuning.goals import not_representative
    from surctl.tuning.outcome import advice, check_finals, misses, tuning_dict

    prepare_folder(out)
    best, _ = task.request.so_far({}, "")
    message = f"the finished trials are in {out}, the best gains in {out / best}; to continue: {same_command()}"
    with stoppable(message):
        tuning = run_tuning(task.request, trials=trials, rounds=rounds, runs=runs, folder=out, progress=progress)
        tuned = check_finals(tuning, task.finals, task.assessed, default=task.default, progress=progress)
    (tuning, checked), unmet = tuned, tuned.unmet
    warning = ""
    if unmet:
        warning = f"HARD GOALS NOT MET ({', '.join(unmet)}): best gains found, but do not use them on a vehicle"
    comparison = checked.comparison
    accepted, verdict = not unmet and comparison.after.accepted(), [comparison.after.verdict()]
    verdict = verdict * (not comparison.after.accepted())
    note = warning or "".join(verdict)
    gains_path = write_file(*task.gain_file(tuning, out, note))
    (out / best).unlink(missing_ok=True)
    more = task.more(tuning, checked, str(gains_path), trials)
    doubtful = not_representative(task.request.goals, comparison.after, **task.limit)
    result = tuning_dict(tuning) | more.data | {"not_representative": doubtful, "accepted": accepted}
    result |= {"unmet": list(unmet), "finals": checked.to_dict(), "assessment": comparison.to_dict()}
    everything = write_file(out / "tuning.json", json.dumps(finite(result), ensure_ascii=False, indent=1) + "\n")
    pictures = list[Path]()
    with saving("plots"):
        pictures = task.pictures(tuning, out)
    headline, *figures = comparison.lines()
    lines = [headline, *more.floor, *figures, "", *tuned.lines(), *doubtful, *more.notes]
    lines += ["", f"gains {gains_path}", f"all   {everything}", *(f"plot  {path}" for path in pictures)]
    then = more.then
    if unmet and tuning.accepted:
        lines += ["", warning]
    if not tuning.accepted:
        missed, (remedy, longer) = misses(tuning), advice(tuning, trials=trials)
        lines += ["", warning, *(f"  {miss.text}" for miss in missed), f"  {remedy}"]
        then = [same_command(trials=2 * trials, rounds=rounds + 2)] if longer else task.look(missed, str(gains_path))
    brief = ["; better: ".join([headline, *comparison.gained[:1]]), *([warning] if warning else []), *verdict]
    brief += [*more.floor, *summary(tuning)[-2:]]
    brief += [*doubtful, *more.over]
    finish(
        result, lines,
        as_json=as_json, passed=accepted, then=then, brief=brief,
        files=[f"gains {gains_path}", f"all {everything}"],
    )  # fmt: skip


def _needs_page(scenario: str | None) -> str:
    """Return the error for options that need --page; the message says how a study file sets their values."""
    if scenario:
        own = f'write [[runs]] with scenario = "{scenario}" in a study file and give the file: surctl tune STUDY.toml'
        return f"--scenario selects the scenario of --page; to tune over chosen scenarios, {own}"
    return "--port and --no-browser need --page"


def _gain(text: str) -> tuple[str, tuple[float, float] | None]:
    name, equals, ends = text.partition("=")
    if not equals:
        return name, None
    low, dots, high = ends.partition("..")
    try:
        if dots:
            return name, (float(low), float(high))
    except ValueError:
        pass
    raise click.BadParameter(f"{text!r} is not NAME=LOW..HIGH", param_hint="--gain")
