"""The systems that python-control gets: its own numbers for them are those of `surctl verify`."""

from __future__ import annotations

from functools import cache
from typing import Any

import control
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification import closed_loop_poles, loop_margins
from surctl.marine.verification.cascade import LOOP_NAMES, build_cascade
from surctl.marine.verification.linear import (
    DISK_PLACES,
    closed_system,
    loop_system,
    open_loop,
    open_system,
    sampled_limits,
    sampled_loop_system,
    sampled_poles,
)
from surctl.verification.linear import disk_margin

CRUISE, DT = 0.15, 0.05


@cache
def _vehicle(lag: bool = True) -> Vehicle:
    vehicle = load_vehicle("sur540-flooded")
    return vehicle if lag else vehicle.with_values({"thrust_lag": 0.0})


def _gains(k_i: float = 0.0) -> dict[str, float]:
    return {**load_gains("default").values, "k_i": k_i}


def _loop(name: str, **changed: Any) -> Any:
    return loop_system(_vehicle(), _gains(), name, cruise=CRUISE, dt=DT, **changed)


@cache
def printed(k_i: float) -> Any:
    return loop_margins(_vehicle(), _gains(k_i), cruise=CRUISE, dt=DT)


@pytest.mark.parametrize("k_i", [0.05])
@pytest.mark.parametrize("name", LOOP_NAMES[1::3])  # all of them: study 40
def test_margins_are_those_that_are_printed(name: str, k_i: float) -> None:
    gains = _gains(k_i)
    ours = printed(k_i)[LOOP_NAMES.index(name)]
    L = loop_system(_vehicle(), gains, name, cruise=CRUISE, dt=DT)
    with np.errstate(over="ignore"):  # its polynomials of 16 states overflow far beyond every frequency that counts
        gm, pm, _, w_phase, w_gain, _ = control.stability_margins(L, returnall=True)
    below = np.pi / DT
    gm = gm[(gm > 1) & (w_phase < below)]
    lag = np.remainder(pm[w_gain < below], 360.0)
    assert ours.gain_margin == pytest.approx(min(gm, default=np.inf), rel=1e-5)
    assert ours.phase_margin_deg == pytest.approx(min(lag, default=np.inf), rel=1e-5)
    assert ours.delay_margin_s == pytest.approx(min(np.deg2rad(lag) / w_gain[w_gain < below], default=np.inf), rel=1e-5)
    omega = np.geomspace(1e-3, below, 4_000)
    assert ours.disk_margin == pytest.approx(control.disk_margins(L, omega)[0], rel=1e-4)


def test_plain_margin_of_the_loop_that_limits() -> None:
    ours = {m.name: m for m in loop_margins(_vehicle(), _gains(), cruise=CRUISE, dt=DT)}
    gm, pm, _, at = control.margin(_loop("yaw"))
    assert (gm, pm, at) == pytest.approx(
        (ours["yaw"].gain_margin, ours["yaw"].phase_margin_deg, ours["yaw"].crossover_rad_s), rel=1e-5
    )


def _among(found: np.ndarray, poles: np.ndarray, within: float) -> None:
    """Each of the poles that were found is one of all."""
    assert len(found)
    assert np.abs(found[:, None] - poles).min(axis=1).max() < within


@pytest.mark.parametrize("lag", [True, False])
def test_closing_the_loops_gives_the_poles_of_all(lag: bool) -> None:
    vehicle = _vehicle(lag)
    wanted = closed_loop_poles(vehicle, _gains(), cruise=CRUISE, dt=DT)
    found = []
    for name in LOOP_NAMES:
        closed = control.feedback(loop_system(vehicle, _gains(), name, cruise=CRUISE, dt=DT), 1).poles()
        _among(closed, wanted, 1e-3)  # some lie close together, where rounding counts by its root
        found.append(closed)
    _among(wanted, np.concatenate(found), 1e-3)
    assert {len(f) for f in found} == ({6, 12} if lag else {5, 10})


