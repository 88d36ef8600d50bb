"""`surctl tune`: search gains and test them; HARD GOALS NOT MET, files, exit status; of a system, goals and page."""

from __future__ import annotations

import json
import os
import sys
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click

from surctl.cli import lib
from surctl.cli.application import to_application
from surctl.cli.options import FOLDER, Count, option, options
from surctl.cli.output import (
    as_json,
    finish,
    finite,
    note_replaced,
    progress,
    result_command,
    same_command,
    saving,
    stoppable,
    waiting,
)
from surctl.cli.subject import OwnSystem, is_system, listed_values, load_system, region_words, seconds_option
from surctl.errors import InputError


@dataclass(frozen=True, eq=False, repr=False)
class TuneOptions:
    """The options about a search of any subject, and about its page."""

    gain: tuple[str, ...] = option(
        "--gain", "Gain to tune, with its range from A to B; repeatable.", (), metavar="NAME[=A..B]"
    )
    goals_file: str | None = option(
        "--goals", "Goals: name or file (default: those of the study, else the built-in goals).", metavar="FILE"
    )
    trials: int = option(
        "--trials",
        "Number of gain sets in a round, each simulated in all scenarios (default 256; multiple of 32).",
        256,
        type=Count(1),
    )
    seed: int = option("--seed", "Seed of the search and of the random test runs (default 0).", 0, type=Count(0))
    rounds: int = option("--rounds", "Largest number of tuning rounds (default 3).", 3, type=Count(1))
    runs: int | None = option(
        "--monte-carlo",
        "Number of random runs that test the best gains of a round (default 2000; 0 for FILE.py).",
        type=Count(0),
    )
    workers: int = option("--workers", "Number of parallel threads (default 2).", 2, type=Count(1))
    out: Path = option(
        "--out",
        "Folder for results (default surctl-out). The same command continues an interrupted search.",
        Path("surctl-out"),
        type=FOLDER,
    )
    page: bool = option("--page", "Do not search: open a web page with a slider per gain.", False)
    port: int | None = option("--port", "TCP port of --page (default: a free port).", type=Count(1, 65535))
    no_browser: bool = option("--no-browser", "Print the address of --page, and open no browser.", False)

    @property
    def ranges(self) -> dict[str, tuple[float, float] | None]:
        """The named gains with their ranges; None: the default range."""
        ranges = dict(map(_parse_gain, self.gain))
        if len(ranges) < len(self.gain):
            raise click.BadParameter("names a gain twice", param_hint="--gain")
        return ranges


@click.command
@click.argument("words", nargs=-1, metavar="FILE.py:FUNCTION [NAME=VALUE,...]...]")
@options(options=TuneOptions)
@seconds_option
@as_json
def tune(words: tuple[str, ...], options: TuneOptions, seconds: float | None, as_json: bool, **_: Any) -> None:
    """Search for gains that meet goals, and test them."""
    ranges = options.ranges
    if (options.port or options.no_browser) and not options.page:
        raise click.UsageError("--port and --no-browser need --page")
    task: Any
    if not is_system(words):
        task = to_application(words)
    else:
        task = (_bench if options.page else _tuned)(words, ranges, options, seconds)
    if options.page:
        _serve(task, port=options.port, browser=not options.no_browser)
        return
    _search(task, options, as_json=as_json)


