"""`surctl sweep`: a grid over two gains."""

from __future__ import annotations

from pathlib import Path

import click

from surctl.cli.output import as_json, finish, progress

__all__ = ["sweep"]


@click.command
@click.argument("axes", nargs=2, metavar="GAIN=V1,V2,... GAIN=V1,V2,...")
@click.option(
    "--scenario", "scenarios", multiple=True, default=("tank-static", "pool-static"), help="Flown at each point."
)
@click.option("--vehicle", help="Vehicle: name or file; default: each scenario's.")
@click.option("--gains", default="default", help="All other gains: name or path.")
@click.option("--seeds", type=click.IntRange(min=1), default=1, help="Seeds 0 to N-1 of every scenario.")
@click.option("--workers", type=click.IntRange(min=1), default=2, help="Processes; the result does not depend on them.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("surctl-out"), help="Folder; its sweep.csv resumes."
)
@as_json
def sweep(
    axes: tuple[str, str],
    scenarios: tuple[str, ...],
    vehicle: str | None,
    gains: str,
    seeds: int,
    workers: int,
    out: Path,
    as_json: bool,
) -> None:
    """Fly scenarios over a grid of two gains, with loop margins, and pick a point.

    Exit status 1 when no point is feasible.
    Example: surctl sweep lookahead=0.6,0.9,1.2 k_v=1,1.5,2 --scenario pool-static --out sweep
    """
    from surctl.control import load_gains, write_gains
    from surctl.files import prepare_folder
    from surctl.report import save_heat_map
    from surctl.simulation import load_scenario
    from surctl.tuning import COLUMNS, Axis, Flight
    from surctl.tuning import sweep as run_sweep
    from surctl.vehicle import load_vehicle

    parsed = [_axis(text) for text in axes]
    loaded = [load_scenario(name) for name in scenarios]
    flights = [Flight(s, load_vehicle(vehicle or s.vehicle), k) for s in loaded for k in range(seeds)]
    base = load_gains(gains)
    grid = (Axis(*parsed[0]), Axis(*parsed[1]))
    prepare_folder(out)
    result = run_sweep(
        base,
        grid,
        flights=flights,
        workers=workers,
        store=out / "sweep.csv",
        progress=lambda done, count: progress(f"{done}/{count} points"),
    )
    (out / "gains.toml").write_text(write_gains(result.gains), encoding="utf-8")
    picture = save_heat_map(result, "score", out)
    rows = [
        {grid[0].name: a, grid[1].name: b} | {name: float(result.column(name)[i, j]) for name in COLUMNS}
        for i, a in enumerate(grid[0].values)
        for j, b in enumerate(grid[1].values)
    ]
    lines = ["  ".join(f"{k}={v:.4g}" for k, v in row.items()) for row in rows]
    where = result.gains.provenance if result.picked else "no point is feasible"
    lines += ["", where, f"gains {out / 'gains.toml'}", f"table {out / 'sweep.csv'}", f"plot  {picture}"]
    data = {
        "axes": {axis.name: list(axis.values) for axis in grid},
        "results": rows,
        "picked": None if result.picked is None else rows[result.picked[0] * len(grid[1].values) + result.picked[1]],
    }
    finish(data, lines, as_json=as_json, passed=result.picked is not None)


def _axis(text: str) -> tuple[str, tuple[float, ...]]:
    name, equals, values = text.partition("=")
    try:
        numbers = tuple(float(v) for v in values.split(","))
    except ValueError:
        numbers = ()
    if not equals or not numbers:
        raise click.BadParameter(f"{text!r} is not GAIN=V1,V2,...")
    return name, numbers
