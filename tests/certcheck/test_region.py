import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.certcheck import Rejected, check_document, region
from surctl.certcheck.region_claim import read_claim
from surctl.certcheck.region_exact import inverse, is_positive_definite, product, root_down, root_up, rounded_up
from surctl.certcheck.region_inclusion import _misled
from surctl.certcheck.region_trim import steady_trim
from surctl.certcheck.turning_terms import outer_force
from surctl.marine.control import build_law, load_gains
from surctl.marine.control.ports import law_parameters
from surctl.marine.guidance import Path as Route
from surctl.marine.vehicle import PLANT_DISTURBANCE, PLANT_PARAMETERS, PLANT_STATE, build_plant, load_vehicle
from tests.certcheck.altering import altered, put, sealed
from tests.certcheck.cruise import boats, matrix, omega, rate, rest, thrust, worst
from tests.certcheck.cruise_inclusion import Vehicle, commanded_thrust, commanded_velocity, true_rate, turned

HERE = Path(__file__).parent
FILES = sorted(HERE.glob("region-cruise-*.json"))
QUICK = ("region-cruise-20-sampled", "region-cruise-ranges")


def document(name: str = "region-cruise-20-norms") -> dict[str, Any]:
    return json.loads((HERE / f"{name}.json").read_text())


@pytest.mark.parametrize("path", [path for path in FILES if path.stem in QUICK], ids=lambda p: p.stem)
def test_the_kept_certificates_are_accepted_and_small(path: Path) -> None:
    """All of them: study 40."""
    found = check_document(json.loads(path.read_text()))
    assert found.accepted, found.reason
    assert len(path.read_text()) < 10_000


def test_there_are_certificates_of_every_kind_of_loop() -> None:
    claims = [json.loads(path.read_text())["claim"] for path in FILES]
    assert {(c["law"]["period_s"] > 0, c["vehicle"]["lag_s"][1] > 0) for c in claims} >= {(False, False), (True, True)}


# what may be changed, and a change that asks for more than was proved
STRONGER: dict[str, Callable[[dict[str, Any], float], None]] = {
    "rate": lambda d, f: d["claim"]["motion"].update(rate_per_s=0.4 * (1 + f)),
    "offset": lambda d, f: d["claim"]["motion"].update(offset_m=d["claim"]["motion"]["offset_m"] * (1.001 + f)),
    "ultimate_bound": lambda d, f: d["claim"]["motion"].update(
        ultimate_bound_m=[x / (1.02 + f) for x in d["claim"]["motion"]["ultimate_bound_m"]]
    ),
    "mass": lambda d, f: d["claim"]["vehicle"].update(mass_kg=[76.0, 114 * (3 + 5 * f)]),
    "thrust": lambda d, f: d["claim"]["vehicle"].update(thrust_n=2.4 * (1 - f)),
    "drag": lambda d, f: d["claim"]["vehicle"].update(quadratic_drag=[48.0, 72 * (4 + f)]),
    "linear": lambda d, f: d["claim"]["vehicle"].update(linear_drag=[1.6, 25 * (1 + f)]),
    "gain k1": lambda d, f: d["claim"]["law"].update(k1=0.01 * (1 - f)),
    "gain k_v": lambda d, f: d["claim"]["law"].update(k_v=0.2 * (1 - f)),
    "lookahead": lambda d, f: d["claim"]["law"].update(lookahead=0.25 * (1 - f / 2)),
    "cap": lambda d, f: d["claim"]["law"].update(cap=0.15 * (1 - f / 2)),
    "wait": lambda d, f: d["claim"]["law"].update(wait=0.1 * (1 - f / 2)),
    "believed mass": lambda d, f: d["claim"]["law"].update(mass_kg=10.0 * (1.1 - f)),
    "integral": lambda d, f: d["claim"]["law"].update(k_i=0.01 + f),
    "floor": lambda d, f: d["proof"].update(floor=d["proof"]["floor"] * 0.01 * (1.01 - f)),
    "last level": lambda d, f: d["proof"]["shells"][-1].update(level=1.01 + f),
    "multiplier": lambda d, f: d["proof"]["shells"][-1].update(multipliers=[f * 1e-4] * 5),
    "sign of P": lambda d, f: d["proof"]["P"][1].__setitem__(1, -d["proof"]["P"][1][1] * (0.1 + f)),
    "size of P": lambda d, f: d["proof"].update(P=[[e * (1e-3 + 0.1 * f) for e in row] for row in d["proof"]["P"]]),
}


