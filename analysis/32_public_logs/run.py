"""Study 32: vehicles fitted to public logs of real robots, and their held-out predictions beside "hold the last speed".

    python analysis/32_public_logs/run.py [--data DIR] [--write] [--quick]

The excerpts of the logs are not part of this repository: `excerpts.py` cuts them from clones of the repositories in
`sources.toml`. Each robot is fitted by `surctl vehicle from-log`. Prints Markdown; --write puts it into the README.
--quick: files of the same formats with simulated motion take the place of the logs; the readers and one fit run.
The exit status is 2 if an excerpt is missing.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from excerpts import EXCERPTS, FOLDER, SOURCES
from standins import write_standins

from surctl.marine.vehicle import HELD_OUT, SPECS, MotionLog, load_vehicle, predict
from surctl.marine.vehicle.identification.identify import velocity_notes
from surctl.marine.vehicle.logs.read import read_mapped_log
from surctl.marine.vehicle.motion_log import in_sequence

ROBOTS = FOLDER / "robots"
MARK = "<!-- results: python analysis/32_public_logs/run.py --write -->"
COLUMNS = ("x_m", "y_m", "z_m", "psi_rad", "u_m_per_s", "v_m_per_s", "w_m_per_s", "r_rad_per_s")


@dataclass(frozen=True)
class Robot:
    """A robot of the study: its name in `sources.toml`, and the windows of the prediction [s]."""

    name: str
    windows: tuple[float, ...]

    @property
    def map(self) -> Path:
        """The map of its logs."""
        return ROBOTS / f"{self.name}-map.toml"

    def log(self, data: Path, log_map: Path) -> MotionLog:
        """Return its logs as one."""
        return in_sequence([read_mapped_log(data / name, log_map) for name in EXCERPTS[self.name]])

    def fit(self, data: Path, out: Path) -> Mapping[str, Any]:
        """Return what `surctl vehicle from-log --json` prints, and write the picture."""
        windows = [word for window in self.windows for word in ("--window", f"{window:g}")]
        files = [str(data / name) for name in EXCERPTS[self.name]]
        words = ["vehicle", "from-log", *files, "--map", str(self.map), "--start", str(ROBOTS / f"{self.name}.toml")]
        words += [*windows, "--name", f"{self.name}-fitted", "--out", str(out / f"{self.name}-fitted.toml"), "--force"]
        words += ["--picture", str(out / f"{self.name}.png"), "--json"]
        done = subprocess.run([sys.executable, "-m", "surctl", *words], capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(done.stderr)
        return dict(json.loads(done.stdout))


FLEET = (Robot("ship", (5.0, 15.0, 40.0)), Robot("fish", (0.5, 1.0, 2.0)), Robot("glider", (5.0, 15.0, 40.0)))


def data_table(data: Path) -> tuple[list[str], bool]:
    """Return a table of the logs, and whether all their velocities follow from their poses."""
    lines = ["| robot | rows | time [s] | rows per s | measured | velocities follow from the poses |"]
    lines.append("|---|---|---|---|---|---|")
    agree = True
    for robot in FLEET:
        log = robot.log(data, robot.map)
        present = np.isfinite(log.motion).any(axis=0)
        measured = ", ".join(c.partition("_")[0] for c, p in zip(COLUMNS, present, strict=True) if p)
        period, notes = float(np.median(np.diff(log.time))), velocity_notes(log)
        duration = float(np.sum(np.diff(log.time)[np.diff(log.time) < 5 * period]))
        agree &= not notes
        said = "; ".join(notes) or ("yes" if present[4:].any() else "not measured")
        lines.append(f"| {robot.name} | {len(log.time)} | {duration:.0f} | {1 / period:.3g} | {measured} | {said} |")
    return lines, agree


def mislabelled(data: Path, folder: Path) -> list[str]:
    """Return what the velocity check says of the ship's columns under the names of their repository."""
    text = (ROBOTS / "ship-map.toml").read_text().replace('frame = "world"', 'frame = "body"')
    text = text.replace('fields = ["r"]\nunit = "deg/s"', 'fields = ["roll"]\nunit = "deg"')
    text = text.replace('[rates]\nfields = ["roll"]\nunit = "deg"', '[rates]\nfields = ["roll"]\nunit = "deg/s"')
    wrong = folder / "as-named.toml"
    wrong.write_text(text)
    return [f"- {note}" for note in velocity_notes(FLEET[0].log(data, wrong))]


