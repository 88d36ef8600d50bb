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
@click.option("--target", default="c99", help="c99.")
@click.option("--real", default="float64", help="float64.")
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
    out: Path,
    seed: int,
    as_json: bool,
) -> None:
    """Write the controller as C99, compile it, and replay a whole closed-loop run through it, step by step.

    The law believes in the sonars, base station and IMU of the scenario; what is said of sensors takes their place.
    Exit status 1 when C and Python differ, however the flight ends.

    Examples: surctl export --gains surctl-out/gains.toml --out firmware; surctl export --priority-mode projected;
    surctl export --scenario tank-static --fault stuck:0:5
    """
    import tempfile

    from surctl.control import build_law, load_gains
    from surctl.errors import InputError, nearest
    from surctl.export import Records, build_bundle, build_controller, compare_runs, write_bundle
    from surctl.ir import find_compiler
    from surctl.simulation import SENSING, law_numbers, load_scenario, simulate
    from surctl.vehicle import load_vehicle

    checked = (("--target", target, ("c99",)), ("--real", real, ("float64",)), ("--sensing", sensing, SENSING))
    for key, value, known in checked:
        if value not in known:
            raise InputError("is not available", key=key, value=value, remedy=nearest(value, known))
    find_compiler()
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
    bundle = build_bundle(built, built.gains.unpack(law_numbers(mission, tuned, flown)), name=name)
    files = write_bundle(bundle, out)
    progress(f"flying {mission.name}")
    run = simulate(mission, flown, gains=tuned, law=built, sensing=sensing, seed=seed)
    record, metrics = run.record, run.metrics
    progress("compiling and replaying")
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch:
        controller = build_controller(built, bundle, Path(scratch, bundle.name))
        (sil,) = compare_runs(controller, [Records(record.law_state, record.law_input, record.law_parameters)])
    result = {
        "name": bundle.name,
        "id": bundle.id,
        "files": [str(f.path) for f in files],
        "sha256": {f.path.name: f.sha256 for f in files},
        "flight": run.to_dict() | ({"sensors": sensors_told(mission)} if sensing == "sonar" else {}),
        "sil": sil.to_dict(),
    }
    told = f"replayed: {mission.name} by {flown.name}, {sensing}, seed {seed}: {metrics.stopped_because} at "
    lines = [*(f"{f.sha256[:12]}  {f.path}" for f in files), "", f"{told}{metrics.time_s:.2f} s", sil.summary()]
    finish(result, lines, as_json=as_json, passed=sil.conclusive)
