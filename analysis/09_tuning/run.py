"""Study 9: are tuned gains better than hand-chosen gains for every seed, and do new runs confirm this?

    python analysis/09_tuning/run.py [--full] [--out DIR]

Prints Markdown. The exit status is 0 if every limit is met, and 1 otherwise. By default the study is short: one seed
and few trials.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from surctl.errors import InputError
from surctl.files import Strict, load_model, prepare_folder
from surctl.marine.control import Gains, write_gains
from surctl.marine.simulation import Case
from surctl.marine.study import load_plan
from surctl.marine.tuning import (
    TUNED,
    Goal,
    Request,
    conditions,
    evaluate,
    figures,
    gain_ranges,
    tuned_gains,
)
from surctl.tuning import Condition, Evaluation, Tuning, tune
from surctl.tuning.outcome import goal_rows

CONFIG = Path(__file__).with_name("config.toml")


class Size(Strict):
    """The size of the study."""

    seeds: int
    searches: tuple[int, ...]
    verified: int
    trials: int
    fresh: int


class Config(Strict):
    """The contents of config.toml."""

    study: str
    rounds: int
    workers: int
    full: Size
    quick: Size


def main(arguments: list[str]) -> int:
    """Run the study, print the results, and return the exit status."""
    parser = argparse.ArgumentParser(prog="run.py", description="Tune the default study and verify the result.")
    parser.add_argument("--full", action="store_true", help="five seeds, 256 trials a search, 2,000 fresh runs a round")
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
    """Search for every seed, tune one in rounds, print, and save the gains; return 0 if every limit is met."""
    plan = load_plan(config.study)
    cases = [Case(leg.scenario, leg.vehicle, plan.gains, law=plan.law) for leg in plan.deciding]
    flown = conditions(cases, seeds=range(size.seeds))
    hand = Hand.flown(plan.goals, flown, plan.gains)
    arrive = f"do not arrive in {len(hand.lost)}" if hand.lost else "arrive in all"
    print(f"{len(flown)} runs a gain set. The hand gains {arrive} of them.\n")
    for one in hand.lost:
        print(f"- {one.label}")
    space, found = gain_ranges(plan.gains, TUNED), []
    for seed, verified in (*((seed, False) for seed in size.searches), (size.verified, True)):
        request = Request(hand.goals, flown, plan.gains, space, seed=seed, threads=config.workers)
        began = time.perf_counter()
        folder = prepare_folder(out / (f"verified{seed}" if verified else f"seed{seed}"))
        rounds, runs = (config.rounds, size.fresh) if verified else (1, 0)
        tuning = tune(request, trials=size.trials, rounds=rounds, runs=runs, folder=folder, progress=tell)
        (folder / "gains.toml").write_text(write_gains(tuned_gains(tuning)), encoding="utf-8")
        print(f"\n## Seed {seed}{', tuned against what refutes it' if verified else ''}\n")
        better = print_goals(tuning, hand)
        print_rounds(tuning, time.perf_counter() - began)
        found.append((seed, better, not tuning.result.refuted or bool(tuning.conflict)))
    *searched, (_, _, settled) = found
    print("\n| seed | better than by hand in every goal |\n|---|---|")
    for seed, better, _ in searched:
        print(f"| {seed} | {word(better)} |")
    ending = "nothing is refuted, or the conflict is named"
    print(f"\nTuned against what refutes it, seed {size.verified}: {ending}: {word(settled)}")
    return 0 if settled and all(better for _, better, _ in searched) else 1


@dataclass(frozen=True)
class Hand:
    """What the hand gains make of the goals, over the runs in which they arrive.

    Attributes:
        lost: the runs in which they do not.
        goals: where they do better than a limit, what they make of it is the limit.
        evaluation: one gain set.
    """

    lost: tuple[Condition, ...]
    goals: tuple[Goal, ...]
    evaluation: Evaluation

    @classmethod
    def flown(cls, goals: Sequence[Goal], flown: Sequence[Condition], gains: Gains) -> Hand:
        """Simulate the runs."""
        sets = {name: np.array([gains[name]]) for name in TUNED}
        arrived = np.isfinite(figures(goals, flown, sets)["effort_n"][0])
        own = [c for c, there in zip(flown, arrived, strict=True) if there]
        known = evaluate(goals, own, sets)
        kept = [
            replace(goal, limit=float(figure))
            if normalised < 1 and goal.metric not in ("reached", "collided")
            else goal
            for goal, normalised, figure in zip(goals, known.normalised[0], known.figure[0], strict=True)
        ]
        lost = tuple(c for c, there in zip(flown, arrived, strict=True) if not there)
        return cls(lost, tuple(kept), evaluate(kept, own, sets))


def print_goals(tuning: Tuning, hand: Hand) -> bool:
    """Print one row per goal; return whether all are better than by hand. A yes-or-no goal must be met."""
    print("| goal | kind | unit | limit | hand gains | tuned | normalised, hand | normalised, tuned | |")
    print("|---|---|---|---|---|---|---|---|---|")
    whole = True
    for j, row in enumerate(goal_rows(tuning)):
        was, normalised = float(hand.evaluation.figure[0, j]), float(hand.evaluation.normalised[0, j])
        better = row["normalised_tuned"] < normalised or (row["metric"] == "reached" and row["met"])
        whole &= better
        bound = f"{row['kind']} | {row['unit']} | {row['sense']} {row['limit']:.4g}"
        told = f"{was:.4g} | {row['tuned']:.4g} | {normalised:.3f} | {row['normalised_tuned']:.3f}"
        print(f"| {row['name']} | {bound} | {told} | {'' if better else '**not better**'} |")
    return whole


def print_rounds(tuning: Tuning, seconds: float) -> None:
    """Print the rounds and the result."""
    last = tuning.result
    print(f"\n- gains: {', '.join(f'{name} = {value:.4g}' for name, value in last.gains.items())}")
    for k, one in enumerate(tuning.rounds, 1):
        by = "claims" if one.verified is None else "fresh runs and claims"
        shares = {} if one.verified is None else one.verified.missed
        refuted = [f"{name} (in {100 * shares[name]:.2g} %)" if name in shares else name for name in one.refuted]
        mark = ", chosen" if one is last else ""
        kept = f"{len(one.training)} training runs kept"
        print(f"- round {k}: score {one.score:.4f}, {kept}, refuted by {by}: {', '.join(refuted) or 'nothing'}{mark}")
    if tuning.conflict:
        print(f"- not met together: {'; '.join(tuning.conflict)}")
    print(f"- {seconds:.0f} s")


def word(met: bool) -> str:
    """Return the word for the outcome of a limit."""
    return "yes" if met else "**no**"


def tell(text: str) -> None:
    """Print progress on stderr."""
    print(f"  {text}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
