import control
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import cruise_loop
from surctl.marine.verification.linear import open_loop
from surctl.verification.linear import OpenLoop, sensitivity_of

GAINS = load_gains("default").values


def test_one_loop_has_the_sensitivity_of_python_control() -> None:
    system = control.tf([4.0], [1.0, 3.0, 3.0, 1.0])
    ss = control.ss(system)
    found = sensitivity_of(OpenLoop(*(np.asarray(m) for m in (ss.A, ss.B, ss.C, ss.D))), "here", highest=50.0)
    s = 1j * found.omega
    assert pytest.approx(np.abs(1 / (1 + system(s))), rel=1e-9) == found.S
    assert pytest.approx(np.abs(system(s) / (1 + system(s))), rel=1e-9) == found.T
    assert found.to_dict()["peak_S"] == found.S.max() > 1


def test_all_loops_together_are_deaf_to_fast_noise_and_an_unstable_one_has_no_response() -> None:
    loop = cruise_loop(load_vehicle("sur400"), GAINS, cruise=0.15, dt=0.05)
    found = sensitivity_of(open_loop(loop, "measurement"), "measurement", highest=60.0)
    assert found.T[-1] < 0.02 and found.S[-1] == pytest.approx(1, abs=0.02) and np.all(found.S + found.T >= 1 - 1e-9)
    with pytest.raises(InputError, match="is unstable"):
        wu = cruise_loop(load_vehicle("bluerov2-wu"), GAINS, cruise=0.47, dt=0.05)
        sensitivity_of(open_loop(wu, "thrust"), "thrust", highest=60.0)


@pytest.mark.parametrize("seed", range(4))
def test_the_units_of_the_signals_do_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    B, C, D = rng.normal(size=(4, 3)), rng.normal(size=(3, 4)), np.zeros((3, 3))
    A = np.diag(-rng.uniform(0.5, 3.0, 4)) - np.eye(4)
    C *= 0.5 / np.abs(C @ B).max()  # weak enough to be stable
    units = 10.0 ** rng.integers(-4, 5, 3)
    own = sensitivity_of(OpenLoop(A, B, C, D), highest=50.0)
    other = sensitivity_of(OpenLoop(A, B / units, units[:, None] * C, D), highest=50.0)
    assert pytest.approx(own.S, rel=1e-4) == other.S and pytest.approx(own.T, rel=1e-4) == other.T
    at = 1j * own.omega[:, None, None]
    S = np.linalg.inv(np.eye(3) + C @ np.linalg.solve(at * np.eye(4) - A, np.broadcast_to(B, (len(own.omega), 4, 3))))
    assert np.all(np.linalg.norm(S, 2, axis=(1, 2)) * (1 + 1e-9) >= own.S)
    assert np.all(np.abs(np.linalg.eigvals(S)).max(axis=1) * (1 - 1e-9) <= own.S)
