"""The corners of a vehicle's ranges, and the loop at the worst of them."""

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import build_law, load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import cruise_loop, law_corners
from surctl.marine.verification.corners import corners
from surctl.verification.sampled_margins import SampledLoop

VEHICLE = load_vehicle("sur540-flooded")
GAINS = load_gains("default")


@pytest.mark.parametrize("k_i", [0.0, 0.2])
def test_short_periods_have_the_slowest_pole_of_the_loop_without_delay(k_i: float) -> None:
    short = cruise_loop(VEHICLE, {**GAINS.values, "k_i": k_i}, cruise=0.15, dt=1e-4)
    (A, B, _, C, _), (Az, By, _, _, _, _) = short.plant, short.law
    n = len(Az) - 4  # the thrusts that wait are the last states of the law
    Cz, D = Az[n:, :n], By[n:]
    continuous = np.block([[A + B @ D @ C, B @ Cz], [By[:n] @ C / 1e-4, (Az[:n, :n] - np.eye(n)) / 1e-4]])
    assert short.rates.real.max() == pytest.approx(np.linalg.eigvals(continuous).real.max(), rel=1e-3)


def test_the_worst_corner_is_that_of_all_corners_one_by_one() -> None:
    tried = corners(VEHICLE, 0.3)
    found = law_corners(build_law(), tried, GAINS, cruise=0.2)
    each = {
        name: SampledLoop(cruise_loop(plant, GAINS.values, cruise=0.2, dt=0.05, model=VEHICLE)).disk
        for name, plant in zip(tried.labels, tried.vehicles, strict=True)
    }
    worst = min(each, key=lambda name: each[name])
    assert (found.corner, found.disk) == (worst, pytest.approx(each[worst], rel=1e-9))


def test_masses_of_surge_and_sway_that_differ_may_turn_it_broadside() -> None:
    together, apart = (corners(VEHICLE.with_values({"m22": m})) for m in (VEHICLE["m22"], (1 + 1e-9) * VEHICLE["m22"]))
    assert (len(together.vehicles), len(apart.vehicles)) == (33, 65)
    assert all(v["m11"] == v["m22"] for v in together.vehicles)
    assert corners(load_vehicle("sur400")).labels[1] == "mass -5%, drag -20%"  # its file states no ranges
    assert len(corners(VEHICLE, known=["m11", "m22", "m33", "m44", "Nr", "Xuu"]).vehicles) == 1
    found = law_corners(build_law(), apart, GAINS, cruise=0.15)
    assert not found.stable and "UNSTABLE" in "".join(found.lines())


def test_corners_that_cannot_cruise_are_counted() -> None:
    told = law_corners(build_law(), corners(VEHICLE), GAINS, cruise=0.2)
    assert "16 of them cannot hold 0.2 m/s" in told.of and (told.count, len(told.lost)) == (32, 16)
    with pytest.raises(InputError, match=r"cruise = 0\.9"):
        law_corners(build_law(), corners(VEHICLE, 0.2), GAINS, cruise=0.9)


def test_bad_numbers_are_named() -> None:
    with pytest.raises(InputError, match="uncertainty = 1"):
        corners(VEHICLE, 1.0)
