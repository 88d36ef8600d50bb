"""The linear table against python-control, one point at a time."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import control
import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import LINEAR_METRICS, cruise_loop, linear_table
from surctl.marine.verification.linear_table import LINEAR_PARAMETERS, LOOP_NAMES
from surctl.verification import system_margins

GAINS = {"k1": 0.3, "k2": 0.3, "k_psi": 0.6, "k_r": 1.5, "k_v": 1.5, "lookahead": 1.2}
VEHICLE = load_vehicle("sur540-flooded")
ABOUT = {"cruise": 0.15, "dt": 0.05}


def random_points(count: int, *, seed: int) -> dict[str, NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    found = {name: value * 6 ** rng.uniform(-1, 1, count) for name, value in GAINS.items()}
    found["k_psi"][-2:] = 60.0  # unstable whatever the rest
    return {**found, "k_i": np.where(rng.random(count) < 0.5, 0.0, rng.uniform(0, 0.4, count))}


def row(values: dict[str, NDArray[np.float64]], k: int) -> dict[str, float]:
    return {name: float(column[k]) for name, column in values.items()}


VALUES = random_points(8, seed=3)


@cache
def whole() -> Mapping[str, NDArray[np.float64]]:
    return linear_table(VEHICLE, VALUES, base=GAINS, **ABOUT)


def test_every_metric_is_a_column() -> None:
    assert list(whole()) == list(LINEAR_METRICS)
    assert all(column.shape == (8,) for column in whole().values())
    stable = whole()["slowest_pole_per_s"] < 0
    assert 2 <= (~stable).sum() <= 5, "the draw has both"


@pytest.mark.parametrize("k", range(8))
def test_poles_are_those_of_damp(k: int) -> None:
    transition = cruise_loop(VEHICLE, row(VALUES, k), **ABOUT).transition
    n = len(transition)
    closed = control.ss(transition, np.zeros((n, 1)), np.zeros((1, n)), 0, ABOUT["dt"])
    natural, damping, poles = control.damp(closed, doprint=False)
    assert whole()["slowest_pole_per_s"][k] == pytest.approx((-damping * natural).max(), abs=1e-7)
    assert whole()["least_damping"][k] == pytest.approx(damping[poles.imag != 0].min(), abs=1e-7)


@pytest.mark.parametrize("k", [7])
def test_margins_are_those_of_stability_margins_and_disk_margins(k: int) -> None:
    one = cruise_loop(VEHICLE, row(VALUES, k), **ABOUT)
    if not one.stable:
        for name, nothing in (("gain_margin", 1), ("phase_margin_deg", 0), ("delay_margin_s", 0), ("disk_margin", 0)):
            assert {whole()[f"{name}.{loop}"][k] for loop in LOOP_NAMES.values()} | {whole()[name][k]} == {nothing}
        assert np.isinf(whole()["sensitivity_peak"][k]) and whole()["rejection_rad_per_s.yaw"][k] == 0
        assert np.isnan(whole()["crossover_rad_per_s.yaw"][k])
        return
    omega = np.geomspace(1e-4, np.pi / 0.05, 500)
    places = [one.opened(signal) for signal in LOOP_NAMES]
    for name, loop in zip(LOOP_NAMES.values(), places, strict=True):
        system = control.ss(*loop, ABOUT["dt"])
        found = control.stability_margins(control.frd(system, omega, smooth=True), returnall=True)
        gain, phase, at_phase = found[0], found[1], found[4]
        gain = gain[np.isfinite(gain) & (gain > 1) & (gain < 1e6)]
        lag = np.remainder(phase, 360)
        expected = {
            "gain_margin": np.min(gain, initial=np.inf),
            "phase_margin_deg": np.min(lag, initial=np.inf),
            "delay_margin_s": np.min(np.deg2rad(lag) / at_phase, initial=np.inf),
        }
        for metric, value in expected.items():
            assert whole()[f"{metric}.{name}"][k] == pytest.approx(value, rel=1e-4), (metric, name)
        peak = 1 / np.min(found[2], initial=1.0)  # far off, L is 0 and |S| is 1
        assert max(whole()[f"sensitivity_peak.{name}"][k], 1.0) == pytest.approx(peak, rel=1e-4), name
        assert whole()[f"crossover_rad_per_s.{name}"][k] == pytest.approx(np.max(at_phase, initial=0.0), rel=1e-4), name
        edge = whole()[f"rejection_rad_per_s.{name}"][k]
        below = np.abs(1 + control.frequency_response(system, omega[omega < edge]).complex)
        assert np.all(below >= np.sqrt(2) * (1 - 1e-9)), "attenuated up to there"
        if edge:
            assert abs(1 + system(np.exp(1j * ABOUT["dt"] * edge))) == pytest.approx(np.sqrt(2), rel=1e-5), name
        else:
            assert abs(1 + system(np.exp(1e-4j * ABOUT["dt"]))) < np.sqrt(2), name
        # the grid of python-control holds the least radius to the width of its steps
        coarse = control.disk_margins(system, omega)[0]
        assert whole()[f"disk_margin.{name}"][k] == pytest.approx(coarse, rel=1e-2)
        assert whole()[f"disk_margin.{name}"][k] <= coarse * (1 + 1e-9)


@pytest.mark.parametrize("k", [0, 1, 2, 7])
def test_step_responses_are_those_of_step_info(k: int) -> None:
    one = cruise_loop(VEHICLE, row(VALUES, k), **ABOUT)
    for signal in ("x", "y", "psi"):
        settling, overshoot = (whole()[f"{name}.{LOOP_NAMES[signal]}"][k] for name in ("settling_time_s", "overshoot"))
        if not one.stable:
            assert settling == overshoot == np.inf
            continue
        A, B, C, D = one.transferred([f"measured.{signal}"], [f"measured.{signal}"])
        closed = control.ss(A, B, C, D, ABOUT["dt"])
        info = control.step_info(closed, T=ABOUT["dt"] * np.arange(2 * settling / ABOUT["dt"]))
        assert settling == pytest.approx(info["SettlingTime"], abs=1.5 * ABOUT["dt"])
        assert overshoot == pytest.approx(info["Overshoot"] / 100, abs=1e-3)


def test_the_table_and_the_margins_of_one_point_are_one() -> None:
    for k in range(2):
        for m in system_margins(cruise_loop(VEHICLE, row(VALUES, k), **ABOUT), *LOOP_NAMES):
            assert whole()[f"disk_margin.{LOOP_NAMES[m.name]}"][k] == pytest.approx(m.disk_margin, rel=1e-9)
            assert whole()[f"delay_margin_s.{LOOP_NAMES[m.name]}"][k] == pytest.approx(m.delay_margin_s, rel=1e-9)


def test_knobs_of_the_plant_leave_the_model_alone() -> None:
    heavy = VEHICLE.with_values({"m33": 115.0})
    by_knob = linear_table(VEHICLE, {"plant.m33": [95.0, 115.0]}, base=GAINS, **ABOUT)
    by_hand = linear_table(heavy, {}, base=GAINS, model=VEHICLE, **ABOUT)
    both = linear_table(VEHICLE, {"vehicle.m33": 115.0}, base=GAINS, **ABOUT)
    right = linear_table(heavy, {}, base=GAINS, **ABOUT)
    for name in LINEAR_METRICS:
        assert by_knob[name][1] == pytest.approx(by_hand[name][0], rel=1e-9)
        assert both[name][0] == pytest.approx(right[name][0], rel=1e-9)
    assert by_knob["delay_margin_s.heave"][0] != pytest.approx(by_knob["delay_margin_s.heave"][1], rel=1e-3)


def test_orders_mix_and_threads_change_nothing() -> None:
    values = {"k_i": [0.0, 0.1, 0.0, 0.1], "vehicle.thrust_lag": [0.0, 0.0, 0.3, 0.3], "margin": [1.0, 2.0, 3.0, 4.0]}
    one, two = (linear_table(VEHICLE, values, base=GAINS, workers=w, **ABOUT) for w in (1, 2))
    for name in LINEAR_METRICS:
        np.testing.assert_array_equal(one[name], two[name])
    lags = one["delay_margin_s.yaw"]
    assert lags[0] > lags[2] > 0 and lags[0] > lags[1] > 0
    assert "margin" not in LINEAR_PARAMETERS


def test_an_axis_without_thrust_has_no_loop() -> None:
    """A surface craft: its depth is no loop that the law closes, and decides no margin of the others."""
    submerged = load_vehicle("sur400")
    craft = submerged.with_values({"Fw_max": 0.0})
    loop = cruise_loop(craft, GAINS, **ABOUT)
    assert "heave" not in loop.names.commands and not {"z", "w"} & set(loop.names.outputs)
    one = {name: np.array([value]) for name, value in GAINS.items()}
    table, deep = (linear_table(vehicle, one, base=GAINS, **ABOUT) for vehicle in (craft, submerged))
    for name in ("disk_margin", "delay_margin_s"):
        assert np.isnan([table[f"{name}.{of}"] for of in ("heave", "depth")]).all()
        np.testing.assert_allclose(table[f"{name}.yaw"], deep[f"{name}.yaw"])
    slack = {name: np.array([value / 3]) for name, value in GAINS.items() if name == "k2"}
    loose = linear_table(craft, {**one, **slack}, base=GAINS, **ABOUT)
    np.testing.assert_array_equal(loose["disk_margin"], table["disk_margin"])


def test_a_cruise_beyond_the_thrust_has_no_figures() -> None:
    table = linear_table(VEHICLE, {"scenario.cruise": [0.1, 0.9]}, base=GAINS, **ABOUT)
    for column in table.values():
        assert not np.isnan(column[0]) and np.isnan(column[1])


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"k_v": [1.0, -1.0]}, "k_v = -1"),
        ({"k_psi": [1.0, np.nan]}, "k_psi"),
        ({"k_i": [-0.1]}, "k_i"),
        ({"plant.m11": [0.0]}, "plant.m11"),
        ({"vehicle.Xu": [-1.0]}, "vehicle.Xu"),
        ({"scenario.cruise": [0.0]}, "cruise"),
        ({"k_v": [1.0, 2.0], "k_r": [1.0, 2.0, 3.0]}, "values"),
    ],
)
def test_bad_values_are_named(values: dict[str, list[float]], key: str) -> None:
    with pytest.raises(InputError, match=key):
        linear_table(VEHICLE, values, base=GAINS, **ABOUT)


@pytest.mark.parametrize(
    "columns", [["disk_margin"], ["delay_margin_s"], ["least_damping"], ["overshoot.heading", "delay_margin_s.yaw"]]
)
def test_columns_alone_are_those_of_the_whole_table(columns: list[str]) -> None:
    alone = linear_table(VEHICLE, VALUES, base=GAINS, columns=columns, **ABOUT)
    assert list(alone) == columns
    for name in columns:
        np.testing.assert_array_equal(alone[name], whole()[name])


def test_an_unknown_column_is_named() -> None:
    with pytest.raises(InputError, match=r"columns = 'disc_margin': no such column; did you mean 'disk_margin'"):
        linear_table(VEHICLE, VALUES, base=GAINS, columns=["disc_margin"], **ABOUT)
