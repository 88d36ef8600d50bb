"""Export of a study: the law with perception as C code, which is compiled and then replays the study's runs."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from surctl.export import (
    Bundle,
    Controller,
    ExportedFile,
    Records,
    SilReport,
    build_controller,
    compare_runs,
    write_bundle,
)
from surctl.marine.control import Gains, Law, build_law
from surctl.marine.export import build_bundle, origin_of
from surctl.marine.simulation import Run, law_numbers
from surctl.marine.study.plan import Leg, Plan

__all__ = ["Shipment", "shipping", "with_perception"]


def with_perception(plan: Plan, leg: Leg) -> Law:
    """Return the plan's law with perception, for the sensors of the mission's scenario on the hull of its vehicle.

    If the plan simulates no sonars (`Plan.unheard`), the law takes obstacle positions. The law allocates its thrust to
    the thrusters of the vehicle, if it has any.

    Raises:
        InputError: the law cannot use the sonars of the scenario.
    """
    mission, actuators = leg.scenario, leg.vehicle.actuators
    if plan.unheard:
        return build_law(plan.law, guidance=plan.guidance, actuators=actuators)
    equipment = mission.sensors.on(leg.vehicle["radius"])
    return build_law(
        plan.law,
        sonar=True,
        equipment=equipment,
        guidance=plan.guidance,
        depths=mission.depths is not None,
        actuators=actuators,
    )


@dataclass(frozen=True, eq=False)
class Shipment:
    """An exported law.

    Attributes:
        law: the exported law.
        bundle: the exported C code, with default gains and a default mission.
        files: paths of the written files.
        compiling: future (`concurrent.futures`) whose result is the compiled bundle.
    """

    law: Law
    bundle: Bundle
    files: tuple[ExportedFile, ...]
    compiling: Future[Controller]

    def carries(self, run: Run) -> bool:
        """Return whether a run used the exported law; its gains and mission may differ from those of the export."""
        return run.law is self.law or run.law.block.digest() == self.law.block.digest()

    def replayed(self, runs: Sequence[Run]) -> tuple[SilReport, ...]:
        """Replay the given runs of the exported law and return one report per run; wait for the compiler if necessary.

        Raises:
            SurctlError: the compiler rejects the bundle, or the compiled program crashes during a replay.
        """
        records = [Records(r.law_state, r.law_input, r.step_parameters) for r in (run.record for run in runs)]
        return compare_runs(self.compiling.result(), records)


@contextmanager
def shipping(law: Law, gains: Gains, leg: Leg, out: Path) -> Iterator[Shipment]:
    """Write the C code of the law to `out` and compile it in parallel with the body of the `with` statement.

    Args:
        law: the law to export.
        gains: complete gain set.
        leg: the study's mission whose scenario and vehicle become the defaults of the export.
        out: folder of the exported bundle.

    Raises:
        InputError: the folder cannot be written.
    """
    numbers = law_numbers(leg.scenario, gains, leg.vehicle)
    bundle = build_bundle(law, law.gains.unpack(numbers), origin=origin_of(law, leg.vehicle))
    files = tuple(write_bundle(bundle, out))
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch, ThreadPoolExecutor(1) as beside:
        yield Shipment(law, bundle, files, beside.submit(build_controller, law, bundle, Path(scratch, bundle.name)))
