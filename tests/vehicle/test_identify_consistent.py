"""What a fit writes is one model: held parameters, drags at 0, constant forces, gaps; intervals of coloured noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

from surctl.errors import InputError
from surctl.marine.cli.vehicle import vehicle as vehicle_command
from surctl.marine.vehicle import MotionLog, Vehicle, identify, load_vehicle, predict, write_vehicle
from surctl.marine.vehicle.identification.identify import held_out_windows, velocity_notes
from surctl.marine.vehicle.identification.intervals import spread_of
from surctl.marine.vehicle.identification.model import sections_of
from surctl.marine.vehicle.identification.prediction import predict_with
from surctl.marine.vehicle.motion_log import LOG_MOTION, LOG_THRUST
from surctl.marine.vehicle.parameters import Parameter, vehicle_from_table
from tests.vehicle.test_identify import START, TRUE, made_log


def with_force(vehicle: Vehicle, **force: float) -> Vehicle:
    units = {"X0": "N", "Y0": "N", "Z0": "N", "N0": "N m"}
    terms = {k: Parameter(v, units[k], None, "true") for k, v in force.items()}
    return replace(vehicle, parameters={**vehicle.parameters, **terms})


def cut(log: MotionLog, kept: np.ndarray) -> MotionLog:
    return MotionLog(log.time[kept], log.motion[kept], log.thrust[kept], log.source)


def test_a_constant_force_is_found_and_written() -> None:
    true = with_force(TRUE, X0=0.8, Z0=-1.5)
    log = made_log(true, seed=5, rows=300)
    found = identify(log, START, name="fitted")
    for name, value in {"X0": 0.8, "Z0": -1.5}.items():
        assert abs(found.estimates[name][0] - value) <= 1.5 * found.estimates[name][1] and name in found.identified
        assert found.vehicle[name] == pytest.approx(value, abs=0.1)
    import tomllib

    again = vehicle_from_table(tomllib.loads(write_vehicle(found.vehicle)), source="")
    assert again["X0"] == found.constant_force[0] != 0
    free = predict_with(log, START, {k: v for k, (v, _) in found.estimates.items()})
    for column, error in predict(log, again).model.items():
        assert error <= 1.01 * free.model[column], "the file predicts like the fit itself"


def test_a_force_that_cannot_be_told_from_0_is_no_term() -> None:
    found = identify(made_log(TRUE, seed=1), START, name="fitted")
    told = {k for k in ("X0", "Y0", "Z0", "N0") if abs(found.estimates[k][0]) > found.estimates[k][1]}
    assert set(found.vehicle.parameters) - set(START.parameters) == told


def test_what_is_held_is_held_first_and_the_rest_fitted_with_it() -> None:
    """A log of surge alone does not tell linear from quadratic drag: what is written predicts like the fit itself."""
    log = made_log(TRUE, seed=1, axes=(0,))
    found = identify(log, START, name="fitted")
    assert {"m22", "Yv", "Yvv"} <= set(found.held) and found.vehicle["m22"] == START["m22"]
    free = predict_with(log, START, {k: v for k, (v, _) in found.estimates.items()})
    written = predict(log, found.vehicle)
    assert written.model["u_m_per_s"] <= 1.01 * free.model["u_m_per_s"]
    assert any("sway: no motion" in text for text in found.directions)


def test_a_negative_drag_is_fixed_at_0_and_said() -> None:
    log = made_log(TRUE, seed=2, rows=150)
    pushed = log.thrust + np.outer(np.nan_to_num(log.motion[:, 4]), [-25.0, 0, 0, 0])  # thrust that hides the drag
    wrong = MotionLog(log.time, log.motion, pushed, "log.csv")
    found = identify(wrong, START, name="fitted")
    value, half = found.estimates["Xu"]
    assert f"Xu = {value:.3g} ± {half:.2g} N s/m would be below 0; check the signs" in found.refusal
    assert "Xu" in found.zeroed and found.vehicle["Xu"] == 0.0
    assert any("drag below 0: the model is wrong (Xu" in note for note in found.notes)
    assert (
        found.vehicle.parameters["Xu"].range is None and "model is wrong" in found.vehicle.parameters["Xu"].provenance
    )


def test_a_lag_is_not_told_by_thrust_in_a_few_rows_or_at_its_bound() -> None:
    log = made_log(TRUE, seed=3, rows=60)
    few = log.thrust.copy()
    few[5:] = 0.0
    found = identify(MotionLog(log.time, log.motion, few, "log.csv"), START, name="fitted")
    assert "thrust_lag" in found.held and any("only 5 of 60 rows" in note for note in found.notes)
    fast = made_log(TRUE.with_values({"thrust_lag": 0.0}), seed=3, rows=60)
    found = identify(fast, START, name="fitted")
    assert "thrust_lag" in found.held and any("smallest value that the fit allows" in note for note in found.notes)


def test_a_log_is_split_at_its_gaps_and_a_gap_costs_no_steps() -> None:
    log = made_log(TRUE, seed=4, rows=400)
    kept = np.ones(400, dtype=bool)
    kept[150:200] = kept[300:303] = False
    sections = sections_of(cut(log, kept))
    assert [(s.rows.start, s.rows.stop) for s in sections] == [(0, 150), (150, 347)]  # 0.4 s is no gap
    assert max(s.dt.max() for s in sections) <= 0.05 + 1e-9 and sum(len(s.dt) for s in sections) < 1000
    found = identify(cut(log, kept), START, name="fitted")
    assert found.sections == 2 and abs(found.estimates["m11"][0] - TRUE["m11"]) <= 2 * found.estimates["m11"][1]
    with pytest.raises(InputError, match="has no part of 20 rows without a gap"):
        sections_of(cut(log, np.arange(400) % 20 < 10))
    with pytest.raises(InputError, match=r"t_s: has rows 100 s apart \(median\).*; is the time in ms\?"):
        sections_of(MotionLog(1e3 * log.time, log.motion, log.thrust, "log.csv"))


@pytest.mark.parametrize(("factor", "words"), [(np.pi / 180, "times 57.3"), (180 / np.pi, "divided by 57.3")])
def test_a_heading_in_the_wrong_unit_is_named(factor: float, words: str) -> None:
    time = 0.05 * np.arange(600)
    heading, motion = 0.6 * np.sin(0.3 * time), np.zeros((600, 8))
    motion[:, 4] = 0.5
    velocity = 0.5 * np.exp(1j * heading)
    place = np.concatenate([[0], np.cumsum((velocity[1:] + velocity[:-1]) / 2 * np.diff(time))])
    motion[:, 0], motion[:, 1], motion[:, 3], motion[:, 7] = place.real, place.imag, factor * heading, np.nan
    (note,) = velocity_notes(MotionLog(time, motion, np.zeros((600, 4)), "log.csv"))
    assert f"with the heading {words}" in note


def test_intervals_of_coloured_noise_are_those_of_the_estimates() -> None:
    """The mean of an AR(1) series: its interval is that of its long-run variance."""
    rng = np.random.default_rng(1)
    phi, n, hits, white = 0.9, 1500, 0, 0
    for _ in range(100):
        e = np.zeros((n, 8))
        e[:, 4] = lfilter([1.0], [1.0, -phi], rng.normal(size=n))
        mean = e[:, 4].mean()
        slope = np.zeros((n, 8, 13))
        slope[:, 4, 0] = 1.0
        left = e.copy()
        left[:, 4] -= mean
        sd = left[:, 4].std()
        present = np.zeros((n, 8), dtype=bool)
        present[:, 4] = True
        spread = spread_of([(left / sd, slope / sd)], [present], np.full(1, 1e-6), np.full(12, 1.0))
        hits += abs(mean) <= spread.half_intervals()[0]
        white += abs(mean) <= 1.96 * sd / np.sqrt(n)
    assert white < 50 and hits >= 87  # fewer of 100 at 95 %: 1 of 1000 cases


def test_a_held_out_part_is_predicted_beside_the_last_velocity() -> None:
    log = made_log(TRUE, seed=6, rows=400)
    [found] = held_out_windows(log, START, [5.0])
    assert found.windows >= 2 and found.time[0] > 24.0
    assert all(found.model[c] < 0.5 * found.hold[c] for c in ("u_m_per_s", "v_m_per_s", "r_rad_per_s"))
    poses = log.motion.copy()
    poses[:, 4:] = np.nan
    [alone] = held_out_windows(MotionLog(log.time, poses, log.thrust), START, [5.0])
    assert set(alone.model) == {"x_m", "y_m", "z_m", "psi_rad"}
    assert alone.model["x_m"] < alone.hold["x_m"]


def test_a_coupled_vehicle_is_fitted_with_its_coupling() -> None:
    def coupled(value: float) -> Vehicle:
        term = Parameter(value, "kg m", None, "true")
        return replace(TRUE, parameters={**TRUE.parameters, "m24": term})

    log = made_log(coupled(4.0), seed=7, rows=300)
    found = identify(log, coupled(2.0), name="fitted")
    assert abs(found.estimates["m24"][0] - 4.0) <= 2 * found.estimates["m24"][1] and "m24" in found.identified


def test_the_default_vehicle_is_unchanged() -> None:
    assert load_vehicle("sur540-flooded").digest() == START.digest()


def test_a_fit_without_physical_meaning_is_not_written(tmp_path: Path) -> None:
    log = made_log(TRUE, seed=2, rows=150)
    pushed = log.thrust + np.outer(np.nan_to_num(log.motion[:, 4]), [-25.0, 0, 0, 0])
    (tmp_path / "start.toml").write_text(write_vehicle(START))
    for thrust, status in ((pushed, 1), (log.thrust, 0)):
        rows = np.column_stack([log.time, log.motion, thrust])
        names = ",".join(("t_s", *LOG_MOTION, *LOG_THRUST))
        np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=names, comments="")
        words = ["--start", str(tmp_path / "start.toml"), "--held-out", "0", "--out", str(tmp_path / "fit.toml")]
        result = CliRunner().invoke(vehicle_command, ["from-log", str(tmp_path / "log.csv"), *words])
        assert (result.exit_code, (tmp_path / "fit.toml").exists()) == (status, status == 0), result.output
        assert ("not written: the log contradicts the model: Xu = -" in result.output) == (status == 1)
