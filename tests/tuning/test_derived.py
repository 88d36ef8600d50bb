"""Gains that follow from a vehicle: margins reached or the bearable speed stated, for unequal masses too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.cli.robot_options import choose_gains
from surctl.marine.control import GAINS, Gains, build_law, load_gains, write_gains
from surctl.marine.simulation import findings
from surctl.marine.tuning import default_cruise, derive_gains, derived_gains, gains_for
from surctl.marine.tuning.derived import REQUIRED, held_speed, inner_start, munk_rate, rule, shared_gains
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification import law_corners
from surctl.marine.verification.speeds import check_held
from surctl.verification.linear import LEAST_DISK_MARGIN
from tests.craft import mission

WU, VON_BENZON = load_vehicle("bluerov2-wu"), load_vehicle("bluerov2-vonbenzon")
DT = 0.05


def made(name: str, **values: float) -> Vehicle:
    """A vehicle with other numbers, none of which has a range."""
    base = load_vehicle("sur400")
    changed = {key: replace(base.parameters[key], value=value, range=None) for key, value in values.items()}
    return replace(base, name=name, parameters={**base.parameters, **changed}, source="")


REXROV = made(
    "rexrov", radius=1.3, m11=2643.0, m22=3085.0, m33=5523.0, m44=916.0, Xu=75.0, Yv=69.0, Zw=728.0, Nr=105.0,
    Xuu=748.0, Yvv=993.0, Zww=1821.0, Nrr=523.0, Fu_max=2800.0, Fv_max=2800.0, Fw_max=2800.0, Fr_max=1500.0,
)  # fmt: skip
GIRONA = made(
    "girona500", radius=0.75, m11=147.0, m22=147.0, m33=147.0, m44=40.0, Xu=10.0, Yv=20.0, Zw=20.0, Nr=15.0,
    Xuu=130.0, Yvv=200.0, Zww=200.0, Nrr=30.0, Fu_max=300.0, Fv_max=150.0, Fw_max=150.0, Fr_max=60.0,
)  # fmt: skip


def least(vehicle: Vehicle, gains: Mapping[str, float], cruise: float) -> float:
    whole = load_gains("default").with_values(gains)
    return law_corners(build_law(), vehicle, whole, cruise=cruise, proved=False).disk


def reached(vehicle: Vehicle, gains: Gains, cruise: float) -> float:
    return law_corners(build_law(), vehicle, gains, cruise=cruise).disk


@pytest.mark.parametrize(("vehicle", "cruise"), [(VON_BENZON, 0.17), (GIRONA, 0.51)])  # others: study 40
def test_derived_gains_have_the_margin_of_all_loops_at_once(vehicle: Vehicle, cruise: float) -> None:
    found = derive_gains(vehicle, cruise=cruise)
    assert found.reached and found.disk_margin >= LEAST_DISK_MARGIN
    assert found.disk_margin == reached(vehicle, found.gains, cruise)
    assert found.bearable == cruise and found.warning == ""
    # the margin holds at lower speeds too, where the Munk moment is smaller
    slower = [least(vehicle, found.gains.values, s * cruise) for s in (0.1, 0.5)]
    assert min(slower) >= LEAST_DISK_MARGIN
    assert set(found.gains.values) == set(GAINS)


def test_a_speed_that_no_gains_bear_is_stated_with_the_largest_that_they_do() -> None:
    fast = derive_gains(WU, cruise=0.47)
    assert not fast.reached and fast.searched and 0.3 < fast.bearable < 0.4
    assert reached(WU, fast.gains, 0.47) == fast.disk_margin > 0  # stable: the best set at this speed
    assert reached(WU, derived_gains(WU, cruise=fast.bearable), fast.bearable) >= LEAST_DISK_MARGIN
    head, warning = fast.lines()
    assert head.startswith("gains derived from the vehicle bluerov2-wu at 0.47 m/s, disk margin 0.")
    assert (
        f"reach {REQUIRED} up to at least {fast.bearable:.3g} m/s" in warning
        and "thrust lag" in warning
        and "m44" in warning
    )


def test_wide_ranges_move_the_gains_and_narrow_ones_leave_them() -> None:
    wide = load_vehicle("sur540-jets")  # yaw inertia from a quarter of the nominal one
    found = derive_gains(wide, cruise=0.15)
    formulae = inner_start(wide, cruise=0.15, dt=DT)
    assert found.reached and found.searched and found.gains["k_r"] < formulae[1]
    assert least(wide, rule(wide, formulae, cruise=0.15, dt=DT), 0.15) < LEAST_DISK_MARGIN
    assert not derive_gains(VON_BENZON, cruise=0.15).searched


def test_the_formulae_are_those_documented() -> None:
    assert munk_rate(WU, 0.47) == pytest.approx(0.47 * np.sqrt((24.2 - 17.0) / 0.28))
    assert munk_rate(GIRONA, 0.51) == 0.0
    k_v, k_r, k_psi = inner_start(REXROV, cruise=0.66, dt=DT)
    assert (k_v, k_r, k_psi) == pytest.approx((0.55 / 0.375, 0.55 / 0.375, 0.55 / 0.375 / 2.5))
    slow = inner_start(made("slow", thrust_lag=1.5), cruise=0.15, dt=DT)
    assert slow[0] == pytest.approx(0.55 / 1.575)
    munk = inner_start(WU, cruise=0.47, dt=DT)
    assert munk[1] * munk[2] == pytest.approx(2 * munk_rate(WU, 0.47) ** 2)
    gains = rule(REXROV, np.array([k_v, k_r, k_psi]), cruise=0.66, dt=DT)
    assert gains["lookahead"] == gains["wait"] == pytest.approx(4 * 1.3) and gains["margin"] == pytest.approx(0.26)
    weak = rule(made("weak", Fu_max=0.5, Fv_max=0.5), np.array([1.0, 1.0, 0.5]), cruise=0.1, dt=DT)
    assert weak["lookahead"] == pytest.approx(0.1**2 / 0.01) and weak["k1"] == pytest.approx(0.1)


def test_the_result_does_not_depend_on_anything_but_the_arguments(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from surctl.marine.tuning import derived

    first = derive_gains(WU, cruise=0.15)
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path))
    derived._known.clear()
    again = derive_gains(WU, cruise=0.15)
    assert again is not first and again == first
    derived._known.clear()
    slower = derive_gains(WU, cruise=0.1)
    monkeypatch.setattr(derived, "_derivation", lambda *_: pytest.fail("it is on disk"))
    assert derive_gains(WU, cruise=0.15) == first and slower != first
    derived._known.clear()
    assert derive_gains(WU, cruise=0.1) == slower


def test_built_in_vehicles_keep_the_set_chosen_for_them(tmp_path: Path) -> None:
    for name in ("sur400", "sur540-flooded", "sur540-light"):
        gains, derivation = gains_for(None, load_vehicle(name), cruise=0.2)
        assert derivation is None and gains == load_gains("default")
    assert gains_for("default", WU, cruise=0.15)[0] == load_gains("default"), "a named set applies"
    gains, derivation = gains_for(None, VON_BENZON, cruise=0.2)
    assert derivation is not None and gains == derived_gains(VON_BENZON, cruise=0.2)
    assert "derived from the vehicle bluerov2-vonbenzon at 0.2 m/s" in gains.provenance
    file = tmp_path / "g.toml"
    file.write_text(write_gains(gains))
    assert load_gains(str(file)).values == gains.values
    # a vehicle too weak for the mission's speed gets gains for a speed that it holds
    slower = gains_for(None, VON_BENZON, cruise=2.0)[1]
    assert slower is not None and slower.cruise < 0.5
    assert slower.gains.provenance.endswith("; the thrust cannot hold 2 m/s")
    # a speed that it just holds is not lowered
    held = 0.98 * held_speed(VON_BENZON)
    exact = gains_for(None, VON_BENZON, cruise=held)[1]
    assert exact is not None and exact.cruise == held
    mixed, none = shared_gains(None, [(VON_BENZON, 0.2), (load_vehicle("sur400"), 0.2)])
    assert none is None and mixed == load_gains("default")


def test_mistakes_are_one_line() -> None:
    with pytest.raises(InputError, match=r"cruise = -1\.0: must be greater than 0"):
        derive_gains(WU, cruise=-1.0)
    with pytest.raises(InputError, match="thrust"):
        derive_gains(WU, cruise=3.0)
    assert default_cruise(WU) == 0.48


def test_a_craft_without_sway_force_cruises_beyond_its_limit_astern() -> None:
    """Its mission in both loops is a check of `analysis/40_long_checks`."""
    otter = load_vehicle("otter")  # 239 N ahead, 133 N astern; 2 m/s need 155 N
    derive_gains(otter, cruise=2.0)
    assert choose_gains("default", otter, cruise=2.0).lines == []
    scenario = replace(
        mission([[30.0, 30.0], [60.0, 30.0]], "otter", size=(120.0, 120.0), time=90.0), cruise=2.0, cap=2.2
    )
    assert not [one for one in findings(scenario, otter) if one.level == "error"]
    check_held((2.0,), otter, cap=3.0, key="--cruise")
    with pytest.raises(InputError, match=r"needs thrust \[248"):
        derive_gains(otter, cruise=3.2)


def test_a_cruise_beyond_the_symmetric_limit_of_the_law_is_told_before_any_margin() -> None:
    scow = load_vehicle("otter")
    scow = replace(scow, parameters={**scow.parameters, "Fv_max": replace(scow.parameters["Fv_max"], value=50.0)})
    with pytest.raises(InputError, match="needs 155 N ahead; the law gives at most 133 N, the smaller of") as raised:
        derive_gains(scow, cruise=2.0)
    assert raised.value.key == "cruise" and "raise Fu_reverse" in (raised.value.remedy or "")
    assert choose_gains("default", scow, cruise=2.0).lines == [
        "  warning: at 2 m/s otter needs 155 N ahead; the law gives at most 133 N, the smaller of ahead and astern; "
        "lower the cruise speed or raise Fu_reverse"
    ]


def test_the_speed_that_a_rudder_craft_bears_does_not_hang_on_the_speed_asked_for() -> None:
    # asked for 0.8, 0.87 or 1 m/s, the same craft bears 0.387 m/s
    assert derive_gains(load_vehicle("remus100"), cruise=0.7).bearable == pytest.approx(0.387, rel=0.005)
