from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import (
    avoidance_claims,
    braking_claims,
    claims,
    library,
    settling_intrusion,
    tracking_claims,
)
from surctl.verification import decide, evaluate, falsify, prove, setting_from

ALL = [claim.name for claim in claims()]
PRINTED = [claim.name for claim in claims() if claim.expected == "refuted"]
CORRECTED = [claim.name for claim in claims() if claim.expected == "proved"]
OF_GAINS = [claim.name for claim in claims() if claim.name in CORRECTED and claim.paper]


def one(name: str, gains: dict[str, float] | None = None) -> Any:
    return claims(gains, [name])[0]


@pytest.mark.parametrize("name", [name for name in ALL if name != "v1-speed-cap-region"])
def test_every_claim_comes_out_as_expected(name: str) -> None:
    verdict = decide(one(name))
    assert verdict.as_expected and verdict.verdict == verdict.claim.expected, verdict.to_dict()
    assert (verdict.counterexample is not None) == (name in PRINTED)
    assert (verdict.certificate is not None) == (name in CORRECTED)
    if verdict.certificate is not None:
        assert verdict.certificate["claim"]["slack"] == 0.0


GAINS = [
    {"k1": 0.37, "k2": 0.61, "lookahead": 0.83, "kappa": 0.31, "k3": 1.37},
    {"k1": 1.9, "k2": 0.11, "lookahead": 0.21, "kappa": 0.2072333577977318, "margin": 0.09256033756048328},
]


@pytest.mark.parametrize(
    ("name", "gains"),  # one proof of the claim that is left out takes as long as all of the others
    [(name, GAINS[k % 2]) for k, name in enumerate(OF_GAINS) if name != "v1-speed-cap-region"],
)
def test_corrected_claims_are_proved_for_other_gains(name: str, gains: dict[str, float]) -> None:
    verdict = decide(one(name, gains), samples=512, starts=4)
    assert verdict.verdict == "proved", verdict.to_dict()


def test_the_errata_that_the_reading_calls_wrong_are_all_refuted() -> None:
    refuted = {e for name in PRINTED for e in one(name).errata}
    assert {"E1", "E7", "E8", "E9", "E11", "E12"} <= refuted


gain = st.floats(0.1, 2.0)


@settings(max_examples=1)
@given(k1=gain, k2=gain, k3=st.floats(0.5, 2.0), lookahead=st.floats(0.2, 2.0), kappa=st.floats(0.1, 0.9))
def test_the_verdicts_do_not_hang_on_the_gains(**gains: float) -> None:
    for claim in claims(gains):
        verdict = falsify(claim, samples=256, starts=3)
        assert verdict.as_expected, (gains, verdict.to_dict())


# ---- figures


@pytest.mark.parametrize(
    ("name", "witness", "figure"),
    [
        ("v1-printed", 0, 0.12),
        ("v2-printed", 0, 0.0010945409),
        ("v2-obstacle", 0, 0.0037701269),
        ("v2-clockwise", 0, 0.5 * 0.1993877),
        ("clearance-printed", 0, 0.22),
    ],
)
def test_witnesses_give_the_known_figures(name: str, witness: int, figure: float) -> None:
    assert falsify(one(name), samples=64).witnesses[witness].margin == pytest.approx(figure, rel=1e-6)


def test_share_of_the_box_agrees_with_a_plain_grid() -> None:
    # cell centres of [−2, 2]³, V̇1 written out by hand
    g = (np.arange(80) + 0.5) / 20 - 2
    x, y, z = np.meshgrid(g, g, g, indexing="ij")
    share = np.mean(-0.5 * x**2 - (0.15 - 0.5 * x) * y**2 / 0.5 - 0.5 * z**2 > 0)
    assert share == pytest.approx(0.143, rel=0.01)
    assert falsify(one("v1-printed"), samples=16384, starts=1).fraction == pytest.approx(share, rel=0.01)


def test_first_violation_under_the_cap_is_where_the_closed_form_says() -> None:
    x, y = tracking_claims.cap_limit(setting_from(None))
    assert (x, y) == pytest.approx((5.0, np.sqrt(2)), rel=1e-12)
    claim = one("v1-speed-cap")
    at = {"y_e": y, "z_e": 0.0, "turn": 0.0}
    assert evaluate(claim, {"x_e": -1.001 * x, **at})[0] > 0 > evaluate(claim, {"x_e": -0.999 * x, **at})[0]
    assert falsify(claim.on({"x_e": (-1.001 * x, 0.0)})).verdict == "refuted"


def test_sway_leaves_lookahead_times_v_over_u() -> None:
    claim = one("course-printed")
    at = {"u": 0.15, "v": 0.05}
    assert evaluate(claim, {"y_e": 0.166, **at})[0] > 0 > evaluate(claim, {"y_e": 0.168, **at})[0]


def test_inequality_24_holds_exactly_where_the_condition_says() -> None:
    # (24) iff e2 [u_OB cos(φ − ψ_OB) − u δ/S] ≤ 0, with V̇2 of the library and everything else by hand
    rng = np.random.default_rng(0)
    claim = one("v2-obstacle")
    vdot = ca.Function("vdot", [claim.symbols], [claim.left])
    e2, delta = rng.uniform(-0.4, 2, 20000), rng.uniform(-0.2, 0.2, 20000)
    phi, psi = rng.uniform(-np.pi, np.pi, (2, 20000))
    u_ob, u = rng.uniform(0, 0.25, 20000), rng.uniform(0.02, 0.25, 20000)
    left = np.asarray(vdot(np.vstack([e2, phi, psi, u_ob, u, delta])))[0]
    size = np.hypot(0.5, e2 + delta)
    gap = e2 * (u_ob * np.cos(phi - psi) - u * delta / size)
    clear = abs(gap) > 1e-12
    assert np.array_equal((left <= -u * e2**2 / size)[clear], (gap <= 0)[clear])


