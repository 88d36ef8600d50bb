"""`surctl simulate FILE.py:FUNCTION`: one recorded run of a system of the user's own."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surctl.cli.output import finish, saving
from surctl.cli.system_option import OwnSystem, assigned, command_line, load_system

if TYPE_CHECKING:
    from surctl.system import Record, System

__all__ = ["cost_data", "cost_lines", "end_text", "simulate_own_system"]


def simulate_own_system(
    words: Sequence[str], *, seconds: float | None, out: Path | None, save: str, as_json: bool
) -> None:
    """Simulate one run, print how it ended and its costs, and write signals (as csv, mat or nc) and plot to `out`."""
    from surctl.files import prepare_folder
    from surctl.system import LOST, run_system

    own = load_system(words)
    duration, values = own.seconds(seconds), assigned(own.settings)
    if out is not None:
        prepare_folder(out)
    record = run_system(own.system, duration, values)
    lines = [end_text(own, record), *cost_lines(own.system, record.figures)]
    files = [] if out is None else _write(own, record, out, save)
    lines += [f"  {file}" for file in files]
    data = {
        **own.names,
        "values": {name: value.ravel().tolist() for name, value in values.items()},
        "stopped": record.stopped,
        "not_finite": record.lost or None,
        "duration_s": record.duration,
        "costs": cost_data(own.system, record.figures),
        "files": [str(file) for file in files],
    }
    fine = record.stopped != LOST
    then = [command_line("verify", own, *own.settings), _sweep(own, duration)] if fine else []
    finish(data, lines, as_json=as_json, passed=fine, then=[command for command in then if command])


def end_text(own: OwnSystem, record: Record) -> str:
    """Return one line with the system, and when and why the run ended."""
    why = f"{record.stopped}: {record.lost}" if record.lost else record.stopped
    return f"{own.title}: ended after {record.duration:.10g} s ({why}), control period {own.system.dt:g} s"


def cost_lines(system: System, figures: Mapping[str, float]) -> list[str]:
    """Return one line for each cost: name, value with unit, and what it means."""
    width = max(map(len, figures), default=0)
    if figures and all(map(math.isnan, figures.values())):
        return ["  no costs: a run that ends at its start, or is not finite, has none"]
    return [
        f"  {name:<{width}}  {value:.6g} {cost.unit} ({cost.how}){f'  {cost.meaning}' if cost.meaning else ''}"
        for (name, value), cost in zip(figures.items(), system.costs.values(), strict=True)
    ]


def cost_data(system: System, figures: Mapping[str, float]) -> dict[str, Any]:
    """Return the costs with unit, kind and meaning, for JSON."""
    return {
        name: {"value": figures[name], "unit": cost.unit, "how": cost.how, "meaning": cost.meaning}
        for name, cost in system.costs.items()
    }


def _write(own: OwnSystem, record: Record, out: Path, kind: str) -> list[Path]:
    from surctl.files import file_name
    from surctl.system import save_record

    name = file_name(f"{own.system.plant.name}-{own.system.controller.name}")
    origin = own.origin | {"values": json.dumps({n: v.tolist() for n, v in assigned(own.settings).items()})}
    files = list[Path]()
    with saving("record"):
        files.append(save_record(record, out / f"{name}.{kind}", about=origin))
    with saving("plot"):
        from surctl.report.system_plots import save_record_plot

        files.insert(0, save_record_plot(record, out, name=name))
    return files


def _sweep(own: OwnSystem, seconds: float) -> str:
    """Return the command that sweeps the first gain about its nominal value; "" if no gain can be swept."""
    swept = [port for port in own.system.controller.gains if port.size == 1 and port.default > 0]
    if not swept or not own.system.costs:
        return ""
    axis = f"{swept[0].name}={swept[0].default / 2:.4g}..{swept[0].default * 2:.4g}:9"
    return command_line("sweep", own, axis, "--seconds", f"{seconds:g}", "--out", "sweep")
