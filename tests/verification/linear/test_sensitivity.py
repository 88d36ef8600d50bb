"""The sensitivities of all loops at once, over frequency."""

import control
import numpy as np
import pytest

from surctl.marine.control import load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import cruise_loop
from surctl.system import LinearLoop
from surctl.system.linear_loop import LoopNames
from surctl.tuning.loop_responses import sensitivities_at, sensitivity_curves

GAINS = load_gains("default").values


def test_all_loops_together_are_deaf_to_fast_noise() -> None:
    loop = cruise_loop(load_vehicle("sur400"), GAINS, cruise=0.15, dt=0.05)
    pose = loop.places["measurements"]
    omega, S, T = sensitivity_curves(loop, pose)
    near = omega[S.argmax()] * np.linspace(0.99, 1.01, 1001)
    assert S.max() == pytest.approx(sensitivities_at(loop, pose, near)[0].max(), rel=1e-9)
    assert T[-1] < 0.02 and S[-1] == pytest.approx(1, abs=0.02) and np.all(S + T >= 1 - 1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_units_of_the_signals_do_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    B, C = rng.normal(size=(4, 3)), rng.normal(size=(3, 4))
    A = np.diag(-rng.uniform(0.5, 3.0, 4)) - np.eye(4)
    C *= 0.5 / np.abs(C @ B).max()  # weak enough to be stable
    units = 10.0 ** rng.integers(-4, 5, 3)
    names = tuple("abc")

    def loop(units: np.ndarray) -> LinearLoop:
        none = np.zeros((3, 0))
        law = (np.zeros((0, 0)), none.T, np.zeros((0, 0)), none, -np.eye(3), none)
        labels = LoopNames("plant", "law", tuple("wxyz"), (), names, names, names)
        return LinearLoop((A, B / units, np.zeros((4, 0)), units[:, None] * C, none), law, labels, 0.02)

    omega = np.geomspace(0.01, 100.0, 50)
    own, other = (sensitivities_at(loop(each), names, omega) for each in (np.ones(3), units))
    assert own == pytest.approx(other, rel=1e-4)
    Ad, Bd, Cd, D = loop(np.ones(3)).opened(*names)
    S = np.linalg.inv(np.eye(3) + control.ss(Ad, Bd, Cd, D, 0.02)(np.exp(0.02j * omega)).transpose(2, 0, 1))
    assert np.all(np.linalg.norm(S, 2, axis=(1, 2)) * (1 + 1e-9) >= own[0])
    assert np.all(np.abs(np.linalg.eigvals(S)).max(axis=1) * (1 - 1e-9) <= own[0])
