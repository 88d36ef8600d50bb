"""`surctl tune`: find gains that meet goals, and verify them with new random runs."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from surctl.cli.law_option import trust_option
from surctl.cli.output import as_json, at_hand, finish, finite, progress, same_command, stoppable
from surctl.cli.speeds import SPEEDS

if TYPE_CHECKING:
    from surctl.vehicle import Vehicle

__all__ = ["tune"]


@click.command
@click.argument("file", required=False, metavar="[STUDY]")
@click.option(
    "--gain",
    "gain",
    multiple=True,
    metavar="NAME[=LOW..HIGH]",
    help="Gain to tune, with its range; repeatable.",
)
@click.option(
    "--goals",
    "goals_file",
    metavar="FILE",
    help="Goals: name or file (default: the study's, else the built-in goals).",
)
@click.option(
    "--cruise",
    type=SPEEDS,
    metavar="U1,U2,...",
    help="Cruise speeds [m/s] of goals about the linear loop that name none themselves.",
)
@click.option(
    "--trials",
    type=click.IntRange(min=1),
    default=256,
    metavar="N",
    help="Gain sets tried by each of the two searches of a round (default 256).",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    metavar="N",
    help="Seed of the search and of the new runs (default 0).",
)
@click.option(
    "--seeds",
    type=click.IntRange(1, 1_000_000),
    default=4,
    metavar="N",
    help="Simulate every scenario with the seeds 0 to N-1 (default 4).",
)
@click.option(
    "--vehicle",
    "vehicles",
    multiple=True,
    metavar="FILE",
    help="Vehicle of every scenario: name or file; repeatable (default: the study's).",
)
@click.option(
    "--guidance",
    metavar="NAME",
    help="Path guidance: los, ilos or alos (default: the study's). Loop margins always use los.",
)
@click.option(
    "--rounds",
    type=click.IntRange(min=1),
    default=3,
    metavar="N",
    help="Largest number of rounds of tuning and verifying (default 3).",
)
@click.option(
    "--monte-carlo",
    "runs",
    type=click.IntRange(min=0),
    default=2000,
    metavar="N",
    help="New runs that verify a round (default 2000); up to 10 N more runs train.",
)
@click.option("--descend", is_flag=True, help="Also start the search from a gradient descent; this takes minutes.")
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=2,
    metavar="N",
    help="Threads (default 2); the result does not depend on N.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("surctl-out"),
    metavar="DIR",
    help="Output folder (default surctl-out); an interrupted tuning resumes there.",
)
@click.option("--page", is_flag=True, help="Open a local web page with sliders instead; needs the package marimo.")
@click.option("--scenario", metavar="FILE", help="Scenario of --page: name or file (default: the study's first).")
@click.option("--gains", "gains_file", metavar="FILE", help="Gain set of --page: name or file (default: the study's).")
@click.option("--port", type=click.IntRange(1, 65535), metavar="N", help="Port of --page (default: a free port).")
@click.option("--no-browser", is_flag=True, help="Print the address of --page, but do not open it.")
@trust_option
@as_json
def tune(
    file: str | None,
    gain: tuple[str, ...],
    goals_file: str | None,
    cruise: tuple[float, ...] | None,
    trials: int,
    seed: int,
    seeds: int,
    vehicles: tuple[str, ...],
    guidance: str | None,
    rounds: int,
    runs: int,
    descend: bool,
    workers: int,
    out: Path,
    page: bool,
    scenario: str | None,
    gains_file: str | None,
    port: int | None,
    no_browser: bool,
    trust: bool,
    as_json: bool,
) -> None:
    """Tune gains to goals, and tune them again with the runs in which they fail.

    The gains must meet the hard goals for every scenario, seed and corner of the vehicle's ranges; the soft goals are
    minimised. New random runs and the claims then test the result. Exit status: 1 if a hard goal is not met, or fails
    in the test.

    Examples: surctl tune; surctl tune my-study.toml --gain k_v=0.5..3 --gain lookahead --goals my-goals.toml;
    surctl tune --page --scenario pool-behind --gains my-gains.toml
    """
    if page:
        from surctl.cli.tuning_page import serve_page

        serve_page(
            file, goals_file, vehicles,
            scenario=scenario, gains=gains_file, cruise=cruise, port=port, browser=not no_browser,
        )  # fmt: skip
        return
    if scenario or gains_file or port or no_browser:
        raise click.UsageError("--scenario, --gains, --port and --no-browser need --page")
    from surctl.control import write_gains
    from surctl.errors import InputError
    from surctl.files import prepare_folder, write_file
    from surctl.study import load_plan
    from surctl.tuning import (
        Request,
        build_cases,
        check_goals,
        conditions,
        default_tuned,
        gain_ranges,
        goals_at,
        load_goals,
        summary,
        tuned_gains,
        tuning_dict,
    )
    from surctl.tuning import tune as run_tuning
    from surctl.vehicle import load_vehicle

    ranges = dict(_gain(text) for text in gain)
    if len(ranges) < len(gain):
        raise click.BadParameter("a gain is named twice", param_hint="--gain")
    plan = load_plan(file, trust=trust)
    goals = goals_at(plan.goals if goals_file is None else load_goals(goals_file), cruise or plan.cruise)
    if cruise and not any(goal.linear for goal in goals):
        remedy = "add one, on disk_margin say, or leave the option out"
        raise InputError("no goal is about the linear loop", key="--cruise", value=list(cruise), remedy=remedy)
    pairs = [(leg.scenario, leg.vehicle) for leg in plan.deciding]
    if vehicles:
        scenarios = {s.name: s for s, _ in pairs}.values()
        pairs = [(s, v) for v in map(load_vehicle, vehicles) for s in scenarios]
    kind = {"law": plan.law, "guidance": plan.guidance if guidance is None else guidance}
    cases = [build_cases([scenario], [vehicle], gains=plan.gains, **kind)[0] for scenario, vehicle in pairs]
    all_runs = conditions(cases, seeds=range(seeds))
    try:
        check_goals(goals, all_runs)
    except InputError as error:
        raise error.inside(goals_file or plan.source) from None
    prepare_folder(out)
    request = Request(
        goals,
        all_runs,
        plan.gains,
        gain_ranges(plan.gains, ranges or default_tuned(plan.gains)),
        seed=seed,
        threads=workers,
    )
    with stoppable(f"the finished trials are in {out}; to continue: {same_command()}"):
        tuning = run_tuning(
            request, trials=trials, rounds=rounds, runs=runs, descend=descend, folder=out, progress=progress
        )
    warning = ""
    if not tuning.accepted:
        warning = f"HARD GOALS NOT MET ({', '.join(tuning.unmet)}): best gains found, but do not use them on a vehicle"
    gains_path = write_file(out / "gains.toml", write_gains(tuned_gains(tuning), warning=warning))
    result = tuning_dict(tuning)
    everything = write_file(out / "tuning.json", json.dumps(finite(result), ensure_ascii=False, indent=1) + "\n")
    from surctl.report import save_tuning  # loads matplotlib only now

    pictures = save_tuning(tuning, out)
    lines = [*summary(tuning), "", f"gains {gains_path}", f"all   {everything}"]
    lines += [f"plot  {path}" for path in pictures]
    mission, robot = pairs[0]
    about = at_hand(mission, robot, str(gains_path))
    region = _region(robot)
    # a region claim needs only the speeds; with --scenario, the safety claim would also affect the exit status
    speeds = ["--cruise", f"{mission.cruise:g}", "--cap", f"{mission.cap:g}"]
    arguments = [*region, *(speeds if region else about[:2]), *about[2:], "--out", str(out / "proofs")]
    law = shlex.join(["--law", plan.law, "--guidance", kind["guidance"]])
    then = [
        shlex.join(["surctl", "verify", *arguments]),
        f"surctl export {shlex.join(about)} {law}",
    ]
    if not tuning.accepted:
        again = shlex.join([*sys.argv[1:], "--trials", str(2 * trials), "--rounds", str(rounds + 2)])
        then = [f"surctl {again}"]
        lines += ["", f"{warning}; increase --trials, or relax a goal"]
    finish(result, lines, as_json=as_json, passed=tuning.accepted, then=then)


def _region(vehicle: Vehicle) -> list[str]:
    # the region claim to suggest next
    from surctl.errors import NotApplicable
    from surctl.verification.assumptions import check_alike

    try:
        check_alike(vehicle)
    except NotApplicable:
        return []
    return ["region-cruise-20"]


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
