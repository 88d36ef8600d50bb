"""What a study ships: the law with its senses as C, compiled while the study goes on, and replayed over its flights."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from surctl.control import Gains, Law, build_law
from surctl.export import (
    Bundle,
    Controller,
    ExportedFile,
    Records,
    SilReport,
    build_bundle,
    build_controller,
    compare_runs,
    origin_of,
    write_bundle,
)
from surctl.simulation import Run, law_numbers
from surctl.study.plan import Leg, Plan

__all__ = ["Shipment", "shipping", "with_perception"]


def with_perception(plan: Plan, leg: Leg) -> Law:
    """The plan's law in closed form, with the senses that the leg's scenario has on the leg's hull.

    Raises:
        InputError: sonars that the law cannot listen to.
    """
    mission = leg.scenario
    equipment = mission.sensors.on(leg.vehicle["radius"])
    return build_law(
        plan.law, sonar=True, equipment=equipment, guidance=plan.guidance, depths=mission.depths is not None
    )


@dataclass(frozen=True, eq=False)
class Shipment:
    """An exported law.

    Attributes:
        law: the law.
        bundle: its C, with the gains and the mission of one leg.
        files: as written.
        compiling: the compiled bundle, sooner or later.
    """

    law: Law
    bundle: Bundle
    files: tuple[ExportedFile, ...]
    compiling: Future[Controller]

    def carries(self, run: Run) -> bool:
        """Whether the run was flown by this law, whatever its gains and its mission."""
        return run.law is self.law or run.law.block.digest() == self.law.block.digest()

    def replayed(self, runs: Sequence[Run]) -> tuple[SilReport, ...]:
        """One report a run of this law; waits for the compiler.

        Raises:
            SurctlError: the compiler refuses the bundle, or the program crashes.
        """
        records = [Records(r.law_state, r.law_input, r.law_parameters) for r in (run.record for run in runs)]
        return compare_runs(self.compiling.result(), records)


@contextmanager
def shipping(law: Law, gains: Gains, leg: Leg, out: Path) -> Iterator[Shipment]:
    """Write the law's C to `out`, and have it compiled beside what is done in the meantime.

    Args:
        law: the law.
        gains: complete gain set.
        leg: whose mission and vehicle are the exported defaults.
        out: folder of the bundle.

    Raises:
        InputError: the folder cannot be written.
    """
    numbers = law_numbers(leg.scenario, gains, leg.vehicle)
    bundle = build_bundle(law, law.gains.unpack(numbers), origin=origin_of(law, leg.vehicle))
    files = tuple(write_bundle(bundle, out))
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch, ThreadPoolExecutor(1) as beside:
        yield Shipment(law, bundle, files, beside.submit(build_controller, law, bundle, Path(scratch, bundle.name)))
