"""Options of `surctl simulate` for another physics: the plant, a film of the scene, and a window that shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.activity import doing
from surctl.cli.animate_option import NamedFile
from surctl.cli.output import saving, together

if TYPE_CHECKING:
    from surctl.marine.control import Law
    from surctl.marine.engine import EngineOptions
    from surctl.marine.export import CompiledLaw, LinkedLaw
    from surctl.marine.simulation import Case, Run, ThrusterFault
    from surctl.marine.vehicle import Vehicle

__all__ = ["PlantOptions", "plant_options"]

plant_options = together(
    click.option("--plant", default="own", metavar="NAME", help="Plant: own (default) or mujoco[:KEY=VALUE,..]."),
    click.option(
        "--film", type=NamedFile(path_type=Path), metavar="FILE", help="Film of --plant mujoco: FILE.gif or FILE.mp4."
    ),
    click.option("--view", is_flag=True, help="Show the run in MuJoCo's window."),
)
"""A decorator that adds these options to a command, which receives them as `plant`, `film` and `view`."""


@dataclass(frozen=True)
class PlantOptions:
    """The options for the physics on the command line.

    Attributes:
        plant: name of the physics with its options.
        film: file of the film, or None.
        view: whether MuJoCo's window shows the run.
        threads: number of processes, or None.
    """

    plant: str
    film: Path | None
    view: bool
    threads: int | None

    @property
    def own(self) -> bool:
        """Whether the physics is surctl's own."""
        return self.plant == "own"

    def check(self, *, campaign: bool, runs: int, controller: str | None, sensing: str) -> EngineOptions | None:
        """Return the options of MuJoCo, None for surctl's own physics.

        Raises:
            InputError: an option is wrong, or does not go with another one.
            ToolMissing: MuJoCo is not installed, or no program writes the film.
        """
        from surctl.errors import InputError
        from surctl.marine.engine import parse_plant

        chosen = parse_plant(self.plant)
        requested = [("--film", self.film), ("--view", self.view or None)]
        for key, value in requested if chosen is None else ():
            if value is not None:
                raise InputError(
                    "applies only to runs in MuJoCo", key=key, remedy="add --plant mujoco; --animate shows all"
                )
        if chosen is None:
            return None
        if campaign:
            raise InputError(
                "does not simulate a campaign, whose compiled loop has surctl's own plant",
                key="--plant",
                value=self.plant,
                remedy="drop --monte-carlo and --random-worlds, and give --runs N with --threads N",
            )
        if controller is not None and controller != "c" and self.threads not in (None, 1):
            remedy = "drop --threads, or give --controller c"
            raise InputError("has one connection", key="--controller", value=controller, remedy=remedy)
        for key, value in requested:
            if value is not None and runs != 1:
                remedy = "name one scenario, drop --runs"
                raise InputError(f"shows one run, not {runs}", key=key, remedy=remedy)
        if self.view and self.threads not in (None, 1):
            raise InputError("opens one window", key="--view", remedy="drop --threads")
        unheard = chosen.unheard if sensing == "truth" else ()
        for key in unheard[:1]:
            remedy = "add --sensing sonar, or drop it"
            raise InputError("has no effect with true positions", key=f"--plant mujoco:{key}", remedy=remedy)
        from surctl.marine.engine.mjcf import mujoco_library

        mujoco_library()
        if self.film is not None:
            from surctl.files import prepare_folder
            from surctl.marine.engine.pictures import check_pictures
            from surctl.marine.report import check_film

            check_pictures()
            prepare_folder(check_film(self.film).parent, key="--film")
        if self.view:
            from surctl.marine.engine.pictures import check_screen

            check_screen()
        return chosen

    def fit(self, options: EngineOptions | None, vehicles: Iterable[Vehicle]) -> None:
        """Raise InputError if the options do not fit one of the vehicles."""
        from surctl.errors import InputError

        for vehicle in vehicles if options is not None else ():
            try:
                assert options is not None
                options.of(vehicle)
            except InputError as error:
                raise error.inside(None, f"--plant mujoco:{error.key}") from None

    def runs(
        self,
        options: EngineOptions | None,
        case: Case,
        law: Law,
        seeds: Iterable[int],
        *,
        fallback: str,
        faults: tuple[ThrusterFault, ...],
        linked: Callable[..., LinkedLaw | CompiledLaw | None],
        compiled: type[CompiledLaw] | None,
    ) -> Iterator[tuple[Run, Any]]:
        """Yield each run with the report of what computed its control steps in place of the law, or None."""
        from surctl.marine.simulation import OwnPhysics, simulate

        physics: Any = OwnPhysics
        if options is not None:
            from surctl.marine.engine import BatchCase, mujoco_physics
            from surctl.marine.engine.physics import simulate_with_steppers

            physics = mujoco_physics(options)
            if self.threads not in (None, 1):
                batch_case = BatchCase(case, physics, fallback, faults, compiled)
                yield from simulate_with_steppers(batch_case, list(seeds), processes=self.threads or 1)
                return
            if self.view:
                from surctl.marine.engine.pictures import watched

                physics = watched(physics)

        def watch(time: float) -> None:
            doing(f"{case.scenario.name}: {f'{time:.1f} s simulated' if time else 'building the law'}")

        for seed in seeds:
            stepper = linked(seed=seed)
            run = simulate(
                case.scenario,
                case.vehicle,
                gains=case.gains,
                law=law,
                sensing=case.sensing,
                seed=seed,
                stepper=stepper,
                thruster_faults=faults,
                physics=physics,
                watch=watch,
            )
            yield run, None if stepper is None else stepper.report()

    def output(self, run: Run, options: EngineOptions | None, result: dict[str, Any]) -> list[str]:
        """Return lines about the physics of a run, and write its film; add both to `result`."""
        if options is None:
            return []
        touched = ", ".join(f"{contact.what} at {contact.time:.2f} s" for contact in run.contacts) or "none"
        tilt = ""
        if run.record.tilt is not None:
            tilt = f"; largest roll {result['max_roll_deg']:.1f} deg, pitch {result['max_pitch_deg']:.1f} deg"
        lines = [f"  {run.plant}: contacts {touched}{tilt}"]
        result["plant_options"] = options.of(run.vehicle).to_dict()
        if self.film is not None:
            with saving("film"):
                from surctl.marine.report import save_film

                result["film"] = str(save_film(run, self.film, options=options))
                lines.append(f"  {result['film']}")
        return lines