@pytest.mark.parametrize("kind", [*STRONGER][1::4])  # all of them: study 40
def test_what_asks_for_more_is_rejected_however_it_is_sealed(kind: str) -> None:
    share, changed = float(np.random.default_rng(len(kind)).uniform(size=3).min()), document()
    STRONGER[kind](changed, share)
    assert not check_document(sealed(changed)).accepted, (kind, share)


CELLS = {key: change for key, change in STRONGER.items() if key not in ("multiplier", "size of P")} | {
    "growth": lambda d, f: d["proof"]["shells"][-1].update(growth=1e-4 * f),
    "asymmetry": lambda d, f: d["claim"]["vehicle"].update(asymmetry=1 + f),
    "asymmetry 2": lambda d, f: d["claim"]["vehicle"].update(asymmetry=2.0),
    "drag that the law does not know": lambda d, f: d["claim"]["law"].update(linear_drag=0.0),
    "held commands": lambda d, f: d["claim"]["law"].update(period_s=0.05),
    "lag": lambda d, f: d["claim"]["vehicle"].update(lag_s=[0.2, 0.2]),
    "current": lambda d, f: d["claim"]["vehicle"].update(current_m_per_s=0.01),
    "force": lambda d, f: d["claim"]["vehicle"].update(force_n=0.5 + f),
    "place": lambda d, f: d["claim"]["vehicle"].update(place_error_m=0.01 + f / 10),
    "velocity": lambda d, f: d["claim"]["vehicle"].update(velocity_error_m_per_s=0.005 + f / 10),
    "slopes": lambda d, f: d["proof"].update(trim=[0.0, 0.0]),
}


@pytest.mark.parametrize("kind", [*CELLS][::2])
def test_a_proof_by_cells_of_headings_proves_no_more_either(kind: str) -> None:
    changed = document("region-cruise-20")
    CELLS[kind](changed, 0.3)
    assert not check_document(sealed(changed)).accepted


@pytest.mark.parametrize(
    ("where", "value"),
    [
        (("claim", "system"), "other"),
        (("claim", "excludes"), []),
        (("claim", "sha256_law"), "0"),
        (("claim", "more"), 1),
        (("proof", "more"), 1),
        (("more",), 1),
        (("proof", "P"), [[1.0]]),
        (("proof", "shells"), []),
        (("proof", "floor"), True),
        (("claim", "motion", "rate_per_s"), "0.05"),
        (("claim", "vehicle", "lag_s"), [0, 0.3]),
        (("claim", "vehicle", "mass_kg"), [114.0, 76.0]),
        (("claim", "law", "k1"), None),
        pytest.param(("claim", "law", "k1"), 10**400, id="huge"),
    ],
)
def test_what_is_malformed_is_rejected(where: tuple[str, ...], value: Any) -> None:
    assert not check_document(sealed(put(document(), where, value))).accepted


def refuted(changed: dict[str, Any]) -> bool:
    """Whether plain sampling shows an altered certificate to be false."""
    P, proof, motion = matrix(changed), changed["proof"], changed["claim"]["motion"]
    if np.linalg.eigvalsh(P)[0] <= 0 or proof["shells"][-1]["level"] != 1:
        return True
    covariance = np.linalg.inv(P)
    if P[1, 1] * motion["offset_m"] ** 2 > 1 + 1e-9:
        return True
    if np.sqrt(covariance[1, 1] * proof["floor"]) > motion["ultimate_bound_m"][1] * (1 + 1e-9):
        return True
    return worst(changed, low=proof["floor"], high=1.0, count=4000) > 1e-9