def _search(task: Task, options: TuneOptions, *, as_json: bool) -> None:
    """Search gains, test them, write them, and print each goal and figure before and after."""
    trials, rounds, out = options.trials, options.rounds, options.out
    runs = task.tested if options.runs is None else options.runs
    lib.prepare_folder(out)
    best, _ = task.request.so_far({}, "")
    message = f"the finished trials are in {out}, the best gains in {out / best}; to continue: {same_command()}"
    with stoppable(message):
        tuning = lib.tune(task.request, trials=trials, rounds=rounds, runs=runs, folder=out, progress=progress)
        tuned = lib.check_finals(tuning, task.finals, task.assessed, default=task.default, progress=progress)
    (tuning, checked), unmet = tuned, tuned.unmet
    warning = f"HARD GOALS NOT MET ({', '.join(unmet)}): best gains found, but do not use them" if unmet else ""
    comparison = checked.comparison
    accepted, verdict = not unmet and comparison.after.accepted(), [comparison.after.verdict()]
    verdict = verdict * (not comparison.after.accepted())
    note = warning or "".join(verdict)
    note_replaced(out / "tuning.json", result_command())
    gains_path = lib.write_file(*task.gain_file(tuning, out, note))
    (out / best).unlink(missing_ok=True)
    more = task.more(tuning, checked, str(gains_path), trials)
    doubtful = lib.not_representative(task.request.goals, comparison.after, **task.limit)
    result = lib.tuning_dict(tuning) | more.data | {"not_representative": doubtful, "accepted": accepted}
    result |= {
        "command": result_command(),
        "unmet": list(unmet),
        "finals": checked.to_dict(),
        "assessment": comparison.to_dict(),
    }
    everything = lib.write_file(out / "tuning.json", json.dumps(finite(result), ensure_ascii=False, indent=1) + "\n")
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
        missed, (remedy, longer) = lib.misses(tuning), lib.advice(tuning, trials=trials)
        lines += ["", warning, *(f"  {miss.text}" for miss in missed), f"  {remedy}"]
        then = [same_command(trials=2 * trials, rounds=rounds + 2)] if longer else task.look(missed, str(gains_path))
    brief = ["; better: ".join([headline, *comparison.gained[:1]]), *([warning] if warning else []), *verdict]
    brief += [*filter(None, [checked.refused]), *more.floor, *lib.summary(tuning)[-2:], *doubtful, *more.over]
    finish(
        result, lines,
        as_json=as_json, passed=accepted, then=then, brief=brief,
        files=[f"gains {gains_path}", f"all {everything}"],
    )  # fmt: skip


def _parse_gain(text: str) -> tuple[str, tuple[float, float] | None]:
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


@dataclass(frozen=True)
class More:
    """What is printed of a tuning besides goals and assessment: data, lines, and the commands to suggest next."""

    data: dict[str, Any]
    then: list[str]
    floor: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    over: list[str] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Task(ABC):
    """What is tuned, and what is printed and written of it.

    Attributes:
        request: the request of the search.
        finals: goals checked at its end; `default` are those that may be left out.
        limit: words of the remedy if the linear figures do not describe the runs.
        tested: random runs that test the gains of a round by default.
    """

    request: lib.SearchRequest
    finals: Sequence[lib.RunGoal]
    default: Collection[lib.RunGoal]
    limit: Mapping[str, str]
    tested: int

    @abstractmethod
    def assessed(
        self, gains: Mapping[str, float], parts: Collection[str] | None, computed: Mapping[str, lib.Part] | None
    ) -> lib.Assessment:
        """Return what is assessed with these gains."""

    @abstractmethod
    def gain_file(self, tuning: lib.Tuning, out: Path, warning: str) -> tuple[Path, str]:
        """Return file and text of the tuned gains."""

    @abstractmethod
    def more(self, tuning: lib.Tuning, checked: lib.Finals, gains: str, trials: int) -> More:
        """Return what is printed besides goals and assessment; `gains` is the written file."""

    def pictures(self, tuning: lib.Tuning, out: Path) -> list[Path]:
        """Write pictures of the tuning."""
        return []

    def look(self, missed: Sequence[lib.Miss], gains: str) -> list[str]:
        """Return the command that shows a missed goal."""
        return []


@dataclass(frozen=True, eq=False)
class _System(Task):
    request: lib.SystemRequest
    own: OwnSystem

    def assessed(
        self, gains: Mapping[str, float], parts: Collection[str] | None, computed: Mapping[str, lib.Part] | None
    ) -> lib.Assessment:
        return self.request.assessed(gains, parts, computed)

    def gain_file(self, tuning: lib.Tuning, out: Path, warning: str) -> tuple[Path, str]:
        return out / "gains.csv", self.request.so_far(tuning.result.gains, "")[1]

    def more(self, tuning: lib.Tuning, checked: lib.Finals, gains: str, trials: int) -> More:
        own, duration = self.own, self.request.seconds
        costs = {
            when: own.cost_data(self.request.costs(values))
            for when, values in (("before", self.request.begun), ("after", tuning.result.gains))
        }
        numbers = ["--gains", gains]
        seconds = f"{duration or 100 * own.system.dt:g}"
        then = [own.command("verify", *numbers), own.command("export", *numbers, "--seconds", seconds)]
        data = {**own.names, "seconds": duration, "costs": costs}
        notes, over = self.request.scores(tuning.result.gains), checked.comparison.after.decisive(lib.STEP)
        return More(data, then, notes=notes, over=over)


