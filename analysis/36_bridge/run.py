"""Study 36: sessions with an autopilot over a bad link.

    python analysis/36_bridge/run.py            # 1,000 sessions, nine flights, an hour as MCAP
    python analysis/36_bridge/run.py --quick    # 8 sessions, no flight, 5 s as MCAP

Prints Markdown; --write writes the README from it. Status 1 if a thrust lasts longer than its limit, the bridge steers
without the operator, a flight takes 5 % longer than the direct one, or an hour as MCAP has more than 100 MB.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from surctl.marine.bridge import Act, Bridge, LinkQuality, Plan, Rehearsal, SimulatedSub, Wire
from surctl.marine.bridge.bridge import plan_session
from surctl.marine.bridge.rehearsal import rehearse
from surctl.marine.control import load_gains
from surctl.marine.simulation import load_scenario, simulate
from surctl.marine.simulation.record_file import SceneFile
from surctl.marine.vehicle import load_vehicle
from surctl.recorded_write import McapFile

ABOUT = Path(__file__).with_name("about.md")
LINK = LinkQuality(loss=0.2, delay=0.15, jitter=0.02, damaged=0.02, repeated=0.02)
KINDS = ("cut", "mute", "deaf", "blind", "reboot", "disarm", "quit", "manual")
LIMIT = 0.5  # [s] until the thrust is neutral
MODE_LIMIT = 2.0  # [s] the same after a change of mode, which the next heartbeat shows
UNDONE, REARMED, ARMED, END = 2.5, 2.7, 5.0, 7.0  # [s] after the event
HOUR = 3600.0


@dataclass(frozen=True)
class Session:
    """Result of one session: the event, whether the operator armed again, and what followed."""

    kind: str
    rearmed: bool
    steered: bool
    neutral: float
    without_operator: int
    again: bool
    restarts: float
    commands: frozenset[int]


def session(plan: Plan, number: int) -> Session:
    """Run one session; its number determines everything."""
    rng = np.random.default_rng([36, number])
    kind, rearmed = KINDS[number % len(KINDS)], number // len(KINDS) % 2 == 0
    at = float(rng.uniform(4.5, 6.0))
    acts = [Act(2.5, "arm"), Act(at, kind)]
    if kind in ("cut", "mute", "deaf", "blind"):
        acts.append(Act(at + UNDONE, "join"))
    if kind == "manual":
        acts.append(Act(at + UNDONE, "alt_hold"))
    if rearmed:
        acts += [Act(at + REARMED, "disarm"), Act(at + ARMED, "arm")]
    bridge, sub = Bridge(plan, Wire()), SimulatedSub(plan.scenario, plan.vehicle)
    steering: list[float] = []

    def look(run: Rehearsal) -> None:
        if run.thrusts[-1][1]:
            steering.append(run.now)

    result = rehearse(bridge, sub, link=LINK, seed=number, acts=acts, limit=at + END, each=look)
    late = at + (MODE_LIMIT if kind == "manual" else LIMIT)
    armed = at + ARMED if rearmed else np.inf
    (neutral,) = (after for act, after in result.neutral_after if act.action == kind and act.time == at)
    return Session(
        kind,
        rearmed,
        any(t < at for t in steering),
        neutral,
        sum(late < t < armed for t in steering),
        any(t > armed for t in steering),
        bridge.clock.restarts,
        result.commands,
    )


def sessions(count: int) -> Iterator[str]:
    """Run the sessions; yield the rows of the table, and last a line that begins with a count of failures."""
    scenario = replace(load_scenario("pool-behind"), obstacles=())
    plan = plan_session(scenario, load_vehicle("sur400"), law="closed_form")
    results = [session(plan, k) for k in range(count)]
    failures = 0
    head = (
        "event",
        "sessions",
        "steered",
        "neutral after [s]: median",
        "largest",
        "thrust without the operator",
        "after arming",
    )
    yield f"| {' | '.join(head)} |"
    yield "|---|---|---|---|---|---|---|"
    for kind in KINDS:
        mine = [one for one in results if one.kind == kind]
        after = [one.neutral for one in mine if one.steered]
        alone = sum(one.without_operator > 0 for one in mine)
        rearmed = [one for one in mine if one.rearmed and kind != "quit"]
        failures += alone + sum(a > (MODE_LIMIT if kind == "manual" else LIMIT) for a in after)
        failures += sum(one.commands != {511} for one in mine)
        yield (
            f"| {kind} | {len(mine)} | {len(after)} | {np.median(after):.2f} | {max(after):.2f} | {alone} | "
            f"{sum(one.again for one in rearmed)} of {len(rearmed)} |"
        )
    yield ""
    yield f"{failures} failures."


def flights() -> Iterator[str]:
    """Compare flights of `tank-speed-015` with the direct simulation; yield rows, and last a count of failures."""
    scenario, vehicle = load_scenario("tank-speed-015"), load_vehicle("sur540-flooded")
    direct: float | None = None
    links = {
        "no loss": LinkQuality(),
        "20 % lost, 150 ms each way": LinkQuality(loss=0.2, delay=0.15),
        "20 % lost, 300 ms each way": LinkQuality(loss=0.2, delay=0.3),
    }
    failures = 0
    yield "| mode | link | time [s] | direct [s] | clearance [m] | direct [m] | holds |"
    yield "|---|---|---|---|---|---|---|"
    for mode in ("alt_hold", "manual", "guided"):
        plan = plan_session(scenario, vehicle, mode=mode)
        if direct is None:
            run = simulate(scenario, vehicle, gains=load_gains("default"), law=plan.law)
            direct, clear = run.metrics.time_s, run.metrics.min_clearance_m
        for name, link in links.items():
            sub = SimulatedSub(scenario, vehicle)
            sub.mode = mode
            result = rehearse(Bridge(plan, Wire()), sub, link=link)
            failures += not result.arrived or result.time > 1.05 * direct
            yield (
                f"| {mode} | {name} | {result.time:.2f} | {direct:.2f} | {result.clearance:.3f} | {clear:.3f} | "
                f"{result.begun - 1} |"
            )
    yield ""
    yield f"{failures} failures."


def hour(seconds: float) -> Iterator[str]:
    """Write a long flight as MCAP; yield one line, which begins with a count of failures."""
    scenario, vehicle = load_scenario("tank-speed-015"), load_vehicle("sur540-flooded")
    run = simulate(replace(scenario, time_limit=seconds), vehicle, gains=load_gains("default"))
    record, dt = run.record, run.law.dt
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        path, steps = Path(folder, "hour.mcap"), round(seconds / dt)
        peaks = []
        tracemalloc.start()
        with McapFile(path) as file:
            scene = SceneFile(file, scenario, vehicle)
            for k in range(steps):
                at = k % len(record.time)
                scene.moment(
                    k * dt,
                    eta=record.eta[at] + 1e-3 * rng.standard_normal(4),
                    nu=record.nu[at] + 1e-3 * rng.standard_normal(4),
                    tau=record.tau[at] + 1e-2 * rng.standard_normal(4),
                    status=int(record.status[at]),
                    clearance=float(record.clearance[at]),
                    bodies=record.obstacles[at],
                    ranges=rng.uniform(0.2, 4.5, 4),
                    values={"avoiding": float(rng.random()), "nearest": float(rng.random())},
                )
                if k == steps // 2:
                    peaks.append(tracemalloc.get_traced_memory()[1])
                    tracemalloc.reset_peak()
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        size = path.stat().st_size
    failures = int(size * HOUR / seconds > 100e6) + int(peaks[1] > peaks[0] + 2e6)
    first, second = (peak / 1e6 for peak in peaks)
    yield (
        f"{failures} failures. {steps} control periods with noise in every number and four sonars ({seconds:g} s) take "
        f"{size / 1e6:.1f} MB; writing takes {first:.1f} MB of memory in the first half, {second:.1f} MB in the second."
    )


def main() -> int:
    """Print the tables; return 1 if a bar is missed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--write", action="store_true")
    chosen = parser.parse_args()
    parts = (
        sessions(8 if chosen.quick else 1000),
        *([] if chosen.quick else [flights()]),
        hour(5.0 if chosen.quick else HOUR),
    )
    lines = [ABOUT.read_text(encoding="utf-8")]
    failures = 0
    for part in parts:
        for line in part:
            print(line, flush=True)
            lines.append(line)
        failures += int(lines[-1].split()[0])
        print()
        lines.append("")
    if chosen.write:
        Path(__file__).with_name("README.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
