"""The export command that other commands suggest, with vehicle, gains, law, sensing, and a scenario that fits."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from surctl.cli.law_option import law_words

if TYPE_CHECKING:
    from surctl.marine.control import Gains
    from surctl.marine.simulation import Scenario
    from surctl.marine.vehicle import Vehicle

__all__ = ["MISSION", "export_command", "fitting_scenario"]

MISSION = "pool-static"
"""The default scenario of an export."""

_TRIED = (MISSION, "tank-static")


def fitting_scenario(vehicle: Vehicle, scenario: str | None = None) -> str | None:
    """Return the first of the tried scenarios for which `findings` reports no error with this hull, or None.

    If `scenario` is given, only this scenario is tried; otherwise first the default scenario of `surctl export`, then
    `tank-static`.
    """
    from surctl.marine.simulation import load_scenario

    tried = _TRIED if scenario is None else (scenario,)
    return next((word for word in tried if _fits(load_scenario(word), vehicle)), None)


def export_command(
    scenario: str | None,
    vehicle: str,
    gains: str | Gains,
    certificates: Sequence[Path] = (),
    *,
    file: str | None = None,
    law: str = "guarded",
    guidance: str | None = None,
    sensing: str = "sonar",
) -> list[str]:
    """Return the words of the export command, with the certificates that apply; empty if the vehicle fits no scenario.

    Args:
        scenario: name or file of the scenario; None takes a built-in scenario that fits the hull.
        vehicle: name or file of the vehicle.
        gains: name or file of the gains, or the gains.
        certificates: certificate files; the command carries those that concern the law `guarded`.
        file: name or file of the gains in the command; None: `gains` itself.
        law: the law to export, a name or FILE.py:FUNCTION.
        guidance: path guidance; None: the default of the command.
        sensing: "sonar" or "truth".
    """
    from surctl.marine.control import build_law, load_gains
    from surctl.marine.export import fitting_certificates
    from surctl.marine.simulation import law_numbers, load_scenario
    from surctl.marine.vehicle import load_vehicle

    robot = load_vehicle(vehicle)
    chosen = fitting_scenario(robot, scenario)
    if chosen is None:
        return []
    travel: Sequence[Path] = ()
    if certificates:
        values = load_gains(gains) if isinstance(gains, str) else gains
        numbers = law_numbers(load_scenario(chosen), values, robot)
        travel = fitting_certificates(certificates, build_law(), robot, numbers)
    words = ["surctl", "export", "--scenario", chosen, "--vehicle", vehicle, "--gains", file or str(gains)]
    words += [*law_words(law), *(() if guidance is None else ("--guidance", guidance)), "--sensing", sensing]
    return [shlex.join([*words, *(word for file in travel for word in ("--certificate", str(file)))])]


def _fits(scenario: Scenario, vehicle: Vehicle) -> bool:
    from surctl.errors import InputError
    from surctl.marine.simulation import findings

    try:
        return not any(finding.level == "error" for finding in findings(scenario, vehicle))
    except InputError:  # the start lies inside an obstacle
        return False
