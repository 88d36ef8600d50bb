"""The sonar beams of a run at one control period, as numbers and as matplotlib patches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.patches import Wedge

from surctl.marine.simulation import Run

__all__ = ["INSTANT", "Beam", "beam_patch", "beams_at"]

INSTANT = "#6D28D9"
"""Colour that marks the instant at which sonar beams are shown."""


@dataclass(frozen=True)
class Beam:
    """The beam of one sonar in the world frame {E}, drawn as a cone whose length is the filtered range.

    Attributes:
        apex: position of the sonar (x, y) [m].
        axis: direction of the cone's axis [rad].
        half_angle: half of the cone's opening angle [rad].
        length: filtered range [m].
        echo: whether the sonar received an echo; False if it reads its maximum range.
    """

    apex: tuple[float, float]
    axis: float
    half_angle: float
    length: float
    echo: bool


def beams_at(run: Run, step: int) -> tuple[Beam, ...]:
    """Return the beams of all sonars at a control period; empty if the law uses true positions instead of sonar."""
    if run.sensing != "sonar":
        return ()
    array = run.scenario.sensors.array_on(run.vehicle["radius"])
    x, y, _, heading = run.record.eta[step]
    beams = []
    for sensor, length in enumerate(run.record.telemetry[step, run.law.telemetry_slice("ranges")].tolist()):
        at_x, at_y, axis = array.apex(sensor, position=(x, y), heading=heading)
        echo = length < array.maximum - array.resolution
        beams.append(Beam((float(at_x), float(at_y)), float(axis), array.half_angle, length, echo))
    return tuple(beams)


def beam_patch(beam: Beam) -> Wedge:
    """Return the beam as a matplotlib patch in the world frame {E} [m], filled if there is an echo, else dashed."""
    middle, half = np.rad2deg(beam.axis), np.rad2deg(beam.half_angle)
    return Wedge(
        beam.apex,
        beam.length,
        middle - half,
        middle + half,
        facecolor=INSTANT if beam.echo else "none",
        edgecolor=INSTANT,
        linestyle="-" if beam.echo else "--",
        alpha=0.22 if beam.echo else 0.45,
        linewidth=0.9,
        zorder=1.8,
    )