@pytest.mark.parametrize(("delay", "k_i"), [(0, 0.0), (2, 0.05)])
def test_closing_the_sampled_loops_gives_the_sampled_poles(k_i: float, delay: int) -> None:
    wanted = sampled_poles(_vehicle(), _gains(k_i), cruise=CRUISE, period=0.2, delay=delay)
    found = []
    for name in LOOP_NAMES:
        L = sampled_loop_system(_vehicle(), _gains(k_i), name, cruise=CRUISE, period=0.2, delay=delay)
        assert L.dt == 0.2
        found.append(control.feedback(L, 1).poles())
        _among(found[-1], wanted, 1e-5)
    _among(wanted, np.concatenate(found), 1e-5)


def test_the_printed_largest_period_is_where_the_sampled_loop_ends() -> None:
    plain = build_cascade(_vehicle(), _gains(), cruise=CRUISE, dt=DT, delay=0.0)
    end = sampled_limits(plain, DT).largest_period_s[1]
    radii = [
        np.abs(
            control.feedback(
                sampled_loop_system(_vehicle(), _gains(), "sway", cruise=CRUISE, period=T, delay=1), 1
            ).poles()
        ).max()
        for T in (0.999 * end, 1.001 * end)
    ]
    assert radii[0] < 1 < radii[1]


@pytest.mark.parametrize("place", DISK_PLACES)
def test_the_disk_margin_of_all_loops(place: str) -> None:
    """Whoever has slycot gets it from python-control; else from its frequency response and our bounds."""
    cascade = build_cascade(_vehicle(), _gains(), cruise=CRUISE, dt=DT)
    ours = disk_margin(open_loop(cascade, place), place)
    L = open_system(_vehicle(), _gains(), place, cruise=CRUISE, dt=DT)
    response = control.frequency_response(L, [ours.frequency_rad_s]).complex[:, :, 0]
    M = 0.5 * np.eye(len(response)) - response @ np.linalg.inv(np.eye(len(response)) + response)
    # some δ of size α destabilises there, and none is smaller than 1/σ of M
    assert 1 / np.linalg.norm(M, 2) <= ours.reached + 1e-9
    poly = control.feedback(L, np.eye(len(response)))
    np.testing.assert_allclose(np.sort(poly.poles().real)[-3:], np.sort(cascade.poles.real)[-3:], rtol=1e-6)


def test_a_step_of_the_wanted_pose_arrives() -> None:
    system = closed_system(_vehicle(), _gains(), cruise=CRUISE, dt=DT)
    gain = control.dcgain(system)
    np.testing.assert_allclose(gain[:3, :3], np.eye(3), atol=1e-9)  # but for ψ the wanted is what comes
    step = control.step_response(system, T=np.linspace(0, 120, 121), input=1)
    assert step.outputs[1, 0, -1] == pytest.approx(1.0, abs=1e-3)


def test_signals_have_names_and_units() -> None:
    L = _loop("yaw")
    assert L.input_labels == ["Fr_cmd [N m]"] and L.output_labels == ["Fr_cmd [N m] back"]
    assert L.state_labels[:2] == ["y [m]", "psi [rad]"] and "Fr_cmd_delay_3" in L.state_labels
    assert _loop("heading").input_labels == ["psi [rad]"]
    assert closed_system(_vehicle(), _gains(), cruise=CRUISE, dt=DT).input_labels[-1] == "Fr_dist [N m]"


def test_mistakes() -> None:
    with pytest.raises(InputError, match=r"loop.*'yau'.*yaw"):
        _loop("yau")
    with pytest.raises(InputError, match="delay"):
        sampled_loop_system(_vehicle(), _gains(), "yaw", cruise=CRUISE, period=0.1, delay=-1)
    with pytest.raises(InputError, match="place"):
        open_system(_vehicle(), _gains(), "wall", cruise=CRUISE, dt=DT)


@pytest.mark.parametrize("k_i", [0.05])
@pytest.mark.parametrize("name", LOOP_NAMES)
def test_a_loop_that_is_sampled_fast_is_the_continuous_one_later(name: str, k_i: float) -> None:
    T, delay, omega = 1e-3, 2, np.array([0.1, 0.5, 2.0])
    L = loop_system(_vehicle(), _gains(k_i), name, cruise=CRUISE, dt=DT, delay=(delay + 0.5) * T)
    sampled = sampled_loop_system(_vehicle(), _gains(k_i), name, cruise=CRUISE, period=T, delay=delay)
    found, wanted = sampled(np.exp(1j * omega * T)), L(1j * omega)
    np.testing.assert_allclose(found, wanted, rtol=1e-3)
