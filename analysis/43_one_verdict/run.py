"""Study 43: do all pages, commands and statuses say the same about a vehicle, and about a system of one's own?

    python analysis/43_one_verdict/run.py [--quick] [--vehicles 300] [--systems 100] [--seed 0]

Prints Markdown. The exit status is 0 if all of them agree, 1 otherwise, and 2 for a bad option or without a C compiler.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import os
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from html import unescape
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
from draws import SYSTEM_SECONDS, loop, vehicle

from surctl.assessment import Assessment, ClosedLoop, assess, cost_verdicts
from surctl.cli import main as command_line
from surctl.cli.output import finite
from surctl.errors import ToolMissing
from surctl.ir.cache import find_compiler
from surctl.marine.assessment import Mission
from surctl.marine.cli.runs import linear_warning
from surctl.marine.control import Gains, build_law, write_gains
from surctl.marine.report.bench import Bench
from surctl.marine.simulation import load_scenario
from surctl.marine.study import load_plan
from surctl.marine.study.conduct import assessed
from surctl.marine.tuning import derive_gains
from surctl.marine.vehicle import Vehicle, write_vehicle
from surctl.marine.verification import linear_table
from surctl.report.design_bench import SystemBench
from surctl.report.theme import number
from surctl.system import run_system

CAP, DT = 0.3, 0.05  # [m/s], [s]
QUICK = 5e-3  # relative error of margins on a grid of frequencies, which searches and `simulate` use
RARE, COMPILED = 50, 5  # one of so many vehicles is also simulated; one of so many systems is also compiled
MISSION = """kind = "scenario"
name = "m"
title = "A pillar beside the path"
provenance = "chosen"
vehicle = "v.toml"
path_m = [[4.0, 5.0], [8.0, 5.0]]
depth_m = -2.0
cruise_m_per_s = {cruise!r}
cap_m_per_s = 0.3
time_limit_s = 120.0
[site]
length_m = 14.0
width_m = 10.0
depth_m = 6.0
[[obstacles]]
name = "pillar"
shape = "cylinder"
centre_m = [6.0, 5.2]
radius_m = 0.2
"""
STUDY = """kind = "study"
name = "s"
vehicle = "v.toml"
gains = "g.toml"
law = "guarded"
[[runs]]
scenario = "m.toml"
"""
SYSTEM = """import sys

sys.path.insert(0, {folder!r})
from draws import loop


def s{seed}():
    return loop({seed})
