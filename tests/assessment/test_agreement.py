"""One number for one figure: assessment, sweep columns, derived gains, `verify`, `simulate`, for drawn vehicles."""

from dataclasses import replace

import numpy as np
import pytest

from surctl.assessment import assess
from surctl.marine.assessment import Mission
from surctl.marine.control import Gains, build_law, load_gains, write_gains
from surctl.marine.tuning import derive_gains
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification import law_corners, linear_table
from tests.cli.process import surctl_here

DT = 0.05
COLUMNS = ("disk_margin", "single_loop_disk_margin", "delay_margin_s", "slowest_pole_per_s")


def drawn(seed: int) -> tuple[Vehicle, Gains, float]:
    """A vehicle with or without ranges, gains from weak to wild, and a cruise speed."""
    rng = np.random.default_rng(seed)
    base = load_vehicle(("sur400", "sur540-flooded", "bluerov2-wu")[seed % 3])
    values = {n: base[n] * rng.uniform(0.8, 1.25) for n in ("m33", "m44", "Xu", "Nr", "thrust_lag")}
    parameters = dict(base.parameters)
    for name, value in values.items():
        span = parameters[name].range and tuple(float(value / base[name] * end) for end in parameters[name].range)
        parameters[name] = replace(parameters[name], value=float(value), range=span)
    gains = load_gains("default")
    gains = gains.with_values({n: gains[n] * rng.uniform(0.5, 2.0) for n in ("k_v", "k_r", "k_psi", "lookahead", "k1")})
    return replace(base, name=f"drawn{seed}", parameters=parameters), gains, float(rng.uniform(0.08, 0.2))


@pytest.mark.parametrize("seed", range(3))  # 43_one_verdict: hundreds
def test_every_source_of_a_figure_has_the_same_number(seed: int) -> None:
    vehicle, gains, cruise = drawn(seed)
    result = assess(Mission(vehicle, gains, cruise, 0.3), parts=["loop"])
    table = linear_table(vehicle, {}, base=gains.values, cruise=cruise, dt=DT, columns=COLUMNS)
    for name in COLUMNS:
        assert table[name][0] == pytest.approx(result.figures[name].value, rel=2e-3, abs=1e-9), name
    disk = result.figures["disk_margin"]
    fast = law_corners(build_law(), vehicle, gains, cruise=cruise, proved=False)
    assert fast.disk == pytest.approx(disk.value, rel=2e-3) and fast.corner == disk.where
    delay = result.figures["delay_margin_s"]
    assert (fast.delay.delay_s, fast.delay.where) == (pytest.approx(delay.value), delay.where)
    assert delay.value <= result.figures["nominal_delay_margin_s"].value
    assert disk.value <= result.figures["nominal_disk_margin"].value * (1 + 5e-3)
    assert result.passed is (disk.enough and delay.enough) is fast.enough


def test_derived_gains_state_the_margin_that_is_assessed() -> None:
    vehicle, cruise = load_vehicle("bluerov2-wu"), 0.24  # the formulae alone have a delay margin below 0.2 s
    derivation = derive_gains(vehicle, cruise=cruise)
    result = assess(Mission(vehicle, derivation.gains, cruise, 0.3), parts=["loop"])
    assert result.figures["disk_margin"].value == derivation.disk_margin
    assert result.figures["delay_margin_s"].value == pytest.approx(derivation.delay_margin_s, rel=1e-9)
    assert derivation.reached and result.accepted() and derivation.searched


@pytest.mark.parametrize("law_gains", ["default", "weak"])
def test_verify_and_simulate_say_what_is_assessed(law_gains, tmp_path) -> None:
    vehicle, gains = load_vehicle("bluerov2-wu"), load_gains("default")
    if law_gains == "weak":
        gains = gains.with_values({"k_r": 1.0, "k_psi": 1.2})
    (tmp_path / "g.toml").write_text(write_gains(gains))
    words = ("--vehicle", "bluerov2-wu", "--gains", "g.toml", "--json")
    done = surctl_here("verify", "m-norm-corrected", *words, "--cruise", "0.12", cwd=tmp_path)
    result = assess(Mission(vehicle, gains, 0.12, done.json["cap_m_per_s"]), parts=["loop"])
    told = done.json["assessment"]
    assert told["banner"] == result.banner and told["passed"] is result.passed
    assert {n: f["value"] for n, f in told["figures"].items()} == {n: f.value for n, f in result.figures.items()}
    assert done.status == int(result.passed is False)
    assert done.json["linear"]["worst"]["disk_margin"] == told["figures"]["disk_margin"]["value"]
