import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from surctl.errors import InputError
from surctl.marine.verification import claims
from surctl.verification import Counterexample, falsify, replay

REFUTED = [c.name for c in claims() if c.expected == "refuted"]
LYAPUNOV = ["v1-printed", "v1-speed-cap", "course-printed", "v2-printed", "v2-obstacle", "v2-clockwise"]


@pytest.mark.parametrize("name", REFUTED[::2])
def test_every_counterexample_is_confirmed_from_its_json(name: str) -> None:
    claim = claims(names=[name])[0]
    found = falsify(claim, samples=1024).counterexample
    assert found is not None
    back = Counterexample.from_dict(json.loads(json.dumps(found.to_dict())))
    run = replay(claim, back)
    assert run.confirmed and run.margin == pytest.approx(back.margin, rel=1e-12)
    json.dumps(run.to_dict(), allow_nan=False)


@pytest.mark.parametrize("name", LYAPUNOV)
def test_the_lyapunov_function_grows_by_what_the_margin_integrates_to(name: str) -> None:
    claim = claims(names=[name])[0]
    found = falsify(claim, samples=1024).counterexample
    assert found is not None
    run = replay(claim, found)
    assert run.watched[-1] > run.watched[0]
    # V from the states, the excess from the margin: two ways to one number
    assert run.watched - run.watched[0] == pytest.approx(run.excess, abs=1e-9)


def test_the_clearance_falls_faster_than_the_barrier_allows() -> None:
    claim = claims(names=["clearance-printed"])[0]
    run = replay(
        claim,
        Counterexample(
            {"e2": 0.0, "phi": np.deg2rad(135), "psi_ob": 0.0, "u_ob": 0.0, "u": 0.22, "delta": 0.0},
            0.22,
            "m/s",
        ),
    )
    assert run.confirmed
    assert run.watched[1] == pytest.approx(-0.22 * run.time[1], rel=1e-3)  # straight at it
    assert np.all(np.diff(run.watched) < 0) and run.watched[-1] < -0.08


def test_polar_motion_equals_two_points_in_the_plane() -> None:
    claim = claims(names=["v2-obstacle"])[0]
    values = {"e2": -0.05, "phi": 0.4, "psi_ob": -2.5, "u_ob": 0.15, "u": 0.22, "delta": 0.0}
    run = replay(claim, Counterexample(values, 0.0, "m^2/s"))

    def plane(_: float, state: np.ndarray) -> np.ndarray:
        offset = state[2:] - state[:2]
        bearing, gap = np.arctan2(offset[1], offset[0]), np.hypot(*offset) - 0.5
        course = bearing + np.pi / 2 - np.arctan(gap / 0.5)
        return np.array([0.22 * np.cos(course), 0.22 * np.sin(course), 0.15 * np.cos(-2.5), 0.15 * np.sin(-2.5)])

    start = np.array([0, 0, 0.45 * np.cos(0.4), 0.45 * np.sin(0.4)])
    flown = solve_ivp(plane, (0, run.time[-1]), start, rtol=1e-10, atol=1e-12)
    gap = np.hypot(*(flown.y[2:, -1] - flown.y[:2, -1])) - 0.5
    assert run.watched[-1] == pytest.approx(gap**2 / 2, abs=1e-9)


def test_a_point_where_the_claim_holds_is_not_confirmed() -> None:
    claim = claims(names=["v1-printed"])[0]
    holds = Counterexample({"x_e": 0.1, "y_e": 0.1, "z_e": 0.1, "turn": 0.0}, 1.0, "m^2/s")
    assert not replay(claim, holds).confirmed  # whatever margin it says it has
    outside = Counterexample({"x_e": 3.0, "y_e": 3.0, "z_e": 0.0, "turn": 0.0}, 1.0, "m^2/s")
    run = replay(claim, outside)
    assert run.margin > 0 and not run.confirmed


def test_the_replay_ends_with_the_violation() -> None:
    # head-on: V2 grows until the obstacle has come past
    claim = claims(names=["v2-obstacle"])[0]
    assert claim.motion is not None
    longer = replace(claim, motion=replace(claim.motion, duration=20.0))
    values = {"e2": -0.05, "phi": 0.0, "psi_ob": np.pi, "u_ob": 0.15, "u": 0.22, "delta": 0.0}
    run = replay(longer, Counterexample(values, 0.0, "m^2/s"))
    assert run.confirmed and 0.5 < run.time[-1] < 10
    assert np.all(np.diff(run.watched[:-1]) > 0)


def test_wrong_names_are_the_users_mistake() -> None:
    claim = claims(names=["course-printed"])[0]
    with pytest.raises(InputError, match="no such variable"):
        replay(claim, Counterexample({"y_e": 0.1, "u": 0.15, "v": 0.05, "w": 0.0}, 0.0, "m^2/s"))
