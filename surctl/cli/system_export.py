"""`surctl export FILE.py:FUNCTION`: the controller of a system of the user's own as C, checked over a run."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Sequence
from pathlib import Path

from surctl.cli.output import finish, progress
from surctl.cli.system_option import assigned, load_system
from surctl.cli.system_simulate import cost_data, cost_lines, end_text

__all__ = ["export_system"]


def export_system(words: Sequence[str], *, seconds: float | None, name: str | None, out: Path, as_json: bool) -> None:
    """Write the controller as C, compare C and Python over a run; exit with status 1 if a number differs."""
    from surctl.export import build_bundle, build_controller, compare_runs, write_bundle
    from surctl.ir import find_compiler
    from surctl.system import LOST, run_system

    own = load_system(words)
    duration, values = own.seconds(seconds), assigned(own.settings)
    find_compiler()
    controller = own.system.controller
    record = run_system(own.system, duration, values)
    bundle = build_bundle(controller, controller.gains.unpack(record.controller[2]), name=name)
    files = write_bundle(bundle, out)
    progress("compiling and replaying")
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch:
        compiled = build_controller(controller, bundle, Path(scratch, bundle.name))
        (sil,) = compare_runs(compiled, [record])
    largest = max(part.absolute for part in (sil.tau, sil.state, sil.telemetry))
    passed = sil.conclusive and largest == 0.0 and record.stopped != LOST
    lines = [*(f"{file.sha256[:12]}  {file.path}" for file in files), "", f"replayed: {end_text(own, record)}"]
    lines += [*cost_lines(own.system, record.figures), sil.summary()]
    data = {
        **own.names,
        "name": bundle.name,
        "id": bundle.id,
        "commands": {port.name: port.unit for port in own.system.commands},
        "files": [str(file.path) for file in files],
        "sha256": {file.path.relative_to(out).as_posix(): file.sha256 for file in files},
        "stopped": record.stopped,
        "duration_s": record.duration,
        "costs": cost_data(own.system, record.figures),
        "largest_difference": largest,
        "sil": sil.to_dict(),
    }
    finish(data, lines, as_json=as_json, passed=passed, then=[f"make -C {shlex.quote(str(out))} check"])
