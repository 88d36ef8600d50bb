"""`surctl export`: the controller as C."""

from __future__ import annotations

from pathlib import Path

import click

from surctl.cli.output import as_json, finish, progress

__all__ = ["export"]


@click.command
@click.option("--gains", default="default", help="Gain file: name or path.")
@click.option("--vehicle", help="Vehicle: name or file; default: the scenario's.")
@click.option("--scenario", default="pool-static", help="Mission of the defaults and of the check.")
@click.option("--law", default="guarded", help="guarded; paper; a textbook law: apf, dwa, vo, cbf.")
@click.option("--avoidance", default="corrected", help="Form of (20) in law paper.")
@click.option("--priority-mode", default="nsb", help="nsb, or one that keeps limits: filter, projected, lexicographic.")
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
    priority_mode: str,
    name: str | None,
    target: str,
    real: str,
    out: Path,
    seed: int,
    as_json: bool,
) -> None:
    """Write the controller as C99, compile it, and replay a whole closed-loop run through it, step by step.

    Exit status 1 when C and Python differ. Example: surctl export --gains surctl-out/gains.toml --out firmware
    """
    from surctl.control import build_law, load_gains
    from surctl.errors import InputError, nearest
    from surctl.export import Records, build_bundle, software_in_the_loop, write_bundle
    from surctl.ir import find_compiler
    from surctl.simulation import load_scenario, simulate
    from surctl.vehicle import load_vehicle

    for key, value, known in (("--target", target, ("c99",)), ("--real", real, ("float64",))):
        if value not in known:
            raise InputError("is not available", key=key, value=value, remedy=nearest(value, known))
    find_compiler()
    built = build_law(law, avoidance=avoidance, mode=priority_mode)
    mission = load_scenario(scenario)
    progress(f"flying {mission.name}")
    run = simulate(mission, load_vehicle(vehicle or mission.vehicle), gains=load_gains(gains), law=built, seed=seed)
    record = run.record
    bundle = build_bundle(built, built.gains.unpack(record.law_parameters), name=name)
    files = write_bundle(bundle, out)
    progress("compiling and replaying")
    sil = software_in_the_loop(built, Records(record.law_state, record.law_input, record.law_parameters))
    result = {
        "name": bundle.name,
        "id": bundle.id,
        "files": [str(f.path) for f in files],
        "sha256": {f.path.name: f.sha256 for f in files},
        "sil": sil.to_dict(),
    }
    lines = [*(f"{f.sha256[:12]}  {f.path}" for f in files), "", sil.summary()]
    finish(result, lines, as_json=as_json, passed=sil.conclusive)