def test_settling_intrusion_is_the_root_of_the_clearance_rate() -> None:
    claim, depth = one("v2-obstacle"), settling_intrusion(setting_from(None))
    head_on = {"phi": 0.0, "psi_ob": np.pi, "u_ob": 0.15, "u": 0.22, "delta": 0.0}
    assert depth == pytest.approx(-0.466, abs=5e-4)
    assert evaluate(claim, {"e2": depth, **head_on})[0] == pytest.approx(0, abs=1e-12)
    assert evaluate(claim, {"e2": 0.9 * depth, **head_on})[0] > 0


# ---- mutations: a law that is wrong must be caught


@pytest.mark.parametrize("name", [n for n in CORRECTED if n != "course-corrected"])
def test_a_flipped_inequality_is_refuted(name: str) -> None:
    claim = one(name)
    flipped = replace(claim, left=claim.right, right=claim.left)
    assert decide(flipped, samples=256).verdict == "refuted"


def patched(module: Any, name: str, change: Callable[[Any], Any]) -> Callable[[pytest.MonkeyPatch], None]:
    return lambda monkeypatch: monkeypatch.setattr(module, name, change(getattr(module, name)))


def unrepaired(law: Any) -> Any:
    return lambda x, y, **k: law(x, y, **{**k, "repaired": False})


def slower(law: Any) -> Any:
    return lambda x, y, **k: 0.9 * law(x, y, **k)


def pushed(law: Any) -> Any:
    return lambda error, along, **k: -law(error, along, **k)


def turned(law: Any) -> Any:
    return lambda psi: law(psi).T


def form_of(form: str) -> Callable[[Any], Any]:
    return lambda law: lambda _, phi, clearance, **k: law(form, phi, clearance, **k)


def deaf_to_the_obstacle(law: Any) -> Any:
    return lambda form, phi, clearance, **k: law(form, phi, clearance, **{**k, "closing": ca.SX(0)})


def one_sided(law: Any) -> Any:
    return lambda form, phi, clearance, **k: law(form, phi, clearance, **k) - ca.fmin(k["side"], 0) * 0.01


def sluggish(brakes_of: Any) -> Any:
    return lambda vehicle, **k: replace(brakes_of(vehicle, **k), lag=3.0)


class Overconfident(braking_claims._Box):
    """A box that leaves more braking force over than there is."""

    def left(self, obstacle: Any) -> Any:
        return 1.05 * super().left(obstacle)


@pytest.mark.parametrize(
    ("name", "mutate"),
    [
        ("braking-keeps", lambda patch: patch.setattr(braking_claims, "_Box", Overconfident)),
        ("braking-retreat", patched(braking_claims, "brakes_of", sluggish)),
        ("v1-corrected", patched(tracking_claims, "along_command", unrepaired)),
        ("v1-corrected", patched(tracking_claims, "along_command", slower)),
        ("v1-corrected", patched(tracking_claims, "tracking_rate", pushed)),
        ("v1-speed-cap-region", patched(tracking_claims, "along_command", slower)),
        ("m-norm-corrected", patched(tracking_claims, "tracking_rate", pushed)),
        ("course-corrected", patched(library, "planar_rotation", turned)),
        ("v2-static", patched(avoidance_claims, "avoidance_course", form_of("printed"))),
        ("clearance-corrected", patched(avoidance_claims, "avoidance_course", form_of("printed"))),
        ("clearance-corrected", patched(avoidance_claims, "avoidance_course", deaf_to_the_obstacle)),
        ("clearance-corrected", patched(avoidance_claims, "avoidance_course", one_sided)),
    ],
)
def test_a_wrong_law_is_refuted(name: str, mutate: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    mutate(monkeypatch)
    assert falsify(one(name)).verdict == "refuted"
    assert prove(one(name), time_limit=0.05, slack=1e-9).certificate is None


@pytest.mark.parametrize("name", ["sur400"])
@pytest.mark.parametrize("claim", ["braking-keeps", "braking-retreat", "braking-mass"])
def test_braking_holds_of_other_vehicles(name: str, claim: str) -> None:
    vehicle = load_vehicle(name)
    assert decide(claims(names=[claim], vehicle=vehicle)[0], samples=1024).verdict == "proved"


# ---- users' mistakes


def test_an_unknown_claim_names_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'v1-printed'"):
        claims(names=["v1-print"])


def test_names_choose_and_order() -> None:
    assert [c.name for c in claims(names=["v2-static", "v1-printed"])] == ["v2-static", "v1-printed"]
    assert len(claims(names=[])) == 0


@pytest.mark.parametrize(
    ("gains", "key"),
    [
        ({"k1": 0.0}, "k1"),
        ({"lookahead": -1.0}, "lookahead"),
        ({"k2": float("nan")}, "k2"),
        ({"speed_max": 0.1}, "speed_max"),
        ({"obstacle_speed": 0.3}, "obstacle_speed"),
        ({"k3": np.array([1.0, 2.0])}, "k3"),
        ({"margin": -0.1}, "standoff"),
    ],
)
def test_a_bad_gain_is_named(gains: dict[str, Any], key: str) -> None:
    with pytest.raises(InputError) as caught:
        claims(gains)
    assert caught.value.key is not None and key.startswith(caught.value.key)


def test_gains_of_other_parts_are_passed_over_and_delta_zero_keeps_the_printed_one() -> None:
    setting = setting_from({"k_psi": 3.0, "lambda1": 0.0, "delta": 0.0, "margin": 0.05, "k1": 0.3})
    assert (setting.delta, setting.standoff, setting.k1) == (0.1, 0.05, 0.3)