def test_no_altered_certificate_that_sampling_refutes_is_accepted() -> None:
    whole, rng = document(), np.random.default_rng(5)
    false, accepted = 0, 0
    for _ in range(6):
        if false and accepted:
            break
        path, changed = altered(whole, ("claim", "proof"), rng)
        found = check_document(sealed(changed))
        accepted += found.accepted
        if found.accepted:
            assert not refuted(changed), path
        else:
            false += 1
    assert false and accepted  # neither everything nor nothing passes


def test_sampling_finds_no_slower_decay_inside_and_finds_it_far_outside() -> None:
    whole = document()
    assert worst(whole, low=whole["proof"]["floor"], high=1.0) < 0
    assert worst(whole, low=10.0, high=40.0) > 0


# the law and the vehicle of the checker are those of the toolkit


def _flown() -> tuple[dict[str, Any], Any]:
    claim = document()["claim"]
    return claim, read_claim(claim)


def test_the_checkers_law_is_the_law_that_flies() -> None:
    claim, exact = _flown()
    vehicle, gains, law = load_vehicle("sur540-flooded"), load_gains("default"), build_law()
    p = law_parameters(
        gains, vehicle, path=Route(np.array([[0.0, 0.0], [90.0, 0.0]])), depth=-1.0, cruise=claim["law"]["cruise"],
        cap=claim["law"]["cap"], walls=(-1e3, 1e3, -1e3, 1e3),
    )  # fmt: skip
    rng, far = np.random.default_rng(2), 30.0
    for _ in range(20):
        psi, x_e, y_e = rng.uniform(-3, 3), rng.uniform(-0.3, 0.3), rng.uniform(-0.6, 0.6)
        nu = np.array([*rng.uniform(-0.2, 0.2, size=2), 0.0, 0.0])
        x = law.state.pack({"progress": [far]})
        u = law.inputs.pack({"eta": [far + x_e, y_e, -1.0, psi], "nu": nu})
        told = law.step(x, u, p).tau[:2]
        heading = Fraction(float(np.cos(psi))), Fraction(float(np.sin(psi)))
        slant = Fraction(float(np.hypot(1, y_e / claim["law"]["lookahead"])))
        wish = commanded_velocity(exact, Fraction(float(x_e)), Fraction(float(y_e)), slant)
        wanted = turned((heading[0], -heading[1]), wish)
        own = commanded_thrust(exact, wanted, (Fraction(float(nu[0])), Fraction(float(nu[1]))))
        assert np.allclose(told, [float(f) for f in own], atol=1e-9)


@pytest.mark.parametrize("lag", [0.0, 0.3])
def test_the_checkers_vehicle_is_the_vehicle_that_flies(lag: float) -> None:
    claim, _ = _flown()
    claim["vehicle"]["lag_s"] = [lag, lag]
    exact, rng = read_claim(claim), np.random.default_rng(3)
    for _ in range(20):
        psi, r = rng.uniform(-3, 3), rng.uniform(-0.5, 0.5)
        state = np.array([rng.uniform(-0.2, 0.2), rng.uniform(-0.5, 0.5), *rng.uniform(-0.2, 0.2, 2)])
        force = rng.uniform(-3, 3, 2) if lag else np.zeros(2)  # in the path frame
        c, s = np.cos(psi), np.sin(psi)
        turn = np.array([[c, -s], [s, c]])
        boat = Vehicle(Fraction(80), (Fraction(2), Fraction(3)), (Fraction(50), Fraction(70)), Fraction(str(lag)),
                       Fraction(float(r)))  # fmt: skip
        slant = Fraction(float(np.hypot(1, state[1] / 0.8)))
        whole = [Fraction(float(v)) for v in (*state, *(force if lag else ()))]
        told = true_rate(exact, boat, (Fraction(float(c)), Fraction(float(s))), whole, slant)
        nu = np.array([*(turn.T @ state[2:4]), 0.0, r])
        wish = commanded_velocity(exact, whole[0], whole[1], slant)
        wanted = turned((Fraction(float(c)), Fraction(float(-s))), wish)
        command = commanded_thrust(exact, wanted, (Fraction(float(nu[0])), Fraction(float(nu[1]))))
        plant = PLANT_PARAMETERS.pack(
            {
                "mass": [80, 80, 80, 2], "linear_drag": [2, 3, 1, 1], "quadratic_drag": [50, 70, 1, 1],
                "thrust_limit": [9, 9, 9, 9], "thrust_lag": lag,
            }
        )  # fmt: skip
        body = turn.T @ force
        x = PLANT_STATE.pack({"eta": [0, 0, 0, psi], "nu": nu, "tau": [*body, 0, 0]})
        out = np.asarray(build_plant().ode(x, ca.vertcat(*map(float, command), 0, 0), PLANT_DISTURBANCE.pack(), plant))
        eta, nu_rate, tau_rate = out[:2, 0], out[4:6, 0], out[8:10, 0]
        own = [eta[0] - claim["law"]["cruise"], eta[1]]
        own += list(turn @ (nu_rate + r * np.array([-nu[1], nu[0]])))
        if lag:
            own += list(turn @ (tau_rate + r * np.array([-body[1], body[0]])))
        assert np.allclose([float(v) for v in told], own, atol=1e-9)


