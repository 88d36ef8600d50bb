import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.certcheck import check_document
from surctl.certcheck.heading_cells import Plane, constant, rows
from surctl.certcheck.heading_claim import read_claim
from surctl.marine.vehicle import PLANT_DISTURBANCE, PLANT_PARAMETERS, PLANT_STATE, build_plant
from tests.certcheck.altering import altered, put, sealed
from tests.certcheck.heading_inclusion import check_identity, true_rate

HERE = Path(__file__).parent
FILES = sorted(HERE.glob("region-heading-*.json"))
RANGES = ("mass_kg", "yaw_inertia_kg_m2", "surge_linear", "surge_quadratic", "sway_linear", "sway_quadratic",
          "yaw_linear", "yaw_quadratic")  # fmt: skip


def document(name: str = "region-heading-20") -> dict[str, Any]:
    return json.loads((HERE / f"{name}.json").read_text())


def matrix(whole: dict[str, Any]) -> np.ndarray:
    lower = whole["proof"]["P"]
    return np.array([[lower[max(i, j)][min(i, j)] for j in range(6)] for i in range(6)])


def boats(claim: dict[str, Any], count: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    share = rng.uniform(size=(len(RANGES), count))
    share = np.where(rng.uniform(size=share.shape) < 0.6, np.round(share), share)
    return {key: low + (high - low) * s for s, key in zip(share, RANGES, strict=True)
            for low, high in [claim["vehicle"][key]]}  # fmt: skip


def rest(claim: dict[str, Any], boat: dict[str, np.ndarray]) -> np.ndarray:
    """x* [m]."""
    law = claim["law"]
    v = law["cruise"]
    lack = (boat["surge_linear"] - law["linear_drag"]) * v + (boat["surge_quadratic"] - law["quadratic_drag"]) * v * v
    return -lack / (law["mass_kg"] * law["k"]) / law["k1"]


def rate(claim: dict[str, Any], boat: dict[str, np.ndarray], xi: np.ndarray) -> np.ndarray:
    """ξ̇ (n, 6) from the paper's equations in {B}, thrust limited; written for the tests alone."""
    law, limits = claim["law"], claim["vehicle"]["limits"]
    v, push = law["cruise"], law["mass_kg"] * law["k"]
    x_e, y, psi = xi[:, 0] + rest(claim, boat), xi[:, 1], xi[:, 2]
    speed = np.stack([v + xi[:, 3], xi[:, 4]])
    c, s, r = np.cos(psi), np.sin(psi), xi[:, 5]
    u, w = c * speed[0] + s * speed[1], -s * speed[0] + c * speed[1]
    q = np.sqrt(y**2 + law["lookahead"] ** 2)
    wanted = (v - law["k1"] * x_e) * q / law["lookahead"]
    psi_d = -np.arctan2(y, law["lookahead"])
    f = push * (wanted - u) + law["linear_drag"] * v + law["quadratic_drag"] * v * v
    f = np.clip(f, -limits["surge_n"], limits["surge_n"])
    g = np.clip(-push * w, -limits["sway_n"], limits["sway_n"])
    n = -law["yaw_inertia_kg_m2"] * law["k_r"] * (r + law["k_psi"] * (psi - psi_d))
    n = np.clip(n, -limits["yaw_nm"], limits["yaw_nm"])
    m = boat["mass_kg"]
    u_rate = w * r + (f - boat["surge_linear"] * u - boat["surge_quadratic"] * u * np.abs(u)) / m
    w_rate = -u * r + (g - boat["sway_linear"] * w - boat["sway_quadratic"] * w * np.abs(w)) / m
    turn = (n - boat["yaw_linear"] * r - boat["yaw_quadratic"] * r * np.abs(r)) / boat["yaw_inertia_kg_m2"]
    x_rate, y_rate = c * u_rate - s * w_rate - r * speed[1], s * u_rate + c * w_rate + r * speed[0]
    return np.stack([speed[0] - v, speed[1], r, x_rate, y_rate, turn], axis=1)


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_the_linear_form_of_the_proof_is_the_rate_of_vehicle_and_law(path: Path) -> None:
    check_identity(read_claim(document(path.stem)["claim"]), random.Random(6))


def worst(whole: dict[str, Any], *, low: float, high: float, count: int = 40_000, seed: int = 0) -> float:
    """Largest V̇/V + a found for low ≤ V ≤ high."""
    claim, P, rng = whole["claim"], matrix(whole), np.random.default_rng(seed)
    xi = rng.normal(size=(count, 6)) @ np.linalg.inv(np.linalg.cholesky(P))
    xi *= np.sqrt(rng.uniform(low, high, size=count) / np.einsum("ni,ij,nj->n", xi, P, xi))[:, None]
    grow = 2 * np.einsum("ni,ij,nj->n", xi, P, rate(claim, boats(claim, count, rng), xi))
    return float(np.max(grow / np.einsum("ni,ij,nj->n", xi, P, xi))) + claim["motion"]["rate_per_s"]


@pytest.mark.parametrize("path", [path for path in FILES if path.stem == "region-heading-20"], ids=lambda p: p.stem)
def test_the_kept_certificates_are_accepted_and_small(path: Path) -> None:
    """All of them: study 40."""
    found = check_document(json.loads(path.read_text()))
    assert found.accepted, found.reason
    assert len(path.read_text()) < 10_000


def test_the_regions_are_as_large_as_is_said() -> None:
    motion = document()["claim"]["motion"]
    assert motion["rate_per_s"] == 0.05 and motion["offset_m"] >= 0.34
    assert document("region-heading-ranges")["claim"]["motion"]["beside_m"] >= 0.29
    assert document("region-heading-20-slow")["claim"]["motion"]["offset_m"] >= 0.65


STRONGER: dict[str, Callable[[dict[str, Any], float], None]] = {
    "rate": lambda d, f: d["claim"]["motion"].update(rate_per_s=0.15 * (1 + f)),
    "offset": lambda d, f: d["claim"]["motion"].update(offset_m=d["claim"]["motion"]["offset_m"] * (1.001 + f)),
    "beside": lambda d, f: d["claim"]["motion"].update(beside_m=d["claim"]["motion"]["beside_m"] * (1.001 + f)),
    "extent": lambda d, f: d["claim"]["motion"].update(
        extent=[x * (1.001 + f) if k == 1 else x for k, x in enumerate(d["claim"]["motion"]["extent"])]
    ),
    "depth": lambda d, f: d["claim"]["motion"].update(depth_m=d["claim"]["motion"]["depth_m"] * (1.001 + f)),
    "ultimate_bound": lambda d, f: d["claim"]["motion"].update(ultimate_bound_m=0.06 * (1 - f)),
    "mass": lambda d, f: d["claim"]["vehicle"].update(mass_kg=[76.0, 114 * (3 + 5 * f)]),
    "inertia": lambda d, f: d["claim"]["vehicle"].update(yaw_inertia_kg_m2=[1.2, 1.8 * (4 + f)]),
    "surge limit": lambda d, f: d["claim"]["vehicle"]["limits"].update(surge_n=1.9 * (1 - f)),
    "yaw limit": lambda d, f: d["claim"]["vehicle"]["limits"].update(yaw_nm=0.05 * (1 - f / 2)),
    "heave limit": lambda d, f: d["claim"]["vehicle"]["limits"].update(heave_n=0.05 * (1 - f / 2)),
    "sway drag": lambda d, f: d["claim"]["vehicle"].update(sway_quadratic=[48.0, 72 * (200 + f)]),
    "k_psi": lambda d, f: d["claim"]["law"].update(k_psi=0.1 * (1 - f / 2)),
    "lookahead": lambda d, f: d["claim"]["law"].update(lookahead=0.3 * (1 - f / 2)),
    "size of P": lambda d, f: d["proof"].update(P=[[e * (0.02 + 0.1 * f) for e in row] for row in d["proof"]["P"]]),
    "mirror": lambda d, f: d["proof"]["P"][1].__setitem__(0, 0.001 + f),
    "sign of P": lambda d, f: d["proof"]["P"][5].__setitem__(5, -0.1 - f),
    "sign of P_z": lambda d, f: d["proof"]["P_z"][1].__setitem__(1, -0.1 - f),
}  # fmt: skip


@pytest.mark.parametrize("kind", [*STRONGER][::4])  # all of them: study 40
def test_what_asks_for_more_is_rejected_however_it_is_sealed(kind: str) -> None:
    share, changed = float(np.random.default_rng(len(kind)).uniform()), document()
    STRONGER[kind](changed, share)
    assert not check_document(sealed(changed)).accepted, (kind, share)


def false(changed: dict[str, Any]) -> bool:
    """Whether an altered claim is false, as far as sampling tells."""
    P, motion = matrix(changed), changed["claim"]["motion"]
    if np.linalg.eigvalsh(P)[0] <= 0:
        return True
    reach = np.sqrt(np.diag(np.linalg.inv(P)))
    if P[1, 1] * motion["beside_m"] ** 2 > 1 + 1e-9 or np.any(np.array(motion["extent"]) > reach[:3] * (1 + 1e-9)):
        return True
    return worst(changed, low=1e-4, high=1.0, count=4000) > 1e-9


def test_no_altered_certificate_that_sampling_refutes_is_accepted() -> None:
    whole, rng = document(), np.random.default_rng(5)
    accepted, wrong = 0, 0
    for _ in range(6):
        if wrong and accepted:
            break
        path, changed = altered(whole, ("claim", "proof"), rng)
        if check_document(sealed(changed)).accepted:
            accepted += 1
            assert not false(changed), path
        else:
            wrong += 1
    assert accepted and wrong
    assert "altered" in check_document({**whole, "claim": {**whole["claim"], "sha256_vehicle": "0" * 64}}).reason


def test_sampling_finds_no_slower_decay_inside_and_finds_it_far_outside() -> None:
    for path in FILES:
        whole = json.loads(path.read_text())
        assert worst(whole, low=1e-6, high=1.0) < 0
        assert worst(whole, low=10.0, high=30.0) > 0


def test_flights_from_the_edge_stay_below_the_envelope() -> None:
    whole = document()
    claim, P, rng, n, h = whole["claim"], matrix(whole), np.random.default_rng(1), 300, 0.02
    boat = boats(claim, n, rng)
    xi = rng.normal(size=(n, 6)) @ np.linalg.inv(np.linalg.cholesky(P))
    xi /= np.sqrt(np.einsum("ni,ij,nj->n", xi, P, xi))[:, None]
    for k in range(1000):
        xi = xi + h * rate(claim, boat, xi + h / 2 * rate(claim, boat, xi))
        envelope = np.exp(-claim["motion"]["rate_per_s"] * (k + 1) * h)
        assert np.all(np.einsum("ni,ij,nj->n", xi, P, xi) <= envelope * (1 + 1e-6))


def test_the_rows_hold_everywhere_in_a_cell() -> None:
    law = {key: float(value) for key, value in read_claim(document()["claim"]).law.items()}
    rng = np.random.default_rng(3)
    psi, y = rng.uniform(-1.4, 1.4, 60), rng.uniform(-1, 1, 60)
    psi[:5], y[:5] = 0.0, 0.0
    half = np.array([0.05, 0.07])
    at = rows(law, (0.14, 0.16), psi, y, half)
    for _ in range(20):
        a, b = rng.uniform(-1, 1, (2, 60))
        true = rows(law, (0.14, 0.16), psi + a * half[0], y + b * half[1], np.zeros(2))
        for name in ("surge", "sway", "yaw", "ahead", "abeam"):
            plane, value = getattr(at, name), getattr(true, name).mid
            off = np.abs(value - plane.mid - a[:, None] * plane.psi - b[:, None] * plane.y)
            assert np.all(off <= plane.radius), name
            assert np.all(plane.radius < 0.01 * (1 + np.abs(plane.mid)))  # and are of second order
        square = at.ahead * at.yaw + constant(at.surge.mid)
        value = true.ahead.mid * true.yaw.mid + at.surge.mid
        off = np.abs(value - square.mid - a[:, None] * square.psi - b[:, None] * square.y)
        assert np.all(off <= square.radius)
    assert isinstance(square, Plane)


def test_the_checkers_vehicle_is_the_vehicle_that_flies() -> None:
    claim, rng = read_claim(document()["claim"]), np.random.default_rng(3)
    law = {key: float(value) for key, value in claim.law.items()}
    boat = {key: float(rng.uniform(*map(float, pair))) for key, pair in claim.ranges.items()}
    m, inertia = boat["mass_kg"], boat["yaw_inertia_kg_m2"]
    plant = PLANT_PARAMETERS.pack({
        "mass": [m, m, m, inertia], "linear_drag": [boat["surge_linear"], boat["sway_linear"], 1, boat["yaw_linear"]],
        "quadratic_drag": [boat["surge_quadratic"], boat["sway_quadratic"], 1, boat["yaw_quadratic"]],
        "thrust_limit": [9, 9, 9, 9], "thrust_lag": 0.0,
    })  # fmt: skip
    for _ in range(10):
        state = [float(n) for n in rng.uniform(-0.5, 0.5, 6)]
        thrust = tuple(float(n) for n in rng.uniform(-2, 2, 3))
        x = PLANT_STATE.pack({"eta": [0, 0, 0, state[2]], "nu": [state[3], state[4], 0.0, state[5]], "tau": [0] * 4})
        told = np.asarray(build_plant().ode(x, ca.vertcat(*thrust[:2], 0, thrust[2]), PLANT_DISTURBANCE.pack(), plant))
        own = true_rate(law, boat, state, thrust)
        moved = [told[0, 0] - law["cruise"], told[1, 0], told[3, 0], told[4, 0], told[5, 0], told[7, 0]]
        assert np.allclose(own, moved, atol=1e-9)


def test_a_form_that_doubles_cannot_hold_is_rejected() -> None:
    changed = document()
    changed["proof"]["P"] = [[1.0], [0, 1.0], [0, 1 - 1e-12, 1.0], [0, 0, 0, 1.0], [0, 0, 0, 0, 1.0], [0] * 5 + [1.0]]
    changed["claim"]["motion"].update(offset_m=0.01, beside_m=0.01, extent=[0.01, 0.01, 0.01])
    assert "ill-conditioned" in check_document(sealed(changed)).reason


def test_malformed_certificates_are_rejected_with_what_is_wrong() -> None:
    for where, value, text in (
        (("claim", "system"), "other", "not known"),
        (("claim", "excludes"), [], "claim.excludes differs"),
        (("proof", "P"), [[1.0]], "lower triangle"),
        (("claim", "vehicle", "mass_kg"), [114.0, 76.0], "least value exceeds"),
        (("claim", "law", "k"), None, "finite number"),
    ):
        assert text in check_document(sealed(put(document(), where, value))).reason
