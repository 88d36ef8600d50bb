"""`surctl export`: the controller as C."""

from __future__ import annotations

from pathlib import Path

import click

from surctl.cli.output import as_json, finish, progress
from surctl.cli.sensor_options import SensorOptions, sensor_options, sensors_told

__all__ = ["export"]


@click.command
@click.option("--gains", default="default", help="Gain file: name or path.")
@click.option("--vehicle", help="Vehicle: name or file; default: the scenario's.")
@click.option("--scenario", default="pool-static", help="Mission and sensors: of the defaults and of the check.")
@click.option("--law", default="guarded", help="guarded; paper; a textbook law: apf, dwa, vo, cbf.")
@click.option("--avoidance", default="corrected", help="Form of (20) in law paper.")
@click.option("--guidance", default="los", help="los; with memory against a steady push: ilos or alos.")
@click.option("--priority-mode", default="nsb", help="nsb, or one that keeps limits: filter, projected, lexicographic.")
@click.option(
    "--sensing", default="sonar", help="sonar: the law that senses for itself; truth: it is told all positions."
)
@sensor_options
@click.option("--name", help="Prefix of files and C symbols.")
@click.option("--target", default="c99", help="c99; fmu: beside it a functional mock-up unit (FMI 2.0) of the same C.")
@click.option("--real", default="float64", help="float64; float32 for a single-precision floating-point unit.")
@click.option(
    "--check", is_flag=True, help="Also compare the bytes of every compiler and emulated processor with Python's."
)
@click.option("--targets", help="With --check: which, with commas; default: all whose tools are here.")
@click.option("--steps", type=click.IntRange(min=1), help="With --check: single steps beside the flight [100000].")
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("surctl-out", "export"), help="Folder of the bundle."
)
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Seed of the run that is replayed.")
@as_json
def export(
    gains: str,
    vehicle: str | None,
    scenario: str,
    law: str,
    avoidance: str,
    guidance: str,
    priority_mode: str,
    sensing: str,
    faults: tuple[str, ...],
    chances: tuple[str, ...],
    beam: float | None,
    own_state: str | None,
    name: str | None,
    target: str,
    real: str,
    check: bool,
    targets: str | None,
    steps: int | None,
    out: Path,
    seed: int,
    as_json: bool,
) -> None:
    """Write the controller as C99, compile it, and replay a whole closed-loop run through it, step by step.

    The law believes in the sonars, base station and IMU of the scenario; what is said of sensors takes their place.
    With --check the flight, then single steps around it, at its switches and far from it, are also stepped through gcc
    and clang at -O0 to -O3 and QEMU's Cortex-M3, -M4F and -M7: each byte has to be that of Python, and the sizes and
    instructions of a step are told. Exit status 1 when C and Python differ, however the flight ends.

    Examples: surctl export --gains surctl-out/gains.toml --out firmware; surctl export --priority-mode projected;
    surctl export --scenario tank-static --fault stuck:0:5; surctl export --sensing truth --real float32 --check;
    surctl export --check --targets gcc-O0,clang-O3,cortex-m4f --steps 1000
    """
    import tempfile

    from surctl.control import build_law, load_gains
    from surctl.errors import InputError, nearest
    from surctl.export import (
        REALS,
        STEPS,
        Records,
        as_records,
        build_bundle,
        build_controller,
        check_builds,
        chosen_targets,
        compare_runs,
        write_bundle,
        write_fmu,
    )
    from surctl.ir import find_compiler
    from surctl.simulation import SENSING, law_numbers, load_scenario, simulate
    from surctl.vehicle import load_vehicle

    checked = (("--target", target, ("c99", "fmu")), ("--real", real, REALS), ("--sensing", sensing, SENSING))
    for key, value, known in checked:
        if value not in known:
            raise InputError("is not available", key=key, value=value, remedy=nearest(value, known))
    if not check and (targets or steps):
        raise InputError("is for --check", key="--targets" if targets else "--steps", remedy="add --check")
    precision = REALS[REALS.index(real)]
    find_compiler()
    tried, untried = chosen_targets([name.strip() for name in targets.split(",")] if targets else ())
    sensors = SensorOptions(faults, chances, beam, own_state)
    sensors.check(law=law, sensing=sensing)
    mission = sensors.over(load_scenario(scenario))
    flown = load_vehicle(vehicle or mission.vehicle)
    equipment = mission.sensors.on(flown["radius"])
    built = build_law(
        law,
        avoidance=avoidance,
        mode=priority_mode,
        sonar=sensing == "sonar",
        equipment=equipment,
        guidance=guidance,
    )
    tuned = load_gains(gains)
    # before the flight, so that a name or a folder that will not do is told at once
    bundle = build_bundle(built, built.gains.unpack(law_numbers(mission, tuned, flown)), name=name, real=precision)
    files = write_bundle(bundle, out)
    if target == "fmu":
        progress("compiling the functional mock-up unit")
        files.append(write_fmu(built, bundle, law_numbers(mission, tuned, flown), out))
    progress(f"flying {mission.name}")
    run = simulate(mission, flown, gains=tuned, law=built, sensing=sensing, seed=seed)
    record, metrics = run.record, run.metrics
    progress("compiling and replaying")
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch:
        controller = build_controller(built, bundle, Path(scratch, bundle.name))
        flight = as_records(built, Records(record.law_state, record.law_input, record.law_parameters))
        (sil,) = compare_runs(controller, [flight])
        report = (
            check_builds(controller, [flight], tried, steps=steps or STEPS, untried=untried, tell=progress)
            if check
            else None
        )
    result = {
        "name": bundle.name,
        "id": bundle.id,
        "files": [str(f.path) for f in files],
        "sha256": {f.path.name: f.sha256 for f in files},
        "flight": run.to_dict() | ({"sensors": sensors_told(mission)} if sensing == "sonar" else {}),
        "real": real,
        "sil": sil.to_dict(),
    }
    if report is not None:
        result["check"] = report.to_dict()
    told = f"replayed: {mission.name} by {flown.name}, {sensing}, seed {seed}: {metrics.stopped_because} at "
    lines = [*(f"{f.sha256[:12]}  {f.path}" for f in files), "", f"{told}{metrics.time_s:.2f} s", sil.summary()]
    lines += [] if report is None else ["", report.summary()]
    finish(result, lines, as_json=as_json, passed=sil.conclusive and (report is None or report.passed))