BENT = {  # the force is largest between the vertices of the drag: the speed is far from affine there
    "linear_drag": 5.0, "quadratic_drag": 1.0, "mass_kg": 1.0, "k_v": 0.1, "cruise": 1.0, "cap": 2.0,
    "vehicle": {"linear_drag": [2.0, 6.7], "quadratic_drag": [2.7, 2.7], "asymmetry": 0.147, "current_m_per_s": 1e-6,
                "thrust_n": 100.0},
}  # fmt: skip
STRONG = {"cap": 0.5, "vehicle": {"thrust_n": 100.0, "current_m_per_s": 0.1, "quadratic_drag": [60.0, 90.0]}}


@pytest.mark.parametrize(
    ("name", "changes", "least"),
    [
        ("region-cruise-20", {}, 0.85),
        ("region-cruise-current", {}, 0.85),
        ("region-cruise-current", BENT, 0.5),
        ("region-cruise-current", STRONG, 0.7),
    ],
)
def test_the_trim_is_bounded_by_what_sampling_finds(name: str, changes: dict[str, Any], least: float) -> None:
    claim = document(name)["claim"]
    claim["vehicle"] |= changes.get("vehicle", {})
    claim["law"] |= {key: value for key, value in changes.items() if key != "vehicle"}
    exact = read_claim(claim)
    rng, n = np.random.default_rng(4), 3_000
    boat = boats(claim, n, rng)
    w, psi = omega(claim, boat), rng.uniform(0, 2 * np.pi, size=n)
    bound = steady_trim(exact)
    assert float(bound.omega[0]) <= w[:, 0].min() + 1e-15 and w[:, 0].max() <= float(bound.omega[1]) + 1e-15
    assert np.abs(w[:, 1]).max() <= float(bound.drift) and np.abs(rest(claim, boat)[:, 1]).max() <= float(bound.aside)
    # at the steady place and velocity what is left over is the lack of the trim force
    state = np.zeros((n, 4))
    state[:, :2], state[:, 2] = rest(claim, boat), claim["law"]["cruise"]
    lack = np.hypot(*rate(claim, boat, state, psi)[:, 2:].T) * boat["mass"]
    assert least * float(bound.total) < lack.max() <= float(bound.total)


