from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError, ToolMissing
from surctl.export import Records, software_in_the_loop
from surctl.export.sil import _difference
from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from tests.export.standin import StandIn, StandInStep, recorded, stand_in
from tests.tools import need_compiler


def test_a_closed_run_agrees(tmp_path: Path) -> None:
    need_compiler()
    law = stand_in()
    run = recorded(law)
    report = software_in_the_loop(law, run, workdir=tmp_path / "sil")
    assert report.passed, report.summary()
    assert report.resets == () and report.steps == 200
    assert report.tau.mixed <= 1e-12 and report.state.mixed == 0.0
    assert report.fault_cases == 3 * (law.state.size + law.inputs.size + law.gains.size) + 6  # samples, NULL
    statuses = {law.step(x, u, run.P).status for x, u in zip(run.X, run.U, strict=True)}
    assert statuses >= {0, 1, 2, 3}  # the run must reach every branch, or it shows little
    assert (tmp_path / "sil" / "manifest.json").exists()
    assert "passed over 200 steps" in report.summary()


def test_triples_and_gains_that_change_are_taken() -> None:
    need_compiler()
    law = stand_in()
    x, triples = law.initial_state(), []
    for k in range(5):
        p, u = law.gains.pack({"limit": 1.0 + k}), law.inputs.pack({"eta": [3.0, k, 1.0, 9.0]})
        triples.append((x, u, p))
        x = law.step(x, u, p).x_next
    assert software_in_the_loop(law, triples).passed


def test_c_steps_on_its_own_state_and_resets_are_counted() -> None:
    need_compiler()
    law = stand_in()
    run = recorded(law, steps=30)
    X = run.X.copy()
    X[10] = law.state.pack({"memory": np.full((2, 3), 7.0)})
    report = software_in_the_loop(law, replace(run, X=X))
    assert report.passed
    # step 10 was set from outside; what followed was recorded after another state
    assert report.resets[0] == 10
    assert "loaded anew" in report.summary()


def test_refused_inputs_within_a_run_agree_too() -> None:
    need_compiler()
    law = stand_in()
    rng, x, p = np.random.default_rng(2), law.initial_state(), law.gains.pack()
    triples = []
    for k in range(20):
        u = rng.normal(0.0, 3.0, law.inputs.size)
        u[0] = np.nan if k in (5, 6) else u[0]
        triples.append((x, u, p))
        x = law.step(x, u, p).x_next
    report = software_in_the_loop(law, triples)
    assert report.passed and report.resets == ()


class Careless(StandIn):
    """Lets a NaN through to the clamp, which turns it into a number."""

    def step(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> StandInStep:
        with np.errstate(all="ignore"):
            return super().step(np.nan_to_num(x), np.nan_to_num(u), np.nan_to_num(p))


class Thrusting(StandIn):
    """Reports the fault, and thrusts all the same."""

    def step(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> StandInStep:
        step = super().step(x, u, p)
        return step._replace(tau=np.ones(4)) if step.status < 0 else step


class Biased(StandIn):
    """Drifts from its own symbolic function."""

    def step(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> StandInStep:
        step = super().step(x, u, p)
        return step._replace(tau=step.tau * (1 + 1e-10) if step.status >= 0 else step.tau)


class OtherStatus(StandIn):
    """Reports another status than its function."""

    def step(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> StandInStep:
        step = super().step(x, u, p)
        return step._replace(status=step.status | 4 if step.status >= 0 else step.status)


def like(law: StandIn, kind: type[StandIn]) -> StandIn:
    return kind(**{name: getattr(law, name) for name in StandIn.__dataclass_fields__})


@pytest.mark.parametrize("kind", [Careless, Thrusting])
def test_a_missing_guard_fails(kind: type[StandIn]) -> None:
    need_compiler()
    law = stand_in()
    report = software_in_the_loop(like(law, kind), recorded(law, steps=5))
    assert not report.passed
    assert "u.eta[0] = nan (Python)" in report.fault_failures


def test_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    need_compiler()
    law = stand_in()
    software_in_the_loop(law, recorded(law, steps=3))
    assert capfd.readouterr() == ("", "")


def test_small_differences_and_other_statuses_fail() -> None:
    need_compiler()
    law = stand_in()
    run = recorded(law, steps=20)
    biased = software_in_the_loop(like(law, Biased), run)
    assert not biased.passed and biased.tau.relative == pytest.approx(1e-10, rel=1e-3)
    other = software_in_the_loop(like(law, OtherStatus), run)
    assert not other.passed and other.status_mismatches == 20 and other.tau.mixed <= 1e-12


@pytest.mark.parametrize(("state", "telemetry"), [(True, False), (False, True), (False, False)])
def test_laws_without_state_or_telemetry(state: bool, telemetry: bool) -> None:
    need_compiler()
    law = stand_in(telemetry=telemetry) if state else stand_in(state=(), telemetry=telemetry)
    assert software_in_the_loop(law, recorded(law, steps=10)).passed


def test_a_law_of_thrust_alone_is_clean_at_the_highest_level(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compilers look further with -O3: into arrays that would be empty."""
    need_compiler()
    law = stand_in(state=(), telemetry=False)
    monkeypatch.setenv("SURCTL_CFLAGS", "-O3")
    assert software_in_the_loop(law, recorded(law, steps=3)).passed


def test_a_law_without_inputs() -> None:
    need_compiler()
    law = stand_in(inputs=())
    assert software_in_the_loop(law, recorded(law, steps=10)).passed


def test_records_that_do_not_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    law = stand_in()
    run = recorded(law, steps=3)
    with pytest.raises(InputError, match="no step"):
        software_in_the_loop(law, [])
    with pytest.raises(InputError, match=r"records\.U.*expected \(3, 11\)"):
        software_in_the_loop(law, Records(run.X, run.U[:, :2], run.P))
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(ToolMissing, match="CC"):
        software_in_the_loop(law, run)


def test_differences_are_honest_about_what_is_not_finite() -> None:
    have, want = np.array([[1.0, np.nan], [np.inf, 2.0]]), [np.array([1.0, np.nan]), np.array([np.inf, 2.0])]
    assert _difference(have, want).mixed == 0.0
    worse = _difference(np.array([[1.0], [np.nan]]), [np.array([1.0]), np.array([2.0])])
    assert worse.mixed == np.inf and worse.step == 1
    long = np.zeros((700, 2))
    long[600, 1] = 0.5
    assert _difference(long, [np.zeros(2)] * 700).step == 600
    small = _difference(np.array([[1e-3 + 1e-6]]), [np.array([1e-3])])
    assert small.mixed == pytest.approx(1e-6) and small.relative == pytest.approx(1e-3)


def test_the_law_with_limits_ships_with_its_solver() -> None:
    """A flight towards the cylinders by the law with its priority solver inside: C as exported, against Python."""
    need_compiler()
    law, scenario = build_law(mode="projected"), replace(load_scenario("pool-static"), time_limit=2.0)
    record = simulate(scenario, load_vehicle(scenario.vehicle), gains=load_gains("default"), law=law, seed=0).record
    report = software_in_the_loop(law, Records(record.law_state, record.law_input, record.law_parameters))
    assert report.conclusive, report.summary()
    assert report.tau.absolute == report.state.absolute == 0.0
    assert report.steps == 40
    assert report.fault_cases > 300 and not report.fault_failures
