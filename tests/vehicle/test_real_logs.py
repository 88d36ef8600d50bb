"""What real logs need: tables without a header, motion that was not measured, several runs, frames, slow clocks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.vehicle import MotionLog, Vehicle, identify, load_vehicle, predict
from surctl.marine.vehicle.identification.identify import held_out_windows, velocity_notes
from surctl.marine.vehicle.identification.model import sections_of
from surctl.marine.vehicle.logs.read import read_mapped_log
from surctl.marine.vehicle.motion_log import in_sequence

TANK = """
kind = "log-map"
[log]
frame = "ned"
columns = ["t", "x", "y", "psi", "u", "v", "rudder"]
skip_lines = 2
time = "t"
[position]
fields = ["x", "y", ""]
[attitude]
fields = ["psi"]
unit = "deg"
[velocity]
fields = ["u", ""]
frame = "body"
[thrust]
fields = ["u", "rudder"]
unit = "1"
matrix = [[0.5, 0], [0, 2], [0, 0], [0, -3]]
"""


def tank(path: Path, rows: int = 60) -> Path:
    lines = [b"A tank, 2008", "Z20°/10°".encode("cp1252")]
    lines += [f" {0.1 * k:.2f}  {0.2 * k}\t1.5 {k % 3}  1.2  0.0\t{10 - k % 20} ".encode() for k in range(rows)]
    path.write_bytes(b"\r\n".join(lines))
    return path


def test_a_table_without_header_and_what_was_not_measured(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(TANK)
    log = read_mapped_log(tank(tmp_path / "run.dat"), tmp_path / "map.toml")
    assert log.motion[3, :2] == pytest.approx([1.5, 0.6]) and np.isnan(log.motion[:, [2, 5, 6, 7]]).all()
    assert log.motion[:, 4] == pytest.approx(1.2)
    assert log.thrust[2] == pytest.approx([0.6, -16.0, 0.0, 24.0])
    world = TANK.replace('fields = ["u", ""]\nframe = "body"', 'fields = ["u", "", "v"]\nframe = "world"')
    (tmp_path / "map.toml").write_text(world)
    motion = read_mapped_log(tmp_path / "run.dat", tmp_path / "map.toml").motion
    assert np.isnan(motion[:, 4:6]).all() and (motion[:, 6] == 0).all()  # one of two horizontal components is none


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        (('"rudder"]\nskip', '"rudder", "n"]\nskip'), "run.dat:3: has 7 cells, but 'columns' has 8 names"),
        (("skip_lines = 2", "skip_lines = 1"), "run.dat:2: has 1 cells, but 'columns' has 7 names"),
        (("skip_lines = 2", "skip_lines = 99"), "has no rows"),
        (('"x", "y", "psi"', '"x", "x", "psi"'), "columns names x twice"),
        (('columns = ["t", "x", "y", "psi", "u", "v", "rudder"]\n', ""), "skip_lines needs columns"),
    ],
)
def test_a_map_that_does_not_match_the_table(change: tuple[str, str], fragment: str, tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(TANK.replace(*change))
    with pytest.raises(InputError) as caught:
        read_mapped_log(tank(tmp_path / "run.dat"), tmp_path / "map.toml")
    assert fragment in str(caught.value)


def circling() -> MotionLog:
    t = np.linspace(0.0, 29.9, 300)
    psi = 0.4 * np.sin(0.3 * t) + 0.05 * t
    u, v = 0.5 + 0.2 * np.sin(0.5 * t), 0.2 * np.cos(0.4 * t)
    flat = np.exp(1j * psi) * (u + 1j * v)
    place = np.concatenate([[0], np.cumsum(0.05 * (flat[1:] + flat[:-1]))])
    motion = np.column_stack([place.real, place.imag, 0.1 * t, psi, u, v, 0 * t + 0.1, np.gradient(psi, t)])
    return MotionLog(t, motion, np.zeros((300, 4)), "log.csv")


@pytest.mark.parametrize(
    ("column", "values", "fragments"),
    [
        (slice(4, 6), lambda m: np.gradient(m[:, :2], 0.1, axis=0), ["x_m, y_m, psi_rad", 'frame = "world"']),
        (slice(4, 6), lambda m: np.gradient(m[:, 1::-1], 0.1, axis=0) * [1, -1], ['frame = "world"']),
        (5, lambda m: -m[:, 5], ["the other sign of v"]),
        (3, lambda m: -m[:, 3], ["the other sign of the heading"]),
        (7, lambda m: np.degrees(m[:, 7]), ["r_rad_per_s does not follow", "the factor 0.017"]),
        (6, lambda m: -m[:, 6], ["w_m_per_s does not follow from z_m", "the factor -1"]),
        (0, lambda m: m[:, 0] + 0.6 * np.sin(2 * m[:, 2] * 10), ["or expect a current"]),
    ],
)
def test_a_velocity_in_another_frame_sign_or_unit_is_named(
    column: object, values: object, fragments: list[str]
) -> None:
    log = circling()
    assert velocity_notes(log) == ()
    motion = log.motion.copy()
    motion[:, column] = values(motion)  # type: ignore[index, operator]
    note = velocity_notes(replace(log, motion=motion))[0]
    assert all(fragment in note for fragment in fragments), note


def test_noise_a_gap_and_missing_motion_are_no_wrong_frame() -> None:
    log = circling()
    noisy = log.motion + np.random.default_rng(1).normal(0, 0.3, log.motion.shape)
    assert velocity_notes(replace(log, motion=noisy)) == ()
    apart = log.motion + np.outer(log.time > 15, [9, 9, 9, 0, 0, 0, 0, 0])
    assert velocity_notes(MotionLog(log.time + 30 * (log.time > 15), apart, log.thrust)) == ()
    assert velocity_notes(replace(log, motion=np.where(np.arange(8) < 4, log.motion, np.nan))) == ()


def diver() -> Vehicle:
    start = load_vehicle("sur540-flooded")
    values = {"m33": 110.0, "Zw": 1.0, "Zww": 100.0, "Fw_max": 4.0, "thrust_lag": 0.0}
    parameters = {k: replace(p, value=values.get(k, p.value), range=None) for k, p in start.parameters.items()}
    return replace(start, parameters=parameters)


def depths(seed: int) -> MotionLog:
    """A glider of 130 kg by depth alone at 1 Hz, with a resolution of 5 cm, and 2.3 N of buoyancy up and down."""
    t, z, w, z_at = np.arange(240.0), 0.0, 0.0, []
    force = np.where((t // 40) % 2 == seed % 2, 2.3, -2.3)
    for f in force:
        z_at.append(z)
        for _ in range(100):
            w += 0.01 * (f - 5.0 * w - 90.0 * w * abs(w)) / 130.0
            z += 0.01 * w
    motion = np.full((240, 8), np.nan)
    motion[:, 2] = np.round(np.array(z_at) / 0.05) * 0.05
    return MotionLog(t, motion, np.outer(force, [0, 0, 1, 0]), f"dive{seed}.csv")


def test_a_slow_diver_by_its_depth_alone() -> None:
    log = in_sequence([depths(0), depths(1)])
    assert len(log.time) == 480 and log.source == "dive0.csv, dive1.csv" and np.diff(log.time).max() == 20.0
    sections = sections_of(log)
    assert len(sections) == 8 and sum(len(s.dt) for s in sections) <= 5 * 480  # 5 steps of 0.2 s, not 20 of 0.05 s
    found = identify(log, diver(), name="fitted")
    assert "m33" in found.identified and abs(found.estimates["m33"][0] - 130) <= 2 * found.estimates["m33"][1]
    assert [text.partition(",")[0] for text in found.directions[:3]] == [
        f"{axis}: not measured" for axis in ("surge", "sway", "yaw")
    ]
    assert not any("X0 is" in text for text in found.directions)
    short, long = held_out_windows(log, diver(), [5.0, 40.0, 500.0])
    assert (short.window, long.window) == (5.0, 40.0) and long.windows >= 3  # after eight rows for the velocity
    assert short.model["z_m"] <= short.hold["z_m"] and long.model["z_m"] < 0.3 * long.hold["z_m"]


def test_the_speed_before_a_window_follows_from_several_rows() -> None:
    motion = np.full((120, 8), np.nan)
    motion[:, 2] = np.round(0.13 * np.arange(120.0) / 0.05) * 0.05
    found = predict(MotionLog(np.arange(120.0), motion, np.zeros((120, 4))), diver(), window=5.0)
    assert found.hold["z_m"] < 0.04  # two rows alone give 0.10 or 0.15 m/s