def test_in_a_current_it_settles_as_close_as_is_said() -> None:
    whole = document("region-cruise-current")
    claim, P, rng, n, h = whole["claim"], matrix(whole), np.random.default_rng(6), 150, 0.05
    assert claim["vehicle"]["current_m_per_s"] == 0.05 and max(claim["motion"]["ultimate_bound_m"]) <= 0.06
    assert worst(whole, low=whole["proof"]["floor"], high=1.0) < 0
    boat = boats(claim, n, rng)
    xi = rng.normal(size=(n, 4)) @ np.linalg.inv(np.linalg.cholesky(P))
    state = xi / np.sqrt(np.einsum("ni,ij,nj->n", xi, P, xi))[:, None]
    state[:, :2] += rest(claim, boat)
    state[:, 2] += claim["law"]["cruise"]
    psi = rng.uniform(0, 2 * np.pi, size=n)
    for k in range(1200):
        state = state + h * rate(claim, boat, state, psi)
        psi = psi + h * rng.choice([-0.5, 0.5], size=n) * (k % 40 > 0)
    assert np.all(np.abs(state[:, :2]).max(axis=0) <= claim["motion"]["ultimate_bound_m"])
    assert np.abs(state[:, 1]).max() > 0.3 * claim["motion"]["ultimate_bound_m"][1]  # it is not for want of a current
    claim["law"]["period_s"] = 0.05
    assert "current" in check_document(sealed(whole)).reason


@pytest.mark.parametrize("name", ["region-cruise-20-force"])
def test_pushed_and_misled_it_settles_as_close_as_is_said(name: str) -> None:
    whole = document(name)
    claim, P, rng, n, h = whole["claim"], matrix(whole), np.random.default_rng(8), 60, 0.05
    floor = whole["proof"]["floor"]
    assert worst(whole, low=floor, high=1.0) < 0
    boat = boats(claim, n, rng)
    ends = rng.normal(size=(n, 4)) @ np.linalg.inv(np.linalg.cholesky(P))
    state = ends / np.sqrt(np.einsum("ni,ij,nj->n", ends, P, ends))[:, None]
    state[:, :2] += rest(claim, boat)
    state[:, 2] += claim["law"]["cruise"]
    psi, most = rng.uniform(0, 2 * np.pi, size=n), 0.0
    for k in range(1400):
        if k % 100 == 0:  # it pushes and misleads another way for 5 s
            other = boats(claim, n, rng)
            boat |= {key: other[key] for key in ("push", "place", "speed")}
        state = state + h * rate(claim, boat, state, psi)
        psi = psi + h * rng.choice([-0.5, 0.5], size=n)
        if k > 1000:
            most = max(most, *(np.abs(state[:, :2]).max(axis=0) / claim["motion"]["ultimate_bound_m"]))
    assert 0.1 < most <= 1
    for key in ("force_n", "place_error_m", "velocity_error_m_per_s"):
        if claim["vehicle"][key]:
            claim["vehicle"][key] *= 3
            assert not check_document(sealed(whole)).accepted
            claim["vehicle"][key] /= 3


def test_errors_of_what_is_measured_change_the_thrust_by_no_more_than_is_counted() -> None:
    claim = document("region-cruise-20-noise")["claim"]
    exact, rng, n = read_claim(claim), np.random.default_rng(9), 40_000
    y = 0.4
    state = np.stack(
        [rng.uniform(-0.7, 0.7, n), rng.uniform(-y, y, n), rng.uniform(0, 0.3, n), rng.uniform(-0.1, 0.1, n)], axis=1
    )
    angle, boat, psi = rng.uniform(0, 2 * np.pi, (2, n)), boats(claim, n, rng), rng.uniform(0, 2 * np.pi, n)
    for size, key in (
        (claim["vehicle"]["place_error_m"], "place"),
        (claim["vehicle"]["velocity_error_m_per_s"], "speed"),
    ):
        boat[key] = size * np.stack([np.cos(angle[0]), np.sin(angle[0])], axis=1)
    measured = state + np.hstack([boat["place"], boat["speed"]])
    change = np.hypot(*(thrust(claim, measured, psi) - thrust(claim, state, psi)).T)
    slope = exact.mass_model * exact.k_v + exact.linear_model + 2 * exact.quadratic_model * exact.cap
    for counted in (
        float(_misled(exact, steady_trim(exact), Fraction(y), slope)),
        outer_force(replace(region._turning(exact), force=Fraction(0)), y),
    ):
        assert 0.5 * counted < change.max() <= counted
    assert outer_force(region._turning(exact), y) == pytest.approx(counted + float(exact.force))