def error_table(robot: Robot, result: Mapping[str, Any]) -> list[str]:
    """Return the held-out errors of a robot, and the channels in which holding the last speed is better."""
    found = result["held_out_windows"]
    columns = [c for c in COLUMNS if found and c in found[0]["model"]]
    lines = ["| window | windows | " + " | ".join(f"{c}: model, held" for c in columns) + " |"]
    lines.append("|---" * (len(columns) + 2) + "|")
    worse = []
    for one in found:
        cells = []
        for column in columns:
            model, held = one["model"][column], one["last_velocity_held"][column]
            bad = model > held
            worse += [f"{column} over {one['window_s']:g} s ({model:.2g}, {held:.2g})"] * bad
            cells.append(f"{'**' * bad}{model:.2g}{'**' * bad}, {held:.2g}")
        lines.append(f"| {one['window_s']:g} s | {one['windows']} | " + " | ".join(cells) + " |")
    lines += ["", "Worse than the last speed held: " + ("; ".join(worse) if worse else "nothing") + "."]
    return lines


def unfitted_line(robot: Robot, data: Path) -> str:
    """Return the errors of the start values, without a fit, over the longest window of the same held-out part."""
    log = robot.log(data, robot.map)
    cut = int(np.searchsorted(log.time, log.time[0] + (1.0 - HELD_OUT) * (log.time[-1] - log.time[0])))
    part = MotionLog(log.time[cut:], log.motion[cut:], log.thrust[cut:], log.source)
    errors = predict(part, load_vehicle(ROBOTS / f"{robot.name}.toml"), window=robot.windows[-1]).model
    said = ", ".join(f"{column} {error:.2g}" for column, error in errors.items())
    return f"The start values without a fit, over {robot.windows[-1]:g} s: {said}."


def parameter_lines(result: Mapping[str, Any]) -> list[str]:
    """Return the identified parameters with their intervals, those held, those fixed at 0, and the notes."""
    units = {k: SPECS[k].unit for k in result["estimates"]}
    known = [
        f"{k} {e['value']:.3g} ± {e['half_interval']:.2g} {units[k]}".rstrip()
        for k, e in result["estimates"].items()
        if e["identified"] and k not in result["held"] and k not in result["fixed_at_0"]
    ]
    fitted = [
        k for k, e in result["estimates"].items()
        if not e["identified"] and k not in result["held"] and k not in result["fixed_at_0"]
    ]  # fmt: skip
    lines = ["- **Identified, with 95 % interval**: " + ("; ".join(known) if known else "nothing")]
    lines.append("- **Fitted together with the held values, but not identified**: " + (", ".join(fitted) or "none"))
    lines.append("- **Held at the start value**: " + (", ".join(result["held"]) or "none"))
    lines.append("- **Fixed at 0**, because the estimate is negative: " + (", ".join(result["fixed_at_0"]) or "none"))
    lines.append("- **Badly excited**: " + ("; ".join(result["not_determined"]) or "nothing"))
    return lines + [f"- {note}" for note in result["notes"]]


def report(data: Path, out: Path) -> list[str]:
    """Return the results as Markdown."""
    lines, _ = data_table(data)
    with tempfile.TemporaryDirectory() as folder:
        lines += [
            "",
            "Under the names that the ship's repository gives its columns, `surctl vehicle from-log` says:",
            "",
        ]
        lines += mislabelled(data, Path(folder))
        for robot in FLEET:
            result = robot.fit(data, Path(folder))
            lines += ["", f"### {robot.name}: {SOURCES[robot.name]['robot']}", *["", *error_table(robot, result)]]
            lines += ["", unfitted_line(robot, data), "", *parameter_lines(result)]
            picture = Path(folder) / f"{robot.name}.png"
            if robot == FLEET[0] and picture.exists():
                (out / picture.name).write_bytes(picture.read_bytes())
    return lines


def quick() -> int:
    """Read stand-ins of all formats, check that their velocities follow from their poses, and fit one of them."""
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder)
        write_standins(data)
        lines, agree = data_table(data)
        found = mislabelled(data, data)
        result = Robot("glider", (5.0, 20.0)).fit(data, data)
        print("\n".join([*lines, "", *found, "", *error_table(FLEET[2], result), "", *parameter_lines(result)]))
    model, held = (result["held_out_windows"][-1][k]["z_m"] for k in ("model", "last_velocity_held"))
    return 0 if agree and len(found) == 2 and "m33" in result["estimates"] and model < held else 1


def main() -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=FOLDER / "data")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    if given.quick:
        return quick()
    missing = [name for names in EXCERPTS.values() for name in names if not (given.data / name).exists()]
    if missing:
        print(f"{given.data}: no {missing[0]}; clone the repositories of sources.toml, then run excerpts.py CLONES",
              file=sys.stderr)  # fmt: skip
        return 2
    text = "\n".join(report(given.data, FOLDER if given.write else given.data))
    print(text)
    if given.write:
        readme = FOLDER / "README.md"
        readme.write_text(readme.read_text().partition(MARK)[0] + MARK + "\n\n" + text + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
