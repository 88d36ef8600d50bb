"""What real logs have: outliers, coarse resolution, a start vehicle that is far off, and a trim that drifts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from surctl.marine.cli.vehicle import _fit_lines
from surctl.marine.vehicle import FITTED, MotionLog, identify
from surctl.marine.vehicle.identification.model import Model, drift_sections_of, sections_of
from surctl.marine.vehicle.identification.solve import minimise, outliers
from tests.vehicle.test_identify import START, TRUE, made_log

MASSES = ("m11", "m22", "m33", "m44")


@cache
def made() -> MotionLog:
    return made_log(TRUE, seed=1, rows=300)


def check(log: MotionLog, *, share: float, outside: int) -> list[str]:
    """Fit, compare masses within a share and all intervals; return the notes."""
    found = identify(log, START, name="fitted")
    for name in MASSES:
        assert found.estimates[name][0] == pytest.approx(TRUE[name], rel=share), name
    assert sum(abs(found.estimates[k][0] - TRUE[k]) > found.estimates[k][1] for k in FITTED) <= outside
    return list(found.notes)


def test_outliers_are_omitted_and_counted() -> None:
    rng = np.random.default_rng(5)
    motion = made().motion.copy()
    wrong = rng.random(motion.shape) < 0.02
    motion[wrong] += rng.choice([-1.0, 1.0], wrong.sum()) * rng.uniform(0.3, 3.0, wrong.sum())
    notes = check(replace(made(), motion=motion), share=0.02, outside=2)
    assert any("outliers are not used: " in note and "of x_m" in note for note in notes)


def test_motion_noise_and_resolution_are_no_outliers() -> None:
    rng = np.random.default_rng(1)
    t = 0.1 * np.arange(500)
    sharp = 0.3 * np.abs((t % 4.0) - 2.0)  # the corners of a speed
    noisy = sharp + 0.003 * rng.normal(size=500)
    rest = np.where(t < 40, 0.1 + 0.2, noisy)  # a sensor that stands still for most of the time
    for values in (noisy, rest, np.round(sharp, 2), np.round(sharp, 1), np.zeros(500), np.repeat(noisy[::10], 10)):
        assert not outliers(values).any()
    assert not np.any([outliers(rng.normal(size=2000)) for _ in range(50)])
    for values in (noisy, np.round(noisy, 2)):
        values[[100, 102, 300]] += 1.0
        values[101] = np.nan
        assert np.flatnonzero(outliers(values)).tolist() == [100, 102, 300]


def test_coarse_resolution_is_noise() -> None:
    steps = np.array([0.01, 0.01, 0.01, np.radians(1.0), 0.01, 0.01, 0.01, np.radians(1.0)])
    assert not [
        n
        for n in check(replace(made(), motion=np.round(made().motion / steps) * steps), share=0.02, outside=3)
        if "outliers" in n
    ]


def test_a_trim_that_drifts_is_said_and_does_not_change_masses_and_drag() -> None:
    """0.5 N of drift, a tenth of the thrust: with a constant force, masses would be wrong by 8 %, drag by far more."""
    rows = 400
    drift = np.linspace(-1.0, 1.0, rows)[:, None] * np.array([0.5, 0.3, -0.5, 0.0])
    log = made_log(TRUE, seed=1, rows=rows, drift=drift)
    found = identify(log, START, name="fitted")
    for name in MASSES:
        assert found.estimates[name][0] == pytest.approx(TRUE[name], rel=0.02), name
    assert sum(abs(found.estimates[k][0] - TRUE[k]) > found.estimates[k][1] for k in FITTED) <= 3
    assert found.sections == 2 and any("the constant force drifts (X0 from -0." in note for note in found.notes)
    assert found.vehicle["X0"] == found.estimates["X0"][0] != 0.0  # the mean, although the drift makes it uncertain
    assert "mean of a force that drifts" in found.vehicle.parameters["X0"].provenance
    assert found.drifting == ("X0", "Y0", "Z0", "N0")
    assert [line.split()[1:3] for line in _fit_lines(found) if line.startswith("  X0 ")] == [["drifts;", "mean"]]
    assert not {"X0", "Y0", "Z0", "N0"} & set(found.held)


def test_a_heading_that_is_wrong_by_a_whole_turn_is_turned_back() -> None:
    """With the noise of a heading that is wrong by a turn, nothing but a whole turn at once decreases the cost."""
    log = replace(made(), time=made().time[:60], motion=made().motion[:60].copy(), thrust=made().thrust[:60])
    log.motion[3, 3] = np.nan
    model = Model(log, TRUE, sections_of(log))
    theta = model.begin(model.sections)
    theta[model.size + 3] += 2.0 * np.pi
    noise = np.array([0.003, 0.003, 0.003, 6.0, 0.003, 0.003, 0.003, 0.003])
    found, converged = minimise(model, theta, noise, model.sections, free=np.zeros(model.size, dtype=bool))
    assert converged and found[model.size + 3] == pytest.approx(log.motion[0, 3], abs=0.02)


def test_sections_of_a_drifting_force_are_not_too_short_for_a_log_with_few_rows() -> None:
    slow = replace(made(), time=10.0 * made().time)  # one row per second
    assert sum(s.rows.stop - s.rows.start for s in drift_sections_of(slow)) == len(slow.time)
    assert max(float(np.sum(s.dt)) for s in drift_sections_of(made())) <= 20.0
