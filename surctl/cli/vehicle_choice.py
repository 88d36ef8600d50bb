"""The vehicle that a command uses: that of `--vehicle`, else that of the scenario, else the command's default."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from surctl.marine.simulation import Scenario
    from surctl.marine.vehicle import Vehicle

__all__ = ["DEFAULT_VEHICLE", "VehicleChoice", "at_hand", "choose_vehicle"]

DEFAULT_VEHICLE = "sur540-flooded"
"""The vehicle of a command without `--vehicle` and without a scenario."""


class VehicleChoice(NamedTuple):
    """Name or file of a vehicle, and the origin of the choice: "--vehicle", "scenario NAME" or "default"."""

    word: str
    origin: str

    def line(self, name: str) -> str:
        """Return one line that names the vehicle and the origin of the choice; `name` is the name in its file."""
        return f"vehicle {name} (from {self.origin})" if self.origin != "default" else f"vehicle {name} (default)"


def choose_vehicle(
    option: str | None, scenario: tuple[str, str] | None = None, *, default: str = DEFAULT_VEHICLE
) -> VehicleChoice:
    """Return the vehicle of the option `--vehicle`, else the vehicle of the scenario, else the default vehicle.

    Args:
        option: value of the option `--vehicle`; None if it is not given.
        scenario: name of the scenario and name or file of its vehicle; None if the command has no scenario.
        default: vehicle if neither the option nor the scenario names one.

    Raises:
        InputError: the scenario names a file that does not exist.
    """
    if option is not None:
        return VehicleChoice(option, "--vehicle")
    if scenario is not None:
        if scenario[1].endswith(".toml") and not Path(scenario[1]).is_file():
            from surctl.errors import InputError

            key, remedy = f"vehicle of scenario {scenario[0]}", "correct the entry, or give --vehicle"
            raise InputError("no such file", key=key, value=scenario[1], remedy=remedy)
        return VehicleChoice(scenario[1], f"scenario {scenario[0]}")
    return VehicleChoice(default, "default")


def at_hand(scenario: Scenario, vehicle: Vehicle, gains: str) -> list[str]:
    """Return the command-line options that select the given mission, vehicle and gain file."""
    from surctl.marine.simulation import LIBRARY as SCENARIOS
    from surctl.marine.vehicle import LIBRARY as VEHICLES

    def word(source: str, library: Path) -> str:
        return Path(source).stem if Path(source).parent == library else source

    mission, robot = word(scenario.source, SCENARIOS) or scenario.name, word(vehicle.source, VEHICLES) or vehicle.name
    return ["--scenario", mission, "--vehicle", robot, "--gains", gains]