def _tuned(
    words: Sequence[str], ranges: Mapping[str, tuple[float, float] | None], options: TuneOptions, seconds: float | None
) -> Task:
    """Return the tuning of a system; words NAME=V1,V2,… are the numbers of its cases, one value is for all cases.

    Raises:
        InputError: a word, a range or a goal does not fit the system.
    """
    import numpy as np

    own, goals_file = load_system(words), options.goals_file
    about, points, of_runs = ((), {}, ()) if goals_file is None else lib.load_system_goals(goals_file, own.system)
    duration = own.seconds(seconds) if own.system.costs or seconds is not None else 0.0
    listed, space = listed_values(own.settings), own.gain_ranges(ranges)
    for name in listed:
        if len(listed[name]) > 1:
            lib.check_scalar(own.system, name)
    cases = {name: np.array(v[0] if len(v) == 1 else v) for name, v in listed.items()}
    try:
        request = lib.system_request(
            own.system, duration, space,
            cases=cases, trials=options.trials, seed=options.seed, threads=options.workers, goals=about, points=points,
            run_goals=of_runs,
        )  # fmt: skip
    except InputError as error:
        raise (error.inside(goals_file) if (error.key or "").startswith(("goals.", "point ")) else error) from None
    finals, costs = lib.margin_goals(own.system), own.system.costs
    late = next((name for name, cost in costs.items() if cost.how == "last_time"), next(iter(costs), None))
    remedy = f'ask it of the run, such as metric = "{late}"' if late else "give the system a cost of its runs"
    return _System(request, finals, finals, {"command": "command {}", "run": "the run", "remedy": remedy}, 0, own)


_PERIODS = 600  # of a run, without --seconds


def _bench(
    words: Sequence[str], ranges: Mapping[str, tuple[float, float] | None], options: TuneOptions, seconds: float | None
) -> lib.DesignBench:
    """Return what the page of a system of the user's own shows; NAME=V1,V2 gives the operating points."""
    own = load_system(words)
    others, region, uncertain = region_words(own.settings, own.system)
    about_loop, stated = ((), {}) if options.goals_file is None else lib.load_loop_goals(options.goals_file)
    values = listed_values(others)
    swept = {name: numbers for name, numbers in values.items() if len(numbers) > 1}
    fixed = {name: numbers[0] for name, numbers in values.items() if len(numbers) == 1}
    if len(swept) > 1:
        raise InputError(
            "are two lists", key=", ".join(swept), remedy="vary one number; use [[points]] of a goals file"
        )
    places = {name: {**fixed, **numbers} for name, numbers in stated.items()}
    for name, numbers in swept.items():
        places |= {f"{name}={number:g}": {**fixed, name: number} for number in numbers}
    places = places or {"nominal": dict(fixed)}
    gains = {name for name in fixed if "." not in name}
    if gains:
        raise InputError("is a gain", key=min(gains), remedy="move its slider")
    duration = own.seconds(seconds or own.system.duration or _PERIODS * own.system.dt)

    def problem(gains: Mapping[str, float]) -> object:
        return None if region is None else region.problem(own.system, {**fixed, **gains})

    bench = lib.SystemBench(
        own.system, own.word, duration, own.gain_ranges(ranges), places, about_loop,
        None if region is None else problem, own.origin, {**own.system.ranges, **uncertain},
    )  # fmt: skip
    start = {one.name: one.value for one in bench.sliders}
    loops = {point: bench.loop(start, point) for point in bench.points}
    lib.judge_loops(about_loop, loops)  # reports unknown signals here
    problem(start)
    return bench


def _serve(bench: lib.DesignBench, *, port: int | None, browser: bool) -> None:
    def ready(address: str) -> None:
        waiting()
        click.echo(f"{address}  (Ctrl-C stops the page)")
        sys.stdout.flush()
        if browser:
            click.launch(address)

    try:
        lib.serve(bench, port=port, ready=ready)
    except KeyboardInterrupt:
        click.echo("surctl: stopped; saved files stay", err=True)
        sys.stdout.flush()
        os._exit(130)  # a normal exit would wait for the threads of an open page; all files are complete
