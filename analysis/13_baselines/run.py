"""Study 13: the guarded law, the printed stack and four textbook laws, in every scenario and in random worlds.

    python analysis/13_baselines/run.py [--quick] [--out DIR]
    surctl simulate pool-behind --law analysis/13_baselines/vo.py:law

Prints Markdown; with --out it saves the picture there. Status 0; 2 for a bad option.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

import numpy as np
from matplotlib.patches import Patch

from surctl.errors import InputError
from surctl.files import prepare_folder
from surctl.marine.control import law_ref, load_gains
from surctl.marine.simulation import BatchResult, Case, Sensing, load_scenario, simulate_batch
from surctl.marine.simulation.campaign.worlds import RandomWorlds, world_template
from surctl.marine.simulation.scenario import LIBRARY
from surctl.marine.vehicle import load_vehicle
from surctl.report.theme import AVOIDING, GOOD, INK, MUTED, dress, legend_below, new_figure

ENDS = {"reached": GOOD, "collided": AVOIDING, "neither": "#D5D8DC"}
HERE, WORLDS = Path(__file__).parent, "random-worlds"
CONSTANTS = {
    "apf": ("RANGE", "STRENGTH", "NEAREST", "DAMPING"),
    "dwa": ("HORIZON", "GRID", "EXTRA", "FREE_DISTANCE", "HEADING", "CLEARANCE", "VELOCITY"),
    "vo": ("HORIZON", "EXTRA", "SAFETY"),
    "cbf": ("ALPHA", "EXTRA"),
}


@dataclass(frozen=True)
class Line:
    """The runs of a law in a scenario with one kind of sensing."""

    scenario: str
    sensing: Sensing
    law: str
    runs: BatchResult

    def share(self, name: str) -> float:
        """Return the mean of a column of zeros and ones."""
        return float(self.runs.column(name).mean())

    def median(self, name: str) -> float:
        """Return the median over the runs that arrive; NaN if none does."""
        arrived = self.runs.column("reached") > 0.5
        return float(np.nanmedian(self.runs.column(name)[arrived])) if arrived.any() else float("nan")

    def row(self) -> str:
        """Return its row of the table."""
        count = len(self.runs.table)
        told = [f"`{self.scenario}`", self.sensing, named(self.law), str(count)]
        told += [f"{round(count * self.share(name))}" for name in ("reached", "collided")]
        told += [_number(self.median("time_s"), 1), _number(self.median("length_m"), 2)]
        told += [_number(float(self.runs.column("min_clearance_m").min()), 3)]
        told += [_number(self.median("deviation_m"), 3), _number(float(self.runs.column("effort_n").mean()), 2)]
        return f"| {' | '.join(told)} |"


def named(law: str) -> str:
    """Return the name of a law in the tables: that of its file."""
    return law.removesuffix(".py:law")


def flown(scenario: str, sensing: Sensing, law: str, *, gains: str, seeds: int) -> Line:
    """Simulate all seeds; only one run if nothing depends on the seed."""
    mission = load_scenario(scenario)
    case = Case(
        mission, load_vehicle(mission.vehicle), load_gains(gains), law=law_ref(law, folder=HERE), sensing=sensing
    )
    drawn = seeds if sensing == "sonar" or mission.seeded else 1
    return Line(scenario, sensing, law, simulate_batch(case, seeds=np.arange(drawn), threads=2))


def flown_worlds(plan: RandomWorlds, sensing: Sensing, law: str, *, worlds: int) -> Line:
    """Simulate the first random worlds, which are the same for every law."""
    case = replace(plan.case, law=law_ref(law, folder=HERE), sensing=sensing)
    runs = simulate_batch(case, plan.values(0, worlds), seeds=plan.seeds(0, worlds), threads=2)
    return Line(WORLDS, sensing, law, runs)


def summary(lines: Sequence[Line], sensing: Sensing, law: str) -> str:
    """Return the row of a law over all scenarios, each with the same weight."""
    mine = [line for line in lines if (line.sensing, line.law) == (sensing, law)]
    reached, collided = (100 * float(np.mean([line.share(name) for line in mine])) for name in ("reached", "collided"))
    always = sum(line.share("reached") == 1.0 for line in mine)
    never = sum(line.share("collided") == 0.0 for line in mine)
    return f"| {sensing} | {named(law)} | {reached:.1f} % | {collided:.1f} % | {always} | {never} | {len(mine)} |"


def draw(lines: Sequence[Line], laws: Sequence[str], sensing: Sequence[Sensing], file: Path) -> None:
    """Draw the outcomes: one panel per sensing, one group of bars per scenario, one bar per law."""
    scenarios = sorted({line.scenario for line in lines})
    figure = new_figure(1.6 + 1.15 * len(scenarios) * len(laws) / 6, 3.2 * len(sensing))
    found = {(line.scenario, line.sensing, line.law): line for line in lines}
    width = 0.8 / len(laws)
    for panel, kind in enumerate(sensing):
        ax = figure.add_subplot(len(sensing), 1, panel + 1)
        for i, scenario in enumerate(scenarios):
            for j, law in enumerate(laws):
                line, at = found[scenario, kind, law], i + (j - (len(laws) - 1) / 2) * width
                reached, collided = line.share("reached"), line.share("collided")
                bottom = 0.0
                for share, colour in zip((reached, collided, 1 - reached - collided), ENDS.values(), strict=True):
                    ax.bar(at, 100 * share, width * 0.9, bottom=bottom, color=colour)
                    bottom += 100 * share
                back = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8}
                ax.text(at, 2, named(law), rotation=90, ha="center", va="bottom", fontsize=6, color=INK, bbox=back)
        ax.set_xticks(range(len(scenarios)), scenarios, fontsize=7, color=MUTED)
        dress(ax, title=f"sensing: {kind}", y="share of the runs [%]")
        if panel == len(sensing) - 1:
            legend_below(ax, columns=3, handles=[Patch(color=colour, label=end) for end, colour in ENDS.items()])
    figure.savefig(file, dpi=150, bbox_inches="tight")


def parameters() -> str:
    """Return the constants of the textbook laws as text."""
    told = []
    for law, names in CONSTANTS.items():
        module = import_module(law)
        told.append(f"{law}: " + ", ".join(f"{name} {getattr(module, name):g}" for name in names))
    return "; ".join(told)


def main(words: list[str]) -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(prog="run.py", description="Simulate every law in every scenario.")
    parser.add_argument("--quick", action="store_true", help="two seeds, three laws, one scenario, true positions")
    parser.add_argument("--out", help="folder for the picture")
    options = parser.parse_args(words)
    config = tomllib.loads((HERE / "config.toml").read_text(encoding="utf-8"))
    config |= config["quick" if options.quick else "full"]
    try:
        out = prepare_folder(Path(options.out)) if options.out else None
    except InputError as error:
        print(error.inside("--out"), file=sys.stderr)
        return error.exit_status
    names = config["scenarios"] or sorted(path.stem for path in LIBRARY.glob("*.toml"))
    names += [WORLDS] if config["worlds"] else []
    flies = load_vehicle(config["vehicle"])
    plan = RandomWorlds(Case(world_template(flies), flies, load_gains(config["gains"])))
    print(f"Constants: {parameters()}.\n")
    print("## Every law in every scenario\n")
    print(
        "Time, length and distance to the path are medians over the runs that arrive, the clearance is the least of "
        "all runs, the effort the mean of all.\n"
    )
    print(
        "| scenario | sensing | law | runs | reached | collided | time [s] | length [m] | least clearance [m] "
        "| off the path [m] | effort [N] |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    lines = []
    for name in names:
        for sensing in config["sensing"]:
            for law in config["laws"]:
                if name == WORLDS:
                    lines.append(flown_worlds(plan, sensing, law, worlds=config["worlds"]))
                else:
                    lines.append(flown(name, sensing, law, gains=config["gains"], seeds=config["seeds"]))
                print(lines[-1].row(), flush=True)
    print("\n## Over all scenarios, each with the same weight\n")
    print("| sensing | law | reached | collided | scenarios always reached | without a collision | of |")
    print("|---|---|---|---|---|---|---|")
    for sensing in config["sensing"]:
        for law in config["laws"]:
            print(summary(lines, sensing, law))
    if out is not None:
        draw(lines, config["laws"], config["sensing"], out / "baselines.png")
    return 0


def _number(value: float, digits: int) -> str:
    return "-" if np.isnan(value) else f"{value:.{digits}f}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
