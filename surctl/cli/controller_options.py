"""Options of `surctl simulate` for a controller that runs in its own process or on an emulated processor."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from surctl.cli.activity import progress
from surctl.cli.output import together

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from surctl.export import SerialLine
    from surctl.marine.control import Law
    from surctl.marine.export import CompiledLaw, LinkedLaw, LinkFaults
    from surctl.marine.simulation import Scenario
    from surctl.marine.vehicle import Vehicle

__all__ = ["ControllerOptions", "controller_options"]

controller_options = together(
    click.option(
        "--controller",
        metavar="URL",
        help="Law as C: c, tcp://HOST:PORT or qemu:cortex-m4f.",
    ),
    click.option("--link-loss", type=float, metavar="P", help="Probability that a message is lost (default 0)."),
    click.option("--link-delay", type=float, metavar="S", help="Delay of each command [s] (default 0)."),
    click.option("--link-deadline", type=float, metavar="S", help="Largest age of a used command [s] (default 0.25)."),
    click.option("--link-compact", is_flag=True, help="Request short replies, for a slow line."),
    click.option(
        "--link-timeout", type=float, metavar="S", help="Stop if the link is silent for S seconds (default 5)."
    ),
)


@dataclass(frozen=True)
class ControllerOptions:
    """The options for the controller process and its connection; an option that is not given has the value None."""

    controller: str | None
    loss: float | None
    delay: float | None
    deadline: float | None
    timeout: float | None
    compact: bool = False

    def check(self, *, campaign: bool) -> None:
        """Raise InputError for options that exclude each other, or that require another option that is not given."""
        from surctl.errors import InputError

        options = {"loss": self.loss, "delay": self.delay, "deadline": self.deadline, "timeout": self.timeout}
        alone = [f"--link-{name}" for name, value in options.items() if value is not None]
        alone += ["--link-compact"] * self.compact
        if self.controller in (None, "c"):
            if alone:
                raise InputError(
                    "needs a controller over a link", key=alone[0], remedy="add --controller tcp://127.0.0.1:PORT"
                )
            if self.controller is None or not campaign:
                return
        if campaign:
            raise InputError(
                "applies only to single runs",
                key="--controller",
                remedy="drop --monte-carlo, --random-worlds and --from",
            )
        if self.timeout is not None and not 0.0 < self.timeout <= 3600.0:
            raise InputError(
                "is not a valid time", key="link-timeout", value=self.timeout, remedy="give seconds, above 0"
            )
        if self.controller is None or not self.controller.startswith(("tcp://", "qemu:")):
            raise InputError(
                "is not the address of a controller",
                key="controller",
                value=self.controller,
                remedy="use c, tcp://HOST:PORT or qemu:cortex-m4f",
            )
        self._faults(seed=0)

    @contextmanager
    def opened(
        self, law: Law, p: NDArray[np.float64], mission: Scenario, vehicle: Vehicle
    ) -> Iterator[SerialLine | None]:
        """Open the connection to the controller of this law and these parameters; None if no option requests one.

        Raises:
            InputError: no controller listens at the address, or the processor is unknown.
        """
        if self.controller in (None, "c"):
            yield None
            return
        from surctl.errors import InputError
        from surctl.export import connect, emulated, emulated_target
        from surctl.marine.export import build_bundle, closed_form, operating_envelope

        assert self.controller is not None
        if mission.path.fed and not self.controller.startswith("tcp://"):
            raise InputError(
                "cannot receive a path of more than 8 points, or speeds or depths for its legs",
                key="--controller",
                value=self.controller,
                remedy="give at most 8 points, or use tcp://HOST:PORT, whose controller has the mission in its bundle",
            )
        if self.controller.startswith("tcp://"):
            with connect(self.controller, **({} if self.timeout is None else {"patience": self.timeout})) as line:
                yield line
            return
        target = emulated_target(self.controller.removeprefix("qemu:"))
        shipped = closed_form(law, real="float32")
        within = operating_envelope(law, mission, vehicle, law.gains, tuned=p)
        bundle = build_bundle(shipped, law.gains.unpack(p), real="float32", envelope=within)
        progress(f"compiling for {target.name}")
        with (
            tempfile.TemporaryDirectory(prefix="surctl-pil-") as scratch,
            emulated(bundle, target, Path(scratch)) as line,
        ):
            line.patience = line.patience if self.timeout is None else self.timeout
            yield line

    @property
    def compiled(self) -> type[CompiledLaw] | None:
        """What computes each step by the law's C in this process, if it is requested."""
        if self.controller != "c":
            return None
        from surctl.marine.export import CompiledLaw

        return CompiledLaw

    def linked(
        self,
        law: Law,
        p: NDArray[np.float64],
        line: SerialLine | None,
        mission: Scenario,
        vehicle: Vehicle,
        *,
        seed: int,
    ) -> LinkedLaw | CompiledLaw | None:
        """Return the function that computes each step of a run as C, over the open connection or here; else None.

        Raises:
            InputError: the connected controller is not the controller of this run.
        """
        if self.compiled is not None:
            return self.compiled(law)
        if line is None:
            return None
        from surctl.marine.export import LinkedLaw, operating_envelope

        within = operating_envelope(law, mission, vehicle, law.gains, tuned=p)
        return LinkedLaw(law, p, line, self._faults(seed=seed), within, compact=self.compact, fed=mission.path.fed)

    def _faults(self, *, seed: int) -> LinkFaults:
        from surctl.marine.export import LinkFaults

        usual = LinkFaults()
        options = (self.loss, self.delay, self.deadline)
        loss, delay, deadline = (
            value if value is not None else other
            for value, other in zip(options, (usual.loss, usual.delay, usual.deadline), strict=True)
        )
        return LinkFaults(loss, delay, deadline, seed)
