"""The slowest mode: its states, its cause, and what makes an unstable loop stable."""

from pathlib import Path

import numpy as np
import pytest

from surctl.marine.control import build_law, load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import cruise_loop, law_corners
from surctl.marine.verification.corners import corners
from surctl.marine.verification.cruise_loop import THRUSTS
from surctl.marine.verification.linear import bearable_speed, slowest_mode
from surctl.verification.linear import DiskMargin, disk_margin
from surctl.verification.sampled_margins import open_loop

GAINS = load_gains("default").values
WU = load_vehicle("bluerov2-wu")  # 17 kg in surge, 24.2 kg in sway


def stable(cruise: float, **gains: float) -> bool:
    return cruise_loop(WU, {**GAINS, **gains}, cruise=cruise, dt=0.05).stable


def test_an_unstable_loop_names_the_munk_moment_and_what_stabilises_it() -> None:
    mode = slowest_mode(WU, GAINS, cruise=0.25, dt=0.05)
    assert not mode.stable and mode.real == pytest.approx(cruise_loop(WU, GAINS, cruise=0.25, dt=0.05).rates[0].real)
    assert mode.cause == "Munk moment (m22 - m11) u v" and mode.without[mode.cause] < -0.3
    assert next(iter(mode.participation)) == "psi" and sum(mode.participation.values()) == pytest.approx(1, abs=0.01)
    # a larger k_r stabilises, which "lower k_v and k_r" would not have told
    assert set(mode.remedies) == {"k_psi", "k_r"} and mode.remedies["k_r"] > GAINS["k_r"]
    assert all(stable(0.25, **{name: value}) for name, value in mode.remedies.items())
    assert stable(0.99 * mode.bearable) and not stable(1.01 * mode.bearable)
    text = "\n".join(mode.lines())
    assert "UNSTABLE at 0.25 m/s" in text and "caused by the Munk moment" in text and "k_r = " in text


def test_with_one_mass_there_is_no_munk_moment_and_the_thrust_bounds_the_speed() -> None:
    vehicle = load_vehicle("sur400")
    mode = slowest_mode(vehicle, GAINS, cruise=0.15, dt=0.05)
    assert mode.stable and mode.cause is None and not mode.remedies
    assert next(iter(mode.participation)) == "y" and "UNSTABLE" not in "".join(mode.lines())
    linear, quadratic, most = (vehicle[name] for name in ("Xu", "Xuu", "Fu_max"))
    held = np.roots([quadratic, linear, -most]).max()
    assert bearable_speed(corners(vehicle).alone, GAINS, dt=0.05) == pytest.approx(held, rel=1e-6)


def test_participation_is_that_of_the_mode_s_residue() -> None:
    # p_k = dλ/da_kk: what the pole moves by when a state's own rate does
    loop = cruise_loop(WU, GAINS, cruise=0.2, dt=0.05)
    mode = slowest_mode(WU, GAINS, cruise=0.2, dt=0.05)
    scale = abs(_moved(loop.transition, 3)) / mode.participation["psi"]
    for name, k in (("v", 5), ("r", 7)):
        assert abs(_moved(loop.transition, k)) == pytest.approx(scale * mode.participation[name], rel=1e-3)


def _moved(closed: np.ndarray, k: int) -> float:
    nudged = closed.copy()
    nudged[k, k] += 1e-6
    return float((np.linalg.eigvals(nudged).real.max() - np.linalg.eigvals(closed).real.max()) / 1e-6)


def test_a_disk_margin_that_cannot_be_shown_is_not_judged_and_ends_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path / "cache"))  # this result must not be stored for others
    monkeypatch.setattr("surctl.verification.linear._STEPS", 0)
    loop = open_loop(cruise_loop(WU, GAINS, cruise=0.15, dt=0.05), *THRUSTS)
    found: DiskMargin = disk_margin(loop)
    assert found.stable and np.isnan(found.guaranteed) and found.reached > 0
    loops = law_corners(build_law(), corners(WU).alone, load_gains("default"), cruise=0.15)
    assert loops.stable and np.isnan(loops.disk)
    assert "all commands at once: disk margin not determined" in "\n".join(loops.lines())
