"""The checker of cruises with unequal masses: what it accepts, and what it must not."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.certcheck import check_document
from surctl.certcheck.document import Rejected
from surctl.certcheck.region_exact import inverse, quadratic
from surctl.certcheck.turning import _check_munk_moment, cruise_of, require_starts, triangle
from surctl.certcheck.turning_cells import Setting, Trim, _lack, heading_cells, steady
from surctl.certcheck.turning_claim import axis_pairs, drag_factors, read_claim
from surctl.certcheck.turning_form import Extent, Form, axes_of
from surctl.certcheck.turning_terms import coupling_of, inverse_masses, other_forces, other_moment, turn_points
from surctl.marine.control import build_law, load_gains
from surctl.marine.control.ports import law_parameters
from surctl.marine.guidance import Path as Route
from surctl.marine.vehicle import (
    PLANT_DISTURBANCE,
    PLANT_PARAMETERS,
    PLANT_STATE,
    build_plant,
    load_vehicle,
    plant_parameters,
)
from tests.certcheck.altering import altered, put, sealed
from tests.certcheck.turning_samples import check_samples, draw_motions, draw_vehicles
from tests.certcheck.turning_truth import true_rate

HERE = Path(__file__).parent
NAMES = ("region-turning", "region-turning-20", "region-turning-20-rest")
COUPLED, CURVED = "region-turning-20-rexrov", "region-turning-20-curved"
OTHERS = ("region-turning-20-scale", COUPLED, CURVED)


def document(name: str = "region-turning") -> dict[str, Any]:
    return json.loads((HERE / f"{name}.json").read_text())


def matrix(whole: dict[str, Any]) -> np.ndarray:
    lower = whole["proof"]["P"]
    return np.array([[lower[max(i, j)][min(i, j)] for j in range(4)] for i in range(4)])


def trim_of(whole: dict[str, Any]) -> Trim:
    slopes = [Fraction(repr(n)) for n in whole["proof"]["trim"]]
    return steady(read_claim(whole["claim"]), (slopes[0], slopes[1]))


def worst(whole: dict[str, Any], *, low: float, high: float, count: int = 20_000) -> float:
    """Largest V̇/V + a [1/s] found for low ≤ V ≤ high."""
    claim, P, rng = read_claim(whole["claim"]), matrix(whole), np.random.default_rng(0)
    boat = draw_vehicles(claim, count, rng)
    slopes = whole["proof"]["trim"]
    omega = sum(s * (boat[name].mean(axis=1) - 1) for s, name in zip(slopes, ("linear", "quadratic"), strict=True))
    xi = rng.normal(size=(count, 4)) @ np.linalg.inv(np.linalg.cholesky(P))
    xi *= np.sqrt(rng.uniform(low, high, size=count) / np.einsum("ni,ij,nj->n", xi, P, xi))[:, None]
    state = xi.copy()
    state[:, 0] -= omega / float(claim.k1)
    state[:, 2] += float(claim.cruise)
    r = float(claim.yaw_rate) * rng.choice([-1.0, 1.0], size=count)
    rate = true_rate(claim, boat, state, rng.uniform(0, 7, size=count), r, draw_motions(claim, count, rng))
    change = 2 * np.einsum("ni,ij,nj->n", xi, P, rate)
    return float(np.max(change / np.einsum("ni,ij,nj->n", xi, P, xi))) + float(claim.rate)


@pytest.mark.parametrize("name", [path.stem for path in sorted(HERE.glob("region-[ct]*.json"))])
def test_the_true_loop_decays_as_each_certificate_claims(name: str) -> None:
    whole = document(name)
    claim, proof = read_claim(whole["claim"]), whole["proof"]
    weight = Fraction(repr(proof["thrust"]["weight"])) if claim.period else None
    form = Form.of(triangle(proof["P"], 6 if claim.lag[1] else 4, "proof.P"), weight)
    check_samples(claim, cruise_of(claim, proof), form.p, proof["floor"])


@pytest.mark.parametrize("name", ["region-turning"])
def test_the_kept_certificates_are_accepted_and_small(name: str) -> None:
    """All of them: study 40."""
    whole = document(name)
    found = check_document(whole, time_limit=20.0)
    assert found.accepted, found.reason
    assert len((HERE / f"{name}.json").read_text()) < 10_000
    claim = whole["claim"]
    equal = claim["law"]["mass_kg"][0] == claim["law"]["mass_kg"][1]
    assert equal == (name in ("region-turning-20-scale", CURVED)) and claim["motion"]["offset_m"] >= (
        0.34 if equal else 0.25
    )
    assert name not in ("region-turning", "region-turning-20-rest") or claim["motion"]["rest_offset_m"] >= 0.2
    assert worst(whole, low=whole["proof"]["floor"], high=1.0) < 0 < worst(whole, low=20.0, high=40.0)


STRONGER: dict[str, Callable[[dict[str, Any]], Any]] = {
    "rate": lambda d: d["claim"]["motion"].update(rate_per_s=0.4),
    "offset": lambda d: d["claim"]["motion"].update(offset_m=d["claim"]["motion"]["offset_m"] * 1.002),
    "start at rest": lambda d: d["claim"]["motion"].update(rest_offset_m=d["claim"]["motion"]["offset_m"]),
    "ultimate bound": lambda d: d["claim"]["motion"].update(ultimate_bound_m=[0.001, 0.001]),
    "masses": lambda d: d["claim"]["vehicle"].update(mass_factor=[0.5, 2.0], mass_asymmetry=1.0),
    "mass asymmetry": lambda d: d["claim"]["vehicle"].update(mass_factor=[0.6, 1.4], mass_asymmetry=1.9),
    "drag": lambda d: d["claim"]["vehicle"].update(drag_factor=[0.3, 3.0]),
    "thrust": lambda d: d["claim"]["vehicle"].update(thrust_n=[5.5, 5.5]),
    "no thrust": lambda d: d["claim"]["vehicle"].update(thrust_n=[1.0, 40.0]),
    "yaw rate": lambda d: d["claim"]["vehicle"].update(yaw_rate_rad_per_s=20.0),
    "Munk moment": lambda d: d["claim"]["vehicle"].update(munk_moment_nm=0.001),
    "model": lambda d: d["claim"]["law"].update(mass_kg=[19.8567, 206.206]),
    "k1": lambda d: d["claim"]["law"].update(k1=0.02),
    "k_v": lambda d: d["claim"]["law"].update(k_v=0.05),
    "lookahead": lambda d: d["claim"]["law"].update(lookahead=0.2),
    "cap": lambda d: d["claim"]["law"].update(cap=0.151),
    "wait": lambda d: d["claim"]["law"].update(wait=0.05),
    "integral": lambda d: d["claim"]["law"].update(k_i=0.1),
    "floor": lambda d: d["proof"].update(floor=d["proof"]["floor"] * 1e-3),
    "last level": lambda d: d["proof"]["shells"][-1].update(level=1.1),
    "a shell left out": lambda d: d["proof"].update(shells=d["proof"]["shells"][:-1]),
    "growth": lambda d: d["proof"]["shells"][-1].update(growth=3.0),
    "no growth": lambda d: d["proof"]["shells"][0].update(growth=0.0),
    "trim": lambda d: d["proof"].update(trim=[2.0, 2.0]),
    "size of P": lambda d: d["proof"].update(P=[[e * 0.05 for e in row] for row in d["proof"]["P"]]),
    "sign of P": lambda d: put(d, ("proof", "P", 1, 1), -1.0),
    "mirror": lambda d: put(d, ("proof", "P", 1, 0), 1e-3),
    "few cells": lambda d: d["proof"].update(cells=3),
    "cells": lambda d: d["proof"].update(cells=24.0),
    "excludes": lambda d: d["claim"].update(excludes=[]),
    "system": lambda d: d["claim"].update(system="cruise"),
    "hash": lambda d: d["claim"].update(sha256_law="0"),
    "more": lambda d: d["claim"].update(more=1),
    "huge": lambda d: put(d, ("claim", "law", "k1"), 10**400),
    "word": lambda d: put(d, ("claim", "motion", "rate_per_s"), "0.05"),
}


@pytest.mark.parametrize("kind", [*STRONGER][::2])  # all of them: study 40
def test_what_asks_for_more_is_rejected_however_it_is_sealed(kind: str) -> None:
    # the certificate over ranges, unless only the other one states a start at rest or has no error to absorb
    changed = document("region-turning" if kind in ("start at rest", "no growth") else "region-turning-20")
    STRONGER[kind](changed)
    assert not check_document(sealed(changed)).accepted


def refuted(changed: dict[str, Any]) -> bool:
    """Whether plain sampling shows an altered certificate to be false."""
    P, proof, motion = matrix(changed), changed["proof"], changed["claim"]["motion"]
    if np.linalg.eigvalsh(P)[0] <= 0 or proof["shells"][-1]["level"] != 1:
        return True
    omega = [float(w) / changed["claim"]["law"]["k1"] for w in trim_of(changed).omega]
    starts = [(motion["offset_m"], 0.0)]
    if motion["rest_offset_m"] is not None:
        starts.append((motion["rest_offset_m"], -changed["claim"]["law"]["cruise"]))
    if any(np.array([w, y, u, 0]) @ P @ np.array([w, y, u, 0]) > 1 + 1e-9 for w in omega for y, u in starts):
        return True
    extent = np.sqrt(np.diag(np.linalg.inv(P))[:2] * proof["floor"])
    if extent[0] + max(map(abs, omega)) > motion["ultimate_bound_m"][0] * (1 + 1e-9):
        return True
    if extent[1] > motion["ultimate_bound_m"][1] * (1 + 1e-9):
        return True
    return worst(changed, low=proof["floor"], high=1.0, count=1500) > 1e-9


def quick() -> dict[str, Any]:
    """A certificate of the two outer shells, which is checked in a fraction of the time."""
    whole = document()
    shells = whole["proof"]["shells"]
    extent = np.sqrt(np.diag(np.linalg.inv(matrix(whole)))[:2] * shells[-3]["level"])
    whole["claim"]["motion"]["ultimate_bound_m"] = [round(float(n) + 1e-3, 6) for n in extent]
    whole["proof"] |= {"floor": shells[-3]["level"], "shells": shells[-2:]}
    return sealed(whole)


def test_no_altered_certificate_that_sampling_refutes_is_accepted() -> None:
    whole, rng = quick(), np.random.default_rng(5)
    assert check_document(whole).accepted
    rejected, accepted = 0, 0
    for _ in range(16):
        if rejected > 5 and accepted > 1:
            break
        path, changed = altered(whole, ("claim", "proof"), rng)
        if not check_document(sealed(changed)).accepted:
            rejected += 1
            continue
        accepted += 1
        assert not refuted(changed), path
    assert rejected > 5 and accepted > 1  # neither everything nor nothing passes


# the pieces of the proof, against sampling


def test_the_vertices_of_factors_enclose_every_allowed_vehicle() -> None:
    vertices = axis_pairs((Fraction(4, 5), Fraction(6, 5)), Fraction(1, 20))
    assert len(vertices) == 6
    for one in vertices:
        assert min(one) >= Fraction(4, 5) and max(one) <= Fraction(6, 5)
        assert max(one) - min(one) <= Fraction(1, 20) * (max(one) + min(one)) / 2
    drag = drag_factors(read_claim(document("region-turning-20")["claim"]))
    assert set(drag) == {(*linear, *quadratic) for linear in vertices for quadratic in vertices}
    assert (Fraction(4, 5),) * 2 + (Fraction(6, 5),) * 2 in drag  # less linear drag, more quadratic drag


def test_the_waiting_of_the_target_counts_the_error_of_the_place() -> None:
    whole = document("region-cruise-20-noise")
    claim, p = read_claim(whole["claim"]), triangle(whole["proof"]["P"], 4, "proof.P")
    trim, extent = cruise_of(claim, whole["proof"]), Extent.of(inverse(p))
    wait = 2 * (extent.size(0, Fraction(1)) + max(map(abs, trim.moved)) / claim.k1 + claim.place_error)
    cells = heading_cells(claim, trim, 4)
    Setting(replace(claim, wait=wait), trim, cells).commanded(extent, Fraction(1))
    with pytest.raises(Rejected, match="target waits"):
        Setting(replace(claim, wait=wait - Fraction(1, 10**6)), trim, cells).commanded(extent, Fraction(1))


def test_the_triangles_contain_every_heading() -> None:
    whole = document("region-turning-20")
    claim, trim = read_claim(whole["claim"]), trim_of(whole)
    for count in (4, 24, 96):
        cells = heading_cells(claim, trim, count)
        for k in range(count):
            psi = np.linspace(k, k + 1, 41) * np.pi / 2 / count
            z = np.stack([np.cos(2 * psi), np.sin(2 * psi), np.ones(41)])
            weights = np.linalg.solve(np.vstack([cells.corners[k].T, np.ones(3)]), z)
            assert weights.min() > 0
            for axis, n in enumerate((np.cos(psi), np.sin(psi))):
                assert np.all((cells.share[k, axis, 0] <= n) & (n <= cells.share[k, axis, 1]))
                # n nᵀ of this axis is affine in z
                own = axes_of(z[:2].T)[0][axis]
                body = np.stack([np.cos(psi), np.sin(psi)] if axis == 0 else [-np.sin(psi), np.cos(psi)])
                assert np.allclose(own, np.einsum("ik,jk->kij", body, body))


def test_the_error_of_the_trim_force_is_bounded_by_what_sampling_finds() -> None:
    whole = document("region-turning-20")
    claim, trim, n = read_claim(whole["claim"]), trim_of(whole), 20_000
    cells = heading_cells(claim, trim, 12)
    boat = draw_vehicles(claim, n, np.random.default_rng(3))
    omega = sum(
        float(s) * (boat[name].mean(axis=1) - 1) for s, name in zip(trim.slopes, ("linear", "quadratic"), strict=True)
    )
    assert float(trim.omega[0]) <= omega.min() and omega.max() <= float(trim.omega[1])
    psi = np.random.default_rng(4).uniform(0, np.pi / 2, size=n)
    v, cell, ratio = float(claim.cruise), (psi / (np.pi / 2) * 12).astype(int), []
    for i, share in enumerate((np.cos(psi), np.sin(psi))):
        m, a, b = float(claim.mass[i]) * float(claim.k_v), float(claim.linear[i]), float(claim.quadratic[i])
        w, u = (v + omega) * share, v * share
        drag = boat["linear"][:, i] * a * u + boat["quadratic"][:, i] * b * u * u
        lack = np.abs(a * w + b * w * w + m * (w - u) - drag)
        assert np.all(lack <= cells.lack[cell, i])
        ratio.append(lack.max() / cells.lack[:, i].max())
    assert min(ratio) > 0.7
    assert np.array_equal(_lack(claim, trim, cells.share), cells.lack)
    assert not heading_cells(read_claim(document()["claim"]), trim_of(document()), 12).lack.any()


def test_the_coriolis_points_enclose_every_ratio_of_masses() -> None:
    claim = read_claim(document("region-turning-20")["claim"])
    points, boat = np.array(turn_points(claim))[:, :2], draw_vehicles(claim, 400, np.random.default_rng(1))
    m1, m2 = (boat["mass"][:, k] * float(claim.mass[k]) for k in (0, 1))
    inside = np.stack([1 - m2 / m1, m1 / m2 - 1], 1) * np.random.default_rng(2).uniform(-0.5, 0.5, size=(400, 1))
    for angle in np.linspace(0, 2 * np.pi, 181):
        direction = np.array([np.cos(angle), np.sin(angle)])
        assert (inside @ direction).max() <= (points @ direction).max() + 1e-15


def test_the_corners_that_are_left_out_lie_between_the_others() -> None:
    whole = document("region-turning-20")
    whole["claim"]["vehicle"]["thrust_n"] = [8.0, 8.0]  # so little that the limit binds in V ≤ 9
    claim, trim = read_claim(whole["claim"]), trim_of(whole)
    extent = Extent.of(inverse([[Fraction(repr(float(e))) for e in row] for row in matrix(whole)]))
    cells, directions = heading_cells(claim, trim, 8), np.linspace(0, 2 * np.pi, 181)
    ahead, plans = np.stack([np.cos(directions), np.sin(directions)]), np.diag([0.3, 0.2])[None]
    for i, axes in enumerate(axes_of(cells.corners)[0]):
        led = extent.largest(plans, np.zeros((2, 2)), axes, 9.0)
        every = Setting(claim, trim, cells).loops(extent, i, axes, plans, led, 9.0)[1]
        assert every is not None
        for kept in every:
            gain = float(claim.mass[i] * claim.k_v)
            assert len(kept) == 6
            part, (low, top) = kept[:, 1].min() / gain, (kept[:, 2].min(), kept[:, 2].max())
            h0, h1 = (kept[:, 0] / kept[:, 1] - 1).min() * gain, (kept[:, 0] / kept[:, 1] - 1).max() * gain
            kept = np.stack([kept[:, 0], kept[:, 1] + kept[:, 2]], 1)
            assert 0 < part < 1 and 0 <= h0 < h1 and 0 <= low < top
            corners = [(q * (gain + h), q * gain + t) for q in (part, 1) for h in (h0, h1) for t in (low, top)]
            assert np.all((np.array(corners) @ ahead).max(axis=0) <= (kept @ ahead).max(axis=0) + 1e-9)
    kept = np.array(inverse_masses(claim, coupling_of(claim)))[:, :2] * np.array([float(m) for m in claim.mass])
    share, masses = claim.mass_asymmetry, np.linspace(float(claim.mass_factor[0]), float(claim.mass_factor[1]), 41)
    first, second = (grid.ravel() for grid in np.meshgrid(masses, masses))
    every = 1 / np.stack([first, second], 1)[np.abs(first - second) <= float(share) * (first + second) / 2]
    assert len(kept) == 6 and len(every) > 41
    assert np.all((every @ ahead).max(axis=0) <= (kept @ ahead).max(axis=0) + 1e-12)


def test_the_points_of_a_coupled_inertia_enclose_its_inverse_and_its_coriolis_term() -> None:
    claim, rng = read_claim(document(COUPLED)["claim"]), np.random.default_rng(3)
    claim = replace(claim, terms={**claim.terms, "m12": Fraction(300)})  # so that every term is seen
    coupling, boat = coupling_of(claim), draw_vehicles(claim, 500, rng)
    masses, points = np.array(inverse_masses(claim, coupling)), np.array(turn_points(claim))
    quarter, turn = np.array([[0.0, -1.0], [1.0, 0.0]]), float(claim.yaw_rate)
    found, loose = [], []
    for k in range(500):
        m1, m2 = boat["mass"][k] * [float(m) for m in claim.mass]
        c = 300 * boat["term_mass"][k] * rng.choice([-1.0, 1.0])
        inertia = np.array([[m1, c], [c, m2]])
        inner = np.linalg.inv(inertia)
        found.append([inner[0, 0], inner[1, 1], inner[0, 1]])
        coriolis = quarter - inner @ quarter @ inertia
        plain = -np.array([[0, 1 - m2 / m1], [m1 / m2 - 1, 0]])
        loose.append(turn * np.linalg.norm(coriolis - plain, 2))
    assert max(loose) <= float(coupling.loose) <= 1.3 * max(loose)
    for _ in range(200):
        direction = rng.normal(size=3) / np.abs(masses).max(axis=0)
        assert (np.array(found) @ direction).max() <= (masses @ direction).max() * (1 + 1e-12)
    assert len(points) == 6 and not points[:, 2].any()
    bends = np.array(turn_points(read_claim(document(CURVED)["claim"])))[:, 2]
    assert {round(float(b), 6) for b in bends} == {0.03334, -0.03334}
    with pytest.raises(Rejected, match="m12"):
        coupling_of(replace(claim, terms={"m12": Fraction(1500)}))


def test_the_forces_beside_equation_3_are_bounded_tightly() -> None:
    whole, rng, n = document(COUPLED), np.random.default_rng(4), 4000
    extra = {"Yr": 30.0, "Yvr": 20.0, "Xrr": -9.0, "X0": 4.0, "Nv": 8.0}
    whole["claim"]["vehicle"]["terms"] |= extra
    claim = read_claim(whole["claim"])
    bare, fastest = replace(claim, terms={}), Fraction(3, 2)
    boat, motions = draw_vehicles(claim, n, rng), draw_motions(claim, n, rng)
    boat["mass"][:] = 1.0  # the same masses with and without the terms
    psi, r = np.zeros(n), float(claim.yaw_rate) * rng.choice([-1.0, 1.0], size=n)
    angle = rng.uniform(0, 7, size=n)
    state = np.stack([0 * psi, 0 * psi, 1.5 * np.cos(angle), 1.5 * np.sin(angle)], 1)
    m12 = boat["term_mass"] * float(claim.terms["m12"])
    own = {**claim.terms, "m12": Fraction(0)}
    change = (
        true_rate(replace(claim, terms=own), boat, state, psi, r, motions)[:, 2:]
        - (true_rate(bare, boat, state, psi, r, motions)[:, 2:])
    )
    force = np.abs(change) * [float(m) for m in claim.mass]
    bounds = [float(f) for f in other_forces(claim, fastest)]
    assert m12.any() and np.all(force <= np.array(bounds) + 1e-9) and np.all(force.max(axis=0) > 0.6 * np.array(bounds))
    assert float(other_moment(claim, fastest)) > 1.5 * 50 and other_moment(bare, fastest) == 0
    for wrong in ({"m11": 1.0}, {"m21": 1.0}, {"Xuu": 1.0}, {"Yv": 1.0}, {"Kp": 1.0}, {"": 1.0}, {"m14": "7"}, []):
        whole["claim"]["vehicle"]["terms"] = wrong
        with pytest.raises(Rejected):
            read_claim(whole["claim"])


BEYOND: dict[str, tuple[str, Callable[[dict[str, Any]], Any]]] = {
    "m12": (COUPLED, lambda d: d["claim"]["vehicle"]["terms"].update(m12=200.0)),
    "m24": (COUPLED, lambda d: d["claim"]["vehicle"]["terms"].update(m24=3000.0)),
    "force": (COUPLED, lambda d: d["claim"]["vehicle"]["terms"].update(Y0=2000.0)),
    "drag": (COUPLED, lambda d: d["claim"]["vehicle"]["terms"].update(Yvr=1500.0)),
    "heave": (COUPLED, lambda d: d["claim"]["vehicle"].update(heave_m_per_s2=20.0)),
    "yaw acceleration": (COUPLED, lambda d: d["claim"]["vehicle"].update(yaw_rad_per_s2=40.0)),
    "a term left out": (COUPLED, lambda d: d["claim"]["vehicle"].pop("terms")),
    "curvature": (CURVED, lambda d: d["claim"]["motion"].update(curvature_per_m=0.9)),
    "curvature below 0": (CURVED, lambda d: d["claim"]["motion"].update(curvature_per_m=-0.1)),
    "no curvature": (CURVED, lambda d: d["claim"]["motion"].pop("curvature_per_m")),
    "cruise": (CURVED, lambda d: d["claim"]["law"].update(cruise=0.15)),
}


@pytest.mark.parametrize("kind", BEYOND)
def test_stronger_claims_about_coupled_vehicles_and_curved_paths_are_rejected(kind: str) -> None:
    name, change = BEYOND[kind]
    changed = document(name)
    change(changed)
    assert not check_document(sealed(changed)).accepted


@pytest.mark.parametrize("name", [COUPLED, CURVED])
def test_offset_and_munk_moment_are_decided_to_the_last_digit(name: str) -> None:
    whole = document(name)
    claim, trim = read_claim(whole["claim"]), trim_of(whole)
    p = [[Fraction(repr(float(e))) for e in row] for row in matrix(whole)]
    x = max(map(abs, trim.omega)) / claim.k1
    edge = (1 - p[0][0] * x * x) / p[1][1]  # square of the largest offset
    largest = np.sqrt(float(edge))
    while Fraction(repr(float(largest))) ** 2 > edge:
        largest = np.nextafter(largest, 0)
    while Fraction(repr(float(np.nextafter(largest, 1e9)))) ** 2 <= edge:
        largest = np.nextafter(largest, 1e9)
    require_starts(replace(claim, offset=Fraction(repr(float(largest)))), p, trim.moved, trim.beside)
    for off in (np.nextafter(largest, 1e9), largest + 1e-12, largest + 1e-6):
        with pytest.raises(Rejected, match="start"):
            require_starts(replace(claim, offset=Fraction(repr(float(off)))), p, trim.moved, trim.beside)
    if name == COUPLED:
        least = next(m for m in (np.nextafter(float(_moment(claim)), 1e9),) if Fraction(float(m)) >= _moment(claim))
        _check_munk_moment(replace(claim, munk_moment=Fraction(float(least))), Fraction(1))
        for less in (np.nextafter(np.nextafter(least, 0), 0), least - 1e-6):
            with pytest.raises(Rejected, match="Munk"):
                _check_munk_moment(replace(claim, munk_moment=Fraction(float(less))), Fraction(1))


def _moment(claim: Any) -> Fraction:
    """The yaw moment at 1 m/s, computed anew."""
    pairs = axis_pairs(claim.mass_factor, claim.mass_asymmetry)
    apart = max(abs(f * claim.mass[0] - g * claim.mass[1]) for f, g in pairs)
    t, f = claim.terms, claim.mass_factor[1]
    carried = sum(abs(t[f"m{i}3"]) * claim.heave + abs(t[f"m{i}4"]) * claim.yaw_rate for i in (1, 2))
    return apart / 2 + f * (abs(t["m12"]) + carried)


# the law and the vehicle of the checker are those of the toolkit


def test_the_checkers_coupled_vehicle_is_that_of_the_toolkit() -> None:
    whole = document(COUPLED)
    claim, vehicle, rng, n = read_claim(whole["claim"]), load_vehicle("rexrov"), np.random.default_rng(7), 10
    plant, still = build_plant(vehicle.form), PLANT_DISTURBANCE.pack()
    boat = {key: np.ones((n, 2)) for key in ("mass", "linear", "quadratic")}
    boat |= {"term_mass": np.ones(n), "term": np.ones(n)}
    psi, r, w = rng.uniform(-3, 3, n), rng.uniform(-0.5, 0.5, n), rng.uniform(-0.1, 0.1, n)
    state = np.stack([rng.uniform(-1, 1, n), rng.uniform(-2, 2, n), *rng.uniform(-0.5, 0.5, (2, n))], 1)
    zero = np.zeros(n)
    bare = true_rate(replace(claim, terms={}), boat, state, psi, r)  # for the thrust
    for k in range(n):
        c, s = np.cos(psi[k]), np.sin(psi[k])
        turn = np.array([[c, -s], [s, c]])
        u, v = turn.T @ state[k, 2:]
        m1, m2 = (float(m) for m in claim.mass)
        du, dv = turn.T @ bare[k, 2:] + r[k] * np.array([v, -u])
        drag = [
            float(a) * e + float(b) * e * abs(e) for a, b, e in zip(claim.linear, claim.quadratic, (u, v), strict=True)
        ]
        tau = np.array([m1 * du - m2 * v * r[k] + drag[0], m2 * dv + m1 * u * r[k] + drag[1]])
        x = PLANT_STATE.pack({"eta": [0, 0, 0, psi[k]], "nu": [u, v, w[k], r[k]], "tau": [*tau, 0, 0]})
        rate = np.asarray(plant.ode(x, [*tau, 0, 0], still, plant_parameters(vehicle)))[4:8, 0]
        other = np.stack([w, zero + rate[2], zero + rate[3], zero], 1)
        found = true_rate(claim, boat, state, psi, r, other)[k, 2:]
        assert np.allclose(found, turn @ (rate[:2] + r[k] * np.array([-v, u])), atol=1e-9)


def test_the_path_frame_turns_as_it_does_on_an_arc() -> None:
    whole = document(CURVED)
    claim, bend = read_claim(whole["claim"]), 0.0333
    v = float(claim.cruise)
    boat = {key: np.ones((1, 2)) for key in ("mass", "linear", "quadratic")} | {
        "term_mass": np.ones(1),
        "term": np.ones(1),
    }
    state, psi, r = np.array([[0.1, -0.2, 0.12, 0.03]]), np.array([0.4]), np.array([0.2])
    straight = true_rate(claim, boat, state, psi, r)[0]
    found = true_rate(claim, boat, state, psi, r, np.array([[0, 0, 0, bend]]))[0]
    place, speed, acceleration = state[0, :2], state[0, 2:], straight[2:]  # in a frame at rest

    def seen(t: float) -> np.ndarray:
        angle = bend * t
        target = v / bend * np.array([np.sin(angle), 1 - np.cos(angle)])
        back = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        return np.concatenate([back @ (place + speed * t - target), back @ (speed + acceleration * t)])

    assert np.allclose(found, (seen(1e-5) - seen(-1e-5)) / 2e-5, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_the_checkers_loop_is_the_law_and_the_vehicle_of_the_toolkit(name: str) -> None:
    claim = document(name)["claim"]
    exact, vehicle, law = read_claim(claim), load_vehicle("bluerov2-vonbenzon"), build_law()
    p = law_parameters(
        load_gains("default"), vehicle, path=Route(np.array([[0.0, 0.0], [90.0, 0.0]])), depth=-1.0,
        cruise=claim["law"]["cruise"], cap=claim["law"]["cap"], walls=(-1e3, 1e3, -1e3, 1e3),
    )  # fmt: skip
    rng, far, n = np.random.default_rng(2), 30.0, 12
    boat = draw_vehicles(exact, n, rng)
    psi, r = rng.uniform(-3, 3, size=n), rng.uniform(-0.5, 0.5, size=n)
    state = np.stack([rng.uniform(-0.3, 0.3, n), rng.uniform(-0.6, 0.6, n), *rng.uniform(-0.3, 0.3, (2, n))], axis=1)
    found = true_rate(exact, boat, state, psi, r)
    plant_law = build_plant()
    for k in range(n):
        c, s = np.cos(psi[k]), np.sin(psi[k])
        turn = np.array([[c, -s], [s, c]])
        nu = np.array([*(turn.T @ state[k, 2:]), 0.0, r[k]])
        u = law.inputs.pack({"eta": [far + state[k, 0], state[k, 1], -1.0, psi[k]], "nu": nu})
        tau = law.step(law.state.pack({"progress": [far]}), u, p).tau
        drag = [boat["linear"][k] * claim["law"]["linear_drag"], boat["quadratic"][k] * claim["law"]["quadratic_drag"]]
        plant = PLANT_PARAMETERS.pack(
            {
                "mass": [*(boat["mass"][k] * claim["law"]["mass_kg"]), 20, 1], "linear_drag": [*drag[0], 1, 1],
                "quadratic_drag": [*drag[1], 1, 1], "thrust_limit": [90] * 4, "thrust_lag": 0.0,
            }
        )  # fmt: skip
        x = PLANT_STATE.pack({"eta": [0, 0, 0, psi[k]], "nu": nu, "tau": [0, 0, 0, 0]})
        out = np.asarray(plant_law.ode(x, ca.vertcat(*map(float, tau[:2]), 0, 0), PLANT_DISTURBANCE.pack(), plant))
        nu_rate = out[4:6, 0] + r[k] * np.array([-nu[1], nu[0]])
        own = [*(turn @ nu[:2] - [claim["law"]["cruise"], 0]), *(turn @ nu_rate)]
        assert np.allclose(found[k], own, atol=1e-9)


def test_starts_on_the_edge_of_the_region_are_inside_and_no_further() -> None:
    whole = document()
    motion, law = whole["claim"]["motion"], whole["claim"]["law"]
    p = [[Fraction(repr(float(e))) for e in row] for row in matrix(whole)]
    for beside, speed in ((motion["offset_m"], 0), (motion["rest_offset_m"], -law["cruise"])):
        at = [Fraction(0), Fraction(repr(beside)), Fraction(repr(float(speed))), Fraction(0)]
        assert quadratic(p, at) <= 1
        assert quadratic(p, [at[0], at[1] + Fraction(1, 1000), *at[2:]]) > 1
