"""Files with the formats of the three public logs and simulated motion, for a quick run without the logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from excerpts import EXCERPTS


def write_standins(folder: Path) -> None:
    """Write one file for each excerpt."""
    time = 0.5 * np.arange(120)
    for name in EXCERPTS["ship"]:
        table = _ship(time)
        rows = "\n".join(" ".join(f"{v:18.9f}" for v in row) for row in table)
        (folder / name).write_bytes("a tank\n a ship\n Z20°/10°\n Time series\n".encode("cp1252") + rows.encode())
    for name in EXCERPTS["fish"]:
        table = _fish(0.1 * np.arange(100))
        np.savetxt(folder / name, table, delimiter=",", header="t,x,y,psi,v1,v2,omega,u1,u2", comments="")
    header = "t_s,depth_m,buoyancy_cm3,density_above_1005_kg_per_m3"
    np.savetxt(folder / EXCERPTS["glider"][0], _glider(240), delimiter=",", header=header, comments="")


def _track(time: np.ndarray, speed: complex, turn: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    # heading, velocity in the world and place of a craft that weaves
    psi = turn * np.sin(0.2 * time)
    velocity = speed * np.exp(1j * psi)
    step = float(time[1] - time[0])
    return psi, velocity, np.concatenate([[0], np.cumsum(step / 2 * (velocity[1:] + velocity[:-1]))])


def _ship(time: np.ndarray) -> np.ndarray:
    psi, velocity, place = _track(time, 1.1 - 0.1j, 0.8)
    rate, none = np.gradient(np.degrees(psi), time), np.zeros(len(time))
    columns = [time, place.real, place.imag, np.degrees(psi), velocity.real, velocity.imag, rate, np.sin(time)]
    return np.column_stack([*columns, 20 * np.sign(np.sin(0.2 * time)), 10.2 + none, 45 + none, 1 + none])


def _fish(time: np.ndarray) -> np.ndarray:
    psi, _, place = _track(time, 0.1 + 0.02j, 0.8)
    none = np.zeros(len(time))
    rate = np.gradient(psi, time)
    return np.column_stack([time, place.real, place.imag, psi, 0.1 + none, 0.02 + none, rate, 0.3 + none, 0.05 * none])


def _glider(seconds: int) -> np.ndarray:
    # a body of 140 kg between two buoyancies, integrated in steps of 10 ms
    depth, speed, rows = 5.0, 0.0, []
    for second in range(seconds):
        volume = -230.0 if second // 40 % 2 == 0 else 230.0
        rows.append([float(second), round(depth, 2), volume, 0.0])
        for _ in range(100):
            speed += 0.01 * (-0.009859 * volume - 80.0 * speed * abs(speed)) / 140.0
            depth += 0.01 * speed
    return np.array(rows)
