"""The law whole, with sonars and by true positions: how long its C is, what compiling it takes, and what a step takes.

    python analysis/18_export_benchmark/whole.py [--quick]

Instructions on x86 are counted by Valgrind's callgrind over a flight, guard included.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from contenders import SCENARIO

from surctl.export import TARGETS, Bundle, Controller, Exportable, Records, build_controller, write_bundle
from surctl.export.check import step_stack
from surctl.export.envelope import as_records
from surctl.export.process import code_bytes, compile_controller
from surctl.ir import Real
from surctl.ir.cache import FLAGS
from surctl.marine.control import build_law, load_gains
from surctl.marine.export import build_bundle, closed_form, operating_envelope
from surctl.marine.simulation import law_numbers, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle

MOST_SOURCE, MOST_SECONDS, MOST_MEMORY = 200_000, 8.0, 250.0  # B with the self-test, s, MB; of the law with sonars


@dataclass(frozen=True)
class Compiled:
    """What gcc -O2 took for one file."""

    file: str
    size: int
    seconds: float
    megabytes: float


def whole(*, quick: bool) -> tuple[list[str], list[tuple[str, bool]]]:
    """(lines, bars and whether they hold)."""
    told = ["| law guarded | file | C, B | gcc -O2: s, MB |", "|---|---|---|---|"]
    taken = [
        "| law guarded | x86 -O2, double: instructions a step, mean / max | M4F -Os, float: code, B | stack, B |",
        "|---|---|---|---|",
    ]
    held: list[tuple[str, bool]] = []
    for name, sonar in (("by true positions", False), ("with sonars", True)):
        flight, double, bundle = made(sonar, "float64", steps=20 if quick else None)
        with tempfile.TemporaryDirectory() as scratch:
            controller = build_controller(double, bundle, Path(scratch, "b"))
            files = [_compiled(Path(scratch, "b"), file) for file in (*bundle.sources, bundle.selftest)]
            mean, most = _counted(controller, as_records(double, flight), Path(scratch, "callgrind"))
        _, _, small = made(sonar, "float32", steps=1)
        told += [f"| {name} | `{f.file}` | {f.size} | {f.seconds:.1f}, {f.megabytes:.0f} |" for f in files]
        size, seconds = sum(f.size for f in files), sum(f.seconds for f in files)
        memory = max(f.megabytes for f in files)
        told.append(f"| {name} | all | {size} | {seconds:.1f}, {memory:.0f} |")
        taken.append(f"| {name} | {mean:.0f} / {most} | {_on_processor(small)} |")
        if sonar:
            held = [
                (f"C of the law with sonars and its self-test: at most {MOST_SOURCE} B ({size})", size <= MOST_SOURCE),
                (f"gcc -O2 takes at most {MOST_SECONDS:.0f} s for it, all files one by one", seconds <= MOST_SECONDS),
                (f"and at most {MOST_MEMORY:.0f} MB", memory <= MOST_MEMORY),
            ]
    return [*told, "", *taken], held


def made(sonar: bool, real: Real, *, steps: int | None, scenario: str = SCENARIO) -> tuple[Records, Exportable, Bundle]:
    """The beginning of a flight (all of it if `steps` is None), the law that was exported, and its bundle."""
    mission, gains = load_scenario(scenario), load_gains("default")
    vehicle = load_vehicle(mission.vehicle)
    law = build_law("guarded", sonar=sonar, equipment=mission.sensors.on(vehicle["radius"]))
    numbers = law_numbers(mission, gains, vehicle)
    record = simulate(mission, vehicle, gains=gains, law=law, sensing="sonar" if sonar else "truth", seed=0).record
    shipped = closed_form(law, real=real)
    within = operating_envelope(law, mission, vehicle, shipped.gains)
    flight = Records(record.law_state[:steps], record.law_input[:steps], record.law_parameters)
    return flight, shipped, build_bundle(shipped, law.gains.unpack(numbers), real=real, envelope=within)


def _compiled(folder: Path, file: str) -> Compiled:
    """One compilation, its processor time and its largest memory."""
    # GNU time: what the system tells of a child of this process is never less than the process itself
    command = ["/usr/bin/time", "-f", "%U %S %M", "gcc", *FLAGS, "-c", "-o", os.devnull, str(folder / file)]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    user, system, kilobytes = map(float, told.split())
    return Compiled(file, (folder / file).stat().st_size, user + system, kilobytes / 1024)


def _counted(controller: Controller, flight: Records, out: Path) -> tuple[float, int]:
    """(mean, largest) instructions of a step on this machine."""
    step = f"{controller.bundle.name}_step"
    load = np.zeros(len(flight), dtype=bool)
    load[0] = True
    options = (f"--toggle-collect={step}", f"--dump-after={step}", "--combine-dumps=yes", f"--callgrind-out-file={out}")
    command = ["valgrind", "--tool=callgrind", *options, *controller.command]
    subprocess.run(command, input=controller.stream(flight, load=load), capture_output=True, check=True)
    counts = np.array([int(n) for n in re.findall(r"^(?:totals|summary): (\d+)", out.read_text(), flags=re.MULTILINE)])
    counts = counts[counts > 0]
    return float(counts.mean()), int(counts.max())


def _on_processor(bundle: Bundle) -> str:
    """Flash without the self-test, and stack below a step."""
    target = TARGETS["cortex-m4f-Os"]
    with tempfile.TemporaryDirectory() as scratch:
        write_bundle(bundle, Path(scratch, "b"))
        flags = (*target.flags, "-fstack-usage")
        code = compile_controller(bundle, Path(scratch, "b"), flags=flags, compiler=target.compiler)
        return f"{code_bytes(code[:-1], target.size_tool)} | {step_stack(bundle, code)}"


if __name__ == "__main__":
    lines, bars = whole(quick="--quick" in sys.argv[1:])
    print("\n".join([*lines, "", *(f"- {what}: {'holds' if holds else '**does not hold**'}" for what, holds in bars)]))
    sys.exit(0 if all(holds for _, holds in bars) else 1)
