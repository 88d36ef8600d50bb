"""Recordings of a simulated robot, as a user's file would hold them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from surctl.marine.sensing import SonarArray
from surctl.marine.world import Wall
from surctl.noise import NoiseStream
from tests.oracles.echoes import fire, true_range

# narrow beams: the ones ahead and astern would else hear the same side wall, as in crosstalk
ARRAY = SonarArray(beam_angle=0.25)
SPEED = 0.15
WALLS = [
    Wall(point=(9.0, 0.0), normal=(-1.0, 0.0)),
    Wall(point=(0.0, 0.0), normal=(1.0, 0.0)),
    Wall(point=(0.0, 2.4), normal=(0.0, -1.0)),
    Wall(point=(0.0, -1.5), normal=(0.0, 1.0)),
]
HEADER = "time_s,sensor,sample_1_m,sample_2_m,sample_3_m,sample_4_m,sample_5_m,closing_m_per_s,turn_rad_per_s"


def place(time: float) -> tuple[float, float]:
    return (5.0 + SPEED * time, 0.0)


def truth(sensor: int, time: float) -> float:
    return min(ARRAY.maximum, true_range(ARRAY, sensor, position=place(time), heading=0.0, shapes=WALLS))


def recorded(seconds: float, *, seed: int = 0, jitter: float = 0.003, start: float = 100.0) -> list[str]:
    """Rows of a straight run along the tank; the header is `HEADER`."""
    noise, draws = NoiseStream(seed), np.random.default_rng(seed)
    rows = []
    for tick in range(round(seconds / ARRAY.firing_period)):
        time, sensor = tick * ARRAY.firing_period, ARRAY.sensor_at(tick)
        samples = fire(
            ARRAY, sensor, position=place(time), heading=0.0, shapes=WALLS, noise=noise.normals(ARRAY.samples)
        )
        closing = SPEED * math.cos(ARRAY.azimuths[sensor])
        stamp = start + time + float(draws.uniform(-jitter, jitter))
        rows.append(f"{stamp:.6f},{sensor}," + ",".join(f"{s:.5f}" for s in samples) + f",{closing:.6f},0")
    return rows


def write(folder: Path, rows: list[str], *, header: str = HEADER, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_text("\n".join([header, *rows]) + "\n")
    return path
