"""The missions of a study of a vehicle that fits none of the built-in scenarios: they are scaled to the vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from surctl.files import file_name, write_file
from surctl.marine.control import Gains, default_law, law_source
from surctl.marine.simulation import (
    Scenario,
    disturbed,
    load_scenario,
    mission_size,
    scaled_scenario,
    straight_mission,
    two_leg_mission,
)
from surctl.marine.simulation.scenario_table import scenario_table
from surctl.marine.simulation.toml_text import toml_text
from surctl.marine.tuning import Derivation, default_cruise, gains_for
from surctl.marine.vehicle import Vehicle
from surctl.tuning import Axis

__all__ = ["TANK", "scaled_axes", "scaled_missions", "write_missions"]

TANK = "tank-static"
"""The built-in scenario whose obstacles are scaled to the vehicle."""

_SHARE = 0.02  # waves and drift as a share of the surge thrust, so that seeds differ and an unstable loop shows
_OWN = {"sideslip": (0.75, 1.0, 1.5), "foresight": (0.8, 1.0, 1.4)}  # factors of the sweep on gains of law `steered`
_SHARED = {"lookahead": (0.7, 1.0, 1.4), "k_v": (0.8, 1.0, 1.2)}


def scaled_missions(vehicle: Vehicle) -> tuple[tuple[Scenario, ...], Gains, Derivation | None]:
    """Return three missions scaled to a vehicle, the gains for them, and their derivation.

    The missions are a straight path, two legs with a corner of 90°, and the obstacles of `tank-static`. They have waves
    and drift of 2 % of the surge thrust. The cruise speed is 35 % of the top speed, or the largest at which derived
    gains have the required disk margin.

    Example:
        >>> from surctl.marine.study import scaled_missions
        >>> from surctl.marine.vehicle import load_vehicle
        >>> missions, gains, _ = scaled_missions(load_vehicle("girona500"))
        >>> [mission.name for mission in missions], gains.name
        (['straight-girona500', 'two-legs-girona500', 'tank-static-girona500'], 'derived')
    """
    own = law_source(default_law(vehicle)).gains
    speed = default_cruise(vehicle)
    gains, derivation = gains_for(None, vehicle, cruise=speed, own=own)
    if derivation is not None and not derivation.reached and derivation.bearable > 0:
        speed = derivation.bearable
        gains, derivation = gains_for(None, vehicle, cruise=speed, own=own)
    size = mission_size(vehicle, gains, cruise=speed)
    missions = (
        straight_mission(vehicle, cruise=speed, size=size),
        two_leg_mission(vehicle, cruise=speed, size=size),
        scaled_scenario(load_scenario(TANK), vehicle, cruise=speed, size=size),
    )
    return tuple(disturbed(mission, vehicle, share=_SHARE) for mission in missions), gains, derivation


def write_missions(missions: Sequence[Scenario], folder: Path) -> tuple[Scenario, ...]:
    """Write missions that no file contains as scenario files, and return them with the names of their files."""
    written = []
    for mission in missions:
        path = folder / f"{file_name(mission.name)}.toml"
        if not mission.source:
            folder.mkdir(parents=True, exist_ok=True)
            write_file(path, toml_text(scenario_table(mission)))
        written.append(mission if mission.source else replace(mission, source=str(path)))
    return tuple(written)


def scaled_axes(gains: Gains) -> tuple[Axis, ...]:
    """Return the axes of the sweep: factors about derived gains.

    For law `steered`, they are gains that plan turns and do not change the margins of the loop.
    """
    factors = _OWN if "sideslip" in gains.own else _SHARED
    return tuple(
        Axis(name, tuple(float(f"{factor * gains[name]:.3g}") for factor in row)) for name, row in factors.items()
    )
