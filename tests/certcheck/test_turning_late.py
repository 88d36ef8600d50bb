"""Turning cruises with thrust lag, held commands and a current: what the checker counts, and what it rejects."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.certcheck import check_document
from surctl.certcheck.document import Rejected
from surctl.certcheck.turning_cells import heading_cells, steady
from surctl.certcheck.turning_claim import drag_factors, read_claim
from surctl.certcheck.turning_form import Form, Phase, axes_of, stir
from surctl.certcheck.turning_matrix import Inclusion
from surctl.certcheck.turning_terms import flow_error, other_forces
from surctl.marine.vehicle import PLANT_DISTURBANCE, PLANT_STATE, build_plant, load_vehicle, plant_parameters
from tests.certcheck.altering import put, sealed
from tests.certcheck.turning_samples import draw_vehicles
from tests.certcheck.turning_truth import commanded, true_rate

HERE, STEP, ONE = Path(__file__).parent, 1e-6, Fraction(1)
BESIDE = ("claim", "motion", "ultimate_bound_m", 1)


def document(name: str = "region-turning-20-lag") -> dict[str, Any]:
    """The certificate with its two outermost shells, which is checked in a fraction of the time."""
    whole = json.loads((HERE / f"{name}.json").read_text())
    shells, proof = whole["proof"]["shells"], whole["proof"]
    whole["claim"]["motion"]["ultimate_bound_m"] = [0.2, 0.4]
    proof |= {"floor": shells[-3]["level"], "shells": shells[-2:]}
    return sealed(whole)


STRONGER: dict[str, Callable[[dict[str, Any]], Any]] = {
    "lag": lambda d: d["claim"]["vehicle"].update(lag_s=[0.1, 0.3]),
    "range of the lag": lambda d: d["claim"]["vehicle"].update(lag_s=[0.2, 0.1]),
    "lag from 0": lambda d: d["claim"]["vehicle"].update(lag_s=[0.0, 0.1]),
    "no lag": lambda d: d["claim"]["vehicle"].update(lag_s=[0.0, 0.0]),
    "current": lambda d: d["claim"]["vehicle"].update(current_m_per_s=0.05),
    "held commands": lambda d: d["claim"]["law"].update(period_s=0.1),
    "long period": lambda d: d["claim"]["law"].update(period_s=200.0),
    "yaw rate": lambda d: d["claim"]["vehicle"].update(yaw_rate_rad_per_s=1.0),
    "saturated thrust": lambda d: d["claim"]["vehicle"].update(thrust_n=[9.0, 9.0]),
    "curve": lambda d: d["claim"]["motion"].update(curvature_per_m=0.01),
    "force": lambda d: d["claim"]["vehicle"].update(force_n=0.01),
    "a thrust": lambda d: d["proof"].update(thrust={"weight": 1.0, "split": 1.0}),
    "no row of the thrust": lambda d: d["proof"]["P"].pop(),
    "light thrust": lambda d: [put(d, ("proof", "P", k, k), d["proof"]["P"][k][k] * 0.7) for k in (4, 5)],
    "mirror": lambda d: put(d, ("proof", "P", 5, 0), 1e-3),
    "m12": lambda d: d["claim"]["vehicle"].update(terms={"m12": 0.1}),
}  # a row each  # fmt: skip


def test_a_certificate_with_thrust_lag_is_accepted_and_what_asks_for_more_is_rejected() -> None:
    found = check_document(document())
    assert found.accepted, found.reason
    for kind, change in STRONGER.items():
        changed = document()
        change(changed)
        assert not check_document(sealed(changed)).accepted, kind


HELD: dict[str, Callable[[dict[str, Any]], Any]] = {
    "longer period": lambda d: d["claim"]["law"].update(period_s=0.07),
    "long period": lambda d: d["claim"]["law"].update(period_s=200.0),
    "no period": lambda d: d["claim"]["law"].update(period_s=0.0),
    "lag": lambda d: d["claim"]["vehicle"].update(lag_s=[0.1, 0.1]),
    "yaw rate": lambda d: d["claim"]["vehicle"].update(yaw_rate_rad_per_s=0.5),
    "gain": lambda d: d["claim"]["law"].update(k_v=9.0),
    "saturated thrust": lambda d: d["claim"]["vehicle"].update(thrust_n=[9.0, 9.0]),
    "curve": lambda d: d["claim"]["motion"].update(curvature_per_m=0.01),
    "small weight": lambda d: d["proof"]["thrust"].update(weight=d["proof"]["thrust"]["weight"] / 4),
    "large weight": lambda d: d["proof"]["thrust"].update(weight=d["proof"]["thrust"]["weight"] * 4),
    "small split": lambda d: d["proof"]["thrust"].update(split=0.01),
    "large split": lambda d: d["proof"]["thrust"].update(split=30.0),
    "no weight": lambda d: d["proof"]["thrust"].update(weight=0.0),
    "no thrust": lambda d: d["proof"].pop("thrust"),
}  # a row each  # fmt: skip


def test_a_certificate_with_held_commands_is_accepted_and_what_asks_for_more_is_rejected() -> None:
    found = check_document(document("region-turning-20-sampled"))
    assert found.accepted, found.reason
    for kind, change in HELD.items():
        changed = document("region-turning-20-sampled")
        change(changed)
        assert not check_document(sealed(changed)).accepted, kind


def test_what_a_current_leaves_of_the_trim_force_is_bounded_by_what_sampling_finds() -> None:
    whole, rng, n = json.loads((HERE / "region-turning-20-current.json").read_text()), np.random.default_rng(4), 20_000
    claim, flow = read_claim(whole["claim"]), np.array(whole["proof"]["flow"])
    rows = tuple((Fraction(repr(a)), Fraction(repr(b))) for a, b in flow.tolist())
    slopes = Fraction(0), Fraction(0)
    pushed = heading_cells(claim, steady(claim, slopes, (rows[0], rows[1], rows[2])), 12).pushed
    boat, psi, angle = draw_vehicles(claim, n, rng), rng.uniform(0, np.pi / 2, n), rng.uniform(0, 2 * np.pi, n)
    c, v = float(claim.current) * np.stack([np.cos(angle), np.sin(angle)]), float(claim.cruise)
    means = np.stack([np.ones(n), *(boat[key].mean(axis=1) - 1 for key in ("linear", "quadratic"))])
    shift = -(flow.T @ means) * c
    errors = []
    for i, axis in enumerate(([np.cos(psi), np.sin(psi)], [-np.sin(psi), np.cos(psi)])):
        m, a, b = (float(one[i]) for one in (claim.mass, claim.linear, claim.quadratic))
        w, to, water = axis[0] * v, axis[0] * shift[0] + axis[1] * shift[1], axis[0] * c[0] + axis[1] * c[1]
        law = (m * float(claim.k_v) + a) * to + b * (np.abs(w + to) * (w + to) - np.abs(w) * w)
        drag = boat["linear"][:, i] * a * water
        drag -= boat["quadratic"][:, i] * b * (np.abs(w - water) * (w - water) - np.abs(w) * w)
        errors.append(law + drag)
    ratio = np.hypot(*errors) / pushed[(psi / (np.pi / 2) * 12).astype(int)]
    assert 0.6 < ratio.max() <= 1


CURRENT: dict[str, Callable[[dict[str, Any]], Any]] = {
    "faster": lambda d: d["claim"]["vehicle"].update(current_m_per_s=0.05),
    "none": lambda d: d["claim"]["vehicle"].update(current_m_per_s=0.0),
    "no shift": lambda d: d["proof"].update(flow=[[0.0, 0.0]] * 3),
    "with the current": lambda d: d["proof"].update(flow=[[-g for g in row] for row in d["proof"]["flow"]]),
    "large shift": lambda d: d["proof"].update(flow=[[9.0, 9.0], [0.0, 0.0], [0.0, 0.0]]),
    "two rows": lambda d: d["proof"]["flow"].pop(),
    "no flow": lambda d: d["proof"].pop("flow"),
    "held": lambda d: (d["claim"]["law"].update(period_s=0.001), d["proof"].update(thrust={"weight": 1, "split": 1})),
    "narrower": lambda d: put(d, BESIDE, d["claim"]["motion"]["ultimate_bound_m"][1] - 0.001),
    "wider start": lambda d: d["claim"]["motion"].update(offset_m=d["claim"]["motion"]["offset_m"] + 0.005),
}  # a row each  # fmt: skip


def test_a_certificate_with_a_current_is_accepted_and_what_asks_for_more_is_rejected() -> None:
    whole = json.loads((HERE / "region-turning-20-current.json").read_text())
    found = check_document(whole)
    assert found.accepted, found.reason
    for kind, change in CURRENT.items():
        changed = json.loads((HERE / "region-turning-20-current.json").read_text())
        change(changed)
        assert not check_document(sealed(changed)).accepted, kind


def test_in_a_current_the_checkers_vehicle_is_that_of_the_toolkit() -> None:
    whole, vehicle, rng = document(), load_vehicle("bluerov2-heavy"), np.random.default_rng(3)
    claim, n = read_claim(whole["claim"]), 5
    boat = {key: np.ones((n, 2)) for key in ("mass", "linear", "quadratic")}
    boat |= {"term_mass": np.ones(n), "term": np.ones(n)}
    psi, r, flow = rng.uniform(-3, 3, n), rng.uniform(-0.5, 0.5, n), rng.uniform(-0.2, 0.2, (n, 2))
    state, error = rng.uniform(-0.3, 0.3, (n, 4)), rng.uniform(-2, 2, (n, 2))
    found = true_rate(claim, boat, state, psi, r, flow=flow, error=error)[:, 2:]
    thrust, plant = commanded(claim, state, psi) + error, build_plant(vehicle.form)
    for k in range(n):
        c, s = np.cos(psi[k]), np.sin(psi[k])
        turn = np.array([[c, -s], [s, c]])
        nu = turn.T @ state[k, 2:]
        tau = [*thrust[k], 0, 0]
        x = PLANT_STATE.pack({"eta": [0, 0, 0, psi[k]], "nu": [*nu, 0, r[k]], "tau": tau})
        water = PLANT_DISTURBANCE.pack({"current": [*flow[k], 0.0]})
        rate = np.asarray(plant.ode(x, tau, water, plant_parameters(vehicle)))[4:6, 0]
        assert np.allclose(found[k], turn @ (rate + r[k] * np.array([-nu[1], nu[0]])), atol=1e-9)


@pytest.mark.parametrize("key", ["current_m_per_s", "lag_s"])
def test_a_claim_without_its_lag_or_current_is_refused(key: str) -> None:
    whole = document()
    del whole["claim"]["vehicle"][key]
    assert key in check_document(sealed(whole)).reason


def test_a_force_by_surge_speed_acts_on_its_axis() -> None:
    claim, rng, n = read_claim(document()["claim"]), np.random.default_rng(4), 5
    boat = {key: np.ones((n, 2)) for key in ("mass", "linear", "quadratic")} | {
        "term_mass": np.ones(n),
        "term": np.ones(n),
    }
    state, still = rng.uniform(-0.3, 0.3, (n, 4)), np.zeros(n)
    u, v, r = *state[:, 2:].T, rng.uniform(-0.5, 0.5, n)
    first = true_rate(replace(claim, terms={}), boat, state, still, r)
    for name, speeds in {"Xuv": np.abs(u) * v, "Yu": u, "Yvu": np.abs(v) * u, "Yur": np.abs(u) * r}.items():
        axis = "XY".index(name[0])
        change = true_rate(replace(claim, terms={name: Fraction(2)}), boat, state, still, r) - first
        assert np.allclose(change[:, 2 + axis], -2 * speeds / float(claim.mass[axis]), rtol=0, atol=1e-12), name
        assert not change[:, 3 - axis].any()


def test_a_form_that_doubles_cannot_hold_is_rejected() -> None:
    near = [[ONE if i == j else Fraction(10**12 - 1, 10**12) * (i + j == 1) for j in range(4)] for i in range(4)]
    with pytest.raises(Rejected, match="ill-conditioned"):
        Form.of(near)


def test_forces_by_surge_speed_are_bounded_on_their_axis() -> None:
    claim, speed = read_claim(document()["claim"]), Fraction(3)
    plain = other_forces(replace(claim, terms={}), speed)
    for name, product in {
        "Xuv": speed**2,
        "Yu": speed,
        "Yur": speed * claim.yaw_rate,
        "Xwu": claim.heave * speed,
    }.items():
        bounds = other_forces(replace(claim, terms={name: Fraction(-2)}), speed)
        axis = "XY".index(name[0])
        assert bounds[axis] - plain[axis] == 2 * max(claim.drag_factor[1], ONE) * product
        assert bounds[1 - axis] == plain[1 - axis]


def test_the_command_in_a_current_moves_by_its_largest_gain() -> None:
    claim = replace(read_claim(document()["claim"]), current=Fraction(1, 50))
    current, v, gain = 0.02, float(claim.cruise), 5.0
    pairs = (Fraction(5), Fraction(0)), (Fraction(0), Fraction(0)), (Fraction(0), Fraction(0))
    share = np.array([[[1.0, 1.0], [0.0, 0.0]]])
    (bound,) = flow_error(claim, pairs, (0.0, 0.0), share)
    linear, square = float(claim.linear[0]), float(claim.quadratic[0])
    law = (float(claim.mass[0] * claim.k_v) + linear) * gain * current + square * ((v + gain * current) ** 2 - v**2)
    drags = [float(f[0]) * linear * current + float(f[2]) * square * ((v + current) ** 2 - v**2)
             for f in drag_factors(claim)]  # fmt: skip
    assert max(abs(law - drag) for drag in drags) <= bound < 1.2 * abs(law)


def test_what_a_current_leaves_is_rounded_up() -> None:
    claim, rng = read_claim(document("region-turning-20-current")["claim"]), np.random.default_rng(0)
    share = np.array([[[1.0, 1.0], [0.0, 0.0]]])
    for _ in range(20):  # a shift that leaves nothing but its own rounding
        m, drag, k_v = (Fraction(repr(round(float(x), 4))) for x in rng.uniform(1, 50, 3))
        known = replace(claim, mass=(m, m), k_v=k_v, linear=(drag, drag), quadratic=(0 * ONE,) * 2,
                        drag_factor=(ONE, ONE), drag_asymmetry=0 * ONE)  # fmt: skip
        gain = Fraction(repr(float(drag / (m * k_v + drag))))
        (bound,) = flow_error(known, ((gain, gain), (0 * ONE,) * 2, (0 * ONE,) * 2), (0.0, 0.0), share)
        assert Fraction(float(bound)) >= abs(drag - (m * k_v + drag) * gain) * claim.current


@pytest.mark.parametrize("lag", [0, Fraction(1, 5)])
def test_what_a_turn_of_the_heading_does_to_a_command_is_bounded_by_what_sampling_finds(lag: Fraction) -> None:
    claim, rng, n = replace(read_claim(document()["claim"]), lag=(lag, lag)), np.random.default_rng(5), 40_000
    r, fast, led, psi = float(claim.yaw_rate), 0.16, 0.03, rng.uniform(0.7, 0.8, n)
    axes = np.array([[np.cos(psi), np.sin(psi)], [-np.sin(psi), np.cos(psi)]])  # n_i (i, entry, n)
    share = np.abs(axes[:, 0]).max(axis=1)
    at = stir(claim, 0.01, fast, 0.0, share, np.full(2, led))
    moved = rng.uniform(-led, led, (2, n)) / np.sqrt(2)
    rest = []
    for i, other in ((0, axes[1]), (1, -axes[0])):  # the axis turns at r times the other one
        m, a, b = (float(one[i]) for one in (claim.mass, claim.linear, claim.quadratic))
        wished = np.array([fast + moved[0], moved[1]])
        slope, steady = ((a + 2 * b * np.abs((axes[i] * w).sum(axis=0))) / m for w in (wished, [[fast], [0.0]]))
        own = (steady if lag else slope) * other[0] * fast  # of w_2: with lag, that of the steady command moves F too
        rest.append(r * (slope * (other * wished).sum(axis=0) - own))
    ratio = np.hypot(*rest) / np.hypot(*moved) / at.swing
    assert 0.6 < ratio.max() <= 1


@pytest.mark.parametrize("moves", [(1, 1), (1, 0), (0, 0)])
@pytest.mark.parametrize(("lag", "begins"), [(0.2, True), (0.2, False), (0.0, True), (0.0, False)])
@pytest.mark.parametrize("disturbed_by", ["nothing", "late", "lack", "pushed"])
def test_the_matrix_of_a_cell_is_that_of_the_equations(
    moves: tuple[int, int], lag: float, begins: bool, disturbed_by: str
) -> None:
    rng, size = np.random.default_rng(1), 6 if lag else 4
    root, weight, split, fall = rng.normal(size=(size, size)), 0.7, 1.3, 9.0
    p = [[Fraction(round(n, 6)).limit_denominator(10**6) for n in row] for row in root @ root.T + np.eye(size)]
    p = [[p[max(i, j)][min(i, j)] for j in range(size)] for i in range(size)]
    claim = replace(read_claim(document("region-turning-20-sampled")["claim"]), lag=(Fraction(1, 5),) * 2)
    form = Form.of(p, Fraction(7, 10))
    psi, r, e1, e2, level, growth = 0.4, 0.3, -0.11, 0.13, 0.5, 0.05
    light, spread, swing, most = np.array([1 / 20.0, 1 / 25.0]), 0.2, 0.1, 0.06
    c, s = np.cos(psi), np.sin(psi)
    n = np.array([[c, s], [-s, c]])
    own = [np.outer(one, one) for one in n]
    loops = [np.array([[30.0, 20.0, 3.0]]), np.array([[28.0, 25.0, 4.0]])]
    plan = np.array([[0.3, 0.0], [0.02, 0.2]])
    none = {"lack": np.zeros((1, 2)), "late": np.zeros((1, 2)), "pushed": np.zeros(1)}
    more = {**none, **({} if disturbed_by == "nothing" else {
        disturbed_by: np.array([most] if disturbed_by == "pushed" else [[most, 0.0]])
    })}  # fmt: skip
    axes, crossed = axes_of(np.array([[[np.cos(2 * psi), np.sin(2 * psi)]]]))
    at = Inclusion(  # the Coriolis force of the steady cruise is another disturbance
        speed=0.0, gain=float(claim.k_v), axes=axes, crossed=crossed, masses=np.array([[*light, 0.0]]),
        modelled=np.array([float(m) for m in claim.mass]), turns=np.array([[r * e1, r * e2, 0.0, r]]),
        along=np.zeros(1), loops=(loops[0][None], loops[1][None]), plans=plan[None], loose=0.0, stray=0.0,
        spread=np.array([spread]), swing=np.array([swing]), phase=Phase(lag, split if begins else 0.0, fall, begins),
        moves=np.array(moves, dtype=float)[:, None], **more,
    )  # fmt: skip
    entries = at.losses(form, float(claim.rate), growth, level)
    masses, k_v, total = np.array([float(m) for m in claim.mass]), float(claim.k_v), size + 2
    A = np.zeros((total, total))
    A[:2, 2:4] = np.eye(2)
    command, drag = np.zeros((2, total)), np.zeros((2, 2))
    for i in (0, 1):
        stiff, damped, slope = loops[i][0]
        share = own[i] / masses[i] if lag else own[i] * light[i]
        command[:, :2] -= stiff * share @ plan
        command[:, 2:4] -= damped * share
        drag += slope * light[i] * own[i]
    A[2:4, 2:4] = -drag - r * (e1 * np.outer(n[0], n[1]) + e2 * np.outer(n[1], n[0]))
    acts = sum(masses[i] * light[i] * own[i] for i in (0, 1))
    if lag:
        A[2:4, 4:6] = acts
        A[4:6] = command / lag
        A[4:6, 4:6] += -np.eye(2) / lag + r * np.array([[0.0, -1.0], [1.0, 0.0]])
    else:
        A[2:4] += command
    if not begins:
        A[4:6, 6:] += np.eye(2) / lag if lag else 0.0
        A[2:4, size:] += 0.0 if lag else acts
    moving = moves[0] * own[0] + moves[1] * own[1]
    if begins:
        J = np.outer(n[0], n[1]) - np.outer(n[1], n[0])
        A[size:] = k_v * moving @ A[2:4]
        A[size:, 2:4] += r * k_v * moving @ J
        A[size:, :2] += r * k_v * moving @ J @ plan
    A[size:, size:] -= (fall - (split if begins else 0.0)) / 2 * np.eye(2)
    P = np.zeros((total, total))
    P[:size, :size], P[size:, size:] = [[float(x) for x in row] for row in p], weight * np.eye(2)
    whole = A.T @ P + P @ A + (float(claim.rate) + growth) * P
    if begins:
        whole[2:4, 2:4] += weight / split * spread**2 * np.eye(2)
        whole[:2, :2] += weight / split * swing**2 * plan.T @ plan
    entry = np.zeros((total, 2))
    for i in (0, 1):
        if disturbed_by == "pushed" or (disturbed_by != "nothing" and i == 0):
            entry[:] = 0
            if disturbed_by == "late":
                entry[4:6] = np.eye(2) * bool(lag)
                entry[size:] += moves[i] * begins * np.eye(2)
            else:
                entry[2:4], entry[size:] = light[i] * np.eye(2), light[i] * k_v * begins * moves[i] * np.eye(2)
            pull = P @ entry @ n[i]
            whole += most**2 / level * np.outer(pull, pull)
    expected = -form.change @ whole @ form.change.T
    for (i, j), found in entries.items():
        assert found.reshape(-1) == pytest.approx(expected[i, j], abs=2e-6 * np.abs(expected).max())
