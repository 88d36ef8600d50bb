import hashlib
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.certcheck import check_document, check_file
from surctl.certcheck.turning_claim import read_claim
from surctl.certcheck.turning_form import Form
from surctl.certcheck.turning_matrix import indefinite
from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.tuning import derived_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.region import (
    REGION_CLAIMS,
    RegionProof,
    RegionStatement,
    SteeringClaim,
    TurningClaim,
    prove_steering,
    prove_turning,
    refused_regions,
    region_statement,
)
from surctl.marine.verification.region.nominal import level_ratios, uncertain_cruise
from surctl.marine.verification.region.turning_loop import selected, steady_turning, vertices
from surctl.marine.verification.region.turning_shells import excess_of, worst_rate
from surctl.verification.conic import minimise, symmetric_basis
from surctl.verification.formula import text_of
from tests.certcheck.turning_samples import draw_vehicles
from tests.certcheck.turning_truth import commanded, true_rate

KEPT = Path(__file__).parents[2] / "certcheck"


def claimed(**changes: Any) -> TurningClaim:
    claim = REGION_CLAIMS["region-cruise-20"].claim(load_vehicle("sur540-flooded"), load_gains("default"))
    assert isinstance(claim, TurningClaim)
    return replace(claim, **changes)


def turning(vehicle: str = "sur540-flooded", **stated: Any) -> TurningClaim:
    claim = RegionStatement(name="test", loop="turning", **stated).claim(load_vehicle(vehicle), load_gains("default"))
    assert isinstance(claim, TurningClaim)
    return claim


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> tuple[RegionProof, Path]:
    """A proof, and the folder in which its search is stored."""
    folder = tmp_path_factory.mktemp("searched")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SURCTL_CACHE", str(folder))
        return prove_turning(claimed(), attempts=1), folder


def test_a_region_is_proved_and_its_certificate_stands_alone(
    searched: tuple[RegionProof, Path], tmp_path: Path
) -> None:
    proof, _ = searched
    assert proof.verdict == "proved", proof.reason
    assert proof.offset > 0.15 and proof.ultimate_bound[1] < proof.offset
    proof.write(tmp_path / "c.json")
    found = check_file(tmp_path / "c.json")
    assert found.accepted and json.loads((tmp_path / "c.json").read_text()) == proof.certificate()
    assert proof.to_dict()["certificate"]["claim"]["motion"]["rate_per_s"] == 0.05
    assert f"{proof.offset:.3g} m" in proof.sentence


