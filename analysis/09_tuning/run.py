"""Study 9: whether tuning beats the gains chosen by hand, from any seed, and what fresh runs say of the result.

    python analysis/09_tuning/run.py [--full] [--out DIR]

Prints Markdown. Ends with 0 when every bar is met, else with 1. Quick by default: one seed and few trials.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from surctl.control import Gains, write_gains
from surctl.errors import InputError
from surctl.files import Strict, load_model, prepare_folder
from surctl.simulation import Case
from surctl.study import load_plan
from surctl.tuning import (
    TUNED,
    Condition,
    Goal,
    Request,
    Tuning,
    conditions,
    evaluate,
    gain_ranges,
    goal_rows,
    tune,
    tuned_gains,
)

CONFIG = Path(__file__).with_name("config.toml")


class Size(Strict):
    """How much is done."""

    seeds: int
    searches: tuple[int, ...]
    verified: tuple[int, ...]
    trials: int
    fresh: int


class Config(Strict):
    """What config.toml holds."""

    study: str
    rounds: int
    workers: int
    full: Size
    quick: Size


def main(arguments: list[str]) -> int:
    """Run the study and print it; the exit status."""
    parser = argparse.ArgumentParser(prog="run.py", description="Tune the default study and verify the result.")
    parser.add_argument("--full", action="store_true", help="five seeds, 256 trials a search, 22,000 runs a round")
    parser.add_argument("--out", type=Path, help="folder; a killed study resumes there; default: a new temporary one")
    options = parser.parse_args(arguments)
    try:
        config = load_model(CONFIG, Config)
        out = prepare_folder(options.out or Path(tempfile.mkdtemp(prefix="surctl-tuning-")))
        return study(config, config.full if options.full else config.quick, out)
    except InputError as error:
        print(error, file=sys.stderr)
        return error.exit_status


def study(config: Config, size: Size, out: Path) -> int:
    """Tune from every seed, print, save the gains; 0 when every bar is met."""
    plan = load_plan(config.study)
    cases = [Case(leg.scenario, leg.vehicle, plan.gains, law=plan.law) for leg in plan.deciding]
    flown = conditions(cases, seeds=range(size.seeds))
    goals, met = none_given_back(plan.goals, flown, plan.gains), []
    for seed in size.searches:
        space = gain_ranges(plan.gains, TUNED)
        request = Request(goals, flown, plan.gains, space, seed=seed, threads=config.workers)
        began = time.perf_counter()
        folder = prepare_folder(out / f"seed{seed}")
        verified = seed in size.verified
        rounds, runs = (config.rounds, size.fresh) if verified else (1, 0)
        tuning = tune(request, trials=size.trials, rounds=rounds, runs=runs, folder=folder, progress=tell)
        (folder / "gains.toml").write_text(write_gains(tuned_gains(tuning)), encoding="utf-8")
        print_tuning(tuning, seed, time.perf_counter() - began)
        met.append(bars(tuning, verified=verified))
    print("\n| seed | better in every goal | nothing refuted, or the conflict is named |\n|---|---|---|")
    for seed, (better, settled) in zip(size.searches, met, strict=True):
        print(f"| {seed} | {word(better)} | {word(settled) if seed in size.verified else 'not asked'} |")
    return 0 if all(all(bar) for bar in met) else 1


def none_given_back(goals: Sequence[Goal], flown: Sequence[Condition], gains: Gains) -> tuple[Goal, ...]:
    """The goals; where the hand gains do better than a limit, what they make of it is the limit."""
    hand = evaluate(goals, flown, {name: np.array([gains[name]]) for name in TUNED})
    kept = []
    for goal, normalised, figure in zip(goals, hand.normalised[0], hand.figure[0], strict=True):
        stricter = normalised < 1 and goal.metric not in ("reached", "collided")
        kept.append(replace(goal, limit=float(figure)) if stricter else goal)
    return tuple(kept)


def bars(tuning: Tuning, *, verified: bool) -> tuple[bool, bool]:
    """Every goal better than with the hand gains (a yes-or-no goal: met); and CEGIS, if asked, came to an end."""
    better = all(row["better"] or (row["metric"] == "reached" and row["met"]) for row in goal_rows(tuning))
    return better, not verified or not tuning.result.refuted or bool(tuning.conflict)


def print_tuning(tuning: Tuning, seed: int, seconds: float) -> None:
    """One row a goal, and how it ended."""
    print(f"\n## Seed {seed}\n")
    print("| goal | kind | unit | limit | hand gains | tuned | normalised, hand | normalised, tuned | |")
    print("|---|---|---|---|---|---|---|---|---|")
    for row in goal_rows(tuning):
        figures = f"{row['hand']:.4g} | {row['tuned']:.4g} | {row['normalised_hand']:.3f}"
        mark = "better" if row["better"] else "**not better**"
        bound = f"{row['kind']} | {row['unit']} | {row['sense']} {row['limit']:g}"
        print(f"| {row['name']} | {bound} | {figures} | {row['normalised_tuned']:.3f} | {mark} |")
    last = tuning.result
    print(f"\n- gains: {', '.join(f'{name} = {value:.4g}' for name, value in last.gains.items())}")
    for k, one in enumerate(tuning.rounds, 1):
        by = "claims" if one.verified is None else "fresh runs and claims"
        mark = ", chosen" if one is last else ""
        kept = f"{len(one.training)} training runs kept"
        print(
            f"- round {k}: score {one.score:.4f}, {kept}, refuted by {by}: {', '.join(one.refuted) or 'nothing'}{mark}"
        )
    if tuning.conflict:
        print(f"- not met together: {'; '.join(tuning.conflict)}")
    print(f"- {seconds:.0f} s")


def word(met: bool) -> str:
    """The outcome of a bar."""
    return "yes" if met else "**no**"


def tell(text: str) -> None:
    """Progress on stderr."""
    print(f"  {text}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
