from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import cruise_loop
from surctl.marine.verification.cruise_loop import POSE, THRUSTS
from surctl.verification import system_margins
from surctl.verification.linear import OpenLoop, _balanced, disk_margin, stored_disk_margin, structured_bounds
from surctl.verification.sampled_margins import open_loop

GAINS = {"k1": 0.3, "k2": 0.3, "k_psi": 0.6, "k_r": 1.5, "k_v": 1.5, "lookahead": 1.2}
VEHICLE = load_vehicle("sur540-flooded")
LOOP = cruise_loop(VEHICLE, GAINS, cruise=0.15, dt=0.05)
PLACES = {**LOOP.places, "both": (*THRUSTS, *POSE)}


def of(system: control.StateSpace) -> OpenLoop:
    return OpenLoop(*(np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D)))


def satellite() -> OpenLoop:
    # Packard, Doyle: the spinning satellite, plant and controller; every single loop has the margin of an integrator
    plant = control.ss([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], np.zeros((2, 2)))
    return of(plant * control.ss([], [], [], [[1, -2], [0, 1]]))


def random_matrix(q: int, seed: int) -> NDArray[np.complex128]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(q, q)) + 1j * rng.normal(size=(q, q))


def test_one_channel_has_the_margin_of_python_control() -> None:
    loop = control.tf([4.0], [1.0, 3.0, 3.0, 1.0])
    found = disk_margin(of(control.ss(loop)))
    expected, gain, phase = control.disk_margins(loop, np.geomspace(1e-1, 1e1, 5_001))
    assert found.reached == pytest.approx(expected, rel=1e-4)
    assert found.guaranteed == pytest.approx(expected, rel=1e-4) and found.guaranteed < expected
    assert found.phase_deg == pytest.approx(phase, rel=1e-4)
    assert 20 * np.log10(found.gain[1]) == pytest.approx(gain, rel=1e-4)


