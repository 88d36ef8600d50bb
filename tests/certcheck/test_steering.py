"""The checker of the heading loop of a craft without sway force: what it accepts, and what it must not."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.certcheck import Rejected, check_document
from surctl.certcheck.region_exact import quadratic
from surctl.certcheck.steering import _matrix, check, extent_of
from surctl.certcheck.steering_claim import read_claim
from surctl.certcheck.steering_law import draw_crafts, true_rate
from surctl.certcheck.steering_loop import delivered, lookahead, nodes, parameters, vertices
from surctl.marine.control import build_law, law_parameters, law_source, turning_radius
from surctl.marine.guidance import Path as Route
from surctl.marine.report import plot_region
from surctl.marine.tuning import derived_gains
from surctl.marine.vehicle import PLANT_DISTURBANCE, PLANT_STATE, build_plant, load_vehicle, plant_parameters
from surctl.marine.verification.portrait import planes_of, portrait
from tests.certcheck.altering import altered, put, sealed

KEPT = Path(__file__).parent / "region-steered-20.json"


FINS = KEPT.with_name("region-steered-20-remus100.json")


def document(path: Path = KEPT) -> dict[str, Any]:
    return json.loads(path.read_text())


def worst(whole: dict[str, Any], *, level: float = 1.0, count: int = 20_000) -> float:
    """Largest V̇/V + a [1/s] found on V = level."""
    claim, rng = read_claim(whole["claim"]), np.random.default_rng(0)
    P = np.array([[float(e) for e in row] for row in _matrix(whole["proof"]["P"])])
    xi = rng.normal(size=(count, 6)) @ np.linalg.inv(np.linalg.cholesky(P))
    xi *= np.sqrt(level / np.einsum("ni,ij,nj->n", xi, P, xi))[:, None]
    rate = true_rate(claim, draw_crafts(claim, count, rng), xi)
    return float(np.max(2 * np.einsum("ni,ij,nj->n", xi, P, rate))) / level + float(claim.rate)


@pytest.mark.parametrize("path", [KEPT, FINS], ids=lambda path: path.stem)
def test_the_kept_certificate_is_accepted_and_small(path: Path) -> None:
    whole = document(path)
    found = check_document(whole)
    assert found.accepted, found.reason
    assert path.stat().st_size < 5_000 and found.seconds < 20 and whole["claim"]["motion"]["offset_m"] >= 0.25
    assert worst(whole) < 0 < worst(whole, level=400.0)


STRONGER: dict[str, Callable[[dict[str, Any]], Any]] = {
    "rate": lambda d: d["claim"]["motion"].update(rate_per_s=0.4),
    "offset": lambda d: d["claim"]["motion"].update(offset_m=d["claim"]["motion"]["offset_m"] * 1.002),
    "masses": lambda d: d["claim"]["vehicle"].update(mass_factor=[0.5, 2.0]),
    "drag": lambda d: d["claim"]["vehicle"].update(drag_factor=[0.1, 4.0]),
    "speed": lambda d: d["claim"]["vehicle"].update(speed_m_per_s=[0.3, 2.5]),
    "slow": lambda d: d["claim"]["vehicle"].update(speed_m_per_s=[0.1, 1.2]),
    "moment": lambda d: d["claim"]["vehicle"].update(moment_nm=5.0),
    "coupling": lambda d: d["claim"]["vehicle"]["terms"].update(m24=80.0),
    "drag by |u|": lambda d: d["claim"]["vehicle"]["terms"].update(Nuv=-900.0),
    "m12": lambda d: d["claim"]["vehicle"]["terms"].update(m12=3.0),
    "constant moment": lambda d: d["claim"]["vehicle"]["terms"].update(N0=3.0),
    "k_psi": lambda d: d["claim"]["law"].update(k_psi=40.0),
    "k_r": lambda d: d["claim"]["law"].update(k_r=0.01),
    "lookahead": lambda d: d["claim"]["law"].update(lookahead=0.2),
    "sideslip": lambda d: d["claim"]["law"].update(sideslip=0.001),
    "crab_time": lambda d: d["claim"]["law"].update(crab_time=0.01),
    "model": lambda d: d["claim"]["law"].update(mass=[60.2815, 137.5, 3.9]),
    "fins": lambda d: d["claim"]["law"].update(fin_share=0.5),
    "a side force without fins": lambda d: d["claim"]["vehicle"].update(side_per_m=-1.0),
    "munk": lambda d: d["claim"]["law"].update(munk=-900.0),
    "integral": lambda d: d["claim"]["law"].update(k_i=0.1),
    "no multiplier": lambda d: d["proof"].update(shares=[[1.0, 0.0]]),
    "too large a multiplier": lambda d: d["proof"].update(shares=[[1.0, 1000.0]]),
    "a share left out": lambda d: d["proof"].update(shares=[[0.9, d["proof"]["shares"][0][1]]]),
    "a negative multiplier": lambda d: put(d, ("proof", "shares", 0, 1), -1.0),
    "shares of another form": lambda d: d["proof"].update(shares=[[1.0]]),
    "no shares": lambda d: d["proof"].pop("shares"),
    "size of P": lambda d: d["proof"].update(P=[[e * 0.002 for e in row] for row in d["proof"]["P"]]),
    "sign of P": lambda d: put(d, ("proof", "P", 1, 1), -1.0),
    "excludes": lambda d: d["claim"].update(excludes=[]),
    "system": lambda d: d["claim"].update(system="cruise"),
    "more": lambda d: d["claim"].update(more=1),
    "huge": lambda d: put(d, ("claim", "law", "k_r"), 10**400),
}


@pytest.mark.parametrize("kind", [*STRONGER][::2])  # all of them: study 40
def test_what_asks_for_more_is_rejected_however_it_is_sealed(kind: str) -> None:
    changed = document()
    STRONGER[kind](changed)
    assert not check_document(sealed(changed)).accepted


def test_the_offset_is_decided_to_the_last_digit() -> None:
    whole = document()
    p00 = Fraction(repr(whole["proof"]["P"][0][0]))
    largest = float(1 / np.sqrt(float(p00)))
    while Fraction(repr(largest)) ** 2 * p00 > 1:
        largest = float(np.nextafter(largest, 0))
    while Fraction(repr(float(np.nextafter(largest, 9)))) ** 2 * p00 <= 1:
        largest = float(np.nextafter(largest, 9))
    check(sealed(_with(largest)))
    for off in (float(np.nextafter(largest, 9)), largest + 1e-12, largest + 1e-6):
        with pytest.raises(Rejected, match="not in the region"):
            check(sealed(_with(off)))


def _with(offset: float) -> dict[str, Any]:
    changed = document()
    changed["claim"]["motion"]["offset_m"] = offset
    return changed


def test_no_altered_certificate_that_sampling_refutes_is_accepted() -> None:
    rng, rejected, accepted = np.random.default_rng(5), 0, 0
    for _ in range(17):
        if rejected > 2 and accepted > 1:
            break
        path, changed = altered(document(), ("claim", "proof"), rng)
        if not check_document(sealed(changed)).accepted:
            rejected += 1
            continue
        accepted += 1
        p = _matrix(changed["proof"]["P"])
        assert quadratic(p, [Fraction(repr(changed["claim"]["motion"]["offset_m"])), *[Fraction(0)] * 5]) <= 1, path
        assert worst(changed, count=3000) <= 1e-9, path
    assert rejected > 2 and accepted > 1  # neither everything nor nothing passes


@pytest.mark.parametrize("change", ["side", "no fins", "drag"])
def test_a_rudder_is_not_taken_for_something_else(change: str) -> None:
    changed = document(FINS)
    if change == "side":
        changed["claim"]["vehicle"]["side_per_m"] = 0.0
    elif change == "no fins":
        changed["claim"]["law"]["fin_share"] = 0.0
    else:
        changed["claim"]["vehicle"]["drag_factor"] = [0.6, 1.4]
    assert not check_document(sealed(changed)).accepted


@pytest.mark.parametrize(
    ("path", "terms"),
    [(KEPT, {"Yuv": 20.0, "Yur": -6.0, "Nuv": -9.0, "Nvv": 3.0, "Yvr": 2.0, "Nr": None})],  # with fins: study 40
)
def test_the_matrices_enclose_the_loop(path: Path, terms: dict[str, float]) -> None:
    whole, rng = document(path), np.random.default_rng(2)
    whole["claim"]["vehicle"]["terms"] |= {name: value for name, value in terms.items() if value is not None}
    claim = read_claim(whole["claim"])
    p = _matrix(whole["proof"]["P"])
    at = extent_of(claim, p)
    loops = [vertices(claim, parameters(claim, at, node), node) for node in nodes(claim)]
    least = float(delivered(claim, at))
    P = np.array([[float(e) for e in row] for row in p])
    xi = rng.normal(size=(40, 6)) @ np.linalg.inv(np.linalg.cholesky(P))
    xi *= (rng.uniform(0.1, 1, size=40) / np.sqrt(np.einsum("ni,ij,nj->n", xi, P, xi)))[:, None]
    rate, direction = true_rate(claim, draw_crafts(claim, 40, rng), xi), rng.normal(size=(40, 6))
    most = np.array([
        max((A @ x @ d + share * (b @ d) * (m @ x)).max() for A, b, m in loops for share in (least, 1.0))
        for d, x in zip(direction, xi, strict=True)
    ])  # fmt: skip
    assert np.all(np.einsum("ni,ni->n", direction, rate) <= most + 1e-12)


@pytest.mark.parametrize(("name", "path"), [("otter", KEPT), ("remus100", FINS)])
def test_the_checkers_loop_is_the_law_and_the_vehicle_of_the_toolkit(name: str, path: Path) -> None:
    whole, rng, n = document(path), np.random.default_rng(3), 3
    claim, law, far, dt = read_claim(whole["claim"]), build_law("steered"), 60.0, 0.05
    cruise = float(claim.cruise)
    craft = load_vehicle(name).at_speed(cruise)
    own = derived_gains(craft, cruise=cruise).with_own(law_source("steered").gains)
    p = law_parameters(
        own, craft, path=Route(np.array([[0.0, 0.0], [190.0, 0.0]])), depth=0.0, cruise=cruise,
        cap=whole["claim"]["law"]["cap"], walls=(-1e3, 1e3, -1e3, 1e3),
    )  # fmt: skip
    low, high = lookahead(claim)
    ahead = max(own["lookahead"], turning_radius(craft, own.values, cruise))
    assert float(low) - 1e-9 <= ahead <= float(high) + 1e-6
    size = np.array([0.3, 0.05, 0.02, 0.05, 0.03, 0.02])
    size *= 1.0 if name == "otter" else 0.2  # within the limit of the rudder's moment
    state = rng.uniform(-1, 1, size=(n, 6)) * size
    u = cruise * rng.uniform(0.92, 1.08, size=n)
    found = true_rate(claim, {"mass": np.ones((n, 4)), "drag": np.ones((n, 8)), "u": u}, state)
    plant, still = build_plant(craft.form), PLANT_DISTURBANCE.pack()
    for k in range(n):
        y, psi, v, r, crab, s = state[k]
        inputs = law.inputs.pack({"eta": [far, y, 0.0, psi], "nu": [u[k], v, 0.0, r]})
        x = law.state.pack({"progress": [far], "crab": [crab], "sway": [s], "surge": [u[k]]})
        step = law.step(x, inputs, p)
        after = law.state.split(step.x_next)
        tau = [float(t) for t in step.tau]
        tau[1] += float(claim.side) * tau[3]  # the rudder's force, which the allocation adds
        at = PLANT_STATE.pack({"eta": [0, 0, 0, psi], "nu": [u[k], v, 0, r], "tau": tau})
        rate = np.asarray(plant.ode(at, tau, still, plant_parameters(craft)))[:, 0]
        assert np.allclose(found[k, :2], rate[[1, 3]], atol=1e-9)
        # the filters are held for one period in the law; the modelled sway of the present step enters the thrust
        assert np.allclose((np.ravel(after["crab"]) - crab) / dt, found[k, 4], rtol=0.04, atol=2e-4)
        assert np.allclose((np.ravel(after["sway"]) - s) / dt, found[k, 5], rtol=0.08, atol=2e-3)
        near = {"mass": np.ones((1, 4)), "drag": np.ones((1, 8)), "u": u[k : k + 1]}
        moved = state[k : k + 1].copy()
        moved[0, 4:] = np.ravel(after["crab"])[0], np.ravel(after["sway"])[0]
        assert np.allclose(true_rate(replace(claim, cap=Fraction(10**6)), near, moved)[0, 2:4], rate[[5, 7]], atol=2e-3)


def test_a_certificate_without_a_floor_is_drawn_in_its_planes() -> None:
    whole = document()
    for plane in planes_of(whole):
        drawn = portrait(whole, plane, points=9)
        assert drawn.levels == (0.0, 1.0) and np.max(drawn.excess[(drawn.level < 1) & (drawn.level > 1e-9)]) < 0
    assert len(plot_region(whole).axes) >= 2