"""
COLUMNS = ("disk_margin", "single_loop_disk_margin", "delay_margin_s", "slowest_pole_per_s")


class Disagreements:
    """What was compared, by page, and the differences that were found."""

    def __init__(self) -> None:
        self.compared: Counter[str] = Counter()
        self.found: list[str] = []
        self.shown = 0

    def progress(self, done: str) -> None:
        """Say on stderr what is done, and the disagreements since the last call."""
        print(f"{done}: {len(self.found)}", *self.found[self.shown :], sep="\n  ", file=sys.stderr, flush=True)
        self.shown = len(self.found)

    def same(self, page: str, what: str, left: object, right: object, *, within: float = 0.0) -> None:
        """Compare one value of a page with that of the assessment."""
        self.compared[page] += 1
        close = left == right or (isinstance(left, float) and isinstance(right, float) and _near(left, right, within))
        if not close:
            self.found.append(f"{page}: {what}: {left!r}, assessed {right!r}")

    def assessment(self, page: str, about: str, data: Mapping[str, Any], expected: Assessment) -> None:
        """Compare an assessment in JSON: every figure that both have, banner, lines and result."""
        known = finite(expected.to_dict())
        for name in known["figures"].keys() & data["figures"].keys():
            self.same(page, f"{about} {name}", data["figures"][name], known["figures"][name])
        for key in ("passed", "banner", "lines"):
            self.same(page, f"{about} {key}", data[key], known[key])


def _near(left: float, right: float, within: float) -> bool:
    return (math.isnan(left) and math.isnan(right)) or abs(left - right) <= within * max(abs(left), abs(right))


def surctl(*words: object) -> tuple[dict[str, Any], int]:
    """Return the JSON that a command prints in this process, and its exit status."""
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    before = sys.argv
    sys.argv = ["surctl", *map(str, words), "--json"]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()) as err:
            command_line()
    except SystemExit as end:
        text = out.buffer.getvalue().decode()  # type: ignore[attr-defined]
        if not text:
            raise RuntimeError(f"{sys.argv}: {err.getvalue()}") from None
        return json.loads(text), int(end.code or 0)
    finally:
        sys.argv = before
    raise RuntimeError(f"{sys.argv} did not end")


def one_vehicle(seed: int, found: Disagreements, *, runs: bool, study: bool) -> None:
    """Compare what is said about one drawn vehicle with its gains; with `runs` and `study`, also what simulates."""
    craft, gains, cruise = vehicle(seed)
    about = f"vehicle {seed}"
    for file, text in (("v", write_vehicle(craft)), ("g", write_gains(gains)), ("m", MISSION.format(cruise=cruise))):
        Path(f"{file}.toml").write_text(text)
    Path("s.toml").write_text(STUDY)
    subject = Mission(craft, gains, cruise, CAP, "guarded")
    result = assess(subject, parts=["loop"])
    figures = result.figures

    words = ("--vehicle", "v.toml", "--gains", "g.toml")
    told, status = surctl("verify", "m-norm-corrected", *words, "--cruise", repr(cruise), "--cap", CAP)
    found.assessment("verify", about, told["assessment"], result)
    found.same("verify", f"{about} status", status, int(result.passed is False))
    for side, name in (("worst", "disk_margin"), ("nominal", "nominal_disk_margin")):
        found.same("verify", f"{about} linear {name}", told["linear"][side]["disk_margin"], finite(figures[name].value))
    late = told["linear"]["worst"]["delay_margin"]
    found.same("verify", f"{about} linear delay", late["delay_s"], finite(figures["delay_margin_s"].value))

    table = linear_table(craft, {}, base=gains.values, cruise=cruise, dt=DT, columns=COLUMNS)
    for name in COLUMNS:
        found.same("sweep", f"{about} {name}", float(table[name][0]), figures[name].value, within=QUICK)
    data, _ = linear_warning(craft, gains, build_law("guarded", dt=DT), cruise=cruise)
    assert data is not None  # guarded has a linear model
    for name in ("disk_margin", "delay_margin_s"):
        found.same("simulate", f"{about} {name}", data[name], figures[name].value, within=QUICK)

    plan = load_plan("s.toml")
    planned = assess(assessed(plan, plan.gains), parts=["loop"])
    known = finite(result.to_dict())["figures"]
    for name, figure in finite(planned.to_dict())["figures"].items():
        found.same("tune", f"{about} {name}", figure, known[name])
    linted, _ = surctl("lint", "s.toml")
    texts = [finding["text"].rpartition(", with the gains") for finding in linted["findings"]]
    warned = [text for text, named, _ in texts if named]
    with_contact = assess(assessed(plan, plan.gains), parts=["loop", "no contact"], computed=planned.parts)
    lines = [line.text for line in with_contact.lines if line.passed is False or line.about == "cap"]
    found.same("lint", f"{about} warnings", warned, lines)
    if runs:
        _runs(craft, gains, cruise, about, found)
    if study:
        told, status = surctl("study", "s.toml", "--out", "s", "--workers", 1)
        for name, figure in finite(planned.to_dict())["figures"].items():
            found.same("study", f"{about} {name}", told["assessment"]["figures"][name], figure)
        found.same("study", f"{about} status", status, int(not told["passed"]))
        fails = any(line["passed"] is False and line["counts"] for line in told["assessment"]["lines"])
        found.same("study", f"{about} passed", told["passed"], not fails)
        _page(Path("s/report.html"), told["assessment"]["banner"], f"{about}", found)


def _runs(craft: Vehicle, gains: Gains, cruise: float, about: str, found: Disagreements) -> None:
    # what simulates: export, design page, derived gains
    mission = load_scenario("m.toml")
    bench = Bench(craft, mission, gains, law="guarded")
    values = {one.name: one.value for one in bench.sliders}
    run = bench.simulate(values)
    about_run: dict[str, Any] = {"scenarios": (mission,), "sensing": "truth", "runs": (run,)}
    full = Mission(craft, bench.gains(values), cruise, CAP, "guarded", **about_run)
    result = assess(full)
    shown = [text for text, _ in bench.decide(values).lines]
    found.same("design page", f"{about} banner", shown[0], result.verdict())
    for name, figure in result.figures.items():
        text = f"{name} = {figure.value:.4g}"
        found.same("design page", f"{about} {name}", any(line.startswith(text) for line in shown), True)
    words = ("--vehicle", "v.toml", "--gains", "g.toml", "--law", "guarded", "--sensing", "truth")
    _, status = surctl("export", "--scenario", "m.toml", *words, "--out", "c")
    manifest = json.loads(Path("c/manifest.json").read_text())["evidence"]["assessment"]
    exported = assess(full, parts=["loop", "no contact", "runs"])
    found.assessment("export", about, manifest, exported)
    found.same("export", f"{about} status", status, int(not exported.accepted()))
    told, status = surctl("verify", "m-norm-corrected", "--scenario", "m.toml", *words)
    found.assessment("verify", f"{about} mission", told["assessment"], assess(full, parts=["loop", "no contact"]))
    derived = derive_gains(craft, cruise=cruise)
    of_derived = assess(Mission(craft, derived.gains, cruise, CAP), parts=["loop"])
    for name in ("disk_margin", "delay_margin_s"):
        found.same(
            "gains derive", f"{about} {name}", getattr(derived, name), of_derived.figures[name].value, within=1e-9
        )
    found.same("gains derive", f"{about} reached", derived.reached, of_derived.parts["loop"].lines[0].passed is True)


def _page(file: Path, banner: str, about: str, found: Disagreements) -> None:
    text = unescape(re.sub(r"<[^>]*>", " ", file.read_text()))
    found.same("report", f"{about} banner", banner in text, True)


def one_system(seed: int, found: Disagreements, *, compiled: bool) -> None:
    """Compare what is said about one drawn system; with `compiled`, also what compiles its controller."""
    about, system = f"system {seed}", loop(seed)
    Path("systems.py").write_text(SYSTEM.format(folder=str(Path(__file__).parent), seed=seed))
    word, seconds = f"systems.py:s{seed}", ("--seconds", SYSTEM_SECONDS)
    record = run_system(system, SYSTEM_SECONDS)
    result = assess(ClosedLoop(system, record=record))
    of_loop = assess(ClosedLoop(system))
    told, status = surctl("verify", word)
    found.assessment("verify", about, told["assessment"], of_loop)
    found.same("verify", f"{about} status", status, int(of_loop.passed is not True))
    found.same("verify", f"{about} worst", told["worst"]["disk_margin"], finite(of_loop.figures["disk_margin"].value))

    bench = SystemBench(system, word, SYSTEM_SECONDS, {"k": (0.5, 2.0)}, {"nominal": {}})
    shown = [text for text, _ in bench.decide({"k": 1.0}).lines]
    found.same("design page", f"{about} banner", shown[0], result.verdict())
    for name, figure in result.figures.items():
        text = f"{name} = {figure.value:.4g}"
        found.same("design page", f"{about} {name}", any(line.startswith(text) for line in shown), True)
    if not compiled:
        return
    told, _ = surctl("export", word, *seconds, "--out", "c")
    found.assessment("export", about, told["assessment"], result)
    manifest = json.loads(Path("c/manifest.json").read_text())["evidence"]["assessment"]
    found.assessment("export", f"{about} manifest", manifest, result)
    told, _ = surctl("sweep", word, "k=1", *seconds, "--out", "w")
    ends, figures = {"duration": record.duration, "dt": system.dt}, record.figures
    bounds = [line for name, cost in system.costs.items() for line in cost_verdicts(name, cost, figures[name], **ends)]
    for row in told["best"].values():
        found.assessment("sweep", about, row["assessment"], of_loop.with_lines(bounds))
    told, status = surctl("tune", word, "--gain", "k=0.5..2", *seconds, "--trials", 10, "--out", "t")
    found.assessment("tune", f"{about} before", told["assessment"]["before"], result)
    gains = told["best"]["gains"]
    tuned = assess(ClosedLoop(system, gains, seconds=SYSTEM_SECONDS))
    found.assessment("tune", f"{about} after", told["assessment"]["after"], tuned)
    short = tuned.figures["disk_margin"].enough
    found.same("tune", f"{about} unmet", "disk margin" in told["unmet"], not short)
    told, status = surctl("study", word, "k=0.5..2:2", *seconds, "--out", "s")
    exported = [line for line in told["assessment"]["lines"] if line["about"] == "export"]
    plain = {**told["assessment"], "lines": [line for line in told["assessment"]["lines"] if line not in exported]}
    found.assessment("study", about, plain, result)
    fails = result.passed is False
    found.same("study", f"{about} status", (status, told["passed"]), (int(fails), not fails))
    _page(Path("s/report.html"), result.banner, about, found)
    text = Path("s/report.html").read_text()
    for name, figure in result.figures.items():
        row = re.search(rf"<code>{re.escape(name)}</code></td><td[^>]*>([^<]*)</td>", text)
        found.same("report", f"{about} {name}", row and unescape(row[1]), number(figure.value))


def main(arguments: list[str]) -> int:
    """Run the campaign; return the exit status."""
    parser = argparse.ArgumentParser(description="one verdict on every page")
    parser.add_argument("--quick", action="store_true", help="one vehicle and two systems")
    parser.add_argument("--vehicles", type=int, default=300)
    parser.add_argument("--systems", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if min(options.vehicles, options.systems, options.seed) < 0:
        parser.error("numbers are at least 0")
    try:
        find_compiler()
    except ToolMissing as missing:
        print(missing, file=sys.stderr)
        return 2
    vehicles, systems = (1, 2) if options.quick else (options.vehicles, options.systems)
    found, began, before = Disagreements(), time.process_time(), Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for k in range(vehicles):
                rare = not options.quick and k % RARE == RARE - 1
                one_vehicle(options.seed + k, found, runs=rare, study=rare and k % (3 * RARE) == RARE - 1)
                found.progress(f"vehicle {k + 1} of {vehicles}")
            for k in range(systems):
                one_system(options.seed + k, found, compiled=k == 1 if options.quick else k % COMPILED == 0)
                found.progress(f"system {k + 1} of {systems}")
        finally:
            os.chdir(before)
    print("| page or command | values compared |\n|---|---|")
    for page, count in sorted(found.compared.items()):
        print(f"| {page} | {count:,} |")
    print(f"\n{vehicles} vehicles, {systems} systems, {time.process_time() - began:.0f} s of processor time.")
    print(f"Disagreements: {len(found.found)}")
    for line in found.found[:40]:
        print(f"- {line}")
    return int(bool(found.found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