def test_loops_that_do_not_touch_have_the_least_of_theirs() -> None:
    one, other = (control.ss(control.tf([k], [1.0, 3.0, 3.0, 1.0])) for k in (2.0, 5.0))
    both = disk_margin(of(control.append(one, other)))
    assert both.reached == pytest.approx(disk_margin(of(other)).reached, rel=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_a_loop_that_only_drives_another_takes_nothing_from_its_margin(seed: int) -> None:
    # the scaling that decouples a triangular M has no bound; channels have units of their own
    rng = np.random.default_rng(seed)
    loops = [control.ss(control.tf([k], [1.0, 3.0, 3.0, 1.0])) for k in rng.uniform(1.0, 6.0, 3)]
    chain = of(control.append(*loops))
    units = 10.0 ** rng.uniform(-6, 6, 3)
    for driven, driver in ((1, 0), (2, 0), (2, 1)):
        ahead = rng.normal(0.0, 2.0, 3)  # static forces of one loop's states on the next
        chain.A[3 * driven : 3 * driven + 3, 3 * driver : 3 * driver + 3] += np.outer(ahead, rng.normal(0.0, 1.0, 3))
    chain = OpenLoop(chain.A, chain.B / units, units[:, None] * chain.C, chain.D)
    least = min(disk_margin(of(one)).reached for one in loops)
    result = disk_margin(chain)
    assert result.reached == pytest.approx(least, rel=1e-3)
    assert result.guaranteed == pytest.approx(least, rel=3e-3)


def test_the_satellite_bears_far_less_in_all_loops_than_in_each() -> None:
    loop = satellite()
    together = disk_margin(loop)
    each = []
    for k in range(2):
        rest = [j for j in range(2) if j != k]
        inner = loop.A - loop.B[:, rest] @ loop.C[rest]
        each.append(disk_margin(OpenLoop(inner, loop.B[:, [k]], loop.C[[k]], np.zeros((1, 1)))).reached)
    assert together.reached < 0.5 * min(each)


@pytest.mark.parametrize("place", PLACES)
def test_the_perturbation_that_is_found_destabilises_and_none_smaller_by_the_bound_does(place: str) -> None:
    loop = open_loop(LOOP, *PLACES[place])
    found = disk_margin(loop, place)
    q = len(loop.D)
    assert found.stable and found.guaranteed <= found.reached <= 1.01 * found.guaranteed
    L = loop.response(loop.warped(np.array([found.frequency_rad_s])))[0]
    S, T = np.linalg.inv(np.eye(q) + L), L @ np.linalg.inv(np.eye(q) + L)
    delta = structured_bounds((S - T) / 2)[2]
    assert np.max(np.abs(delta)) == pytest.approx(found.reached, rel=1e-6)
    factors = np.diag((2 + delta) / (2 - delta))
    assert np.min(np.linalg.svd(np.eye(q) + factors @ L)[1]) < 1e-6  # a pole on the axis


def test_no_gains_inside_the_margin_destabilise() -> None:
    loop, rng = open_loop(LOOP, *PLACES["both"]), np.random.default_rng(5)
    low, high = disk_margin(loop).gain
    draws = np.exp(rng.uniform(np.log(low), np.log(high), size=(200, 8)))
    draws[:100] = np.where(rng.uniform(size=(100, 8)) < 0.5, low, high)
    for factors in draws:
        scaled = OpenLoop(loop.A, loop.B, factors[:, None] * loop.C, factors[:, None] * loop.D)
        assert np.linalg.eigvals(scaled.complementary().A).real.max() < 0


def test_all_thrusts_at_once_bear_no_more_than_the_worst_of_them() -> None:
    for signals in LOOP.places.values():
        least = min(m.disk_margin for m in system_margins(LOOP, *signals))
        assert disk_margin(open_loop(LOOP, *signals)).guaranteed <= least


def test_a_peak_between_the_points_of_the_grid_is_not_missed() -> None:
    # a resonance of 1e-6 relative width, far below the spacing of any grid, right where the loop is small
    narrow = control.tf([2e-6 * 7.3, 0], [1, 2e-6 * 7.3, 7.3**2])
    loop = control.ss(control.tf([0.2], [1, 1])) - 0.8 * control.ss(narrow)
    found = disk_margin(of(loop))
    exact, _, _ = control.disk_margins(loop, np.linspace(7.3 * (1 - 5e-6), 7.3 * (1 + 5e-6), 4001))
    assert found.guaranteed <= exact * (1 + 1e-6)
    assert found.guaranteed == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize(("q", "seed"), [(2, 1), (3, 2), (3, 3)])
def test_the_bounds_meet_up_to_three_channels(q: int, seed: int) -> None:
    upper, lower, delta = structured_bounds(random_matrix(q, seed))
    assert lower <= upper <= lower * (1 + 1e-4)
    assert abs(np.linalg.det(np.eye(q) - np.diag(delta) @ random_matrix(q, seed))) < 1e-8


SLICOT = (3.246844503377368, 3.5397540520025426, 3.828678051097516, 4.787720240803036)
"""ab13md of slycot 0.7.1: `ab13md(random_matrix(4, seed), ones(4), 2 * ones(4))[0]` for seeds 0 to 3."""


def test_the_upper_bound_is_that_of_slicot() -> None:
    for seed, theirs in enumerate(SLICOT):
        assert structured_bounds(random_matrix(4, seed))[0] == pytest.approx(theirs, rel=1e-5)


def test_scalings_balance_rows_and_columns_of_every_frequency() -> None:
    matrices = np.array([random_matrix(4, seed) * 10.0 ** np.arange(-4, 4, 2) for seed in range(20)])
    d, height = _balanced(matrices)
    size = np.abs(d[:, :, None] * matrices / d[:, None]) ** 2
    np.testing.assert_allclose(
        size.sum(axis=1), size.sum(axis=2), rtol=1e-5
    )  # Osborne's condition; the diagonal is in both
    np.testing.assert_allclose(height, [np.linalg.norm(_balanced(one[None])[1]) for one in matrices], rtol=1e-6)


def test_integral_action_stays_closed_when_the_thrust_is_opened() -> None:
    loop = cruise_loop(VEHICLE, {**GAINS, "k_i": 0.2}, cruise=0.15, dt=0.05)
    for signals in PLACES.values():
        closed = np.linalg.eigvals(open_loop(loop, *signals).complementary().A)
        poles = np.log((1 + closed) / (1 - closed)) / 0.05
        assert np.sort(poles.real) == pytest.approx(np.sort(loop.rates.real), abs=1e-5)


def test_an_unstable_loop_has_nothing_left_and_a_wrong_place_is_named() -> None:
    bad = cruise_loop(VEHICLE, {**GAINS, "k_psi": 60.0}, cruise=0.15, dt=0.05)
    found = disk_margin(open_loop(bad, *THRUSTS))
    assert not found.stable and (found.guaranteed, found.gain) == (0.0, (1.0, 1.0))
    with pytest.raises(InputError, match=r"opening = 'swayy'.*sway"):
        open_loop(LOOP, "swayy")


def test_a_stored_margin_is_the_computed_one_and_another_loop_has_its_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path / "cache"))
    loop, faster = (open_loop(cruise_loop(VEHICLE, GAINS, cruise=u, dt=0.05), *THRUSTS) for u in (0.15, 0.1))
    first = stored_disk_margin(loop, "thrust")
    assert first == disk_margin(loop, "thrust")

    def none(_: object) -> None:
        raise AssertionError("computed again")

    monkeypatch.setattr("surctl.verification.linear.disk_margin", none)
    assert stored_disk_margin(loop, "there") == replace(first, place="there")
    with pytest.raises(AssertionError, match="computed again"):
        stored_disk_margin(faster, "thrust")
