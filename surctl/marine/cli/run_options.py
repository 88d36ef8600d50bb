"""`surctl simulate`, options around the law: --animate, --film, --plant, --controller, --link-…; their conflicts."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surctl.cli.options import FILE, changed, option
from surctl.cli.output import doing, progress, saving
from surctl.errors import InputError, mistakes_in
from surctl.marine.cli import lib


def check_animate(path: Path | None, *, runs: int, campaign: bool, film: Path | None = None) -> None:
    """Create the folder of the animation; raise InputError before any simulation if the runs cannot be animated.

    `film` is the file of `--film`, which must be another one.
    """
    if path is None:
        return
    if campaign:
        remedy = "simulate one run of DIR/worst: --from FILE --animate"
        raise InputError("shows one run, not a campaign", key="--animate", value=str(path), remedy=remedy)
    if runs != 1:
        raise InputError(
            f"shows one run, not {runs}", key="--animate", value=str(path), remedy="name one scenario, drop --runs"
        )
    if film is not None and film.resolve() == path.resolve():
        raise InputError("is also the file of --film", key="--animate", value=str(path), remedy="name two files")
    lib.prepare_folder(lib.check_animation(path).parent, key="--animate", value=path)


@dataclass(frozen=True, eq=False, repr=False)
class PlantOptions:
    """The options for the physics on the command line, and the number of processes."""

    plant: str = option("--plant", "Physics: own (surctl's, default), mujoco[:KEY=VALUE,..].", "own", metavar="NAME")
    film: Path | None = option("--film", "Film of a run with --plant mujoco: FILE.gif or FILE.mp4.", type=FILE)
    view: bool = option("--view", "Show a run with --plant mujoco in a window.", False)
    threads: int | None = None

    def check(self, *, campaign: bool, runs: int, controller: str | None, sensing: str) -> lib.EngineOptions | None:
        """Return the options of MuJoCo, None for surctl's own physics.

        Raises:
            InputError: an option is wrong, or does not go with another one.
            ToolMissing: MuJoCo is not installed, or no program writes the film.
        """
        chosen = lib.parse_plant(self.plant)
        requested = [name for name in changed(self) if name != "--plant"]
        for key in requested if chosen is None else ():
            remedy = "add --plant mujoco; --animate shows all"
            raise InputError("applies only to runs in MuJoCo", key=key, remedy=remedy)
        if chosen is None:
            return None
        if campaign:
            problem = "does not simulate a campaign, whose compiled loop has surctl's own plant"
            remedy = "drop --monte-carlo and --random-worlds, and give --runs N with --threads N"
            raise InputError(problem, key="--plant", value=self.plant, remedy=remedy)
        if controller is not None and controller != "c" and self.threads not in (None, 1):
            remedy = "drop --threads, or give --controller c"
            raise InputError("has one connection", key="--controller", value=controller, remedy=remedy)
        for key in requested if runs != 1 else ():
            remedy = "name one scenario, drop --runs"
            raise InputError(f"shows one run, not {runs}", key=key, remedy=remedy)
        if self.view and self.threads not in (None, 1):
            raise InputError("opens one window", key="--view", remedy="drop --threads")
        unheard = chosen.unheard if sensing == "truth" else ()
        for key in unheard[:1]:
            remedy = "add --sensing sonar, or drop it"
            raise InputError("has no effect with true positions", key=f"--plant mujoco:{key}", remedy=remedy)
        lib.mujoco_library()
        if self.film is not None:
            lib.check_pictures()
            lib.prepare_folder(lib.check_animation(self.film, key="--film").parent, key="--film", value=self.film)
        if self.view:
            lib.check_screen()
        return chosen

    def fit(self, options: lib.EngineOptions | None, vehicles: Iterable[lib.Vehicle]) -> None:
        """Raise InputError if the options do not fit one of the vehicles."""
        for vehicle in vehicles if options is not None else ():
            with mistakes_in(None, "--plant mujoco:"):
                assert options is not None
                options.of(vehicle)

    def runs(
        self,
        options: lib.EngineOptions | None,
        case: lib.Case,
        law: lib.Law,
        seeds: Iterable[int],
        *,
        fallback: str,
        faults: tuple[lib.ThrusterFault, ...],
        linked: Callable[..., lib.LinkedLaw | lib.CompiledLaw | None],
        compiled: type[lib.CompiledLaw] | None,
    ) -> Iterator[tuple[lib.Run, Any]]:
        """Yield each run with the report of what computed its control steps in place of the law, or None."""
        physics: Any = lib.OwnPhysics
        if options is not None:
            physics = lib.mujoco_physics(options)
            if self.threads not in (None, 1):
                batch_case = lib.BatchCase(case, physics, fallback, faults, compiled)
                yield from lib.simulate_with_steppers(batch_case, list(seeds), processes=self.threads or 1)
                return
            if self.view:
                physics = lib.watched(physics)

        def watch(time: float) -> None:
            doing(f"{case.scenario.name}: {f'{time:.1f} s simulated' if time else 'building the law'}")

        about: dict[str, Any] = {"law": law, "thruster_faults": faults, "physics": physics, "watch": watch}
        for seed in seeds:
            stepper = linked(seed=seed)
            run = lib.simulate_case(case, seed=seed, stepper=stepper, **about)
            yield run, None if stepper is None else stepper.report()

    def output(self, run: lib.Run, options: lib.EngineOptions | None, result: dict[str, Any]) -> list[str]:
        """Return lines about the physics of a run, and write its film; add both to `result`."""
        if options is None:
            return []
        touched = ", ".join(f"{contact.what} at {contact.time:.2f} s" for contact in run.contacts) or "none"
        tilt = ""
        if run.record.tilt is not None:
            tilt = f"; largest roll {result['max_roll_deg']:.1f} deg, pitch {result['max_pitch_deg']:.1f} deg"
        lines = [f"  {run.plant}: contacts {touched}{tilt}"]
        result["plant_options"] = options.of(run.vehicle).model_dump(mode="json")
        if self.film is not None:
            with saving("film"):
                result["film"] = str(lib.save_film(run, self.film, options=options))
                lines.append(f"  {result['film']}")
        return lines


@dataclass(frozen=True, repr=False)
class ControllerOptions:
    """The options for the controller process and its connection; an option that is not given has the value None."""

    controller: str | None = option(
        "--controller", "C controller: c (local), tcp://HOST:PORT, qemu:cortex-m4f.", metavar="URL"
    )
    link_loss: float | None = option(
        "--link-loss", "Share of lost messages to and from the C code (default 0).", type=float, metavar="P"
    )
    link_delay: float | None = option(
        "--link-delay", "Time from request to reply of C code [s] (default 0).", type=float, metavar="S"
    )
    link_deadline: float | None = option(
        "--link-deadline", "Thrust 0 if a command is older than S s (default 0.25).", type=float, metavar="S"
    )
    link_compact: bool = option("--link-compact", "Request short replies from the C code, for a slow link.", False)
    link_timeout: float | None = option(
        "--link-timeout", "Stop after S s without a reply from C code (default 5).", type=float, metavar="S"
    )

    def check(self, *, campaign: bool) -> None:
        """Raise InputError for options that exclude each other, or that require another option that is not given."""
        alone = [name for name in changed(self) if name != "--controller"]
        if self.controller in (None, "c"):
            if alone:
                raise InputError(
                    "needs a controller over a link", key=alone[0], remedy="add --controller tcp://127.0.0.1:PORT"
                )
            if self.controller is None or not campaign:
                return
        if campaign:
            remedy = "drop --monte-carlo, --random-worlds and --from"
            raise InputError("applies only to single runs", key="--controller", remedy=remedy)
        if self.link_timeout is not None and not 0.0 < self.link_timeout <= 3600.0:
            raise InputError(
                "is not a valid time", key="link-timeout", value=self.link_timeout, remedy="give seconds, above 0"
            )
        if self.controller is None or not self.controller.startswith(("tcp://", "qemu:")):
            problem = "is not the address of a controller"
            remedy = "use c, tcp://HOST:PORT or qemu:cortex-m4f"
            raise InputError(problem, key="controller", value=self.controller, remedy=remedy)
        self._faults(seed=0)

    @property
    def compiled(self) -> type[lib.CompiledLaw] | None:
        """What computes each step by the law's C in this process, if it is requested."""
        if self.controller != "c":
            return None
        return lib.CompiledLaw

    @contextmanager
    def opened(self, case: lib.Case, law: lib.Law) -> Iterator[Callable[..., lib.LinkedLaw | lib.CompiledLaw | None]]:
        """Return the function that computes each step of a run with a `seed` as C, here or over a connection.

        The function returns None if no option requests one.

        Raises:
            InputError: no controller listens at the address, the processor is unknown, or (in a run) the connected
                controller is not the controller of this run.
        """
        compiled = self.compiled
        if self.controller is None or compiled is not None:
            yield lambda seed: None if compiled is None else compiled(law)
            return
        mission, local = case.scenario, self.controller.startswith("qemu:")
        if mission.path.fed and local:
            problem = "cannot receive a path of more than 8 points, or speeds or depths for its legs"
            remedy = "give at most 8 points, or use tcp://HOST:PORT, whose controller has the mission in its bundle"
            raise InputError(problem, key="--controller", value=self.controller, remedy=remedy)
        p = lib.law_numbers(mission, case.gains, case.vehicle)
        within = lib.operating_envelope(law, mission, case.vehicle, law.gains, tuned=p)
        patience = {} if self.link_timeout is None else {"patience": self.link_timeout}
        with ExitStack() as stack:
            if local:
                target = lib.emulated_target(self.controller.removeprefix("qemu:"))
                shipped, numbers = lib.closed_form(law, real="float32"), law.gains.unpack(p)
                bundle = lib.build_bundle(shipped, numbers, real="float32", envelope=within)
                progress(f"compiling for {target.name}")
                scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="surctl-pil-"))
                line: lib.SerialLine = stack.enter_context(lib.emulated(bundle, target, Path(scratch)))
                line.patience = patience.get("patience", line.patience)
            else:
                line = stack.enter_context(lib.connect(self.controller, **patience))
            about: dict[str, Any] = {"compact": self.link_compact, "fed": mission.path.fed}
            yield lambda seed: lib.LinkedLaw(law, p, line, self._faults(seed=seed), within, **about)

    def _faults(self, *, seed: int) -> lib.LinkFaults:
        stated = {"loss": self.link_loss, "delay": self.link_delay, "deadline": self.link_deadline}
        known = {name: value for name, value in stated.items() if value is not None}
        return lib.LinkFaults(**known, seed=seed)
