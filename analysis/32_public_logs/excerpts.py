"""Cut the excerpts that the study fits from clones of the repositories in `sources.toml`.

    python analysis/32_public_logs/excerpts.py CLONES [--out DIR]

CLONES is a folder with one clone per repository, each in a folder with the name of the repository, at the commit that
`sources.toml` states. An excerpt is at most 200 kB. Its rows are rows of the original: nothing is filtered or smoothed.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat

FOLDER = Path(__file__).parent
SOURCES = tomllib.loads((FOLDER / "sources.toml").read_text())
EXCERPTS = {
    "fish": ["fish-1.csv", "fish-2.csv"],
    "ship": ["ship-35-05.dat", "ship-20-10-s.dat", "ship-20-10-p.dat"],
    "glider": ["glider.csv"],
}
"""Excerpts by robot, in the order in which they are fitted."""

Array = NDArray[np.float64]


def fish(files: list[Path], out: Path) -> None:
    """Write every 20th row (10 Hz) of 36 of the 72 trials: every fourth trial in one file, those between in the other.

    The trials follow each other without a time in the original. Here each begins 5 s after the end of the one before.
    """
    held = loadmat(files[0], squeeze_me=True)
    names = ["x_int_list", "y_int_list", "psi_int_list", "v1_int_list", "v2_int_list", "omega_int_list"]
    table = np.column_stack([held[k].astype(float) for k in [*names, "u1_list", "u2_list"]])
    ends = held["Lengths"].astype(int)
    trials = [table[a:b:20] for a, b in zip([0, *ends[:-1]], ends, strict=True)]
    header = "t,x,y,psi,v1,v2,omega,u1,u2"
    for name, some in zip(EXCERPTS["fish"], (trials[::4], trials[2::4]), strict=True):
        rows, begin = [], 0.0
        for trial in some:
            time = begin + 0.1 * np.arange(len(trial))
            rows.append(np.column_stack([time, trial]))
            begin = float(time[-1]) + 5.0
        np.savetxt(out / name, np.vstack(rows), fmt="%.5g", delimiter=",", header=header, comments="")


def ship(files: list[Path], out: Path) -> None:
    """Write the four lines of title and every tenth row (2 Hz) of three zigzag runs, byte by byte."""
    for name, file in zip(EXCERPTS["ship"], files, strict=True):
        lines = file.read_bytes().split(b"\n")
        (out / name).write_bytes(b"\n".join([*lines[:4], *lines[4::10]]) + b"\n")


def glider(files: list[Path], out: Path) -> None:
    """Write time, depth, buoyancy engine and density of five dives below 1 m (1 Hz); depth is pressure."""
    time, pressure, _, buoyancy, density, _ = np.load(files[0])
    table = np.column_stack([time - time[0], 1e5 * pressure / (density * 9.81), buoyancy, density - 1005.0])
    table = table[(table[:, 0] > 1160.0) & (table[:, 0] < 3720.0) & (table[:, 1] > 1.0)]
    header = "t_s,depth_m,buoyancy_cm3,density_above_1005_kg_per_m3"
    form = ["%.2f", "%.3f", "%.2f", "%.3f"]
    np.savetxt(out / EXCERPTS["glider"][0], table, fmt=form, delimiter=",", header=header, comments="")


def main() -> int:
    """Cut the excerpts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clones", type=Path)
    parser.add_argument("--out", type=Path, default=FOLDER / "data")
    given = parser.parse_args()
    given.out.mkdir(exist_ok=True)
    for cut in (fish, ship, glider):
        source = SOURCES[cut.__name__]
        clone = given.clones / source["repository"].rpartition("/")[2]
        cut([clone / name for name in source["files"]], given.out)
        for name in EXCERPTS[cut.__name__]:
            print(f"{name}: {(given.out / name).stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