def test_a_stored_search_is_only_a_proposal_that_is_checked_again(
    searched: tuple[RegionProof, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, folder = searched
    monkeypatch.setenv("SURCTL_CACHE", str(folder))
    monkeypatch.setattr(
        "surctl.marine.verification.region.proof.turning_search", None
    )  # from here on nothing is searched
    again = prove_turning(claimed(name="another"), attempts=1)
    assert first.verdict == again.verdict == "proved" and again.ratios == first.ratios
    assert again.certificate()["claim"] == first.certificate()["claim"]
    [entry] = folder.glob("*.region")
    found = json.loads(entry.read_bytes()[32:])
    body = json.dumps(found | {"stated": found["stated"] | {"offset": 1.1 * found["stated"]["offset"]}}).encode()
    entry.write_bytes(hashlib.sha256(body).digest() + body)
    forged = prove_turning(claimed(), attempts=1)
    assert forged.verdict == "unknown" and "is not in the region" in forged.reason and not forged.certificate()


def test_what_cannot_be_is_unknown_and_says_so() -> None:
    proof = prove_turning(claimed(rate=5.0), attempts=1)
    assert proof.verdict == "unknown" and not proof.certificate()
    assert "found no" in proof.to_dict()["remaining"] and "unknown" in proof.sentence


def test_claims_that_do_not_fit_are_the_users_mistake() -> None:
    vehicle, gains = load_vehicle("sur540-flooded"), load_gains("default")
    with pytest.raises(InputError, match="k_i"):
        REGION_CLAIMS["region-cruise-20"].claim(vehicle, gains.with_values({"k_i": 0.1}))
    with pytest.raises(InputError, match="m22"):
        REGION_CLAIMS["region-cruise-20"].claim(vehicle.with_values({"m22": 80.0}), gains)
    with pytest.raises(InputError, match="cap"):
        claimed(cruise=0.3)
    with pytest.raises(InputError, match="force"):
        claimed(force=0.05, period=0.05)
    with pytest.raises(InputError, match="velocity_error"):
        claimed(velocity_error=-0.1)
    with pytest.raises(InputError, match="region-cruise-20"):
        region_statement("region-cruise-21")


def test_claims_that_a_vehicle_rules_out_are_named_once_for_each_reason() -> None:
    refused = refused_regions(load_vehicle("bluerov2-wu"), load_gains("default"), cruise=0.15, cap=0.22)
    assert [(reason.because[:18], reason.to) for reason, _ in refused] == [("m11 = 17 kg and m2", "this vehicle")]
    assert set(refused[0][1]) == {name for name in REGION_CLAIMS if "turning" not in name and "steered" not in name}
    assert not refused_regions(load_vehicle("sur540-flooded"), load_gains("default"), cruise=0.15, cap=0.22)
    (slow,) = refused_regions(load_vehicle("sur540-flooded"), load_gains("default"), cruise=0.15, cap=0.15)
    assert "not below the cap" in slow[0].because and "region-turning" in slow[1]


@pytest.mark.parametrize("name", [name for name in REGION_CLAIMS if name != "region-steered-20"])
def test_the_library_builds_what_it_says(name: str) -> None:
    alike = ("scale", "curved", "curved-fast", "current")
    equal = "turning" not in name or name.removeprefix("region-turning-20-") in alike
    lagged = {"region-turning-lag": "bluerov2-vonbenzon", "region-turning-20-lag": "bluerov2-heavy",
              "region-turning-20-sampled": "bluerov2-heavy"}  # a table  # fmt: skip
    vehicle = load_vehicle("sur540-flooded" if equal else lagged.get(name, "bluerov2-vonbenzon"))
    gains = derived_gains(vehicle, cruise=0.15) if name in lagged else load_gains("default")
    claim = REGION_CLAIMS[name].claim(vehicle, gains)
    assert claim.name == name
    kept = KEPT / f"{name}.json"
    stated = json.loads(kept.read_text())["claim"]  # of another vehicle, law or claim it proves nothing about this one
    motion = stated["motion"]
    assert isinstance(claim, TurningClaim)
    assert (claim.period > 0, claim.lag > 0) == (
        name.endswith("-sampled") or name in ("region-cruise-20-lag", "region-cruise-20-spin"),
        name.endswith(("-lag", "-spin")),
    )
    assert claim.mass == ((95.0, 95.0) if equal else (19.8567, 20.6206))
    own = claim.document(
        offset=motion["offset_m"], rest_offset=motion["rest_offset_m"],
        ultimate_bound=tuple(motion["ultimate_bound_m"]), munk_moment=stated["vehicle"]["munk_moment_nm"],
    )  # fmt: skip
    own = json.loads(json.dumps(own))
    assert {k: v for k, v in stated.items() if k != "sha256_law"} == {k: v for k, v in own.items() if k != "sha256_law"}


def test_the_ratios_of_a_region_are_those_of_a_long_random_search() -> None:
    told = level_ratios(json.loads((KEPT / "region-cruise-20.json").read_text()))
    assert told.falsifier >= 0.40 and told.thrust >= 11.88 and "1195% of the level at which" in told.sentence


@pytest.mark.parametrize("name", ["region-cruise-20", "region-cruise-20-sampled", "region-cruise-20-spin"])
def test_simulated_motions_from_the_edge_stay_below_the_envelope(name: str) -> None:
    whole = json.loads((KEPT / f"{name}.json").read_text())
    claim, proof, n, steps, rng = read_claim(whole["claim"]), whole["proof"], 24, 4, np.random.default_rng(1)
    P = np.array([[proof["P"][max(i, j)][min(i, j)] for j in range(len(proof["P"]))] for i in range(len(proof["P"]))])
    boat, masses, v = draw_vehicles(claim, n, rng), np.array([float(m) for m in claim.mass]), float(claim.cruise)
    omega = sum(s * (boat[k].mean(axis=1) - 1) for s, k in zip(proof["trim"], ("linear", "quadratic"), strict=True))
    rest = np.stack([-omega / float(claim.k1), 0 * omega, v + 0 * omega, 0 * omega], 1)
    xi = rng.normal(size=(n, len(P))) @ np.linalg.inv(np.linalg.cholesky(P))
    xi /= np.sqrt(np.einsum("ni,ij,nj->n", xi, P, xi))[:, None]
    psi, turn = rng.uniform(0, 2 * np.pi, size=n), float(claim.yaw_rate) * rng.choice([-1.0, 1.0], size=n)
    period, lag, floor = float(claim.period) or 0.05, float(claim.lag[1]), proof["floor"]

    def body(vector: np.ndarray, back: int) -> np.ndarray:
        c, s = np.cos(psi), back * np.sin(psi)
        return np.stack([c * vector[:, 0] + s * vector[:, 1], -s * vector[:, 0] + c * vector[:, 1]], axis=1)

    state = xi[:, :4] + rest
    thrust = commanded(claim, rest, psi) + (body(xi[:, 4:], 1) * masses if lag else 0.0)
    for k in range(int(40 / period)):
        held = commanded(claim, state, psi)
        for _ in range(steps):
            now = commanded(claim, state, psi)
            if not claim.period:
                held = now
            applied = thrust if lag else held
            h = period / steps
            rate = true_rate(claim, boat, state, psi, turn, error=applied - now)
            middle = commanded(claim, state + h / 2 * rate, psi + h / 2 * turn)
            applied = thrust + h / 2 / lag * (held - thrust) if lag else held if claim.period else middle
            state = state + h * true_rate(
                claim, boat, state + h / 2 * rate, psi + h / 2 * turn, turn, error=applied - middle
            )
            thrust = held + (thrust - held) * np.exp(-h / lag) if lag else thrust
            psi = psi + h * turn
        xi[:, :4] = state - rest
        if lag:
            xi[:, 4:] = body((thrust - commanded(claim, rest, psi)) / masses, -1)
        value = np.einsum("ni,ij,nj->n", xi, P, xi)
        fall = np.exp(-whole["claim"]["motion"]["rate_per_s"] * (k + 1) * period)
        assert np.all(value <= np.maximum(fall, floor) + 1e-9)
        turn = np.where(rng.uniform(size=n) < 0.05, -turn, turn)
    assert value.max() < floor


def test_the_loop_of_the_falsifier_is_that_of_the_certificate() -> None:
    whole = json.loads((KEPT / "region-cruise-20.json").read_text())
    claim, slopes, n, rng = read_claim(whole["claim"]), whole["proof"]["trim"], 50, np.random.default_rng(0)
    d, _, loads = uncertain_cruise(whole)
    xi = rng.uniform(*d.box[:, :, None], (4, n))
    w = dict(zip([one.name for one in d.parameters], rng.uniform(*d.ranges[:, :, None], (6, n)), strict=True))
    boat = {"mass": np.tile(w["mass"], (2, 1)).T, "term_mass": np.ones(n), "term": np.ones(n)}
    for name in ("linear", "quadratic"):
        both = w[name], np.clip(w[name] * w[f"{name}_ratio"], *map(float, claim.drag_factor))
        boat[name] = np.stack(both, axis=1)
    omega = sum(s * (boat[k].mean(axis=1) - 1) for s, k in zip(slopes, ("linear", "quadratic"), strict=True))
    state, psi = xi.T + np.array([0, 0, float(claim.cruise), 0]), w["heading"]
    state[:, 0] -= omega / float(claim.k1)
    numbers = np.stack(list(w.values()))
    assert d.evaluate(xi, numbers) == pytest.approx(true_rate(claim, boat, state, psi, np.zeros(n)).T)
    strong = replace(claim, thrust=(Fraction(10**6),) * 2)
    shares = np.abs(commanded(strong, state, psi)).T / np.array([[float(x)] for x in claim.thrust])
    assert np.asarray(d.compiled(*loads)(xi, numbers)) == pytest.approx(shares)


def test_the_conic_solver_finds_the_largest_eigenvalue() -> None:
    rng = np.random.default_rng(0)
    for size in (1, 3, 5):
        root = rng.normal(size=(size, size))
        whole = root + root.T
        # least t with t I − A ⪰ 0
        x = minimise(np.ones(1), [(-whole[None], np.eye(size)[None, None])])
        assert x is not None and np.isclose(x[0], np.linalg.eigvalsh(whole)[-1], atol=1e-6)
    assert minimise(np.ones(1), [(-np.eye(2)[None], np.zeros((1, 1, 2, 2)))]) is None
    assert len(symmetric_basis(4)) == 10


def test_a_certificate_of_these_numbers_is_not_one_of_others() -> None:
    whole = json.loads((KEPT / "region-cruise-20.json").read_text())
    whole["claim"]["law"]["cruise"] = 0.16
    assert "altered" in check_document(whole).reason


def test_all_vertices_of_a_turning_cruise_are_judged_at_once() -> None:
    claim = turning(rate_per_s=0.02)
    P = np.diag([50.0, 12.0, 250.0, 160.0])
    P[0, 2] = P[2, 0] = 40.0
    found = vertices(claim, steady_turning(claim, cells=4), np.linalg.inv(P), 1.0)
    assert found is not None
    [at] = found
    assert at.shape[4] == 6  # the thrust limit binds
    every = at.losses(Form(P), claim.rate, 0.05, 0.05 * 0.3)
    assert len(every) == 10 and every[0, 0].shape == at.shape
    some = np.random.default_rng(0).integers(every[0, 0].size, size=40)
    A, factor, _ = selected(at, some, P)
    h, m, _, z = np.unravel_index(some, at.shape)[:4]
    change, entry = np.linalg.inv(np.linalg.cholesky(P)), P[:, 2:]
    own = A.swapaxes(1, 2) @ P + P @ A + (claim.rate + 0.05) * P
    matrices = np.empty((40, 4, 4))
    for (i, j), row in every.items():
        matrices[:, i, j] = matrices[:, j, i] = -row.reshape(-1)[some]
    assert excess_of(every, some) == pytest.approx(np.linalg.eigvalsh(matrices)[:, -1])
    force = matrices - change @ own @ change.T  # T P B w wᵀ Bᵀ P Tᵀ/(η low) or more
    weighted = change @ P @ factor
    assert weighted @ weighted.swapaxes(1, 2) / (0.05 * 0.3) == pytest.approx(force, abs=1e-8)  # rounding
    lack = at.lack[h] * at.masses[m, :2]
    for sign in (1, -1):
        axes = np.stack([np.cos(at_psi := np.linspace(0, np.pi / 2, 5)[h]), np.sin(at_psi)], 1)
        w = lack[:, :1] * axes + sign * lack[:, 1:] * np.stack([-axes[:, 1], axes[:, 0]], 1)
        pushed = (change @ entry @ w[:, :, None])[..., 0]
        least = np.linalg.eigvalsh(force - np.einsum("ki,kj->kij", pushed, pushed) / (0.05 * 0.3))[:, 0]
        assert not z.any() and least.min() > -1e-9 and np.abs(force).max() > 0
    values = excess_of(every, np.arange(every[0, 0].size))
    bound = float(np.quantile(values, 0.9))
    assert set(np.flatnonzero(indefinite(every, bound))) == set(np.flatnonzero(values >= bound))
    worst, known = worst_rate(every, np.zeros(0, dtype=int))
    assert worst == pytest.approx(values.max(), abs=1e-8) and values[known[0]] == pytest.approx(worst)


def test_unequal_masses_are_proved_and_a_weak_yaw_thrust_is_not() -> None:
    claim = turning("bluerov2-wu", share=0.0, mass_share=0.0, rate_per_s=0.02, at_rest=True)
    proof = prove_turning(claim, attempts=2)
    assert proof.verdict == "proved", proof.reason
    assert proof.offset > 0.25 and proof.rest_offset is not None and proof.rest_offset > 0.2
    assert check_document(proof.certificate()).accepted and " m for a start at rest)" in proof.sentence
    assert " m beside the path (not for a start at rest), " in replace(proof, rest_offset=None).sentence
    weak = prove_turning(replace(claim, yaw_limit=0.01), attempts=2)
    assert weak.verdict == "unknown" and "Munk moment" in weak.reason
    assert weak.sentence.startswith("unknown: not provable for this vehicle")
    with pytest.raises(InputError, match="k_i"):
        turning("bluerov2-wu", gains={"k_i": 0.1})
    with pytest.raises(InputError, match="cap"):
        replace(claim, cruise=0.3)


def test_the_heading_loop_of_a_craft_without_sway_force_is_proved() -> None:
    craft, statement = load_vehicle("otter"), REGION_CLAIMS["region-steered-20"]
    claim = statement.claim(craft, derived_gains(craft, cruise=1.1), cruise=1.1, cap=1.613333333)
    assert isinstance(claim, SteeringClaim)
    stated = json.loads((KEPT / "region-steered-20.json").read_text())["claim"]
    own = claim.dynamics()
    assert {s.name: text_of(rate) for s, rate in zip(own.states, own.rates, strict=True)} == stated["dynamics"]
    assert {w.name: [w.lower, w.upper] for w in own.parameters} == {
        row["name"]: [row["lower"], row["upper"]] for row in stated["parameters"]
    }
    assert {**own.about, "sha256_law": ""} == {**stated["about"], "sha256_law": ""}
    proof = prove_steering(replace(claim, rate=9.0))
    assert proof.verdict == "unknown" and "found no" in proof.reason
    for changed, word in (({"m12": 1.0}, "m12"), ({"Y0": 1.0}, "Y0"), ({"Nuu": 1.0}, "Nuu")):
        more = {name: replace(craft.parameters["m24"], value=value) for name, value in changed.items()}
        with pytest.raises(InputError, match=word):
            replace(claim, vehicle=replace(craft, parameters={**craft.parameters, **more})).dynamics()
    with pytest.raises(InputError, match="sway force"):
        statement.claim(load_vehicle("sur400"), load_gains("default"))
    with pytest.raises(InputError, match="sway force"):
        REGION_CLAIMS["region-turning-20"].claim(craft, load_gains("default"))