@pytest.mark.parametrize(("error", "key"), [("place", "linear"), ("place", "quadratic"), ("speed", "mass")])
@pytest.mark.parametrize("heavy", [0, 1])
def test_errors_count_on_the_axis_with_the_steepest_command(error: str, key: str, heavy: int) -> None:
    """Masses and drag of the axes differ; along the path, k1 is all that counts far ahead."""
    claim, rng, n, y = document("region-cruise-20-noise")["claim"], np.random.default_rng(heavy), 40_000, 0.1
    claim["law"] |= {"lookahead": 100.0, "cap": 1.0, "k1": 1.0, "cruise": 0.5}
    claim["vehicle"]["thrust_n"] = 1e9
    law, psi = read_claim(claim), rng.uniform(0, 2 * np.pi, n)
    pair: dict[str, Any] = {
        name: tuple(value * (1 + 9 * (name == key and axis == heavy)) for axis in (0, 1))
        for name, value in (("mass", law.mass_model), ("linear", law.linear_model), ("quadratic", law.quadratic_model))
    }
    errors: dict[str, Any] = {"place_error": Fraction(0), "velocity_error": Fraction(0)}
    errors["place_error" if error == "place" else "velocity_error"] = Fraction("0.01")
    size, angle = 0.01, rng.uniform(0, 2 * np.pi, n)
    state = np.stack([rng.uniform(-0.6, 0.6, n), *rng.uniform(-y, y, (3, n))], axis=1)
    measured, at = state.copy(), slice(2) if error == "place" else slice(2, 4)
    measured[:, at] += size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    change = np.zeros((n, 2))
    for axis in (0, 1):
        names = {"mass_kg": "mass", "linear_drag": "linear", "quadratic_drag": "quadratic"}
        own = claim | {"law": claim["law"] | {name: float(pair[part][axis]) for name, part in names.items()}}
        change[:, axis] = (thrust(own, measured, psi) - thrust(own, state, psi))[:, axis]
    counted = outer_force(replace(region._turning(law), force=Fraction(0), **pair, **errors), y)
    assert 0.9 * counted < np.hypot(*change.T).max() <= counted


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(1, 6), st.integers(0, 10**6))
def test_definiteness_is_that_of_the_eigenvalues(size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.integers(-9, 10, size=(size, size))
    whole = root @ root.T + int(rng.integers(-20, 20)) * np.eye(size, dtype=int)
    least = np.linalg.eigvalsh(whole.astype(float))[0]
    exact = [[Fraction(int(entry)) for entry in row] for row in whole]
    if abs(least) > 1e-6:
        assert is_positive_definite(exact) == (least > 0)
    if least > 1e-6:
        unit = product(exact, inverse(exact))
        assert all(unit[i][j] == (i == j) for i in range(size) for j in range(size))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.fractions(0, 10**6))
def test_roots_are_on_their_side(value: Fraction) -> None:
    assert root_down(value) ** 2 <= value <= root_up(value) ** 2
    assert root_up(value) - root_down(value) <= Fraction(3, 10**9)


def test_rounding_up_keeps_a_form_above() -> None:
    rng = np.random.default_rng(6)
    for _ in range(50):
        a, b, c = (Fraction(float(v)) for v in rng.normal(size=3))
        up = rounded_up([[a, b], [b, c]])
        assert is_positive_definite([[up[0][0] - a, up[0][1] - b], [up[1][0] - b, up[1][1] - c]])


def test_the_reason_names_what_fails() -> None:
    changed = document()
    changed["claim"]["motion"]["offset_m"] = 3.0
    assert "3 m beside the path is not in the region" in check_document(sealed(changed)).reason
    for axis in (0, 1):
        changed = document()
        changed["claim"]["motion"]["ultimate_bound_m"][axis] *= 0.8
        assert "beyond the claimed ultimate bound" in check_document(sealed(changed)).reason
    with pytest.raises(Rejected, match="exactly the keys"):
        read_claim({})
