from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.vehicle.linearise import STATE_NAMES
from surctl.marine.verification import cruise_loop
from surctl.marine.verification.cruise_loop import POSE, THRUSTS, CruiseLoop
from surctl.marine.verification.linear import (
    corners,
    sampled_limits,
    side,
    worst_linear_side,
)
from surctl.system.linear_loop import LoopNames

VEHICLE = load_vehicle("sur540-flooded")
GAINS = load_gains("default").values
ABOUT = {"cruise": 0.15}


def integrators(gain: float, dt: float = 0.1) -> CruiseLoop:
    law = (
        np.zeros((0, 0)),
        np.zeros((0, 8)),
        np.zeros((0, 0)),
        np.zeros((4, 0)),
        -gain * np.eye(4, 8),
        np.zeros((4, 0)),
    )
    names = LoopNames("integrators", "law", POSE, (), THRUSTS, THRUSTS, STATE_NAMES[:8])
    plant = (np.zeros((4, 4)), np.eye(4), np.zeros((4, 0)), np.eye(8, 4), np.zeros((8, 0)))
    return CruiseLoop.of(plant, law, names, dt)


def test_integrators_are_lost_where_algebra_says() -> None:
    # z − 1 + kT, z² − z + kT, z³ − z² + kT: kT below 2, 1 and the golden section
    found = sampled_limits(integrators(2.0))
    assert found.largest_period_s == pytest.approx((1.0, 0.5, (np.sqrt(5) - 1) / 4), rel=1e-5)
    # d periods of delay bear kT < 2 sin(π/(4d + 2))
    borne = max(d for d in range(50) if 2 * np.sin(np.pi / (4 * d + 2)) > 0.2)
    assert found.delay_periods == borne
    assert found.radius == pytest.approx(np.max(np.abs(np.roots([1, -1, 0.2]))))


def test_a_loop_that_no_period_saves_has_none() -> None:
    found = sampled_limits(integrators(-1.0))
    assert found.largest_period_s == (0.0, 0.0, 0.0) and found.delay_periods == -1


@pytest.mark.parametrize("k_i", [0.0, 0.2])
def test_short_periods_have_the_slowest_pole_of_the_loop_without_delay(k_i: float) -> None:
    short = cruise_loop(VEHICLE, {**GAINS, "k_i": k_i}, dt=1e-4, **ABOUT).resampled(1e-4, 0)
    (A, B, *_), (Az, By, _, Cz, D, _) = short.plant, short.direct
    C = np.eye(8, len(A))
    continuous = np.block([[A + B @ D @ C, B @ Cz], [By @ C / 1e-4, (Az - np.eye(len(Az))) / 1e-4]])
    assert short.rates.real.max() == pytest.approx(np.linalg.eigvals(continuous).real.max(), rel=1e-3)


@pytest.mark.parametrize(("delay", "k_i"), [(2, 0.2)])  # without: study 40
def test_the_loop_flown_step_by_step_decays_below_the_largest_period_and_grows_above(delay: int, k_i: float) -> None:
    gains = {**GAINS, "k_i": k_i}
    limit = sampled_limits(cruise_loop(VEHICLE, gains, dt=0.05, **ABOUT)).largest_period_s[delay]
    for factor, decays in ((0.97, True), (1.03, False)):
        assert (flown(gains, factor * limit, delay) < 1.0) is decays


def flown(gains: dict[str, float], period: float, delay: int) -> float:
    """How a deviation grows over the last half of a long flight, by small steps of the plant and a held thrust."""
    loop = cruise_loop(VEHICLE, gains, dt=period, **ABOUT)
    (A, B, *_), (Az, By, _, Cz, D, _) = loop.plant, loop.direct
    steps = int(np.ceil(period / 0.04))
    h, x, sizes = period / steps, np.random.default_rng(1).normal(size=len(A)), []
    waiting, z = [np.zeros(4)] * delay, np.zeros(len(Az))
    for _ in range(600):
        waiting.append(D @ x[:8] + Cz @ z)
        held, z = waiting.pop(0), By @ x[:8] + Az @ z
        for _ in range(steps):
            rates = [A @ x + B @ held]
            for share in (0.5, 0.5, 1.0):
                rates.append(A @ (x + share * h * rates[-1]) + B @ held)
            x = x + h / 6 * (rates[0] + 2 * rates[1] + 2 * rates[2] + rates[3])
        sizes.append(np.linalg.norm(x))
    return float(max(sizes[575:]) / max(sizes[275:300]))


def test_limits_of_corners_are_computed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path / "cache"))
    one, other = integrators(2.0, 0.05), integrators(3.0, 0.05)
    plant, law = (
        tuple(np.stack(both) for both in zip(getattr(one, part), getattr(other, part), strict=True))
        for part in ("plant", "direct")
    )
    pair = CruiseLoop.of(plant, law, one.names, one.dt)
    first = sampled_limits(pair)
    assert first == side._sampled_limits(pair)
    longer = sampled_limits(pair.resampled(0.06))
    monkeypatch.setattr(side, "_sampled_limits", None)  # what is called now ends the test
    assert sampled_limits(pair) == first and sampled_limits(pair.resampled(0.06)) == longer != first
    for changed in (((0.01 + plant[0], *plant[1:]), law), (plant, (*law[:4], 0.01 + law[4], law[5]))):
        with pytest.raises(TypeError):
            sampled_limits(CruiseLoop.of(*changed, one.names, one.dt))


def test_masses_of_surge_and_sway_that_differ_may_turn_it_broadside() -> None:
    together, apart = corners(VEHICLE), corners(VEHICLE, alike=False)
    assert (len(together.vehicles), len(apart.vehicles)) == (33, 65)
    assert all(v["m11"] == v["m22"] for v in together.vehicles)
    assert corners(load_vehicle("sur400")).labels[1] == "mass -5%, drag -20%"  # its file states no ranges
    assert len(corners(VEHICLE, known=["m11", "m22", "m33", "m44", "Nr", "Xuu"]).vehicles) == 1
    found = worst_linear_side(apart, GAINS, dt=0.05, **ABOUT)
    assert not found.stable and "UNSTABLE" in found.lines()[0]


def test_corners_that_cannot_cruise_are_counted() -> None:
    told = worst_linear_side(corners(VEHICLE), GAINS, dt=0.05, cruise=0.2).of
    assert "16 of them cannot hold 0.2 m/s" in told
    with pytest.raises(InputError, match=r"cruise = 0\.9"):
        worst_linear_side(corners(VEHICLE, 0.2), GAINS, dt=0.05, cruise=0.9)


def test_bad_numbers_are_named() -> None:
    with pytest.raises(InputError, match="uncertainty = 1"):
        corners(VEHICLE, 1.0)
