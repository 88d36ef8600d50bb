"""Study 27: a control law of one's own, from one file, through the whole chain by the command line alone.

    python analysis/27_own_law/run.py            # some minutes
    python analysis/27_own_law/run.py --quick    # two of the steps

Prints Markdown. Status 0 if every command ends as stated, else 1.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
LAW = ["--law", "wall.py:wall"]


def surctl(*arguments: str) -> tuple[int, dict[str, Any]]:
    """Run a command in this folder; return its exit status and what it prints as JSON."""
    command = [sys.executable, "-m", "surctl", *arguments, "--json"]
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False)
    return done.returncode, json.loads(done.stdout) if done.stdout.startswith("{") else {"error": done.stderr.strip()}


def arrived(result: dict[str, Any]) -> tuple[bool, str]:
    """The run of the law arrived."""
    (run,) = result["runs"]
    text = f"{run['stopped_because']} at {run['time_s']:.1f} s, least clearance {run['min_clearance_m']:.3f} m"
    return run["reached"] and ".py:" in run["law"], text


def campaign(result: dict[str, Any]) -> tuple[bool, str]:
    """Every random run arrived, and no claim of another law is told."""
    (table,) = result["campaigns"]
    ends = ", ".join(f"{end['count']} {name}" for name, end in table["stopped"].items() if end["count"])
    return table["stopped"]["reached"]["count"] == table["number_of_runs"] and "claim" not in table, f"runs: {ends}"


def swept(result: dict[str, Any]) -> tuple[bool, str]:
    """A point was chosen, and margins of another law are not told."""
    rows, picked = result["results"], result["picked"]
    unjudged = all(row["disk_margin"] is None for row in rows)
    return unjudged and picked is not None, f"{len(rows)} points, margins not judged: {unjudged}"


def exported(result: dict[str, Any]) -> tuple[bool, str]:
    """C and Python gave equal commands, states and telemetry."""
    sil = result["sil"]
    most = max(sil["tau"], sil["state"], sil["telemetry"])
    return sil["passed"] and most == 0.0, f"{sil['steps']} steps, largest difference {most:.1f}"


def tuned(result: dict[str, Any]) -> tuple[bool, str]:
    """The law's own gains were tuned."""
    best = result["best"]["gains"]
    return {"k_wall", "stand_off"} <= set(best), ", ".join(f"{name} = {value:.3g}" for name, value in best.items())


def judged(result: dict[str, Any]) -> tuple[bool, str]:
    """The loop has margins about a steady motion of the run, and no claim of another law is told."""
    linear, worst = (result["linear"][which] for which in ("nominal", "worst"))
    text = f"disk margin {linear['disk_margin']:.2f}, worst corner {worst['disk_margin']:.2f}, about {linear['place']}"
    return linear["stable"] and worst["stable"] and not result["claims"] and linear["free"] == ["x"], text


# with the set `default`, the disk margin at the worst corner is 0.27 instead of 0.3: these end with status 1
WEAK = ("sweep", "tuning", "C, double", "C, float", "C with sonars", "FMU", "margins")


def main() -> int:
    """Run every step and print one row of a table for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two of the steps")
    quick = parser.parse_args().quick
    with tempfile.TemporaryDirectory() as scratch:
        out = lambda name: str(Path(scratch, name))  # noqa: E731
        mission = ["--scenario", "wall.toml"]
        steps: list[tuple[str, list[str], Callable[[dict[str, Any]], tuple[bool, str]]]] = [
            ("true positions", ["simulate", "wall.toml", *LAW], arrived),
            ("with limits", ["simulate", "wall.toml", *LAW, "--priority-mode", "projected"], arrived),
            (
                "Monte Carlo",
                ["simulate", "wall.toml", *LAW, "--monte-carlo", "--runs", "1000", "--out", out("m")],
                campaign,
            ),
            (
                "sweep",
                ["sweep", "k_wall=0.2..0.8:100", "stand_off=0.7..1.0:100", *mission, *LAW, "--out", out("s")],
                swept,
            ),
            (
                "tuning",
                ["tune", "wall_study.toml", "--trust", "--trials", "60", "--out", out("t")],
                tuned,
            ),
            ("C, double", ["export", *mission, *LAW, "--sensing", "truth", "--out", out("c")], exported),
            (
                "C, float",
                ["export", *mission, *LAW, "--sensing", "truth", "--real", "float32", "--out", out("f")],
                exported,
            ),
        ]
        if not quick:
            sonar = ["simulate", "wall.toml", *LAW, "--sensing", "sonar"]
            fmu = ["export", *mission, *LAW, "--sensing", "truth", "--target", "fmu", "--out", out("u")]
            sensed = ["export", *mission, *LAW, "--sensing", "sonar", "--out", out("n")]
            steps += [("sonars", sonar, arrived), ("C with sonars", sensed, exported), ("FMU", fmu, exported)]
            steps += [("margins", ["verify", *mission, *LAW], judged)]
            more = ["--scenario", "orbit.toml", "--sensing", "truth"]
            station = ["--law", "station.py:station"]
            steps += [
                ("station keeping", ["simulate", "orbit.toml", *station, "--priority-mode", "projected"], arrived),
                ("station keeping, C", ["export", *more, *station, "--out", out("k")], exported),
            ]
        if quick:
            steps = [step for step in steps if step[0] in ("true positions", "C, float")]
        good = True
        print("| step | result | as stated |\n|---|---|---|")
        for name, arguments, judge in steps:
            status, result = surctl(*arguments)
            try:
                held, text = judge(result)
            except (KeyError, ValueError) as error:
                held, text = False, f"{error!r}: {str(result)[:200]}"
            as_stated = held and status == (name in WEAK)
            good = good and as_stated
            print(f"| {name} | {text} | {'yes' if as_stated else f'NO (status {status})'} |", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
