"""Certificates about the heading loop of a craft without sway force: what is accepted, and what must not be."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.certcheck import check_document
from surctl.certcheck.document import Rejected
from surctl.certcheck.law_points import values_at
from surctl.certcheck.steering import STEERED, _planned, heading_loop
from surctl.lyapunov.slope_search import form_of
from surctl.marine.control import build_law, law_source
from surctl.marine.control.ports import law_parameters
from surctl.marine.control.steering import planned_yaw_rate
from surctl.marine.guidance import Path as Route
from surctl.marine.tuning import derived_gains
from surctl.marine.vehicle import PLANT_DISTURBANCE, PLANT_STATE, build_plant, load_vehicle, plant_parameters
from surctl.marine.verification.region.nominal import nominal_motion
from surctl.verification.formula import parse, values_of, variable
from tests.certcheck.altering import sealed

Array = NDArray[np.float64]

KEPT = Path(__file__).parent / "region-steered-20.json"
FINS = KEPT.with_name("region-steered-20-remus100.json")


def document(path: Path = KEPT) -> dict[str, Any]:
    return json.loads(path.read_text())


def form(claim: dict[str, Any]) -> Array:
    function = parse(claim["function"], {name: variable(name) for name in STEERED})
    return form_of(function, tuple(STEERED)) / claim["level"]


def rates(claim: dict[str, Any], at: dict[str, Array]) -> Array:
    known = {name: variable(name) for name in at}
    return values_of([parse(claim["dynamics"][name], known) for name in STEERED], at)


def worst(claim: dict[str, Any], *, level: float = 1.0, count: int = 20_000) -> float:
    """Largest V̇/V + a [1/s] at samples of V = level, with drawn parameters."""
    rng, p = np.random.default_rng(0), form(claim)
    xi = rng.normal(size=(6, count))
    xi *= np.sqrt(level / np.einsum("in,ij,jn->n", xi, p, xi))
    drawn = {row["name"]: np.where(rng.random(count) < 0.5, row["lower"], row["upper"]) for row in claim["parameters"]}
    change = 2 * np.einsum("in,ij,jn->n", xi, p, rates(claim, dict(zip(STEERED, xi, strict=True)) | drawn))
    return float(change.max()) / level + float(claim["rate"])


@pytest.mark.parametrize(("path", "least"), [(KEPT, 0.983), (FINS, 0.32)], ids=["thrusters", "fins"])
def test_the_kept_certificate_is_accepted_and_small(path: Path, least: float) -> None:
    whole = document(path)
    checked = check_document(whole)
    assert checked.accepted, checked.reason
    assert path.stat().st_size < 40_000 and form(whole["claim"])[0, 0] * least**2 < 1
    assert worst(whole["claim"]) < 0 < worst(whole["claim"], level=400.0)


def wider(*names: str, by: float = 0.5) -> Callable[[dict[str, Any]], Any]:
    def change(whole: dict[str, Any]) -> None:
        for row in whole["claim"]["parameters"]:
            if row["name"] in names:
                low, high = row["lower"], row["upper"]
                row["lower"], row["upper"] = low - by * abs(low), high + by * abs(high)

    return change


def claimed(**entries: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda whole: whole["claim"].update(entries)


def scaled(old: str, factor: float) -> Callable[[dict[str, Any]], Any]:
    """Scale the first number of the dynamics of the yaw rate that follows a text."""

    def change(whole: dict[str, Any]) -> None:
        dynamics = whole["claim"]["dynamics"]
        pattern = re.compile(re.escape(old) + r"(\d+(\.\d+)?)")
        assert pattern.search(dynamics["r"])
        for name in ("v", "r"):
            dynamics[name] = pattern.sub(lambda m: f"{old}{factor * float(m.group(1))!r}", dynamics[name], count=1)

    return change


def feedbacks(change: Callable[[list[list[float]]], Any]) -> Callable[[dict[str, Any]], Any]:
    return lambda whole: whole["slopes"].update(feedbacks=change(whole["slopes"]["feedbacks"]))


STRONGER: dict[str, Callable[[dict[str, Any]], Any]] = {
    "rate": claimed(rate=0.4),
    "level": lambda d: d["claim"].update(level=1.5 * d["claim"]["level"]),
    "masses": wider("m11", "m22", "m44", "m24"),
    "drag": wider("Yv", "Yvv", "Nr", "Nrr", by=0.8),
    "speed": wider("u"),
    "coupling": wider("m24", by=20.0),
    "equilibrium": lambda d: d["claim"]["equilibrium"].update(psi=0.01),
    "no feedbacks": feedbacks(lambda rows: []),
    "one feedback": feedbacks(lambda rows: rows[:1]),
    "feedbacks swapped": feedbacks(lambda rows: rows[::-1]),
    "larger feedbacks": feedbacks(lambda rows: [[1.3 * x for x in row] for row in rows]),
    "feedbacks of the other sign": feedbacks(lambda rows: [[-x for x in row] for row in rows]),
    "a feedback of another form": feedbacks(lambda rows: [row[:5] for row in rows]),
    "a smaller box": lambda d: d["claim"]["states"][0].update(lower=-0.3, upper=0.3),
    "indefinite V": lambda d: d["claim"].update(function=d["claim"]["function"].replace("y_e^2", "psi^2")),
    "more": claimed(more=1),
}


@pytest.mark.parametrize("kind", [*STRONGER])
def test_what_asks_for_more_is_rejected_however_it_is_sealed(kind: str) -> None:
    changed = document()
    STRONGER[kind](changed)
    assert not check_document(sealed(changed)).accepted


def test_no_altered_certificate_that_sampling_refutes_is_accepted() -> None:
    rng, rejected, accepted = np.random.default_rng(5), 0, 0
    for k in range(6):
        changed = document()
        factor, name = (
            float(np.exp(rng.normal() * (0.01, 0.3)[k % 2])),
            rng.choice(["rate", "level", "ranges", "feedbacks"]),
        )
        if name == "ranges":
            wider("Yv", "Nr", "Nrr", "u", by=abs(factor - 1))(changed)
        elif name == "feedbacks":
            feedbacks(lambda rows, factor=factor: [[factor * x for x in row] for row in rows])(changed)
        else:
            changed["claim"][name] *= factor
        if check_document(sealed(changed)).accepted:
            accepted += 1
            assert worst(changed["claim"], count=4000) <= 1e-9, (name, factor)
        else:
            rejected += 1
    assert rejected > 0 and accepted > 0  # neither everything nor nothing passes


@pytest.mark.parametrize(("name", "path"), [("otter", KEPT), ("remus100", FINS)])
def test_the_dynamics_are_the_law_and_the_vehicle_of_the_toolkit(name: str, path: Path) -> None:
    claim, law, rng, n = document(path)["claim"], build_law("steered"), np.random.default_rng(3), 3
    cruise, far, dt = {"otter": 1.1, "remus100": 1.5}[name], 60.0, 0.05
    craft = load_vehicle(name).at_speed(cruise)
    own = derived_gains(craft, cruise=cruise).with_own(law_source("steered").gains)
    cap = round(cruise * 0.22 / 0.15, 9)
    p = law_parameters(
        own, craft, path=Route(np.array([[0.0, 0.0], [190.0, 0.0]])), depth=0.0, cruise=cruise, cap=cap,
        walls=(-1e3, 1e3, -1e3, 1e3),
    )  # fmt: skip
    size = np.array([0.3, 0.05, 0.02, 0.05, 0.03, 0.02]) * (1.0 if name == "otter" else 0.2)
    state, u = rng.uniform(-1, 1, size=(n, 6)) * size, cruise * rng.uniform(0.92, 1.08, size=n)
    plant, still = build_plant(craft.form), PLANT_DISTURBANCE.pack()
    for k in range(n):
        y, psi, v, r, crab, s = state[k]
        inputs = law.inputs.pack({"eta": [far, y, 0.0, psi], "nu": [u[k], v, 0.0, r]})
        x = law.state.pack({"progress": [far], "crab": [crab], "sway": [s], "surge": [u[k]]})
        step = law.step(x, inputs, p)
        after = law.state.split(step.x_next)
        tau = [float(t) for t in step.tau]
        side = -1.567398119 if name == "remus100" else 0.0
        tau[1] += side * tau[3]  # the rudder's force, which the allocation adds
        at = PLANT_STATE.pack({"eta": [0, 0, 0, psi], "nu": [u[k], v, 0, r], "tau": tau})
        rate = np.asarray(plant.ode(at, tau, still, plant_parameters(craft)))[:, 0]
        middle = {row["name"]: np.array([(row["lower"] + row["upper"]) / 2]) for row in claim["parameters"]}
        fixed = middle | {"u": u[k : k + 1], "u_model": u[k : k + 1], "share": np.ones(1)}
        known = {name: fixed[name] for name in middle}
        found = rates(claim, dict(zip(STEERED, state[k][:, None], strict=True)) | known)[:, 0]
        assert np.allclose(found[:2], rate[[1, 3]], atol=1e-9)
        # the filters are held for one period in the law; the modelled sway of the present step enters the thrust
        assert np.allclose((np.ravel(after["crab"]) - crab) / dt, found[4], rtol=0.04, atol=2e-4)
        assert np.allclose((np.ravel(after["sway"]) - s) / dt, found[5], rtol=0.08, atol=2e-3)
        moved = state[k].copy()
        moved[4:] = np.ravel(after["crab"])[0], np.ravel(after["sway"])[0]
        now = dict(zip(STEERED, moved[:, None], strict=True)) | known
        assert np.allclose(rates(claim, now)[2:4, 0], rate[[5, 7]], atol=1e-9)


def gains_of(draw: np.random.Generator) -> dict[str, list[float]]:
    """Gains of the law for a craft with or without fins, which drifts outwards or inwards."""
    axes = {name: draw.uniform(1, 50, 4).tolist() for name in ("mass", "linear_drag", "quadratic_drag", "thrust_limit")}
    single = {
        name: [float(draw.uniform(0.2, 2))] for name in ("cruise", "lookahead", "sideslip", "k_psi", "k_r", "crab_time")
    }
    drift = {"munk": [float(draw.uniform(-50, 50))], "centripetal": [float(draw.uniform(-40, 40))]}
    return {**axes, **single, **drift, "fin_share": [float(draw.choice([0.0, 0.4, 1.0]))]}


def test_the_planned_yaw_rate_of_the_texts_is_that_of_the_law() -> None:
    draw, cases = np.random.default_rng(7), set[Any]()
    for _ in range(40):
        gains, speed = gains_of(draw), float(draw.uniform(0.1, 3))
        if draw.random() < 0.2:
            gains["linear_drag"][1] = 0.0
        cases.add((gains["centripetal"][0] < 0, gains["fin_share"][0]))
        p = {name: ca.SX(ca.DM(values)) for name, values in gains.items()}
        own = values_at(["u"], np.array([[speed]]), {"": _planned(gains, "u")})[""][0]
        assert own == pytest.approx(float(planned_yaw_rate(p, ca.SX(speed))), rel=1e-12)
    assert len(cases) == 6


@pytest.mark.parametrize("names", [["other", "u"], ["u", "other"], ["Y0", "u"], ["u", "Ywv"]])
def test_a_loop_has_no_other_parameters(names: list[str]) -> None:
    with pytest.raises(Rejected, match="is not part of the heading loop"):
        heading_loop(gains_of(np.random.default_rng(1)), names)


def test_a_craft_without_coupling_or_added_mass_has_its_own_motion() -> None:
    texts = heading_loop(gains_of(np.random.default_rng(1)), ["u", "share", "m22", "m44"])
    at = {
        "u": 1.2,
        "share": 1.0,
        "m22": 4.0,
        "m44": 3.0,
        "y_e": 0.1,
        "psi": 0.2,
        "v": 0.3,
        "r": 0.05,
        "crab": 0.1,
        "sway": 0.2,
    }
    values = values_at([*at], np.array([[*at.values()]]).T, texts)
    assert values["v"][0] == 0 and values["r"][0] == pytest.approx((values["moment"][0] - 4 * 1.2 * 0.3) / 3, rel=1e-12)


def test_v_decays_at_points_of_the_region_for_drawn_parameters() -> None:
    dynamics, function = nominal_motion(whole := document())
    rng = np.random.default_rng(0)
    xi = rng.normal(size=(len(dynamics.states), 4000))
    w = np.where(rng.random((len(dynamics.parameters), 4000)) < 0.7, *dynamics.ranges[:, :, None])
    both = dynamics.compiled(function, dynamics.change(function))
    xi *= np.sqrt(rng.random(4000) / np.asarray(both(xi, w))[0])  # V ≤ 1
    value, change = np.asarray(both(xi, w))
    assert value.max() <= 1.0001 and np.all(change < -whole["claim"]["rate"] * value)
